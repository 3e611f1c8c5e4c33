"""The datasets by name: those of this package, and those that other installed packages register.

A package of yours registers a dataset with an entry point of the group ``eldata.datasets``: its name, and the place of
its class (docs/adding-a-dataset.md). Nothing of it is imported before that dataset is asked for.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from pathlib import Path

# The group of entry points under which other packages name their datasets.
ENTRY_POINTS = "eldata.datasets"


# A dataset's name is that of its manifest; the place of its class, for commands that read this need no torch; and the
# options that tell manifests apart which one class reads.
_ENTRIES: dict[str, tuple[str, dict[str, str]]] = {
    "eld": ("eldata.datasets.eld:ELDDataset", {}),
    "sid-sony": ("eldata.datasets.sid:SIDDataset", {"camera": "sony"}),
    "sid-fuji": ("eldata.datasets.sid:SIDDataset", {"camera": "fuji"}),
    "drv": ("eldata.datasets.drv:DRVDataset", {}),
    "lrd": ("eldata.datasets.lrd:LRDDataset", {}),
}


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets: this package's own, then those of other packages."""
    return tuple(dict.fromkeys((*_ENTRIES, *sorted(point.name for point in entry_points(group=ENTRY_POINTS)))))


def dataset_class(name: str) -> type[Any]:
    """Return a dataset's class: one of pairs (:class:`~eldata.datasets.base.PairDataset`) or of clips (DRV).

    Raises
    ------
    ArgumentError
        If the name is unknown (the message lists the known ones), or several packages register it.
    DatasetError
        If the class that another package registers is not to be found.
    """
    place, _ = _entry(name)
    module, _, attribute = place.partition(":")
    try:
        found: type[Any] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise DatasetError(f"dataset {name!r} is registered as {place}, which cannot be imported: {error}") from error
    return found


def open_dataset(name: str, root: Path | str | None = None, **options: Any) -> Any:
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
        If the name is unknown (the message lists the known ones), or several packages register it.
    EldataError
        As :func:`dataset_class` and the class do.
    """
    return dataset_class(name)(root, **_entry(name)[1] | options)  # each class has keywords of its own


def _entry(name: str) -> tuple[str, dict[str, str]]:
    own = [_ENTRIES[name]] if name in _ENTRIES else []
    found = own + [(point.value, {}) for point in entry_points(group=ENTRY_POINTS, name=name)]
    if not found:
        raise ArgumentError(f"no dataset is called {name!r}; known are {', '.join(dataset_names())}")
    if len(found) > 1:
        places = ", ".join(place for place, _ in found)
        raise ArgumentError(f"{len(found)} datasets are called {name!r}: {places}; import the one that you want")
    return found[0]
