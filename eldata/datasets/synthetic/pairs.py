"""Synthetic pairs and clips: clean crops and windows with noise made on the fly.

Noisy and clean clips of the same motion cannot be filmed at once; adding noise to clean clips gives such pairs (K. Wei
et al., TPAMI 2021, section 4.6: parameters are drawn once per clip, noise for each frame).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from eldata.base.numbers import checked_number
from eldata.base.visible import name_of
from eldata.datasets.base import SIDES
from eldata.datasets.batches import threads_here
from eldata.datasets.crops import Crop
from eldata.datasets.items import CroppedItems, Crops, DrawnItem, Part, Transform, keywords_of
from eldata.datasets.synthetic.dark_frames import GAIN_SPREAD, DarkFrames
from eldata.datasets.synthetic.draws import Cameras, Isos, NoiseChoice, Turns
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.noise._kernels import prepare
from eldata.noise.model import NoiseMaker, NoiseModel, check_noise_maker, made_exposure
from eldata.raw.levels import CLIP_RANGES, Clip

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.datasets.clean import CleanSource, ClipSource
    from eldata.noise.parameters import NoiseDraw
    from eldata.noise.profile import RowChoice
    from eldata.records import Sensor
    from eldata.sources.frames import Frame


@dataclass(slots=True, eq=False)
class NoisyItem(DrawnItem):
    """An item with its (first) clean frame, what was drawn for it, and the generator of its noise."""

    frame: Frame
    draw: NoiseDraw
    generator: np.random.Generator


_ONE_SCALE = 1.5  # ranges of DN less far apart are other white levels, those farther apart files of other bits


class NoisyItems(CroppedItems):
    """Items whose target is read, and whose input is the target with noise.

    ``method`` is the source's method besides ``len``, ``exposures`` how many frames an item has, ``repeats`` how many
    items a record has, and the name of this argument; all else is as of :class:`SyntheticPairs`.
    """

    def __init__(
        self, source: Any, method: str, profiles: Cameras, repeats: tuple[str, int], exposures: int = 1, *,
        model: NoiseMaker | None, clip: Clip, ratio: float | tuple[float, float], iso: Isos | None,
        range_dn: float | None, row: RowChoice | None, extrapolate: bool,
        crop: int | None, augment: bool, crops: Crops, seed: int, transform: Transform | None,
    ) -> None:  # fmt: skip
        owner = type(self).__name__
        self.source = source
        _check_source(owner, source, method)
        super().__init__(crop, augment, crops, seed, transform, repeats)
        self.clip, self.model = clip, _set_clip(owner, NoiseModel() if model is None else model, clip)
        frames = self.model.dark_frames if isinstance(self.model, NoiseModel) else None
        self._dark = frames if isinstance(frames, DarkFrames) else None
        if self._dark is not None and iso is None:
            iso = self._dark.isos
        self.noise = NoiseChoice.of(profiles, ratio, iso, row, extrapolate)
        self.range_dn = None if range_dn is None else checked_number("range_dn", range_dn, above=0)
        if self.range_dn is not None and self._dark is not None:
            raise ArgumentError(f"{owner}: dark frames are in the frames' own DN; leave range_dn out")
        self._turns = None if self._dark is None else _make_turns(owner, self._dark, self.noise, self.seed, exposures)
        records = map(getattr(source, method), range(len(source)))
        self._count_items(len(source), records if method == "frame" else (clip.frame(0) for clip in records))
        if isinstance(self.model, NoiseModel):
            prepare()  # or each worker would compile it

    def _draw_noise(
        self, place: int, generator: np.random.Generator, frame: Frame, crop: Crop, parts: Iterable[Part],
        *frames: int, **facts: int,
    ) -> NoisyItem:  # fmt: skip
        """Draw an item's noise; dark frames have their turn by the item's place in the sequence of all draws."""
        range_dn, dark_frame = self.range_dn or frame.range_dn, ""
        if self._dark is None or self._turns is None:
            draw = self.noise.draw(generator, range_dn)
        else:
            draw = self.noise.draw(generator, range_dn, self._turns.at(place), gain_spread=GAIN_SPREAD)
            names = self._dark.names(draw.iso or 0.0)
            dark_frame = ", ".join(names[member] for member in draw.dark)
        own = draw.parameters.range_dn
        if self.range_dn is None and frame.sensor is not None and own is not None:  # arrays state whose range it is
            advice = f"range_dn={own:g} makes that camera's noise of it, range_dn={range_dn:g} takes its DN as they are"
            check_scale(frame.name, frame.sensor, draw.camera, own, advice)
        parameters = draw.parameters.as_dict()
        parameters["colour_bias_dn"] = torch.from_numpy(np.array(draw.parameters.colour_bias_dn))  # faster than tensor
        drawn = {"ratio": draw.ratio, "nominal_ratio": draw.ratio, "camera": draw.camera, "camera_id": draw.camera_id}
        drawn |= {"iso": draw.iso or math.nan, "dark_frame": dark_frame, "path": frame.name, "reference": frame.name}
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(SIDES, (*frames, *crop.packed_shape))
        return NoisyItem(crop, shapes, parts, drawn | parameters | facts, frame.sensor, frame, draw, generator)

    def _finish(self, items: Sequence[NoisyItem], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Add the noise: ours to all items at once, for the call alone costs as much as the noise of a small crop."""
        clean, noisy, model = arrays["target"], arrays["input"], self.model
        if isinstance(model, NoiseModel) and self._dark is None:
            images = clean[0].size // math.prod(clean.shape[-3:])
            draws = [item.draw for item in items for _ in range(images)]
            model.apply(clean, draws, [item.generator for item in items], threads=threads_here(), out=noisy)
            return
        for item, light, exposure in zip(items, clean, noisy, strict=True):
            draw, generator = item.draw, item.generator
            if isinstance(model, NoiseModel):
                dark = draw_dark(model, item.frame, item.crop, draw.iso, draw.dark, generator)
                model.apply(light, draw, generator, dark=dark, threads=threads_here(), out=exposure)
            else:
                np.clip(made_exposure(model, light, draw, generator), *CLIP_RANGES[self.clip], out=exposure)

    def _outline(self) -> list[tuple[str, str]]:
        """Describe the dataset by names and values: clean frames, cameras, noise, ratio, then as for all items."""
        low, high = self.noise.ratio
        is_ours = isinstance(self.model, NoiseModel)
        model = repr(self.model) if is_ours else f"{name_of(self.model)}, clip={self.clip!r}"
        ranged = "" if self.range_dn is None else f", range_dn={self.range_dn:g}"
        return [
            ("clean frames", repr(self.source)),
            ("cameras", str(self.noise)),
            ("noise", f"{model}{ranged}"),
            ("ratio", f"{low:g}" if low == high else f"{low:g} to {high:g}"),
            *super()._outline(),
        ]


def draw_dark(
    model: NoiseModel,
    frame: Frame,
    crop: Crop,
    iso: float | None,
    members: Sequence[int],
    generator: np.random.Generator,
) -> NDArray[np.float32] | None:
    """Read the dark frames of a crop by their numbers, from its place on the sensor; ``None`` without component D."""
    if not isinstance(model.dark_frames, DarkFrames) or iso is None:
        return None
    return model.dark_frames.crops(iso, members, model.dark_frames.region(iso, frame, crop, generator))


def check_scale(name: str, sensor: Sensor, camera: str, its_range_dn: float, advice: str) -> None:
    """Refuse a clean file whose range from black to white is not the range in whose DN a camera's noise is.

    Raises
    ------
    DatasetError
        With both ranges, and the advice.
    """
    range_dn = sensor.white_level_dn - sum(sensor.black_level_dn) / len(sensor.black_level_dn)
    if not 1 / _ONE_SCALE < range_dn / its_range_dn < _ONE_SCALE:
        raise DatasetError(
            f"{name}: has {range_dn:g} DN from black to white, but the noise of {camera} is in DN of files that have "
            f"{its_range_dn:g}; {advice}"
        )


def _check_source(owner: str, source: Any, method: str) -> None:
    """Refuse a source of clean data without ``len`` or the method, ``frame`` or ``clip``."""
    if hasattr(source, "__len__") and callable(getattr(source, method, None)):
        return
    known = {"frame": "CleanFrames and Arrays", "clip": "CleanClips"}[method]
    raise ArgumentError(
        f"{owner}: the source of clean data has len and {method}(index), as {known} of eldata.datasets have; found "
        f"{type(source).__name__}"
    )


def _make_turns(owner: str, dark: DarkFrames, choice: NoiseChoice, seed: int, exposures: int) -> Turns:
    """Order the dark frames of the ISOs to draw from."""
    if len(choice.profiles) > 1:
        raise ArgumentError(f"{owner}: dark frames are of one camera; give its profile alone")
    isos = [iso for iso in choice.isos if iso is not None]
    counts = [len(dark.names(iso)) for iso in isos]
    for iso, count in zip(isos, counts, strict=True):
        if count < exposures:
            raise ArgumentError(
                f"{owner}: windows of {exposures} frames, each with a dark frame of its own, need as many dark frames "
                f"of an ISO; ISO {iso:g} has {count}"
            )
    return Turns(seed, np.diff(choice.shares, prepend=0.0).tolist(), counts, exposures)


def _set_clip(owner: str, model: Any, clip: Clip) -> NoiseMaker:
    """Return the model with the clip of the input. The dataset decides, as for the pairs that are tested on."""
    check_choice("clip", clip, CLIP_RANGES)
    if not isinstance(model, NoiseModel):
        check_noise_maker(model)
        maker: NoiseMaker = model
        return maker
    if model.clip not in (None, clip):
        raise ArgumentError(
            f"{owner}: clip={clip!r}, but the noise model's own clip is {model.clip!r}; leave it out of the model, and "
            f"give clip= to {owner} and to the datasets that you test on"
        )
    return model.with_clip(clip)


class SyntheticPairs(NoisyItems):
    """Clean crops and noisy exposures of them, made again each time that they are asked for.

    The k-th time that item i is asked for it is draw k, which depends on (seed, k, i) alone, whatever the workers;
    after :meth:`set_epoch` always that of the epoch, in workers that are running too.

    Parameters
    ----------
    source
        Clean frames: :class:`~eldata.datasets.clean.CleanFrames`,
        :class:`~eldata.datasets.clean.Arrays`, or anything with their two methods.
    profiles
        One camera profile or several (one is drawn for each item), by name, path or object.
    crops_per_frame
        Items per clean frame: the length is this times the number of frames.
    model
        The noise model: a :class:`~eldata.noise.model.NoiseModel`, by default (``None``) the full one, or a callable of
        your own (:class:`~eldata.noise.model.NoiseMaker`). With real dark frames it is
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
    crop, augment, crops, seed, transform
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
        crops_per_frame: int = 1, transform: Transform | None = None,
        model: NoiseMaker | None = None, clip: Clip = "both", ratio: float | tuple[float, float] = (100.0, 300.0),
        iso: Isos | None = None, range_dn: float | None = None, row: RowChoice | None = None, extrapolate: bool = False,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "crops_per_frame")
        super().__init__(method="frame", repeats=("crops_per_frame", crops_per_frame), **options)

    def draw_item(self, place: int, generator: np.random.Generator) -> NoisyItem:
        """Draw a crop of frame ``place`` modulo their number, or of a grid its crop, and its noise."""
        number, tile = self._record_of(place)
        frame = self.source.frame(number)
        crop = Crop.draw(frame, generator, crop=self.crop, augment=self.augment, tile=tile)
        return self._draw_noise(place, generator, frame, crop, [Part("target", frame, is_light=True)])


class SyntheticClips(NoisyItems):
    """Windows of clean clips and noisy exposures of them, made again each time that they are asked for.

    Camera, parameters and ratio are drawn once for a window, and so are its place, crop and orientation, which are the
    same for all of its frames. The noise is fresh in each frame. All else, draws and parameters too, is as in
    :class:`SyntheticPairs`, but for:

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
        frames: int = 5, windows_per_clip: int = 1, transform: Transform | None = None,
        model: NoiseMaker | None = None, clip: Clip = "both", ratio: float | tuple[float, float] = (100.0, 300.0),
        iso: Isos | None = None, range_dn: float | None = None, row: RowChoice | None = None, extrapolate: bool = False,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "frames", "windows_per_clip")
        if frames < 1 or windows_per_clip < 1:
            raise ArgumentError(f"frames and windows_per_clip must be 1 or more; found {frames}, {windows_per_clip}")
        super().__init__(method="clip", repeats=("windows_per_clip", windows_per_clip), exposures=frames, **options)
        self.frames, self._unit = frames, f"windows of {frames} frames"

    @property
    def reads_parts(self) -> bool:
        """Whether the source's clips say that their frames read parts."""
        return getattr(self.source.clip(0), "reads_parts", False)

    def draw_item(self, place: int, generator: np.random.Generator) -> NoisyItem:
        """Draw a window of clip ``place`` modulo their number, or of a crop's clip, its crop and its noise."""
        number, tile = self._record_of(place)
        clip = self.source.clip(number)
        if len(clip) < self.frames:
            raise DatasetError(f"{clip!r}: {len(clip)} frames are too few for a window of {self.frames}")
        start = int(generator.integers(len(clip) - self.frames + 1))
        first = clip.frame(start)
        crop = Crop.draw(first, generator, crop=self.crop, augment=self.augment, tile=tile)
        parts = self._parts(clip, start, first)
        return self._draw_noise(place, generator, first, crop, parts, self.frames, clip=number, start=start)

    def _parts(self, clip: CleanSource, start: int, first: Frame) -> Iterator[Part]:
        """Yield the clean frames in order."""
        yield Part("target", first, 0, is_light=True)
        for step in range(1, self.frames):
            frame = clip.frame(start + step)
            _check_alike(frame, first)
            yield Part("target", frame, step, is_light=True)
            del frame


def _check_alike(frame: Frame, first: Frame) -> None:
    """Refuse a frame of another size, CFA or white level than the first of its clip."""
    own, wanted = (f"{each.kind}, white level {each.white_level_dn:g} DN" for each in (frame, first))
    if own != wanted:
        raise DatasetError(f"{frame.name}: has {own}, but {first.name} has {wanted}; is it one clip?")
