"""Windows of clips from a store: random crops, equal to the bit to those of the files."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar, cast

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.base.compiled import in_threads
from eldata.datasets.batches import Field, new_arrays, new_batch, reading_threads
from eldata.datasets.clips import ClipSample, UnpairedClipSample
from eldata.datasets.draws import CleanCrop, RgbCrop, SharedEpoch
from eldata.datasets.stored_clean import stored_clean_frame, stored_mosaic
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.manifest.clips import clips_of, select_rows, windows
from eldata.raw.cfa import CLIP_RANGES, pack_normalised
from eldata.raw.levels import LEVELS, white_level_dn, with_levels
from eldata.records import Exposure
from eldata.sources.store.layout import StoredFrame, StoredRgb
from eldata.sources.store.read import PixelReader, open_store

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    from eldata.manifest.clips import ClipRecord, FrameRange
    from eldata.raw.cfa import Clip
    from eldata.raw.levels import Levels
    from eldata.records import FrameRecord, Sensor
    from eldata.sources.store.layout import Store

Sample = TypeVar("Sample")
Stored = StoredFrame | StoredRgb


@dataclass(frozen=True, slots=True)
class _Frame:
    """One frame of a clip before its pixels: with the chosen levels, and what it is multiplied by.

    For RGB frames that is nan: they are amplified already, and no file states by what.
    """

    stored: Stored
    sensor: Sensor | None
    ratio: float


class _Item(NamedTuple):
    """One item before its pixels are read: its window, the part of every frame, the shape of what it becomes."""

    record: ClipRecord
    frames: tuple[_Frame, ...]
    reference: _Frame | None
    crop: CleanCrop | RgbCrop
    shape: tuple[int, int, int]


class _StoredWindows(Dataset[Sample], Generic[Sample]):
    """What :class:`PackedClips` and :class:`PackedUnpairedClips` share."""

    _has_reference: bool
    _other: str

    def __init__(
        self,
        path: Path | str,
        *,
        crop: int | None = 512,
        augment: bool = True,
        crops_per_window: int = 1,
        seed: int = 0,
        window: int = 5,
        stride: int | None = None,
        frames: FrameRange = "all",
        splits: Collection[str] | None = None,
        ids: Collection[str] | None = None,
        levels: Levels = "metadata",
        clip: Clip = "both",
    ) -> None:
        for name, value, known in (("levels", levels, LEVELS), ("clip", clip, tuple(CLIP_RANGES))):
            check_choice(name, value, known)
        if seed < 0:
            raise ArgumentError(f"seed must be 0 or more; found {seed}")
        if crops_per_window < 1 or (crop is not None and crop < 2):
            raise ArgumentError(
                f"crops_per_window must be 1 or more and crop 2 or more; found {crops_per_window}, {crop}"
            )
        store = open_store(path)
        rows = self._rows(store)
        wanted = {row.split for row in rows} if splits is None else splits
        chosen = select_rows(rows, splits=wanted, ids=ids)
        self.root = store.path
        self.name = store.dataset
        self.levels: Levels = levels
        self.clip: Clip = clip
        self.crop = crop
        self.augment = augment
        self.crops_per_window = crops_per_window
        self.seed = seed
        self.clips = clips_of(chosen)
        step = window if stride is None else stride
        self.records: tuple[ClipRecord, ...] = tuple(
            record for one in self.clips for record in windows(one, length=window, stride=step, frames=frames)
        )
        stored: dict[str, Stored] = {frame.path: frame for frame in store.frames}
        stored |= {frame.path: frame for frame in store.rgb}
        self._frames: dict[str, _Frame] = {}
        for one in self.clips:
            self._frames |= _frames_of(store, one.reference, one.frames, stored, levels)
        self._text = f"{len(self.clips)} clips, {len(self.records)} windows of {window} frames (frames={frames!r})"
        self._reader = PixelReader(store.path)
        self._compression = store.compression
        self._epoch = SharedEpoch()

    def _rows(self, store: Store) -> tuple[FrameRecord, ...]:
        """Return the rows of the clips that have a reference, or of those that have none."""
        if store.manifest is None:
            raise DatasetError(f"{store.path}: holds clean frames, not clips; read it with StoredFrames or StoredClips")
        noisy = [row for row in store.manifest.records if row.role == "noisy"]
        if any(row.ratio is not None for row in noisy):
            raise DatasetError(f"{store.path}: holds pairs, not clips; read it with PackedStore")
        scenes = {row.scene for row in noisy if (row.reference is not None) == self._has_reference}
        if not scenes:
            what = "with" if self._has_reference else "without"
            raise DatasetError(f"{store.path}: holds no clip {what} a reference; read it with {self._other}")
        return tuple(row for row in store.manifest.records if row.scene in scenes)

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return self._epoch.value

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        self._epoch.set(epoch)

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a pandas DataFrame, one row a window."""
        import pandas as pd

        return pd.DataFrame([asdict(record) | {"paths": list(record.paths)} for record in self.records])

    def __len__(self) -> int:
        return len(self.records) * self.crops_per_window

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Sample:
        """Read one window's crop.

        Raises
        ------
        IndexError
            If the index is outside.
        DatasetError
            If a frame is smaller than the crop (with ``augment`` raw frames need one period of the CFA more).
        StoreError
            If the store cannot be read.
        """
        item = self._item(index)
        arrays = new_arrays([Field(name, shape, "<f4") for name, shape in self._shapes(item).items()])
        in_threads(
            partial(self._read, item, arrays), range(-1, len(item.frames)), reading_threads(self._compression, 1)
        )
        return cast("Sample", self._facts(item) | {name: torch.from_numpy(array) for name, array in arrays.items()})

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Read the windows of a batch into memory that is used again (:mod:`eldata.datasets.batches`).

        torch's DataLoader calls this. The values are those of ``dataset[i]``; errors too.
        """
        items = [self._item(index) for index in indices]
        fields = [Field(name, (len(items), *shape), "<f4") for name, shape in self._shapes(items[0]).items()]
        batch = new_batch(fields) if len({item.shape for item in items}) == 1 else None
        if batch is None:
            return [self[index] for index in indices]

        def work(place: tuple[int, int]) -> None:
            number, step = place
            self._read(items[number], {name: array[number] for name, array in batch.arrays.items()}, step)

        in_threads(
            work,
            [(number, step) for number, item in enumerate(items) for step in range(-1, len(item.frames))],
            reading_threads(self._compression, len(items)),
        )
        return batch.parts([self._facts(item) for item in items])

    def _item(self, index: int) -> _Item:
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is outside of {len(self)} items")
        index %= len(self)
        record = self.records[index % len(self.records)]
        frames = tuple(self._frames[path] for path in record.paths)
        generator = np.random.default_rng([self.seed, self.epoch, index])
        first = frames[0].stored
        crop: CleanCrop | RgbCrop
        if isinstance(first, StoredRgb):
            crop = RgbCrop.draw(
                str(self.root / first.path),
                (first.height, first.width),
                generator,
                crop=self.crop,
                augment=self.augment,
            )
            shape = 3, crop.height, crop.width
        else:
            like = stored_clean_frame(self._reader, first, white_level_dn(first.sensor, self.levels))
            crop = CleanCrop.draw(like, generator, crop=self.crop, augment=self.augment)
            shape = crop.packed_shape
        reference = None if record.reference is None else self._frames[record.reference]
        return _Item(record, frames, reference, crop, shape)

    def _shapes(self, item: _Item) -> dict[str, tuple[int, ...]]:
        shapes: dict[str, tuple[int, ...]] = {"input": (len(item.frames), *item.shape)}
        return shapes if item.reference is None else shapes | {"target": item.shape}

    def _read(self, item: _Item, arrays: Mapping[str, NDArray[np.float32]], step: int) -> None:
        """Fill one frame of a window, or its reference (-1), in the arrays of a sample."""
        if step >= 0:
            frame, out = item.frames[step], arrays["input"][step]
        elif item.reference is not None:
            frame, out = item.reference, arrays["target"]
        else:
            return
        stored, crop = frame.stored, item.crop
        if isinstance(stored, StoredRgb) or isinstance(crop, RgbCrop) or frame.sensor is None:
            rows, columns = (range(part.start, part.stop) for part in crop.slices)
            planes = self._reader.read_planes(stored.key, rows, columns)
            for plane, target in zip(planes, out, strict=True):
                np.divide(crop.turned(plane), np.float32(65535), out=target)
            return
        cut = crop.turned(stored_mosaic(self._reader, stored).borrow(crop.slices))
        black, white = frame.sensor.black_level_dn, frame.sensor.white_level_dn
        pack_normalised(cut, crop.cfa, black, white, clip=self.clip, gain=frame.ratio, out=out)

    def _facts(self, item: _Item) -> dict[str, Any]:
        """Return an item's sample without pixels, in the order that samples have."""
        record, first = item.record, item.frames[0]
        exposure = first.stored.exposure if isinstance(first.stored, StoredFrame) else Exposure()
        facts: dict[str, Any] = dict.fromkeys(self._shapes(item))
        facts |= {
            "ratio": first.ratio,
            "iso": float(exposure.iso or math.nan),
            "exposure_s": float(exposure.exposure_s or math.nan),
            "camera": record.camera,
            "scene": record.scene,
            "split": record.split,
            "path": record.path,
            "start": record.start,
        }
        return facts if record.reference is None else facts | {"reference": record.reference}

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({str(self.root)!r}, {self._text}; crop={self.crop}, augment={self.augment}, "
            f"crops_per_window={self.crops_per_window}, seed={self.seed}, levels={self.levels!r}, clip={self.clip!r})"
        )


class PackedClips(_StoredWindows[ClipSample]):
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
    crop
        Side of the square crop in pixels of the (packed) frame, even for X-Trans; ``None`` takes whole frames.
    augment
        Draw one of the eight orientations; a mosaic's CFA stays in order.
    crops_per_window
        Items per window: the length is this times the number of windows, and item i is of window i modulo that number.
    seed
        First part of each item's seed.
    window, stride, frames
        As in :class:`~eldata.datasets.clips.WindowOptions`.
    splits, ids
        Which clips; ``None`` means all that have a reference.
    levels, clip
        Of raw frames, as in :class:`~eldata.datasets.drv.DRVRawDataset`; RGB frames are divided by 65535.

    Raises
    ------
    StoreError
        If the file is no store, truncated, not complete, or of a newer version.
    DatasetError
        If the store holds no clip with a reference; if frames of a clip differ in size, CFA or exposure, or are exposed
        more than their reference.
    ArgumentError
        If an option is unknown or out of its range; the message lists the known ones.
    """

    _has_reference = True
    _other = "PackedUnpairedClips"


class PackedUnpairedClips(_StoredWindows[UnpairedClipSample]):
    """Windows of the clips of a store that have no reference, such as DRV's dynamic ones.

    ``dataset[i]`` is an :class:`~eldata.datasets.clips.UnpairedClipSample`, not amplified. Parameters and errors are
    those of :class:`PackedClips`.
    """

    _has_reference = False
    _other = "PackedClips"


def _frames_of(
    store: Store, reference: str | None, paths: Sequence[str], stored: Mapping[str, Stored], levels: Levels
) -> dict[str, _Frame]:
    """Return the frames of a clip and its reference by path, after making sure that they belong together."""
    every = [*([] if reference is None else [reference]), *paths]
    for path in every:
        if path not in stored:
            raise DatasetError(f"{store.path}: lacks {path}; pack it again")
        kind, other = _kind(stored[path]), _kind(stored[every[0]])
        if kind != other:
            raise DatasetError(f"{store.path / path}: {kind}, but {every[0]} has {other}; are they of one clip?")
    bright = None if reference is None else stored[reference]
    ratios = {path: _ratio(store, stored[path], bright) for path in paths}
    for path, ratio in ratios.items():
        if ratio != ratios[paths[0]]:
            raise DatasetError(
                f"{store.path / path}: its exposure ratio is {_number(ratio):g}, that of {paths[0]} "
                f"{_number(ratios[paths[0]]):g}; are both frames of one clip? (eldata verify finds all such files)"
            )
    frames = {
        path: _Frame(stored[path], _sensor(stored[path], levels), _number(ratio)) for path, ratio in ratios.items()
    }
    if reference is not None and bright is not None:
        frames[reference] = _Frame(bright, _sensor(bright, levels), 1.0)
    return frames


def _kind(frame: Stored) -> str:
    if isinstance(frame, StoredRgb):
        return f"{frame.height} x {frame.width} pixels of RGB"
    return f"{frame.sensor.height} x {frame.sensor.width} pixels of the CFA {frame.sensor.cfa}"


def _sensor(frame: Stored, levels: Levels) -> Sensor | None:
    return None if isinstance(frame, StoredRgb) else with_levels(frame.sensor, levels)


def _number(ratio: Fraction | None) -> float:
    return math.nan if ratio is None else float(ratio)


def _ratio(store: Store, frame: Stored, reference: Stored | None) -> Fraction | None:
    """Return what a frame is multiplied by: 1 without a reference; ``None`` for RGB, of which no file states it."""
    from fractions import Fraction

    from eldata.raw.reading import exposure_ratio

    if isinstance(frame, StoredRgb) or isinstance(reference, StoredRgb):
        return None
    if reference is None:
        return Fraction(1)
    ratio = exposure_ratio(reference.header(store.path), frame.header(store.path))
    if ratio < 1:
        raise DatasetError(
            f"{store.path / frame.path}: is exposed {float(1 / ratio):g} times as much as its reference "
            f"{reference.path}; are they swapped?"
        )
    return ratio
