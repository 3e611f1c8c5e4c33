"""The datasets that this package knows, by name."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from eldata.datasets.base import PairDataset

# Names of classes, not classes: the registry is read by commands that need no torch.
_CLASSES = {"eld": "eldata.datasets.eld:ELDDataset"}


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets."""
    return tuple(_CLASSES)


def dataset_class(name: str) -> type[PairDataset]:
    """Return a dataset's class.

    Raises
    ------
    ArgumentError
        If the name is unknown; the message lists the known ones.
    """
    if name not in _CLASSES:
        raise ArgumentError(f"no dataset is called {name!r}; known are {', '.join(_CLASSES)}")
    module, _, attribute = _CLASSES[name].partition(":")
    found: type[PairDataset] = getattr(import_module(module), attribute)
    return found
