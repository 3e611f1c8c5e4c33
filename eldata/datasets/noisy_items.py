"""What synthetic pairs and synthetic clips share: clean crops, and noisy exposures of them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

import numpy as np

from eldata.base.keywords import keywords
from eldata.datasets.batches import threads_here
from eldata.datasets.draws import NoiseChoice
from eldata.datasets.items import CroppedItems, Cropping
from eldata.datasets.repeats import Repeats
from eldata.errors import ArgumentError, check_choice
from eldata.noise.makers import check_noise_maker, made_exposure, maker_name
from eldata.noise.model import NoiseModel
from eldata.raw.cfa import CLIP_RANGES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sized

    from numpy.typing import NDArray

    from eldata.datasets.crops import Crop
    from eldata.datasets.draws import Cameras, Isos, NoiseDraw
    from eldata.datasets.items import Part
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.profile import RowChoice
    from eldata.raw.cfa import Clip
    from eldata.sources.frames import Frame


class Noise(TypedDict, total=False):
    """What noise is made.

    Attributes
    ----------
    model
        The noise model: a :class:`~eldata.noise.model.NoiseModel`, by default (``None``) the full one, or a callable of
        your own (:class:`~eldata.noise.makers.NoiseMaker`).
    clip
        Of the input, with the same meaning and the same default, ``"both"``, as in every dataset of pairs
        (:class:`~eldata.datasets.choices.Representation`): give those that you test on the same. The target, which
        stands for light, lies in [0, 1] whatever it is.
    ratio
        Low-light factors: (lowest, highest), drawn uniformly; by default the paper's, 100 to 300. Or one fixed number.
    iso
        ``None``, the default: K is drawn anew for each item, as in the paper. One ISO; or several, as a sequence, which
        are drawn alike, or as a mapping to their weights.
    row, extrapolate
        As in :meth:`eldata.noise.CameraProfile.sample`. By default each of several ISOs has its own row: as it was
        measured, where the profile has all figures of that ISO, else ``"nearest-gain"``; the repr says which. One ISO,
        or a drawn gain, has ``"any"``.
    """

    model: NoiseMaker | None
    clip: Clip
    ratio: float | tuple[float, float]
    iso: Isos | None
    row: RowChoice | None
    extrapolate: bool


class NoiseOptions(Cropping, Noise, total=False):
    """All of the keyword arguments that synthetic pairs and clips share; by default ``crop=512, augment=True``."""


@dataclass(frozen=True, slots=True)
class NoisyItem:
    """One item before its pixels are read: what was drawn for it, the generator of its noise, and its number."""

    frame: Frame
    crop: Crop
    draw: NoiseDraw
    generator: np.random.Generator
    index: int


Item = TypeVar("Item", bound=NoisyItem)
Sample = TypeVar("Sample")


class NoisyItems(CroppedItems[Item, Sample]):
    """Items whose target is read, and whose input is that with noise.

    ``method`` is what the source has beside ``len``.
    """

    def __init__(
        self, source: Sized, method: str, profiles: Cameras, crops: tuple[str, int], options: NoiseOptions
    ) -> None:
        owner = type(self).__name__
        cropping, noise = keywords(owner, options, Cropping, Noise, renamed={})
        _check_source(owner, source, method)
        super().__init__({"crop": 512, "augment": True} | cropping, crops)
        sampling = {name: noise[name] for name in ("iso", "row", "extrapolate") if name in noise}
        self.noise = NoiseChoice.of(profiles, noise.get("ratio", (100.0, 300.0)), **sampling)
        model = noise.get("model")
        self.clip, self.model = _clipped(owner, NoiseModel() if model is None else model, noise.get("clip"), self.clip)
        self._length = len(source) * crops[1]
        self._repeats = Repeats(owner, self._length)

    def __len__(self) -> int:
        return self._length

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        super().set_epoch(epoch)
        self._repeats.settle()

    def fill(self, item: Item, part: Part, out: NDArray[Any]) -> None:
        """Read the clean crop."""
        item.crop.fill(part.frame, out, clip="both", gain=part.gain)

    def facts(self, item: Item) -> dict[str, Any]:
        """Return what the noise was made with, and where the frame comes from."""
        return item.draw.facts() | {"path": item.frame.name}

    def finish(self, item: Item, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Add the noise."""
        clean, noisy, model = arrays["target"], arrays["input"], self.model
        options: dict[str, Any] = {
            "parameters": item.draw.parameters,
            "ratio": item.draw.ratio,
            "range_dn": item.frame.range_dn,
            "generator": item.generator,
        }
        if isinstance(model, NoiseModel):
            noisy[...] = model(clean, **options, threads=threads_here())
        else:
            np.clip(made_exposure(model, clean, **options), *CLIP_RANGES[self.clip], out=noisy)
        self._repeats.note(item.index)

    def _text(self, source: object, items: str) -> str:
        """Return the repr, in which ``items`` says how many there are."""
        model = (
            repr(self.model) if isinstance(self.model, NoiseModel) else f"{maker_name(self.model)}, clip={self.clip!r}"
        )
        return (
            f"{type(self).__name__}({source!r}, {items}, cameras: {self.noise}; {model}, "
            f"ratio={self.noise.ratio}, crop={self.crop}, augment={self.augment}, seed={self.seed})"
        )


def _check_source(owner: str, source: Any, method: str) -> None:
    if hasattr(source, "__len__") and callable(getattr(source, method, None)):
        return
    known = {"frame": "RawFiles, Arrays or StoredFrames", "clip": "RawClips, ArrayClips or StoredClips"}[method]
    raise ArgumentError(
        f"{owner}: the source of clean data has len and {method}(index), as {known} of eldata.datasets have; found "
        f"{type(source).__name__}"
    )


def _clipped(owner: str, model: Any, clip: Clip | None, usual: Clip) -> tuple[Clip, NoiseMaker]:
    """Return the clip of the input, and the model with it. The dataset decides, as for the pairs that are tested on."""
    if clip is not None:
        check_choice("clip", clip, CLIP_RANGES)
    if not isinstance(model, NoiseModel):
        check_noise_maker(model)
        return clip or usual, model
    if clip is None and model.clip not in (None, usual):
        clip = model.clip
        warnings.warn(
            f"{owner}: the noise model has clip={clip!r}, but pairs to test on have {usual!r} unless told otherwise; "
            f"give clip={clip!r} to {owner} and to the datasets that you test on, and leave it out of the model, where "
            "it will be refused from version 0.3 on",
            DeprecationWarning,
            stacklevel=4,
        )
    elif model.clip not in (None, clip or usual):
        raise ArgumentError(
            f"{owner}: clip={clip!r}, but the noise model's own clip is {model.clip!r}; leave it out of the model"
        )
    clip = clip or usual
    return clip, model.with_clip(clip)
