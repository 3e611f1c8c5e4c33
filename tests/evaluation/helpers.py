"""Small trees and folders of predictions that the tests of the evaluation and of the command line share."""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldata.datasets.published import DRVDataset
from eldata.demo.tree import make_tree
from eldata.evaluation import EvaluationResult, save_clip_prediction
from eldata.evaluation.request import make_request, plan_scoring
from eldata.protocols import Protocol
from eldata.records import PairRecord
from tests.drv_tree import SmallDrv, generator_of, rgb_frame_of, still_of
from tests.evaluation import oracle
from tests.evaluation.own_set import Placed
from tests.evaluation.published_code import Score

SIZE = (64, 96)


@dataclass(frozen=True)
class Tree(Placed):
    """A demo tree: ``folder`` holds ``data/ELD-demo`` and ``manifests``."""

    folder: Path

    @property
    def root(self) -> Path:
        return self.folder / "data"

    @property
    def files(self) -> Path:
        return self.root / "ELD-demo"

    @property
    def manifest(self) -> Path:
        return self.folder / "manifests" / "eld-demo.csv"

    @property
    def pairs(self) -> list[oracle.Pair]:
        return oracle.pairs(self.files)

    def copy(self, folder: Path) -> Tree:
        shutil.copytree(self.folder, folder)
        return Tree(folder)


def scored_pairs(dataset: str, protocol: str | Protocol, **options: Any) -> list[PairRecord]:
    """The pairs that a protocol scores of a shipped set."""
    request = make_request("predictions", dataset, protocol, **options)
    return [pair for pair in plan_scoring(request).pairs if isinstance(pair, PairRecord)]


def small_tree(folder: Path, scenes: int = 1) -> Tree:
    make_tree(folder, scenes=scenes, size=SIZE)
    return Tree(folder)


def perturbed(target: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """A prediction as a network would make it: too bright, a little noisy, in places saturated, beyond, or negative."""
    generator = np.random.default_rng(zlib.crc32(name.encode()))
    result = 1.15 * target + generator.normal(0.0, 0.02, target.shape)
    result[:, 5:7, 30:33] = 1.0
    result[:, 20, 2:4] = 1.25
    result[:, 28:30, 10:30] -= 0.1
    return result


def place(
    folder: Path, tree: Tree, make: Callable[[NDArray[np.float64], str], NDArray[Any]] | None = None
) -> dict[str, NDArray[Any]]:
    """Write a packed float32 prediction of each pair; return what was written, by the noisy frame's path."""
    written: dict[str, NDArray[Any]] = {}
    for pair in tree.pairs:
        target = oracle.reference(tree.files / pair.reference)
        prediction = perturbed(target, pair.path) if make is None else make(target, pair.path)
        path = (folder / pair.path).with_suffix(".npy")
        path.parent.mkdir(parents=True, exist_ok=True)
        written[pair.path] = prediction.astype(np.float32)
        np.save(path, written[pair.path])
    return written


CLIPS = ("0007", "0013")
SCORED_FRAMES = range(5, 10)  # numbered from 1


def predicted_frame(clip: str, number: int) -> NDArray[np.float32]:
    """A prediction as a network would make it: too bright, somewhat noisy, in places beyond [0, 1]."""
    still, noisy = (image.transpose(2, 0, 1) / 65535 for image in (still_of(clip), rgb_frame_of(clip, number)))
    frame = 1.1 * (0.8 * still + 0.2 * noisy) + generator_of(f"{clip}-{number}").normal(0, 0.005, still.shape)
    frame[:, 3:5, 7:9] = 1.2
    frame[:, 9:11, 2:5] = -0.1
    return frame.astype(np.float32)


def predicted_clip(clip: str) -> NDArray[np.float32]:
    return np.stack([predicted_frame(clip, number) for number in SCORED_FRAMES])


def predict_clips(drv: SmallDrv, folder: Path) -> None:
    """Save the predicted frames of every clip with scored ones."""
    for record in DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records:
        written = save_clip_prediction(folder, record, predicted_clip(record.scene))
        names = [f"{record.scene}/{number:04d}.npy" for number in SCORED_FRAMES]
        assert [path.relative_to(folder).as_posix() for path in written] == names


def assert_equal(result: EvaluationResult, of: Callable[[Any], Score]) -> None:
    """Hold each score and factor against those of another route, to 1e-6 dB, and 1e-6."""
    assert not result.problems
    assert len(result.scores) == len(result.units) > 0
    off = []
    for pair, image in zip(result.units, result.scores, strict=True):
        score = of(pair)
        factor = 1.0 if np.isnan(score.factor) else score.factor
        off.append((image.psnr_db - score.psnr_db, image.ssim - score.ssim, image.rescale - factor))
    largest = np.abs(off).max(axis=0)
    print(f"{result.protocol.name}: {len(off)} pairs, largest differences of PSNR, SSIM and factor {largest}")
    assert np.all(largest <= 1e-6), result.protocol.name
