"""Pairs and clips of a store: random crops, equal to the bit to those of the files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.base.arguments import spell_keywords
from eldata.base.memory import no_search_for_cycles
from eldata.datasets.base import PairCropping, PairOptions, SourcePairs
from eldata.datasets.choices import Representation, understood
from eldata.datasets.clips import ClipWindows, WindowOptions
from eldata.errors import DatasetError
from eldata.manifest.pairs import Choice
from eldata.sources.store.read import StoreFrames

if TYPE_CHECKING:
    from pathlib import Path


class PackedStore(SourcePairs):
    """Pairs from a store that ``eldata pack`` made: ``dataset[i]`` is a :class:`~eldata.datasets.base.Sample`.

    Each item is a random crop of both frames of a pair, in one of eight orientations. Its values are those of the raw
    route (:class:`~eldata.datasets.base.PairDataset` on the files) at the same place, bit for bit. Item i of epoch e
    depends on (seed, e, i) alone: not on workers, their number, or what was read before. Call :meth:`set_epoch` before
    each epoch; it reaches workers that are running already.

    Parameters
    ----------
    path
        The store.
    options
        As for :class:`~eldata.datasets.base.PairDataset`: the store holds DN, so nothing of them is fixed by it. By
        default ``crop=512`` and ``augment=True``.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, or of a newer version.
    DatasetError
        If the store holds no pairs, or frames of a pair differ in size, CFA or exposure ratio from what they should be.
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.

    Notes
    -----
    Each process opens the store for itself, on its first read. Memory does not grow with the store.

    Examples
    --------
    >>> # eldata pack eld-demo --manifest eldata-demo/manifests/eld-demo.csv --root eldata-demo/data -o demo.h5
    >>> from eldata import PackedStore
    >>> store = PackedStore("demo.h5", crop=64, seed=0)
    >>> len(store), store[0]["input"].shape
    (24, torch.Size([4, 64, 64]))
    """

    source: StoreFrames

    @spell_keywords(PairOptions)
    def __init__(self, path: Path | str, **options: Unpack[PairOptions]) -> None:
        choice, representation, cropping = understood(self, options, Choice, Representation, PairCropping)
        with no_search_for_cycles():
            source = StoreFrames(path)
            super().__init__(
                source,
                source.pairs(choice),
                name=source.store.dataset,
                representation=representation | {"levels": representation.get("levels") or source.levels},
                cropping={"crop": 512, "augment": True} | cropping,
            )

    def _place(self) -> str:
        return str(self.source.path)


class PackedClips(ClipWindows):
    """Windows of clips of a store: ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample`.

    The clips are those that have a reference, or with ``dynamic`` those that have none, such as DRV's dynamic ones.
    Each item is a window of consecutive frames and their one reference, all cut at the same random place and turned the
    same way. The values are those of :class:`~eldata.datasets.published.clips.DRVDataset` on the files, bit for bit.
    Item i of epoch e depends on (seed, e, i) alone, as in :class:`PackedStore`.

    Parameters
    ----------
    path
        The store, as ``eldata pack drv`` or ``eldata pack drv-raw`` makes it.
    dynamic, options
        As for :class:`~eldata.datasets.clips.ClipWindows`; by default ``crop=512`` and ``augment=True``.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, or of another version.
    DatasetError
        If the store holds no clip of this kind; if frames of a clip differ in size, CFA or exposure, or are exposed
        more than their reference.
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    """

    @spell_keywords(WindowOptions)
    def __init__(self, path: Path | str, *, dynamic: bool = False, **options: Unpack[WindowOptions]) -> None:
        options.setdefault("crop", 512)
        options.setdefault("augment", True)
        source = StoreFrames(path)
        if source.store.manifest is None:
            raise DatasetError(f"{source.path}: holds clean frames, not clips; read it with CleanFrames or CleanClips")
        noisy = [row for row in source.store.manifest.records if row.role == "noisy"]
        if any(row.ratio is not None for row in noisy):
            raise DatasetError(f"{source.path}: holds pairs, not clips; read it with PackedStore")
        scenes = {row.scene for row in noisy if (row.reference is None) == dynamic}
        if not scenes:
            what = "without" if dynamic else "with"
            raise DatasetError(f"{source.path}: holds no clip {what} a reference; read it with dynamic={not dynamic}")
        rows = [row for row in source.store.manifest.records if row.scene in scenes]
        subsets = source.store.manifest.card.subsets
        super().__init__(source, rows, subsets, source.path, dynamic=dynamic, **options)
