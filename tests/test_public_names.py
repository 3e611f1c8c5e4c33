"""The public namespace: what the stubs promise is there, whatever was imported before, and light to import."""

from __future__ import annotations

import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from tests.test_architecture import exports
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(".".join(stub.parent.relative_to(ROOT).parts) for stub in (ROOT / "eldata").rglob("__init__.pyi"))


def test_what_the_stubs_promise_is_there_and_documented() -> None:
    for package in PACKAGES:
        module, names = import_module(package), exports(package)
        exported = {name for name in vars(module)["__all__"] if not inspect.ismodule(getattr(module, name))}
        assert exported == set(names) <= set(dir(module)), package
        assert not hasattr(module, "no_such_name"), "hasattr, and getattr with a default, rest on an AttributeError"
        for name, place in names.items():
            value = getattr(module, name)
            assert value is getattr(import_module(place), name)
            if callable(value):
                assert inspect.getdoc(value), f"{package}.{name}"
                is_protocol = getattr(value, "_is_protocol", False)  # nobody calls one
                shown = [] if is_protocol else inspect.signature(value).parameters.values()
                hides = any(parameter.kind is parameter.VAR_KEYWORD for parameter in shown)
                # open_dataset takes the keywords of any class.
                assert hides == (name == "open_dataset"), f"{package}.{name}: an editor shows no keyword"


def test_every_public_module_is_there_after_import_eldata_and_hides_no_function() -> None:
    """An import alone loads none of them, nor what takes long; ``eldata.metrics.psnr`` needs no import of its own.

    Importing ``eldata.manifest.verify`` sets ``eldata.manifest.verify`` to the module, if nothing prevents it.
    """
    modules = sorted(page.stem for page in (ROOT / "docs" / "reference").glob("eldata.*.rst"))
    light = "assert callable(eldata.metrics.psnr) and not {'torch', 'rawpy'} & set(sys.modules)"
    namesakes = [
        f"{package}.{name}"
        for package in PACKAGES
        for name, module in exports(package).items()
        if (ROOT / Path(*package.split(".")) / f"{name}.py").exists() or module == f"{package}.{name}"
    ]
    assert namesakes
    code = "\n".join(
        [
            "import sys, eldata",
            "assert not {'eldata.metrics', 'numpy', 'torch', 'rawpy'} & set(sys.modules)",
            *(light, *modules, *(f"import {name}" for name in namesakes), "eldata.ELDDataset"),
            *(f"assert callable({name})" for name in (*namesakes, "eldata.verify")),
        ]
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
