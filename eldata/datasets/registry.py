"""The datasets that this package knows, by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from eldata.datasets.base import PairDataset


@dataclass(frozen=True, slots=True)
class _Entry:
    """Name of a class, not the class: the registry is read by commands that need no torch."""

    place: str
    options: Mapping[str, str] = field(default_factory=dict)


# A dataset's name is that of its manifest. Some classes read several.
_ENTRIES = {
    "eld": _Entry("eldata.datasets.eld:ELDDataset"),
    "sid-sony": _Entry("eldata.datasets.sid:SIDDataset", {"camera": "sony"}),
    "sid-fuji": _Entry("eldata.datasets.sid:SIDDataset", {"camera": "fuji"}),
}


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets."""
    return tuple(_ENTRIES)


def dataset_class(name: str) -> type[PairDataset]:
    """Return a dataset's class.

    Raises
    ------
    ArgumentError
        If the name is unknown; the message lists the known ones.
    """
    module, _, attribute = _entry(name).place.partition(":")
    found: type[PairDataset] = getattr(import_module(module), attribute)
    return found


def open_dataset(name: str, root: Path | str | None = None, **options: Any) -> PairDataset:
    """Return a dataset by name: ``open_dataset("sid-fuji", root)`` is ``SIDDataset(root, camera="fuji")``.

    Parameters
    ----------
    name
        One of :func:`dataset_names`.
    root
        The dataset's own folder.
    options
        Keyword arguments of its class.

    Raises
    ------
    ArgumentError
        If the name is unknown; the message lists the known ones.
    EldataError
        As the class does.
    """
    build: Any = dataset_class(name)  # each class has keyword arguments of its own
    opened: PairDataset = build(root, **{**_entry(name).options, **options})
    return opened


def _entry(name: str) -> _Entry:
    if name not in _ENTRIES:
        raise ArgumentError(f"no dataset is called {name!r}; known are {', '.join(_ENTRIES)}")
    return _ENTRIES[name]
