"""Synthetic pairs and clips: clean crops and windows with noise made on the fly.

Noisy and clean clips of the same motion cannot be filmed at once; adding noise to clean clips gives such pairs (K. Wei
et al., TPAMI 2021, section 4.6: parameters are drawn once per clip, noise for each frame).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.datasets.crops import Crop
from eldata.datasets.items import Part
from eldata.datasets.synthetic.draws import NoiseFacts
from eldata.datasets.synthetic.noisy_items import NoisyItem, NoisyItems
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    import torch

    from eldata.datasets.clean import CleanSource, ClipSource
    from eldata.datasets.items import Crops
    from eldata.datasets.synthetic.draws import Cameras, Isos
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.profile import RowChoice
    from eldata.raw.levels import Clip
    from eldata.sources.frames import Frame


class SyntheticSample(NoiseFacts):
    """One synthetic pair, as torch's default collate accepts it.

    ``input`` and ``target`` are (C, h, w) float32, normalised; the input is amplified by ``ratio``. ``path`` says where
    the clean frame comes from. The rest are the parameters that its noise was made with.
    """

    input: torch.Tensor
    target: torch.Tensor
    path: str


class SyntheticPairs(NoisyItems[SyntheticSample]):
    """Clean crops and noisy exposures of them, made again each time that they are asked for.

    The k-th time that item i is asked for it is draw k, which depends on (seed, k, i) alone, whatever the workers;
    after :meth:`set_epoch` always that of the epoch, in workers that are running too.

    Parameters
    ----------
    source
        Clean frames: :class:`~eldata.datasets.clean.CleanFrames`,
        :class:`~eldata.datasets.synthetic.arrays.Arrays`, or anything with their two methods.
    profiles
        One camera profile or several (one is drawn for each item), by name, path or object.
    crops_per_frame
        Items per clean frame: the length is this times the number of frames.
    model
        The noise model: a :class:`~eldata.noise.model.NoiseModel`, by default (``None``) the full one, or a callable of
        your own (:class:`~eldata.noise.makers.NoiseMaker`). With real dark frames it is
        ``NoiseModel("P*+D", dark_frames=DarkFrames(...))``: each frame of an ISO is used once before any is used twice.
    clip
        Of the input, as in every dataset of pairs: give those that you test on the same. The target, which stands for
        light, lies in [0, 1] whatever it is.
    ratio
        Low-light factors: (lowest, highest), drawn uniformly, or one fixed number.
    iso
        ``None``: K is drawn for each item, as in the paper; with dark frames, their ISOs, drawn alike. One ISO; or
        several, as a sequence, which are drawn alike, or as a mapping to their weights.
    range_dn
        White minus black level of the simulated camera, in DN, which the profile's figures are in. ``None`` is each
        clean frame's own: right for frames of that camera, and of others with as many bits. Raw files whose range is
        1.5 times the profile's or more, or as much less, need it; with the profile's own they are as bright in photons
        as that camera's. Dark frames take none.
    row, extrapolate
        As in :meth:`eldata.noise.CameraProfile.sample`. By default each of several ISOs has its own row: as it was
        measured, where the profile has all figures of that ISO, else ``"nearest-gain"``; the repr says which. One ISO,
        or a drawn gain, has ``"any"``.
    crop, augment, crops, seed
        As of :class:`~eldata.datasets.base.PairDataset`.

    Raises
    ------
    ArgumentError
        If a value is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata import SyntheticPairs
    >>> from eldata.datasets import Arrays
    >>> clean = Arrays(np.full((2, 4, 128, 128), 0.2, np.float32), range_dn=15871.0)
    >>> pairs = SyntheticPairs(clean, "SonyA7S2", crop=64, crops_per_frame=8, seed=0)
    >>> len(pairs), pairs[0]["input"].shape
    (16, torch.Size([4, 64, 64]))
    >>> bool((pairs[3]["input"] == pairs[3]["input"]).all())
    False
    """

    def __init__(
        self,
        source: CleanSource,
        profiles: Cameras,
        *,
        crops_per_frame: int = 1,
        model: NoiseMaker | None = None, clip: Clip = "both", ratio: float | tuple[float, float] = (100.0, 300.0),
        iso: Isos | None = None, range_dn: float | None = None, row: RowChoice | None = None, extrapolate: bool = False,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(
            source, "frame", profiles, ("crops_per_frame", crops_per_frame), model=model, clip=clip,
            ratio=ratio, iso=iso, range_dn=range_dn, row=row, extrapolate=extrapolate, crop=crop, augment=augment,
            crops=crops, seed=seed,
        )  # fmt: skip
        self.source = source
        self.crops_per_frame = crops_per_frame

    def drawn(self, place: int, generator: np.random.Generator) -> NoisyItem:
        """Draw a crop of frame ``place`` modulo their number, or of a grid its crop, and its noise."""
        number, tile = self._record_of(place, len(self.source))
        frame = self.source.frame(number)
        crop = Crop.draw(frame, generator, crop=self.crop, augment=self.augment, tile=tile)
        return self._noisy(place, generator, frame, crop, [Part("target", frame, is_light=True)])

    def __repr__(self) -> str:
        return self._text(self.source, f"{len(self)} items")


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


class SyntheticClips(NoisyItems[SyntheticClipSample]):
    """Windows of clean clips and noisy exposures of them, made again each time that they are asked for.

    Camera, parameters and ratio are drawn once for a window, and so are its place, crop and orientation, which are the
    same for all of its frames. The noise is fresh in each frame. All else, draws and parameters too, is as in
    :class:`~eldata.datasets.synthetic.pairs.SyntheticPairs`, but for:

    Parameters
    ----------
    source
        Clean clips: :class:`~eldata.datasets.clean.CleanClips`, or anything with its two methods.
    frames
        Length of a window.
    windows_per_clip
        Items per clip: the length of the dataset is this times the number of clips.

    Raises
    ------
    ArgumentError
        If a value is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata import SyntheticClips
    >>> from eldata.datasets import Arrays, CleanClips
    >>> clean = CleanClips([Arrays(np.full((9, 4, 96, 96), 0.2, np.float32), range_dn=15871.0)])
    >>> SyntheticClips(clean, "SonyA7S2", crop=64, seed=0)[0]["input"].shape
    torch.Size([5, 4, 64, 64])
    """

    def __init__(
        self,
        source: ClipSource,
        profiles: Cameras,
        *,
        frames: int = 5,
        windows_per_clip: int = 1,
        model: NoiseMaker | None = None, clip: Clip = "both", ratio: float | tuple[float, float] = (100.0, 300.0),
        iso: Isos | None = None, range_dn: float | None = None, row: RowChoice | None = None, extrapolate: bool = False,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        if frames < 1 or windows_per_clip < 1:
            raise ArgumentError(f"frames and windows_per_clip must be 1 or more; found {frames}, {windows_per_clip}")
        super().__init__(
            source, "clip", profiles, ("windows_per_clip", windows_per_clip), frames, model=model, clip=clip,
            ratio=ratio, iso=iso, range_dn=range_dn, row=row, extrapolate=extrapolate, crop=crop, augment=augment,
            crops=crops, seed=seed,
        )  # fmt: skip
        self.source = source
        self.frames = frames
        self.windows_per_clip = windows_per_clip

    @property
    def reads_parts(self) -> bool:
        """Whether the source's clips say that their frames read parts."""
        return getattr(self.source.clip(0), "reads_parts", False)

    def drawn(self, place: int, generator: np.random.Generator) -> NoisyItem:
        """Draw a window of clip ``place`` modulo their number, or of a crop's clip, its crop and its noise."""
        number, tile = self._record_of(place, len(self.source))
        clip = self.source.clip(number)
        if len(clip) < self.frames:
            raise DatasetError(f"{clip!r}: {len(clip)} frames are too few for a window of {self.frames}")
        start = int(generator.integers(len(clip) - self.frames + 1))
        first = clip.frame(start)
        crop = Crop.draw(first, generator, crop=self.crop, augment=self.augment, tile=tile)
        parts = self._parts(clip, start, first)
        return self._noisy(place, generator, first, crop, parts, self.frames, clip=number, start=start)

    def _parts(self, clip: CleanSource, start: int, first: Frame) -> Iterator[Part]:
        """Yield the clean frames in order."""
        yield Part("target", first, 0, is_light=True)
        for step in range(1, self.frames):
            frame = clip.frame(start + step)
            _check_alike(frame, first)
            yield Part("target", frame, step, is_light=True)
            del frame

    def __repr__(self) -> str:
        return self._text(self.source, f"{len(self)} windows of {self.frames} frames")


def _check_alike(frame: Frame, first: Frame) -> None:
    for name, value, expected in (
        ("size", frame.shape, first.shape),
        ("CFA", frame.cfa, first.cfa),
        ("white level", frame.white_level_dn, first.white_level_dn),
    ):
        if value != expected:
            raise DatasetError(f"{frame.name}: {name} {value}, but {first.name} has {expected}; is it one clip?")
