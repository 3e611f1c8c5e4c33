"""What synthetic pairs and synthetic clips share: items with fresh noise, drawn from (seed, epoch, index)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np
from torch.utils.data import Dataset

from eldata.datasets.batches import Batch, Field, new_batch, threads_here
from eldata.datasets.draws import SharedEpoch
from eldata.errors import ArgumentError
from eldata.noise.model import NoiseModel

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.datasets.draws import NoiseChoice, NoiseDraw


class DrawnItem(Protocol):
    """One item before its pixels are read: all that was drawn for it, and the generator that its noise comes from."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of its clean pixels, packed."""

    @property
    def draw(self) -> NoiseDraw:
        """Camera, parameters and ratio."""

    @property
    def range_dn(self) -> float:
        """White level minus black level."""

    @property
    def generator(self) -> np.random.Generator:
        """Where the noise comes from."""


Item = TypeVar("Item", bound=DrawnItem)
Sample = TypeVar("Sample")


class NoisyItems(Dataset[Sample], ABC, Generic[Item, Sample]):
    """Clean crops and noisy exposures of them. Subclasses say what is drawn, where pixels come from, what a sample is.

    Raises
    ------
    ArgumentError
        If ``seed`` is negative or ``crop`` under 2.
    """

    def __init__(
        self, noise: NoiseChoice, model: NoiseModel | None, *, crop: int | None, augment: bool, seed: int
    ) -> None:
        if seed < 0:
            raise ArgumentError(f"seed must be 0 or more; found {seed}")
        if crop is not None and crop < 2:
            raise ArgumentError(f"crop must be 2 or more; found {crop}")
        self.noise = noise
        self.model = NoiseModel(clip="both") if model is None else model
        self.crop = crop
        self.augment = augment
        self.seed = seed
        self._epoch = SharedEpoch()

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def _drawn(self, index: int, generator: np.random.Generator) -> Item:
        """Draw an item; ``index`` is not negative."""

    @abstractmethod
    def _fill(self, item: Item, target: NDArray[np.float32]) -> None:
        """Read an item's clean pixels."""

    @abstractmethod
    def _sample(self, item: Item, noisy: NDArray[np.float32], target: NDArray[np.float32]) -> Sample:
        """Return an item's sample."""

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return self._epoch.value

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        self._epoch.set(epoch)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Sample:
        """Make one item.

        Raises
        ------
        IndexError
            If the index is outside.
        DatasetError
            If a frame is smaller than the crop (with ``augment`` one period of the CFA more is needed); of clips also
            if one is shorter than a window, or its frames differ in size, CFA or levels.
        """
        item = self._item(index)
        return self._made(item, np.empty(item.shape, np.float32))

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Make the items of a batch in memory that is used again (:mod:`eldata.datasets.batches`).

        torch's DataLoader calls this. The values are those of ``dataset[i]``; errors too.
        """
        if self.crop is None:  # whole frames may differ in size
            return [self[index] for index in indices]
        batch: Batch | None = None
        samples = []
        for number, index in enumerate(indices):  # one whole frame in memory at a time
            item = self._item(index)
            shape = len(indices), *item.shape
            if number == 0:
                batch = new_batch([Field(name, shape, "<f4") for name in ("input", "target")])
            if batch is None or batch.fields[0].shape != shape:  # no such memory; or Bayer and X-Trans
                return [self[index] for index in indices]
            sample: Any = self._made(item, batch.arrays["target"][number])
            batch.arrays["input"][number] = sample["input"].numpy()
            samples.append({**sample, "input": None, "target": None})
            del item, sample
        return [] if batch is None else batch.parts(samples)

    def _item(self, index: int) -> Item:
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is outside of {len(self)} items")
        index %= len(self)
        return self._drawn(index, np.random.default_rng([self.seed, self.epoch, index]))

    def _made(self, item: Item, target: NDArray[np.float32]) -> Sample:
        self._fill(item, target)
        noisy = self.model(
            target,
            parameters=item.draw.parameters,
            ratio=item.draw.ratio,
            range_dn=item.range_dn,
            generator=item.generator,
            threads=threads_here(),
        )
        return self._sample(item, noisy, target)
