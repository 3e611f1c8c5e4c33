"""Batches of small crops with noise against batches of large ones: what a value costs, from arrays and from a store."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from torch.utils.data import DataLoader, Subset

from benchmarks import plain_noise
from benchmarks.harness import Row, in_turn
from benchmarks.synthetic_pairs import PlainPairs
from eldata.datasets import Arrays, CleanFrames, SyntheticPairs
from eldata.demo.scenes import scene_radiance
from eldata.noise import CameraProfile, NoiseModel
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.data import Files

_SMALL, _LARGE, _BATCH = 64, 256, 8
_VALUES = 4 << 20  # of each way in a round
_CAMERA = "SonyA7S2"


def run(files: Files, rounds: int, cores: int) -> list[Row]:  # noqa: ARG001 # every benchmark gets the cores
    frames = np.stack([scene_radiance(n + 1, 700, 900)[[0, 1, 2, 1]] for n in range(2)]).astype(np.float32)
    with tempfile.TemporaryDirectory(prefix="small-crops-", dir=files.data.parent) as folder:
        store = Path(folder) / "none.h5"
        build_store(source_of_dataset("eld-demo", root=files.data, manifest=files.manifest), store)
        sources: dict[str, Arrays | CleanFrames] = {
            "arrays": Arrays(frames, range_dn=plain_noise.RANGE_DN),
            "a store": CleanFrames(store),
        }
        ways: dict[str, Callable[[], object]] = {}
        for name, source in sources.items():
            for crop in (_SMALL, _LARGE):
                ours = SyntheticPairs(source, _CAMERA, crop=crop, crops_per_frame=_count(_SMALL))
                ours.set_epoch(0)  # each round makes the same items
                ways[f"crops of {crop}, {name}"] = _epoch_of(ours, crop)
        for crop in (_SMALL, _LARGE):
            ways[f"plain numpy, crops of {crop}"] = _epoch_of(PlainPairs(frames, crop, _count(crop)), crop)
        ways["the noise alone"] = _noise_alone()
        timings = in_turn(rounds, ways, dict.fromkeys(ways, _VALUES >> 20))
    rows = []
    for name in sources:
        small, large = (f"crops of {crop}, {name}" for crop in (_SMALL, _LARGE))
        case = f"2^20 values, batches of {_BATCH}, {name}"
        rows += [
            timings.cost(f"{case}: crops of {_SMALL}", small, large, at_most=2),
            timings.faster(f"{case}: crops of {_SMALL}", small, f"plain numpy, crops of {_SMALL}"),
            timings.faster(f"{case}: crops of {_LARGE}", large, f"plain numpy, crops of {_LARGE}"),
            timings.cost(f"{case}: crops of {_SMALL}", small, "the noise alone"),
        ]
    return rows


def _count(crop: int) -> int:
    return _VALUES // (4 * crop * crop)


def _epoch_of(dataset: Any, crop: int) -> Callable[[], object]:
    """Return a pass over as many values, as a DataLoader in this process makes and collates them."""
    loader: DataLoader[Any] = DataLoader(Subset(dataset, range(_count(crop))), batch_size=_BATCH)

    def epoch() -> None:
        for batch in loader:
            del batch

    return epoch


def _noise_alone() -> Callable[[], object]:
    """Return the noise of as many values in one image, on one thread."""
    model, generator = NoiseModel(clip="both"), np.random.default_rng(0)
    clean = np.full((4, 1 << 10, _VALUES >> 12), 0.2, np.float32)
    out = np.empty_like(clean)
    parameters = CameraProfile.load(_CAMERA).sample(generator)
    return lambda: model(
        clean, parameters=parameters, ratio=200, range_dn=15871, generator=generator, threads=1, out=out
    )
