"""What datasets of clips share: windows of consecutive frames, decoded on demand."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Protocol, TypedDict, TypeVar

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.base.files import inside
from eldata.base.png import rgb_frame
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.manifest.clips import clips_of, select_rows, windows
from eldata.manifest.drv import Layout
from eldata.manifest.patterns import expand
from eldata.raw.cfa import CLIP_RANGES
from eldata.raw.levels import LEVELS, packed_frame
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    from eldata.manifest.clips import ClipRecord, FrameRange
    from eldata.raw.cfa import CfaRows, Clip
    from eldata.raw.levels import Levels
    from eldata.records import FrameRecord, RawFrame

Sample = TypeVar("Sample")
Region = tuple[int, int, int, int]


class _Facts(TypedDict):
    ratio: float
    iso: float
    exposure_s: float
    camera: str
    scene: str
    split: str
    path: str
    start: int


class UnpairedClipSample(_Facts):
    """A window of a clip without a reference, as torch's default collate accepts it.

    ``input`` is (T, C, h, w) float32, normalised, multiplied by ``ratio``. ``iso`` and ``exposure_s`` (seconds) are the
    first frame's. What the files do not state is nan. ``path`` is the first frame's file, ``start`` its position in the
    clip.
    """

    input: torch.Tensor


class ClipSample(_Facts):
    """A window of a clip and its reference, as torch's default collate accepts it.

    ``target`` is the one still that all frames are compared with, (C, h, w) float32: once, for a copy of it for each
    frame would say nothing more. ``target.expand_as(input)`` repeats it without memory, and ``target[:, None]`` does so
    in a batch. The rest is as in :class:`UnpairedClipSample`; ``reference`` is the reference's file.
    """

    input: torch.Tensor
    target: torch.Tensor
    reference: str


# --- reading ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """One decoded frame.

    Attributes
    ----------
    pixels
        (C, h, w) float32, normalised, multiplied by ``ratio``.
    cfa
        That of the mosaic it was packed from; empty for RGB.
    header
        What a raw file states of itself.
    ratio
        nan if no file states it.
    """

    path: Path
    pixels: NDArray[np.float32]
    cfa: CfaRows
    header: RawHeader | None
    ratio: float


class FrameReader(Protocol):
    """Files of one kind to stills."""

    def plain(self, path: Path) -> Still:
        """Decode a frame as it is."""

    def amplified(self, path: Path, reference: Still) -> Still:
        """Decode a noisy frame, brought to the brightness of its reference."""


class RgbReader:
    """Preprocessed frames: 16-bit RGB PNG, divided by 65535; amplified already, by a ratio that no file states."""

    def plain(self, path: Path) -> Still:
        """Decode a frame: (3, h, w) in the order R, G, B."""
        return Still(path, rgb_frame(path), (), None, math.nan)

    def amplified(self, path: Path, reference: Still) -> Still:
        """Decode a noisy frame, which is as bright as its reference already."""
        del reference
        return self.plain(path)

    def __repr__(self) -> str:
        return "16-bit RGB"


class RawReader:
    """Camera raws: packed and normalised, amplified by the exposure ratio that the files state.

    Parameters
    ----------
    levels, clip
        As in :class:`eldata.datasets.base.PairDataset`.

    Raises
    ------
    ArgumentError
        If one is unknown.
    """

    def __init__(self, *, levels: Levels, clip: Clip) -> None:
        for name, value, known in (("levels", levels, LEVELS), ("clip", clip, tuple(CLIP_RANGES))):
            check_choice(name, value, known)
        self.levels: Levels = levels
        self.clip: Clip = clip

    def plain(self, path: Path) -> Still:
        """Decode a frame, not amplified."""
        from eldata.raw.reading import read_raw

        return self._still(read_raw(path), 1.0)

    def amplified(self, path: Path, reference: Still) -> Still:
        """Decode a noisy frame and multiply it by the ratio of (ISO * t) of its reference to its own."""
        from eldata.raw.reading import exposure_ratio, read_raw

        if reference.header is None:
            raise DatasetError(f"{reference.path}: is no raw file, but the reference of one: {path}")
        frame = read_raw(path)
        ratio = exposure_ratio(reference.header, frame)
        if ratio < 1:
            raise DatasetError(
                f"{path}: is exposed {float(1 / ratio):g} times as much as its reference {reference.path}; are they "
                "swapped?"
            )
        return self._still(frame, float(ratio))

    def _still(self, frame: RawFrame, ratio: float) -> Still:
        pixels = packed_frame(frame, levels=self.levels, clip=self.clip, gain=ratio)
        header = RawHeader(frame.path, frame.sensor.make, frame.sensor.model, frame.exposure)
        return Still(frame.path, pixels, frame.sensor.cfa, header, ratio)

    def __repr__(self) -> str:
        return f"levels={self.levels!r}, clip={self.clip!r}"


# --- datasets ---------------------------------------------------------------------------------------------------------


class WindowOptions(TypedDict, total=False):
    """Which windows of which clips, and which part of them: keyword arguments of every dataset of clips.

    Attributes
    ----------
    ids
        Which clips, such as ``["0007", "0013"]``; ``None`` (default) is all.
    window
        Number of frames of a sample; default 5.
    stride
        How far apart the samples of a clip begin; ``None`` (default) is ``window``, so that none overlap.
    frames
        Which frames of a clip (:func:`eldata.manifest.clips.frame_range`): ``"all"`` (default); ``"authors"``, those
        that the DRV repository's test_video.py takes, the fifth to the fourth from the end; ``"evaluation"``, five
        continuous ones as in the ELD paper, the fifth to the ninth (the paper does not say which).
    region
        (top, left, height, width) in pixels of the packed frame: the part that is kept of each frame. ``None``
        (default) is all of it: for DRV 15 MB a frame preprocessed and 80 MB raw.
    """

    ids: Collection[str] | None
    window: int
    stride: int | None
    frames: FrameRange
    region: Region | None


class Windows:
    """Windows of clips of a folder: which there are, and how one is read. Datasets hold one.

    Parameters
    ----------
    root
        The dataset's own folder.
    rows
        Rows of a manifest; patterns are expanded here.
    reader
        How the files are decoded.
    splits
        Which clips.
    ids, window, stride, frames, region
        See :class:`WindowOptions`.

    Raises
    ------
    ArgumentError
        If a split, a clip or a range is unknown, or a number makes no sense.
    DatasetError
        If the files of a chosen clip are not there or not in order.
    """

    def __init__(
        self,
        root: Path,
        rows: Iterable[FrameRecord],
        reader: FrameReader,
        *,
        splits: Collection[str],
        ids: Collection[str] | None = None,
        window: int = 5,
        stride: int | None = None,
        frames: FrameRange = "all",
        region: Region | None = None,
    ) -> None:
        if region is not None and (min(region[:2]) < 0 or min(region[2:]) < 1):
            raise ArgumentError(f"region must be (top, left, height, width), the sizes above 0; found {region}")
        chosen = expand(select_rows(rows, splits=splits, ids=ids), root)
        self.root = root
        self.reader = reader
        self.region = region
        self.layout = Layout.of(chosen)
        self.clips = clips_of(chosen)
        step = window if stride is None else stride
        self.records: tuple[ClipRecord, ...] = tuple(
            record for clip in self.clips for record in windows(clip, length=window, stride=step, frames=frames)
        )
        self.text = f"{len(self.clips)} clips, {len(self.records)} windows of {window} frames (frames={frames!r})"

    def reference(self, record: ClipRecord) -> Still:
        """Decode the whole reference of a window.

        Raises
        ------
        DatasetError
            If the clip has none.
        """
        if record.reference is None:
            raise DatasetError(f"clip {record.scene}: has no reference")
        return self.reader.plain(inside(self.root, record.reference))

    def paired(self, record: ClipRecord) -> ClipSample:
        """Decode a window, amplified to its reference, and the reference."""
        reference = self.reference(record)
        frames, first = self._stack(record, lambda path: self.reader.amplified(path, reference))
        _check_alike(first, reference)
        return ClipSample(
            input=torch.from_numpy(frames),
            target=torch.from_numpy(self._cut(reference)),
            **_facts(record, first),
            reference=record.reference or "",
        )

    def unpaired(self, record: ClipRecord) -> UnpairedClipSample:
        """Decode a window as it is."""
        frames, first = self._stack(record, self.reader.plain)
        return UnpairedClipSample(input=torch.from_numpy(frames), **_facts(record, first))

    def _cut(self, still: Still) -> NDArray[np.float32]:
        if self.region is None:
            return still.pixels
        top, left, height, width = self.region
        if top + height > still.pixels.shape[1] or left + width > still.pixels.shape[2]:
            raise DatasetError(f"{still.path}: region {self.region} is not inside of {still.pixels.shape[1:]} pixels")
        return still.pixels[:, top : top + height, left : left + width].copy()  # or the whole frame stays in memory

    def _stack(self, record: ClipRecord, read: Callable[[Path], Still]) -> tuple[NDArray[np.float32], Still]:
        """Put frames into one array (T, C, h, w), decoded one after the other; return the first as a still too."""
        first = read(inside(self.root, record.paths[0]))
        part = self._cut(first)
        frames = np.empty((len(record.paths), *part.shape), np.float32)
        frames[0] = part
        for place, path in enumerate(record.paths[1:], 1):
            still = read(inside(self.root, path))
            _check_alike(still, first)
            if still.ratio != first.ratio and not math.isnan(first.ratio):
                raise DatasetError(
                    f"{still.path}: its exposure ratio is {still.ratio:g}, that of {first.path.name} {first.ratio:g}; "
                    "are both frames of one clip? (eldata verify finds all such files)"
                )
            frames[place] = self._cut(still)
        return frames, first


def _check_alike(still: Still, other: Still) -> None:
    if still.pixels.shape != other.pixels.shape or still.cfa != other.cfa:
        raise DatasetError(
            f"{still.path}: {still.pixels.shape}, CFA {still.cfa or 'none'}, but {other.path} has "
            f"{other.pixels.shape}, {other.cfa or 'none'}"
        )


def _facts(record: ClipRecord, first: Still) -> _Facts:
    exposure = Exposure() if first.header is None else first.header.exposure
    return _Facts(
        ratio=first.ratio,
        iso=float(exposure.iso or math.nan),
        exposure_s=float(exposure.exposure_s or math.nan),
        camera=record.camera,
        scene=record.scene,
        split=record.split,
        path=record.path,
        start=record.start,
    )


class ClipWindows(Dataset[Sample]):
    """Windows of clips as a dataset: what :class:`PairedClips` and :class:`UnpairedClips` share."""

    def __init__(self, windows: Windows) -> None:
        self._windows = windows

    @property
    def root(self) -> Path:
        """The dataset's own folder."""
        return self._windows.root

    @property
    def records(self) -> tuple[ClipRecord, ...]:
        """The windows, by clip and position."""
        return self._windows.records

    @property
    def layout(self) -> Layout:
        """How the files of the chosen clips lie, as found."""
        return self._windows.layout

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a pandas DataFrame, one row a window."""
        import pandas as pd

        return pd.DataFrame([asdict(record) | {"paths": list(record.paths)} for record in self.records])

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in range(len(self)))

    def __repr__(self) -> str:
        windows = self._windows
        region = "" if windows.region is None else f", region={windows.region}"
        return (
            f"{type(self).__name__}({str(self.root)!r}, {windows.text}; {windows.reader!r}{region}; found: "
            f"{self.layout})"
        )


class PairedClips(ClipWindows[ClipSample]):
    """Windows of clips that have a reference: ``dataset[i]`` is a :class:`ClipSample`.

    Raises
    ------
    DatasetError
        If a clip has no reference.
    """

    def __init__(self, windows: Windows) -> None:
        super().__init__(windows)
        lone = [clip.scene for clip in windows.clips if clip.reference is None]
        if lone:
            raise DatasetError(f"{windows.root}: no reference of {len(lone)} clips: {', '.join(lone)}")

    def __getitem__(self, index: int) -> ClipSample:
        """Decode one window.

        Raises
        ------
        FileError
            If a file is missing or damaged; for raws also if it states no exposure.
        DatasetError
            If the files differ in size or CFA, frames in exposure, a frame is exposed more than its reference, or the
            region is outside.
        """
        return self._windows.paired(self.records[index])


class UnpairedClips(ClipWindows[UnpairedClipSample]):
    """Windows of clips without a reference: ``dataset[i]`` is an :class:`UnpairedClipSample`, not amplified."""

    def __getitem__(self, index: int) -> UnpairedClipSample:
        """Decode one window; errors as of :class:`PairedClips`."""
        return self._windows.unpaired(self.records[index])
