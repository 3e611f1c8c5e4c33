"""Python objects that a person names: ``package.module:name``."""

from __future__ import annotations

import importlib
import sys
from operator import attrgetter
from pathlib import Path
from typing import Any

from eldata.base.visible import in_line
from eldata.errors import ArgumentError


def named_object(place: str) -> Any:
    """Return what ``package.module:name`` names; modules of the current folder are found, as ``python -m`` finds them.

    Raises
    ------
    ArgumentError
        If the text is not such a name, the module cannot be imported, or it has nothing of that name.
    """
    module_name, _, name = place.partition(":")
    if not module_name or not name:
        raise ArgumentError(f"{place!r} names nothing in a module; expected package.module:name")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the module does as it is imported
        said = str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise ArgumentError(in_line(f"{place}: the module {module_name} cannot be imported: {said}")) from error
    try:
        return attrgetter(name)(module)
    except AttributeError:
        raise ArgumentError(f"{place}: the module {module_name} has no {name}") from None
