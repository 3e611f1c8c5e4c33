"""The public namespace: what the stubs promise is there and documented."""

from __future__ import annotations

import inspect
from importlib import import_module
from pathlib import Path

from tests.test_architecture import exports

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
