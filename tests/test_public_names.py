"""The public namespace: what the stubs promise is there, whatever was imported before, and light to import."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import eldata
from tests.cases import in_one_test
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(".".join(stub.parent.relative_to(ROOT).parts) for stub in (ROOT / "eldata").rglob("__init__.pyi"))


def promised(package: str) -> dict[str, str]:
    """Name of each thing that a package's stub exports: the module it comes from."""
    tree = ast.parse((ROOT / Path(*package.split(".")) / "__init__.pyi").read_text(encoding="utf-8"))
    names = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                assert alias.asname == alias.name, f"{alias.name}: type checkers take 'import x as x' as an export"
                names[alias.name] = f"{package}.{node.module}"
    return names


def test_the_top_level_has_what_scripts_rely_on() -> None:
    assert set(vars(eldata)["__all__"]) >= {"CalibrationFrames", "ELDDataset", "calibrate", "evaluate", "verify"}
    assert eldata.__version__


@in_one_test("package", PACKAGES)
def test_all_is_what_the_stub_promises(package: str) -> None:
    module = import_module(package)
    assert sorted(vars(module)["__all__"]) == sorted(promised(package))
    assert set(promised(package)) <= set(dir(module))


@in_one_test("package, name", [(package, name) for package in PACKAGES for name in promised(package)])
def test_each_name_resolves_and_is_documented(package: str, name: str) -> None:
    found = getattr(import_module(package), name)
    assert not inspect.ismodule(found), "the function, not the module of the same name"
    assert found is getattr(import_module(promised(package)[name]), name)
    if callable(found):
        assert inspect.getdoc(found)


@in_one_test("package", PACKAGES)
def test_an_unknown_name_is_an_attribute_error(package: str) -> None:
    """hasattr, and getattr with a default, rest on it."""
    assert not hasattr(import_module(package), "no_such_name")


NAMESAKES = [
    (package, name)
    for package in PACKAGES
    for name, module in promised(package).items()
    if (ROOT / Path(*package.split(".")) / f"{name}.py").exists() or module.endswith(f".{name}")
]


# In one new process, whose other packages stay imported: each would cost two seconds more in one of its own.
IMPORTED_ANEW = """
import importlib, sys
for package, name in (line.split() for line in sys.stdin):
    for module in [module for module in sys.modules if module.partition(".")[0] == "eldata"]:
        del sys.modules[module]
    importlib.import_module(f"{package}.{name}")
    import eldata
    eldata.ELDDataset
    where = importlib.import_module(package)
    assert callable(getattr(where, name)), f"{package}.{name}"
    assert callable(eldata.verify) and callable(eldata.evaluate), f"after {package}.{name}"
"""


@pytest.mark.skipif(not NAMESAKES, reason="no function bears its module's name")
def test_a_function_is_not_hidden_by_its_module() -> None:
    """Importing ``eldata.manifest.verify`` sets ``eldata.manifest.verify`` to the module, if nothing prevents it."""
    lines = "".join(f"{package} {name}\n" for package, name in NAMESAKES)
    command = [sys.executable, "-c", IMPORTED_ANEW]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not NAMESAKES, reason="no function bears its module's name")
def test_the_floor_of_lazy_loader_keeps_functions_visible() -> None:
    """Of lazy_loader, 0.6 is the first that keeps a module from hiding its namesake: the test above fails with 0.5."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (floor,) = [line.split(">=")[1] for line in project["dependencies"] if line.startswith("lazy-loader")]
    assert tuple(map(int, floor.split("."))) >= (0, 6)
