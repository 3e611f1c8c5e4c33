"""What synthetic pairs and synthetic clips share: clean crops, and noisy exposures of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

from eldata.base.keywords import keywords
from eldata.datasets.batches import threads_here
from eldata.datasets.draws import NoiseChoice
from eldata.datasets.items import CroppedItems, Cropping
from eldata.noise.model import NoiseModel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence, Sized

    import numpy as np
    from numpy.typing import NDArray

    from eldata.datasets.crops import Crop
    from eldata.datasets.draws import NoiseDraw
    from eldata.noise.profile import CameraProfile, RowChoice
    from eldata.sources.frames import Frame


class Noise(TypedDict, total=False):
    """What noise is made.

    Attributes
    ----------
    model
        The noise model; by default (``None``) the full one, clipped to [0, 1] as the published loaders' input is.
    ratio
        Low-light factors: (lowest, highest), drawn uniformly; by default the paper's, 100 to 300. Or one fixed number.
    iso, row, extrapolate
        As in :meth:`eldata.noise.CameraProfile.sample`.
    """

    model: NoiseModel | None
    ratio: float | tuple[float, float]
    iso: float | None
    row: RowChoice
    extrapolate: bool


class NoiseOptions(Cropping, Noise, total=False):
    """All of the keyword arguments that synthetic pairs and clips share; by default ``crop=512, augment=True``."""


@dataclass(frozen=True, slots=True)
class NoisyItem:
    """One item before its pixels are read: all that was drawn for it, and the generator that its noise comes from."""

    frame: Frame
    crop: Crop
    draw: NoiseDraw
    generator: np.random.Generator


Item = TypeVar("Item", bound=NoisyItem)
Sample = TypeVar("Sample")


class NoisyItems(CroppedItems[Item, Sample]):
    """Items whose target is read, and whose input is that with noise."""

    def __init__(
        self,
        source: Sized,
        profiles: CameraProfile | str | Sequence[CameraProfile | str],
        crops: tuple[str, int],
        options: NoiseOptions,
    ) -> None:
        cropping, noise = keywords(type(self).__name__, options, Cropping, Noise, renamed={})
        super().__init__({"crop": 512, "augment": True} | cropping, crops)
        ratio, row = noise.get("ratio", (100.0, 300.0)), noise.get("row", "any")
        self.noise = NoiseChoice.of(profiles, ratio, noise.get("iso"), row, noise.get("extrapolate", False))
        self.model: NoiseModel = noise.get("model") or NoiseModel(clip="both")
        self._length = len(source) * crops[1]

    def __len__(self) -> int:
        return self._length

    def facts(self, item: Item) -> dict[str, Any]:
        """Return what the noise was made with, and where the frame comes from."""
        return item.draw.facts() | {"path": item.frame.name}

    def finish(self, item: Item, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Add the noise."""
        arrays["input"][...] = self.model(
            arrays["target"],
            parameters=item.draw.parameters,
            ratio=item.draw.ratio,
            range_dn=item.frame.range_dn,
            generator=item.generator,
            threads=threads_here(),
        )

    def _text(self, source: object, items: str) -> str:
        """Return the repr, in which ``items`` says how many there are."""
        cameras = ", ".join(profile.camera for profile in self.noise.profiles)
        return (
            f"{type(self).__name__}({source!r}, {items}, cameras: {cameras}; {self.model!r}, "
            f"ratio={self.noise.ratio}, crop={self.crop}, augment={self.augment}, seed={self.seed})"
        )
