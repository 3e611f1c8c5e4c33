"""Pairs and clips of a store: random crops, equal to the files' to the bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.fields import no_search_for_cycles
from eldata.datasets.base import SourcePairs
from eldata.datasets.clips import ClipWindows
from eldata.errors import DatasetError
from eldata.manifest.pairs import Choice
from eldata.sources.store.read import Store

if TYPE_CHECKING:
    from collections.abc import Collection
    from fractions import Fraction
    from pathlib import Path

    from eldata.datasets.crops import Region
    from eldata.datasets.items import Crops
    from eldata.manifest.clips import FrameRange
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip, FrameLevels


class PackedStore(SourcePairs):
    """Pairs from a store that ``eldata pack`` made: ``dataset[i]`` is a :class:`~eldata.datasets.base.Sample`.

    Each item is a random crop of both frames of a pair, in one of eight orientations. Its values are those of the raw
    route (:class:`~eldata.datasets.base.PairDataset` on the files) at the same place, bit for bit. Draws are those of
    the raw route too: another each time that an item is asked for, unless :meth:`set_epoch` fixes them.

    Parameters
    ----------
    path
        The store.
    cameras, scenes, isos, ratios, split, subset, exclude_flags, levels, clip, amplification, dark_shading, crop, \
    augment, crops, crops_per_frame, seed
        As for :class:`~eldata.datasets.base.PairDataset`: the store holds DN, so nothing of them is fixed by it.

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

    source: Store

    def __init__(
        self,
        path: Path | str,
        *,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0,
    ) -> None:  # fmt: skip
        choice = Choice(cameras, scenes, isos, ratios, split, subset, exclude_flags)
        with no_search_for_cycles():
            source = Store(path)
            super().__init__(
                source, source.pairs(choice), name=source.dataset,
                levels=levels or source.levels, clip=clip, amplification=amplification, dark_shading=dark_shading,
                crop=crop, augment=augment, crops=crops, crops_per_frame=crops_per_frame, seed=seed,
            )  # fmt: skip

    def _place(self) -> str:
        return str(self.source.path)


class PackedClips(ClipWindows):
    """Windows of clips of a store: ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample`.

    The clips are those that have a reference, or with ``dynamic`` those that have none, such as DRV's dynamic ones.
    Each item is a window of consecutive frames and their one reference, all cut at the same random place and turned the
    same way. The values are those of :class:`~eldata.datasets.published.DRVDataset` on the files, bit for bit.

    Parameters
    ----------
    path
        The store, as ``eldata pack drv`` or ``eldata pack drv-raw`` makes it.
    dynamic, ids, window, stride, frames, region, crops_per_window, cameras, scenes, isos, ratios, split, subset, \
    exclude_flags, levels, clip, amplification, dark_shading, crop, augment, crops, seed
        As for :class:`~eldata.datasets.clips.ClipWindows`.

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

    def __init__(
        self,
        path: Path | str,
        *,
        dynamic: bool = False,
        ids: Collection[str] | None = None, window: int = 5, stride: int | None = None, frames: FrameRange = "all",
        region: Region | None = None, crops_per_window: int = 1,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels = "metadata", clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        source = Store(path)
        if source.manifest is None:
            raise DatasetError(f"{source.path}: holds clean frames, not clips; read it with CleanFrames or CleanClips")
        noisy = [row for row in source.manifest.records if row.role == "noisy"]
        if any(row.ratio is not None for row in noisy):
            raise DatasetError(f"{source.path}: holds pairs, not clips; read it with PackedStore")
        of_kind = {row.scene for row in noisy if (row.reference is None) == dynamic}
        if not of_kind:
            what = "without" if dynamic else "with"
            raise DatasetError(f"{source.path}: holds no clip {what} a reference; read it with dynamic={not dynamic}")
        rows = [row for row in source.manifest.records if row.scene in of_kind]
        subsets = source.manifest.card.subsets
        super().__init__(
            source, rows, subsets, source.path, dynamic=dynamic,
            cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, ids=ids, window=window, stride=stride, frames=frames, region=region,
            crops_per_window=crops_per_window, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, seed=seed,
        )  # fmt: skip
