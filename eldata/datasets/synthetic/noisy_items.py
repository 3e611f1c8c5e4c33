"""What synthetic pairs and synthetic clips share: clean crops, and noisy exposures of them."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

import numpy as np

from eldata.base.arguments import keywords
from eldata.base.numbers import checked_number
from eldata.datasets.base import SIDES
from eldata.datasets.batches import threads_here
from eldata.datasets.items import CroppedItems, Cropping, DrawnItem, SharedMemory
from eldata.datasets.synthetic.dark_frames import GAIN_SPREAD, DarkFrames
from eldata.datasets.synthetic.draws import NoiseChoice, Turns, fewest_members
from eldata.errors import ArgumentError, check_choice
from eldata.noise.makers import check_noise_maker, made_exposure, maker_name
from eldata.noise.model import NoiseModel
from eldata.raw.levels import CLIP_RANGES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence, Sized

    from numpy.typing import NDArray

    from eldata.datasets.crops import Crop
    from eldata.datasets.items import Part
    from eldata.datasets.synthetic.draws import Cameras, Isos, NoiseDraw
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.profile import RowChoice
    from eldata.raw.levels import Clip
    from eldata.sources.frames import Frame


class Noise(TypedDict, total=False):
    """What noise is made.

    Attributes
    ----------
    model
        The noise model: a :class:`~eldata.noise.model.NoiseModel`, by default (``None``) the full one, or a callable of
        your own (:class:`~eldata.noise.makers.NoiseMaker`). With real dark frames it is
        ``NoiseModel("P*+D", dark_frames=DarkFrames(...))``: each frame of an ISO is used once before any is used twice.
    clip
        Of the input, with the same meaning and the same default, ``"both"``, as in every dataset of pairs
        (:class:`~eldata.datasets.choices.Representation`): give those that you test on the same. The target, which
        stands for light, lies in [0, 1] whatever it is.
    ratio
        Low-light factors: (lowest, highest), drawn uniformly; by default the paper's, 100 to 300. Or one fixed number.
    iso
        ``None``, the default: K is drawn for each item, as in the paper; with dark frames, their
        ISOs, drawn alike. One ISO; or several, as a sequence, which are drawn alike, or as a mapping to their
        weights.
    range_dn
        White minus black level of the simulated camera, in DN, which the profile's figures are in. ``None``, the
        default, is each clean frame's own: right for frames of that camera. Frames of fewer bits are as bright in
        photons with it, so clean frames of several cameras need it. Dark frames take none.
    row, extrapolate
        As in :meth:`eldata.noise.CameraProfile.sample`. By default each of several ISOs has its own row: as it was
        measured, where the profile has all figures of that ISO, else ``"nearest-gain"``; the repr says which. One ISO,
        or a drawn gain, has ``"any"``.
    """

    model: NoiseMaker | None
    clip: Clip
    ratio: float | tuple[float, float]
    iso: Isos | None
    range_dn: float | None
    row: RowChoice | None
    extrapolate: bool


class NoiseOptions(Cropping, Noise, total=False):
    """All of the keyword arguments that synthetic pairs and clips share; by default ``crop=512, augment=True``."""


@dataclass(slots=True, eq=False)
class NoisyItem(DrawnItem):
    """An item with its (first) clean frame, what was drawn for it, the generator of its noise, and its number."""

    frame: Frame
    draw: NoiseDraw
    generator: np.random.Generator
    index: int


Sample = TypeVar("Sample")


class NoisyItems(CroppedItems[Sample]):
    """Items whose target is read, and whose input is that with noise.

    ``method`` is what the source has beside ``len``, ``exposures`` how many frames an item has.
    """

    def __init__(
        self,
        source: Sized,
        method: str,
        profiles: Cameras,
        crops: tuple[str, int],
        options: NoiseOptions,
        exposures: int = 1,
    ) -> None:
        owner = type(self).__name__
        cropping, noise = keywords(owner, options, Cropping, Noise)
        _check_source(owner, source, method)
        super().__init__({"crop": 512, "augment": True} | cropping, crops)
        model = noise.get("model")
        self.clip, self.model = _clipped(owner, NoiseModel() if model is None else model, noise.get("clip"), self.clip)
        frames = self.model.dark_frames if isinstance(self.model, NoiseModel) else None
        self._dark = frames if isinstance(frames, DarkFrames) else None
        sampling = {name: noise[name] for name in ("iso", "row", "extrapolate") if name in noise}
        if self._dark is not None and sampling.get("iso") is None:
            sampling["iso"] = self._dark.isos
        self.noise = NoiseChoice.of(profiles, noise.get("ratio", (100.0, 300.0)), **sampling)
        given = noise.get("range_dn")
        self.range_dn = None if given is None else checked_number("range_dn", given, above=0)
        if self.range_dn is not None and self._dark is not None:
            raise ArgumentError(f"{owner}: dark frames are in the frames' own DN; leave range_dn out")
        self._turns = None if self._dark is None else _turns(owner, self._dark, self.noise, self.seed, exposures)
        records = map(getattr(source, method), range(len(source)))
        self._lay_grid(records if method == "frame" else (clip.frame(0) for clip in records))
        self._length = self._length_of(len(source), crops[1])
        self._repeats = Repeats(owner, self._length)

    def __len__(self) -> int:
        return self._length

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        super().set_epoch(epoch)
        self._repeats.settle()

    def _noisy(
        self,
        index: int,
        generator: np.random.Generator,
        frame: Frame,
        crop: Crop,
        parts: Iterable[Part],
        *frames: int,
        **facts: int,
    ) -> NoisyItem:
        """Draw an item's noise; dark frames have their turn by the item's place in the sequence of all epochs."""
        if self._turns is None:
            draw = self.noise.draw(generator)
        else:
            turn = self._turns.at(self.epoch * self._length + index)
            draw = self.noise.draw(generator, turn, gain_spread=GAIN_SPREAD)
        beside = draw.facts() | {"dark_frame": "", "path": frame.name} | facts
        if self._dark is not None and draw.iso is not None:
            names = self._dark.names(draw.iso)
            beside["dark_frame"] = ", ".join(names[member] for member in draw.dark)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(SIDES, (*frames, *crop.packed_shape))
        return NoisyItem(crop, shapes, parts, beside, frame.sensor, frame, draw, generator, index)

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
                range_dn=[self.range_dn or item.frame.range_dn for item in each],
                generator=[item.generator for item in items],
                threads=threads_here(),
            )
        else:
            for place, item in enumerate(items):
                self._add_noise(item, clean[place], noisy[place])

    def _given(self, items: Sequence[NoisyItem]) -> None:
        """Note the items, for a second pass over the same ones."""
        self._repeats.note(*(item.index for item in items))

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
            "range_dn": self.range_dn or item.frame.range_dn,
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


def _clipped(owner: str, model: Any, clip: Clip | None, usual: Clip) -> tuple[Clip, NoiseMaker]:
    """Return the clip of the input, and the model with it. The dataset decides, as for the pairs that are tested on."""
    if clip is not None:
        check_choice("clip", clip, CLIP_RANGES)
    if not isinstance(model, NoiseModel):
        check_noise_maker(model)
        return clip or usual, model
    clip = clip or usual
    if model.clip not in (None, clip):
        raise ArgumentError(
            f"{owner}: clip={clip!r}, but the noise model's own clip is {model.clip!r}; leave it out of the model, and "
            f"give clip= to {owner} and to the datasets that you test on"
        )
    return clip, model.with_clip(clip)


_NUMBERS = 3  # items that were made, how often one came again, whether all is said
_HEADER_BYTES = 8 * _NUMBERS
_LOOKS = 8  # an item is looked at before training begins


class Repeats(SharedMemory):
    """Warns once, in whichever process, when a second pass gives the items of the first one again.

    Which items were made is kept in shared memory, a byte each, for workers come and go. Looking at some items before
    the first pass is not a second one. So half of the items that were made, and a few more, have to come again; where
    they are a part of the dataset (a rank's, those of a ``Subset``, or those that were looked at), all of them three
    times. Processes may miss each other's count, which says it later.

    Parameters
    ----------
    owner
        Name of the dataset.
    length
        Number of its items.
    """

    def __init__(self, owner: str, length: int) -> None:
        self.owner = owner
        super().__init__(_HEADER_BYTES + length)

    @property
    def _numbers(self) -> NDArray[np.int64]:
        return self._array[:_HEADER_BYTES].view(np.int64)

    def settle(self) -> None:
        """Say nothing from now on: the epoch was chosen."""
        self._numbers[2] = 1

    def note(self, *indices: int) -> None:
        """Note that items were made."""
        for index in indices:
            if self._numbers[2]:
                return
            self._note(index)

    def _note(self, index: int) -> None:
        numbers, is_made = self._numbers, self._array[_HEADER_BYTES:]
        if not is_made[index]:
            is_made[index] = 1
            numbers[0] += 1
            return
        numbers[1] += 1
        made, again = int(numbers[0]), int(numbers[1])
        is_whole = 4 * made >= 3 * is_made.size
        if again > (made // 2 if is_whole else 3 * made) + _LOOKS:
            self.settle()
            warnings.warn(
                f"{self.owner}: items of epoch 0 come again, with the same crops and the same noise to the bit, "
                "for set_epoch was not called; call dataset.set_epoch(epoch) before each pass. If they are to stay the "
                "same, as for validation, call dataset.set_epoch(0) once",
                stacklevel=3,
            )
