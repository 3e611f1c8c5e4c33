"""Names of an earlier version that are found where they are now, with a warning."""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def with_moved(find: Callable[[str], Any], module: str, moved: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` that knows names which moved, until version 0.3.

    Parameters
    ----------
    find
        The module's own ``__getattr__``.
    module
        The module's name.
    moved
        Old name -> ``<module>:<name>`` of what took its place.
    """

    def find_or_forward(name: str) -> Any:
        if name not in moved:
            return find(name)
        place, _, new = moved[name].partition(":")
        warnings.warn(
            f"{module}.{name} is {place}.{new} now; the old name goes with version 0.3",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module(place), new)

    return find_or_forward
