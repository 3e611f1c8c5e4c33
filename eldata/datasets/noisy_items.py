"""What synthetic pairs and synthetic clips share: clean crops, and noisy exposures of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from eldata.datasets.batches import threads_here
from eldata.datasets.items import CroppedItems, DrawnItem
from eldata.noise.model import NoiseModel

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from eldata.datasets.draws import NoiseChoice, NoiseDraw
    from eldata.datasets.items import Cropping


class DrawnNoise(DrawnItem, Protocol):
    """One item before its pixels are read: all that was drawn for it, and the generator that its noise comes from."""

    @property
    def draw(self) -> NoiseDraw:
        """Camera, parameters and ratio."""

    @property
    def range_dn(self) -> float:
        """White level minus black level."""

    @property
    def generator(self) -> np.random.Generator:
        """Where the noise comes from."""


Item = TypeVar("Item", bound=DrawnNoise)
Sample = TypeVar("Sample")


class NoisyItems(CroppedItems[Item, Sample]):
    """Items whose target is read, and whose input is that with noise."""

    def __init__(
        self, noise: NoiseChoice, model: NoiseModel | None, cropping: Cropping, crops: tuple[str, int]
    ) -> None:
        super().__init__(cropping, crops)
        self.noise = noise
        self.model = NoiseModel(clip="both") if model is None else model

    def finish(self, item: Item, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Add the noise."""
        arrays["input"][...] = self.model(
            arrays["target"],
            parameters=item.draw.parameters,
            ratio=item.draw.ratio,
            range_dn=item.range_dn,
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
