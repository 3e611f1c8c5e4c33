"""Synthetic pairs through a DataLoader with two workers: ours, and the same loop with the plain numpy model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from benchmarks import plain_noise
from benchmarks.harness import Row, in_turn
from eldata.datasets import Arrays, SyntheticPairs
from eldata.demo.scenes import scene_radiance
from eldata.noise import CameraProfile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.data import Files

_FRAMES, _PER_FRAME, _CROP = 2, 16, 512


class PlainPairs(Dataset[dict[str, torch.Tensor]]):
    """Random crops, flips of the packed channels, noise by whole-array operations."""

    def __init__(self, frames: NDArray[np.float32], crop: int, count: int) -> None:
        self.frames, self.crop, self.count = frames, crop, count
        self.profile = CameraProfile.load("SonyA7S2")

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        if index >= len(self):
            raise IndexError(index)
        generator = np.random.default_rng([0, index])
        frame = self.frames[index % len(self.frames)]
        y, x = (int(generator.integers(side - self.crop + 1)) for side in frame.shape[1:])
        clean = np.ascontiguousarray(frame[:, y : y + self.crop, x : x + self.crop])
        ratio = float(generator.uniform(100, 300))
        noisy = plain_noise.with_numpy(clean, self.profile.sample(generator), ratio, generator)
        return {"input": torch.from_numpy(np.clip(noisy, 0, 1)), "target": torch.from_numpy(clean)}


def run(files: Files, rounds: int, cores: int) -> list[Row]:  # noqa: ARG001 # every benchmark gets the files
    frames = np.stack([scene_radiance(n + 1, 700, 900)[[0, 1, 2, 1]] for n in range(_FRAMES)]).astype(np.float32)
    ours = SyntheticPairs(
        Arrays(list(frames), range_dn=plain_noise.RANGE_DN), "SonyA7S2", crop=_CROP, crops_per_frame=_PER_FRAME
    )
    ours.set_epoch(0)  # each round makes the same items
    loaders: dict[str, DataLoader[object]] = {
        name: DataLoader(
            dataset, batch_size=4, num_workers=2, persistent_workers=True, multiprocessing_context="forkserver"
        )
        for name, dataset in (("plain numpy", PlainPairs(frames, _CROP, _FRAMES * _PER_FRAME)), ("eldata", ours))
    }

    def epoch(name: str) -> None:
        for batch in loaders[name]:
            del batch

    ways = {name: (lambda name=name: epoch(name)) for name in loaders}
    timings = in_turn(rounds, ways, dict.fromkeys(ways, _FRAMES * _PER_FRAME))
    return [timings.faster("a pair, DataLoader, 2 workers", "eldata", "plain numpy")]
