"""Synthetic clips: clean moving frames with noise made on the fly.

Noisy and clean clips of the same motion cannot be filmed at once; adding noise to clean clips gives such pairs (K. Wei
et al., TPAMI 2021, section on videography: parameters are drawn once a clip, noise for each frame).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch

from eldata.datasets.clean import Arrays, RawFiles
from eldata.datasets.draws import CleanCrop, NoiseChoice, NoiseFacts
from eldata.datasets.noisy_items import NoisyItems
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.patterns import sequence_of
from eldata.raw.extensions import RAW_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.datasets.clean import CleanFrame, CleanSource
    from eldata.datasets.draws import NoiseDraw
    from eldata.noise.model import NoiseModel
    from eldata.noise.profile import CameraProfile, RowChoice
    from eldata.raw.cfa import CfaRows
    from eldata.raw.levels import Levels


class ClipSource(Protocol):
    """What :class:`SyntheticClips` draws its clean windows from: for each clip, a source of its frames in order."""

    def __len__(self) -> int:
        """Return the number of clips."""

    def clip(self, index: int) -> CleanSource:
        """Return the frames of one clip; they are decoded one by one."""


class RawClips:
    """Clean clips of raw files: folders, one a clip, whose files are in the order of the numbers in their names.

    Parameters
    ----------
    folders
        A folder: each folder at any depth below it that holds camera raws is a clip. Or these folders themselves.
    levels
        As in :class:`~eldata.datasets.clean.RawFiles`.

    Raises
    ------
    DatasetError
        If there is no clip, or the names of a clip do not follow one numbering.
    """

    def __init__(self, folders: Path | str | Iterable[Path | str], *, levels: Levels = "metadata") -> None:
        if isinstance(folders, (str, Path)):
            top = Path(folders)
            found = sorted({path.parent for path in top.rglob("*") if path.suffix.lower() in RAW_EXTENSIONS})
            if not found:
                raise DatasetError(f"{top}: holds no folder with camera raws")
        else:
            found = [Path(folder) for folder in folders]
            if not found:
                raise DatasetError("no folder was given")
        self.folders: tuple[Path, ...] = tuple(found)
        self.levels: Levels = levels
        self._clips = tuple(RawFiles(_frames_of(folder), levels=levels) for folder in found)

    def __len__(self) -> int:
        return len(self._clips)

    def clip(self, index: int) -> RawFiles:
        """Return the frames of one clip."""
        return self._clips[index]

    def __repr__(self) -> str:
        return f"RawClips({len(self)} clips, first {self.folders[0]}, levels={self.levels!r})"


def _frames_of(folder: Path) -> list[Path]:
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    raws = [name for name in names if Path(name).suffix.lower() in RAW_EXTENSIONS and not name.startswith(".")]
    sequence = sequence_of(raws)
    if not raws:
        raise DatasetError(f"{folder}: holds no camera raw file")
    if sequence.odd or sequence.doubles or sequence.gaps:
        what = ", ".join(sequence.odd) or f"two of {sequence.doubles}"
        if sequence.gaps:
            what = f"nothing from {sequence.gaps[0][0]} to {sequence.gaps[0][1]}"
        raise DatasetError(f"{folder}: expected the frames of one clip, numbered without a gap; found {what}")
    return [folder / name for name in sequence.names]


class ArrayClips:
    """Clean clips from packed, normalised arrays (T, C, h, w) in memory (or memory-mapped).

    Parameters
    ----------
    arrays
        One array a clip; their lengths and sizes may differ.
    range_dn, cfa
        As in :class:`~eldata.datasets.clean.Arrays`.

    Raises
    ------
    ArgumentError
        If there is no array or ``range_dn`` is not positive.
    """

    def __init__(self, arrays: Sequence[NDArray[Any]], *, range_dn: float, cfa: CfaRows = ((0, 1), (3, 2))) -> None:
        if len(arrays) == 0:
            raise ArgumentError("no array was given")
        self._clips = tuple(Arrays(array, range_dn=range_dn, cfa=cfa) for array in arrays)

    def __len__(self) -> int:
        return len(self._clips)

    def clip(self, index: int) -> Arrays:
        """Return the frames of one clip."""
        return self._clips[index]

    def __repr__(self) -> str:
        return f"ArrayClips({len(self)} clips, first {self._clips[0]!r})"


class SyntheticClipSample(NoiseFacts):
    """One synthetic window, as torch's default collate accepts it.

    ``input`` and ``target`` are (T, C, h, w) float32, normalised; the input is amplified by ``ratio``. ``path`` says
    where the first clean frame comes from, ``clip`` is the clip's place in the source, ``start`` the first frame's in
    the clip. The rest are the parameters that the noise of all frames was made with.
    """

    input: torch.Tensor
    target: torch.Tensor
    path: str
    clip: int
    start: int


class _Item(NamedTuple):
    clip: CleanSource
    place: int
    start: int
    first: CleanFrame
    crop: CleanCrop
    draw: NoiseDraw
    generator: np.random.Generator
    shape: tuple[int, int, int, int]

    @property
    def range_dn(self) -> float:
        return self.first.range_dn


class SyntheticClips(NoisyItems[_Item, SyntheticClipSample]):
    """Windows of clean clips and noisy exposures of them, made anew in each epoch.

    Camera, parameters and ratio are drawn once for a window, and so are its place, crop and orientation, which are the
    same for all of its frames. The noise is fresh in each frame. Item i of epoch e depends on (seed, e, i) alone, as in
    :class:`~eldata.datasets.synthetic.SyntheticPairs`, whose parameters these are but for:

    Parameters
    ----------
    source
        Clean clips: :class:`RawClips`, :class:`ArrayClips`, or anything with their two methods.
    frames
        Length of a window.
    windows_per_clip
        Items per clip: the length of the dataset is this times the number of clips.

    Raises
    ------
    ArgumentError
        If a value is out of its range.
    """

    def __init__(
        self,
        source: ClipSource,
        profiles: CameraProfile | str | Sequence[CameraProfile | str],
        *,
        frames: int = 5,
        model: NoiseModel | None = None,
        ratio: float | tuple[float, float] = (100.0, 300.0),
        crop: int | None = 512,
        augment: bool = True,
        windows_per_clip: int = 1,
        seed: int = 0,
        iso: float | None = None,
        row: RowChoice = "any",
    ) -> None:
        if frames < 1 or windows_per_clip < 1:
            raise ArgumentError(f"frames and windows_per_clip must be 1 or more; found {frames}, {windows_per_clip}")
        super().__init__(NoiseChoice.of(profiles, ratio, iso, row), model, crop=crop, augment=augment, seed=seed)
        self.source = source
        self.frames = frames
        self.windows_per_clip = windows_per_clip

    def __len__(self) -> int:
        return len(self.source) * self.windows_per_clip

    def _drawn(self, index: int, generator: np.random.Generator) -> _Item:
        place = index % len(self.source)
        clip = self.source.clip(place)
        if len(clip) < self.frames:
            raise DatasetError(f"{clip!r}: {len(clip)} frames are too few for a window of {self.frames}")
        start = int(generator.integers(len(clip) - self.frames + 1))
        first = clip.frame(start)
        crop = CleanCrop.draw(first, generator, crop=self.crop, augment=self.augment)
        shape = self.frames, *crop.packed_shape
        return _Item(clip, place, start, first, crop, self.noise.draw(generator), generator, shape)

    def _fill(self, item: _Item, target: NDArray[np.float32]) -> None:
        item.crop.packed(item.first, out=target[0])
        for step in range(1, self.frames):  # one whole frame in memory at a time
            frame = item.clip.frame(item.start + step)
            _check_alike(frame, item.first)
            item.crop.packed(frame, out=target[step])

    def _sample(self, item: _Item, noisy: NDArray[np.float32], target: NDArray[np.float32]) -> SyntheticClipSample:
        return SyntheticClipSample(
            **item.draw.facts(),
            input=torch.from_numpy(noisy),
            target=torch.from_numpy(target),
            path=item.first.name,
            clip=item.place,
            start=item.start,
        )

    def __repr__(self) -> str:
        cameras = ", ".join(profile.camera for profile in self.noise.profiles)
        return (
            f"SyntheticClips({self.source!r}, {len(self)} windows of {self.frames} frames, cameras: {cameras}; "
            f"{self.model!r}, ratio={self.noise.ratio}, crop={self.crop}, augment={self.augment}, seed={self.seed})"
        )


def _check_alike(frame: CleanFrame, first: CleanFrame) -> None:
    for name, value, expected in (
        ("size", frame.mosaic.shape, first.mosaic.shape),
        ("CFA", frame.cfa, first.cfa),
        ("white level", frame.white_level_dn, first.white_level_dn),
    ):
        if value != expected:
            raise DatasetError(f"{frame.name}: {name} {value}, but {first.name} has {expected}; is it one clip?")
