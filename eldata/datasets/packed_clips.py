"""Windows of clips from a store: random crops, equal to the bit to those of the files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.datasets.clips import ClipSample, ClipWindows, PairedClips, Sample, UnpairedClips, UnpairedClipSample
from eldata.errors import DatasetError
from eldata.sources.store.read import StoreFrames

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.datasets.clips import ListedClips, WindowOptions


class _Packed(ClipWindows[Sample]):
    """Those clips of a store that have a reference, or those that have none."""

    def __init__(self, path: Path | str, **options: Unpack[WindowOptions]) -> None:
        options.setdefault("crop", 512)
        options.setdefault("augment", True)
        super().__init__(*_clips(path, is_paired=self._is_paired), **options)


class PackedClips(_Packed[ClipSample], PairedClips):
    """Windows of clips of a store: ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample`.

    The clips are those that have a reference. Each item is a window of consecutive frames and their one reference, all
    cut at the same random place and turned the same way. The values are those of
    :class:`~eldata.datasets.drv.DRVDataset` (RGB) or :class:`~eldata.datasets.drv.DRVRawDataset` (raw) on the files,
    bit for bit. Item i of epoch e depends on (seed, e, i) alone, as in
    :class:`~eldata.datasets.packed_store.PackedStore`.

    Parameters
    ----------
    path
        The store, as ``eldata pack drv`` or ``eldata pack drv-raw`` makes it.
    options
        As for :class:`~eldata.datasets.clips.ClipWindows`; by default ``crop=512`` and ``augment=True``.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, not complete, or of a newer version.
    DatasetError
        If the store holds no clip with a reference; if frames of a clip differ in size, CFA or exposure, or are exposed
        more than their reference.
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    """


class PackedUnpairedClips(_Packed[UnpairedClipSample], UnpairedClips):
    """Windows of the clips of a store that have no reference, such as DRV's dynamic ones.

    ``dataset[i]`` is an :class:`~eldata.datasets.clips.UnpairedClipSample`, not amplified. Parameters and errors are
    those of :class:`PackedClips`.
    """


def _clips(path: Path | str, *, is_paired: bool) -> ListedClips:
    """Return the clips of a store that have a reference, or those that have none."""
    source = StoreFrames(path)
    if source.store.manifest is None:
        raise DatasetError(f"{source.path}: holds clean frames, not clips; read it with StoredFrames or StoredClips")
    noisy = [row for row in source.store.manifest.records if row.role == "noisy"]
    if any(row.ratio is not None for row in noisy):
        raise DatasetError(f"{source.path}: holds pairs, not clips; read it with PackedStore")
    scenes = {row.scene for row in noisy if (row.reference is not None) == is_paired}
    if not scenes:
        what, other = ("with", "PackedUnpairedClips") if is_paired else ("without", "PackedClips")
        raise DatasetError(f"{source.path}: holds no clip {what} a reference; read it with {other}")
    rows = [row for row in source.store.manifest.records if row.scene in scenes]
    return source, rows, source.store.manifest.card.subsets, source.path
