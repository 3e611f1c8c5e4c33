"""Names that have moved: the old module forwards them, with a warning, until 0.3."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def forwarded(
    module: str, target: str | Mapping[str, str], find: Callable[[str], Any] | None = None
) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a module whose names have moved; nothing is imported before a name is asked for.

    Parameters
    ----------
    module
        The old module's name, ``__name__``.
    target
        The module that has all of the names now, or for each old name its place, such as ``"eldata.new:name"``.
    find
        The module's own ``__getattr__``, for the names that have not moved.
    """

    def forward(name: str) -> Any:
        place = f"{target}:{name}" if isinstance(target, str) else target.get(name, "")
        new_module, _, new_name = place.partition(":")
        if name.startswith("__") or not new_module:
            if find is not None:
                return find(name)
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        found = getattr(import_module(new_module), new_name)
        warnings.warn(
            f"{module}.{name} is {new_module}.{new_name} now; the old name will be removed in version 0.3",
            DeprecationWarning,
            stacklevel=2,
        )
        return found

    return forward
