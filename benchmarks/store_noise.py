"""Noisy pairs from clean crops, two ways beside SyntheticPairs: the published loaders', and noise in the main process.

Apart from ``store_routes``, for scipy would count among the memory of a worker that only reads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.utils.data import Dataset

from benchmarks import plain_noise
from benchmarks.store_routes import CROP
from eldata.datasets.batches import Field, new_batch
from eldata.datasets.crops import Crop
from eldata.datasets.synthetic.draws import NoiseChoice
from eldata.noise import CameraProfile, NoiseModel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from benchmarks.store_routes import Lmdb
    from eldata.datasets import CleanFrames


class LmdbWithNoise(Dataset[dict[str, torch.Tensor]]):
    """Fixed clean patches, and the full noise model by whole-array operations, as the published loaders go about it."""

    def __init__(self, clean: Lmdb) -> None:
        self.clean = clean
        self.profile = CameraProfile.load("SonyA7S2")

    def __len__(self) -> int:
        return len(self.clean)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        generator = np.random.default_rng([0, index])
        clean = self.clean.crop(self.clean.places[index][0], 1, 0, 0)
        ratio = float(generator.uniform(100, 300))
        noisy = plain_noise.with_numpy(clean, self.profile.sample(generator), ratio, generator)
        return {"input": torch.from_numpy(np.clip(noisy, 0, 1)), "target": torch.from_numpy(clean)}


class CleanCrops(Dataset[dict[str, Any]]):
    """Clean crops of a store alone, for noise that the main process makes, on whole batches by all threads."""

    def __init__(self, source: CleanFrames, count: int) -> None:
        self.source, self.count = source, count
        self.model = NoiseModel(clip="both")
        self.choice = NoiseChoice.of("SonyA7S2", (100.0, 300.0), None, "any")

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> dict[str, Any]:
        return dict(self.__getitems__([index])[0])

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        batch = new_batch([Field("target", (len(indices), 4, CROP, CROP), "<f4")])
        if batch is None:
            raise RuntimeError("too many batches are held")
        for number, index in enumerate(indices):
            frame = self.source.frame(index % len(self.source))
            crop = Crop.draw(frame, np.random.default_rng([0, index]), crop=CROP, augment=False)
            crop.fill(frame, batch.arrays["target"][number])
        return batch.parts([{"target": None, "index": index} for index in indices])

    def noisy(self, batch: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return noisy exposures of a batch."""
        generators = [np.random.default_rng([0, 1, index]) for index in batch["index"].tolist()]
        draws = [self.choice.draw(generator, plain_noise.RANGE_DN) for generator in generators]
        return self.model.apply(batch["target"].numpy(), draws, generators[0])
