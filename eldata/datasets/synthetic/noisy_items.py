"""What synthetic pairs and synthetic clips share: clean crops, and noisy exposures of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.numbers import checked_number
from eldata.datasets.base import SIDES
from eldata.datasets.batches import threads_here
from eldata.datasets.items import CroppedItems, DrawnItem
from eldata.datasets.synthetic.dark_frames import GAIN_SPREAD, DarkFrames
from eldata.datasets.synthetic.draws import NoiseChoice, Turns, fewest_members
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.noise.makers import check_noise_maker, made_exposure, maker_name
from eldata.noise.model import NoiseModel
from eldata.raw.levels import CLIP_RANGES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence, Sized

    from numpy.typing import NDArray

    from eldata.datasets.crops import Crop
    from eldata.datasets.items import Crops, Part
    from eldata.datasets.synthetic.draws import Cameras, Isos, NoiseDraw
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.profile import RowChoice
    from eldata.raw.levels import Clip
    from eldata.records import Sensor
    from eldata.sources.frames import Frame


@dataclass(slots=True, eq=False)
class NoisyItem(DrawnItem):
    """An item with its (first) clean frame, what was drawn for it, and the generator of its noise."""

    frame: Frame
    draw: NoiseDraw
    generator: np.random.Generator


Sample = TypeVar("Sample")

_ONE_SCALE = 1.5  # ranges of DN less far apart are other white levels, those farther apart files of other bits


class NoisyItems(CroppedItems[Sample]):
    """Items whose target is read, and whose input is that with noise.

    ``method`` is what the source has beside ``len``, ``exposures`` how many frames an item has, ``repeats`` how many
    items a record has, and the name of this argument; all else is as of
    :class:`~eldata.datasets.synthetic.pairs.SyntheticPairs`.
    """

    def __init__(
        self, source: Sized, method: str, profiles: Cameras, repeats: tuple[str, int], exposures: int = 1, *,
        model: NoiseMaker | None, clip: Clip, ratio: float | tuple[float, float], iso: Isos | None,
        range_dn: float | None, row: RowChoice | None, extrapolate: bool,
        crop: int | None, augment: bool, crops: Crops, seed: int,
    ) -> None:  # fmt: skip
        owner = type(self).__name__
        _check_source(owner, source, method)
        super().__init__(crop, augment, crops, seed, repeats)
        self.clip, self.model = clip, _clipped(owner, NoiseModel() if model is None else model, clip)
        frames = self.model.dark_frames if isinstance(self.model, NoiseModel) else None
        self._dark = frames if isinstance(frames, DarkFrames) else None
        if self._dark is not None and iso is None:
            iso = self._dark.isos
        self.noise = NoiseChoice.of(profiles, ratio, iso, row, extrapolate)
        self.range_dn = None if range_dn is None else checked_number("range_dn", range_dn, above=0)
        if self.range_dn is not None and self._dark is not None:
            raise ArgumentError(f"{owner}: dark frames are in the frames' own DN; leave range_dn out")
        self._turns = None if self._dark is None else _turns(owner, self._dark, self.noise, self.seed, exposures)
        records = map(getattr(source, method), range(len(source)))
        self._count_items(len(source), records if method == "frame" else (clip.frame(0) for clip in records))
        self._length = self._length_of(len(source))

    def __len__(self) -> int:
        return self._length

    def _noisy(
        self,
        place: int,
        generator: np.random.Generator,
        frame: Frame,
        crop: Crop,
        parts: Iterable[Part],
        *frames: int,
        **facts: int,
    ) -> NoisyItem:
        """Draw an item's noise; dark frames have their turn by the item's place in the sequence of all draws."""
        if self._turns is None:
            draw = self.noise.draw(generator)
        else:
            draw = self.noise.draw(generator, self._turns.at(place), gain_spread=GAIN_SPREAD)
        beside = draw.facts() | {"dark_frame": "", "path": frame.name} | facts
        if self._dark is not None and draw.iso is not None:
            names = self._dark.names(draw.iso)
            beside["dark_frame"] = ", ".join(names[member] for member in draw.dark)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(SIDES, (*frames, *crop.packed_shape))
        return NoisyItem(crop, shapes, parts, beside, frame.sensor, frame, draw, generator)

    def _finish(self, items: Sequence[NoisyItem], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Add the noise: ours to all items at once, for the call alone costs as much as the noise of a small crop."""
        clean, noisy, model = arrays["target"], arrays["input"], self.model
        if isinstance(model, NoiseModel) and self._dark is None:
            images = clean[0].size // math.prod(clean.shape[-3:])
            each = [item for item in items for _ in range(images)]
            model(
                clean,
                out=noisy,
                parameters=[item.draw.parameters for item in each],
                ratio=[item.draw.ratio for item in each],
                range_dn=[self._range_of(item) for item in each],
                generator=[item.generator for item in items],
                threads=threads_here(),
            )
        else:
            for place, item in enumerate(items):
                self._add_noise(item, clean[place], noisy[place])

    def _range_of(self, item: NoisyItem) -> float:
        """Return the range of DN that the noise's figures are in: as given, else the clean file's own."""
        if self.range_dn is not None:
            return self.range_dn
        own, its = item.frame.range_dn, item.draw.parameters.range_dn
        if item.frame.sensor is not None and its is not None:  # arrays state whose range it is
            both = f"range_dn={its:g} makes that camera's noise of it, range_dn={own:g} takes the figures for DN of it"
            check_scale(item.frame.name, item.frame.sensor, item.draw.camera, its, both)
        return own

    def _outline(self) -> list[tuple[str, str]]:
        """Return what the dataset is, as names and values."""
        model = repr(self.model) if isinstance(self.model, NoiseModel) else maker_name(self.model)
        low, high = self.noise.ratio
        return [
            ("clean frames", repr(self.source)),
            ("cameras", str(self.noise)),
            ("noise", f"{model}, clip {self.clip}"),
            ("ratio", f"{low:g}" if low == high else f"{low:g} to {high:g}"),
            ("items", f"{len(self)}, {'whole frames' if self.crop is None else f'{self.crop} x {self.crop}'}"),
        ]

    def _add_noise(self, item: NoisyItem, clean: NDArray[Any], noisy: NDArray[Any]) -> None:
        """Add the noise of dark frames, or of a model of the caller's own."""
        model = self.model
        options: dict[str, Any] = {
            "parameters": item.draw.parameters,
            "ratio": item.draw.ratio,
            "range_dn": self._range_of(item),
            "generator": item.generator,
        }
        if isinstance(model, NoiseModel):
            options |= from_sensor(model, item.frame, item.crop, item.draw.iso, item.draw.dark, item.generator)
            model(clean, **options, threads=threads_here(), out=noisy)
        else:
            np.clip(made_exposure(model, clean, **options), *CLIP_RANGES[self.clip], out=noisy)

    def _text(self, source: object, items: str) -> str:
        """Return the repr, in which ``items`` says how many there are."""
        model = (
            repr(self.model) if isinstance(self.model, NoiseModel) else f"{maker_name(self.model)}, clip={self.clip!r}"
        )
        ranged = "" if self.range_dn is None else f", range_dn={self.range_dn:g}"
        return (
            f"{type(self).__name__}({source!r}, {items}, cameras: {self.noise}; {model}, "
            f"ratio={self.noise.ratio}{ranged}, {self._cut}, seed={self.seed})"
        )


def from_sensor(
    model: NoiseModel,
    frame: Frame,
    crop: Crop,
    iso: float | None,
    dark: Sequence[int],
    generator: np.random.Generator,
) -> dict[str, Any]:
    """Return what the noise of a crop has from the sensor that took it, as the model's arguments.

    ``dark`` are the numbers of its dark frames.
    """
    if not isinstance(model.dark_frames, DarkFrames) or iso is None:
        return {}
    return {"dark": model.dark_frames.crops(iso, dark, model.dark_frames.region(iso, frame, crop, generator))}


def check_scale(name: str, sensor: Sensor, camera: str, its_range_dn: float, advice: str) -> None:
    """Refuse a clean file of other bits than those in whose DN a camera's noise is, by the levels that it states.

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
    if hasattr(source, "__len__") and callable(getattr(source, method, None)):
        return
    known = {"frame": "CleanFrames and Arrays", "clip": "CleanClips"}[method]
    raise ArgumentError(
        f"{owner}: the source of clean data has len and {method}(index), as {known} of eldata.datasets have; found "
        f"{type(source).__name__}"
    )


def _turns(owner: str, dark: DarkFrames, choice: NoiseChoice, seed: int, exposures: int) -> Turns:
    """Return whose turn it is among the dark frames of the ISOs to draw from."""
    if len(choice.profiles) > 1:
        raise ArgumentError(f"{owner}: dark frames are of one camera; give its profile alone")
    isos = [iso for iso in choice.isos if iso is not None]
    counts = [len(dark.names(iso)) for iso in isos]
    for iso, count in zip(isos, counts, strict=True):
        if count < fewest_members(exposures):
            raise ArgumentError(
                f"{owner}: windows of {exposures} frames, each with a dark frame of its own, need "
                f"{fewest_members(exposures)} dark frames of an ISO; ISO {iso:g} has {count}"
            )
    return Turns(seed, np.diff(choice.shares, prepend=0.0).tolist(), counts, exposures)


def _clipped(owner: str, model: Any, clip: Clip) -> NoiseMaker:
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
