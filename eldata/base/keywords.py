"""Keyword arguments that are typed once, as TypedDicts, and taken by many functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping


def keywords(owner: str, given: Mapping[str, Any], *kinds: type) -> list[Any]:
    """Return keyword arguments by kind: for each TypedDict a dictionary of those that it names.

    Parameters
    ----------
    owner
        Name of the function or class, for messages.
    given
        What it was called with.
    kinds
        TypedDicts whose fields are the known names.

    Raises
    ------
    TypeError
        If a name is unknown (the message lists the known ones).
    """
    known = [tuple(kind.__annotations__) for kind in kinds]
    for name in given:
        if not any(name in names for names in known):
            every = ", ".join(name for names in known for name in names)
            raise TypeError(f"{owner} got an unexpected keyword argument {name!r}; known are {every}")
    return [{name: given[name] for name in names if name in given} for names in known]
