"""The public namespace: what the stubs promise is there, whatever was imported before, and light to import."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import eldata
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(".".join(stub.parent.relative_to(ROOT).parts) for stub in (ROOT / "eldata").rglob("__init__.pyi"))


def promised(package: str) -> dict[str, str]:
    """Name of each thing that a package's stub exports: the module it comes from."""
    tree = ast.parse((ROOT / Path(*package.split(".")) / "__init__.pyi").read_text(encoding="utf-8"))
    names = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                assert alias.asname == alias.name, f"{alias.name}: type checkers take 'import x as x' as an export"
                names[alias.name] = f"{package}.{node.module}"
    return names


def is_protocol(found: object) -> bool:
    """Nobody calls one, and its signature says nothing."""
    return getattr(found, "_is_protocol", False)


def test_the_top_level_has_what_scripts_rely_on() -> None:
    assert set(vars(eldata)["__all__"]) >= {"CalibrationFrames", "ELDDataset", "calibrate", "evaluate", "verify"}
    assert eldata.__version__


def test_what_the_stubs_promise_is_there_and_documented() -> None:
    for package in PACKAGES:
        module, names = import_module(package), promised(package)
        exported = {name for name in vars(module)["__all__"] if not inspect.ismodule(getattr(module, name))}
        assert exported == set(names), package
        assert set(names) <= set(dir(module)), package
        assert not hasattr(module, "no_such_name"), "hasattr, and getattr with a default, rest on an AttributeError"
        for name, place in names.items():
            found = getattr(module, name)
            assert not inspect.ismodule(found), f"{package}.{name}: the function, not the module of the same name"
            assert found is getattr(import_module(place), name)
            if callable(found):
                assert inspect.getdoc(found), f"{package}.{name}"
                shown = [] if is_protocol(found) else inspect.signature(found).parameters.values()
                hides = any(one.kind is one.VAR_KEYWORD for one in shown)
                # open_dataset takes the keywords of any class.
                assert hides == (name == "open_dataset"), f"{package}.{name}: an editor shows no keyword"


def test_every_public_module_is_there_after_import_eldata() -> None:
    """An import alone loads none of them, nor what takes long; ``eldata.metrics.psnr`` needs no import of its own."""
    modules = sorted(page.stem for page in (ROOT / "docs" / "reference").glob("eldata.*.rst"))
    code = "\n".join(
        [
            "import sys, eldata",
            "assert not {'eldata.metrics', 'numpy', 'torch', 'rawpy'} & set(sys.modules)",
            "assert callable(eldata.metrics.psnr) and not {'torch', 'rawpy'} & set(sys.modules)",
            *modules,
        ]
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr


NAMESAKES = [
    (package, name)
    for package in PACKAGES
    for name, module in promised(package).items()
    if (ROOT / Path(*package.split(".")) / f"{name}.py").exists() or module == f"{package}.{name}"
]


def test_a_function_is_not_hidden_by_its_module() -> None:
    """Importing ``eldata.manifest.verify`` sets ``eldata.manifest.verify`` to the module, if nothing prevents it."""
    assert NAMESAKES
    imports = [f"import {package}.{name}, {package}" for package, name in NAMESAKES]
    checks = [f"assert callable({package}.{name}), {package}.{name}" for package, name in NAMESAKES]
    code = "\n".join([*imports, "import eldata; eldata.ELDDataset", *checks, "assert callable(eldata.verify)"])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr


def test_the_floor_of_lazy_loader_keeps_functions_visible() -> None:
    """Of lazy_loader, 0.6 is the first that keeps a module from hiding its namesake: the test above fails with 0.5."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (floor,) = [line.split(">=")[1] for line in project["dependencies"] if line.startswith("lazy-loader")]
    assert tuple(map(int, floor.split("."))) >= (0, 6)
