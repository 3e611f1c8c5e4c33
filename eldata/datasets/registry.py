"""The datasets by name: those of this package, and those that other installed packages register.

A package of yours registers a dataset by an entry point (:mod:`eldata.manifest.catalogue`). Nothing of it is imported
before that dataset is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError, DatasetError, did_you_mean
from eldata.manifest.catalogue import registered_names, registered_place

if TYPE_CHECKING:
    from pathlib import Path

# A dataset's name is that of its manifest; the place of its class, for commands that read this need no torch; and the
# options that tell manifests apart which one class reads.
_ENTRIES: dict[str, tuple[str, dict[str, str]]] = {
    "eld": ("eldata.datasets.published.pairs:ELDDataset", {}),
    "sid-sony": ("eldata.datasets.published.pairs:SIDDataset", {"camera": "sony"}),
    "sid-fuji": ("eldata.datasets.published.pairs:SIDDataset", {"camera": "fuji"}),
    "drv": ("eldata.datasets.published.clips:DRVDataset", {}),
    "crvd": ("eldata.datasets.published.clips:CRVDDataset", {}),
    "lrd": ("eldata.datasets.published.pairs:LRDDataset", {}),
    "lrid": ("eldata.datasets.published.pairs:LRIDDataset", {}),
    "sidd": ("eldata.datasets.published.pairs:SIDDDataset", {}),
    "sidd-blocks": ("eldata.datasets.published.pairs:SIDDDataset", {"manifest": "sidd-blocks"}),
}


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets: this package's own, then those of other packages.

    Examples
    --------
    >>> from eldata.datasets import dataset_names
    >>> dataset_names()
    ('eld', 'sid-sony', 'sid-fuji', 'drv', 'crvd', 'lrd', 'lrid', 'sidd', 'sidd-blocks')
    """
    return tuple(dict.fromkeys((*_ENTRIES, *registered_names())))


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
    own, options = _ENTRIES.get(name, (None, {}))
    place = registered_place(name, own)
    if place is None:
        known = dataset_names()
        hint = did_you_mean(name, known)
        raise ArgumentError(f"no dataset is called {name!r}; known are {', '.join(known)}{hint}")
    return place, options
