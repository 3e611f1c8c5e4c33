"""Keyword arguments that are typed once, as TypedDicts, and taken by many functions."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping


def keywords(owner: str, given: Mapping[str, Any], *kinds: type, renamed: Mapping[str, str]) -> list[Any]:
    """Return keyword arguments by kind: for each TypedDict a dictionary of those that it names.

    Parameters
    ----------
    owner
        Name of the function or class, for messages.
    given
        What it was called with.
    kinds
        TypedDicts whose fields are the known names.
    renamed
        Old names, which are understood with a warning, and the new ones.

    Raises
    ------
    TypeError
        If a name is unknown (the message lists the known ones), or an argument is given by both of its names.
    """
    found = dict(given)
    for old in renamed.keys() & found.keys():
        new = renamed[old]
        if new in found:
            raise TypeError(f"{owner}: {new} was called {old}; give it once")
        warnings.warn(
            f"{owner}: {old} is called {new} now; the old name will be removed in version 0.3",
            DeprecationWarning,
            stacklevel=4,
        )
        found[new] = found.pop(old)
    known = [tuple(kind.__annotations__) for kind in kinds]
    for name in found:
        if not any(name in names for names in known):
            every = ", ".join(name for names in known for name in names)
            raise TypeError(f"{owner} got an unexpected keyword argument {name!r}; known are {every}")
    return [{name: found[name] for name in names if name in found} for names in known]
