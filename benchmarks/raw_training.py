"""A training of 200 steps on a tree like SID's, from its uncompressed raw files and from a store of them."""

from __future__ import annotations

import struct
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tifffile
import torch

from benchmarks.harness import Row, in_turn
from eldata.datasets import PackedStore, SIDDataset, training_loader
from eldata.manifest.catalogue import shipped_manifest
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.data import Files

SHAPE = (2848, 4256)  # of an A7S II's frames, borders included
_SCENES = ("00001", "00002")


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="raw-training-", dir=files.data.parent) as name:
        raws, store = make_datasets(Path(name), _SCENES, SHAPE, crop=256, crops_per_frame=40)
        losses: dict[str, list[float]] = {}

        def train_on(way: str) -> None:
            losses[way] = train({"raws": raws, "store": store}[way], steps=200, workers=cores - 1)

        timings = in_turn(min(rounds, 5), {way: partial(train_on, way) for way in ("raws", "store")})
        assert losses["raws"] == losses["store"]
        case = f"200 steps, {f'{cores - 1} worker' if cores > 1 else 'this process'}"
        return [replace(timings.cost(case, "raws", "store", at_most=1.1), values="losses bit-identical")]


def make_datasets(
    folder: Path, scenes: Sequence[str], shape: tuple[int, int], **options: Any
) -> tuple[SIDDataset, PackedStore]:
    """Write the frames of some of SID's scenes, pack them, and return both as datasets of as many crops."""
    generator = np.random.default_rng(0)
    for record in shipped_manifest("sid-sony").records:
        if record.scene in scenes:
            path = folder / "SID" / record.path
            path.parent.mkdir(parents=True, exist_ok=True)
            signal = 3000 if record.role == "reference" else 540
            mosaic = generator.normal(signal, 20, shape).astype(np.uint16)
            write_arw(path, mosaic, int(record.iso or 0), float(record.exposure_s or 0))
    build_store(source_of_dataset("sid-sony", root=folder, scenes=scenes), folder / "sid.h5")
    raws = SIDDataset(folder / "SID", scenes=scenes, split=None, seed=1, **options)
    return raws, PackedStore(folder / "sid.h5", augment=False, seed=1, **options)


def write_arw(path: Path, mosaic: np.ndarray[Any, Any], iso: int, exposure_s: float) -> None:
    """Write a TIFF as an A7S II's uncompressed ARW is one: numbers of 16 bits that call themselves 14."""
    tags: list[Any] = [(271, "s", 0, "SONY", True), (272, "s", 0, "ILCE-7SM2", True), (33421, "H", 2, (2, 2), True)]
    tags += [(33422, "B", 4, bytes((0, 1, 1, 2)), True), (34855, "H", 1, iso, True)]
    tags += [(33434, "2I", 1, (round(exposure_s * 1000), 1000), True)]
    tifffile.imwrite(path, mosaic, photometric=32803, metadata=None, extratags=tags)
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages.first.tags[258].offset
    with path.open("r+b") as file:
        file.seek(offset + 8)
        file.write(struct.pack("<H", 14))


def train(dataset: Any, steps: int, workers: int = 0) -> list[float]:
    """Train a small network from the same weights on a dataset's crops, in the same order; return the losses."""
    torch.manual_seed(0)
    layers = [torch.nn.Conv2d(4, 8, 3, padding=1), torch.nn.ReLU(), torch.nn.Conv2d(8, 4, 3, padding=1)]
    network = torch.nn.Sequential(*layers)
    optimiser, losses = torch.optim.Adam(network.parameters()), []
    dataset.set_epoch(0)
    for batch, _ in zip(training_loader(dataset, 4, num_workers=workers), range(steps), strict=False):
        loss = (network(batch["input"]) - batch["target"]).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    if len(losses) != steps:
        raise ValueError(f"{len(dataset)} crops are too few for {steps} steps")
    return losses
