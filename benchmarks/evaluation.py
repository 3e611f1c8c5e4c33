"""The evaluation of a pair, from files to scores."""

from __future__ import annotations

from typing import TYPE_CHECKING
from unittest.mock import patch

import numpy as np
import torch

from benchmarks import published
from benchmarks.harness import Row, in_turn
from benchmarks.oracle import deviations
from eldata import evaluate
from eldata.evaluation import score

if TYPE_CHECKING:
    from benchmarks.data import Files
    from eldata.evaluation import EvaluationResult


def looking_cost(files: Files, rounds: int) -> list[Row]:
    """Measure what looking for mistakes costs where every pair is looked at; of ELD's 240 pairs 24 are."""

    def looking() -> EvaluationResult:
        return evaluate(files.predictions, root=files.data, manifest=files.manifest)

    def scoring() -> EvaluationResult:
        with patch.object(score, "choose_frames", lambda _frames: frozenset()):
            return looking()

    count = len(looking().scores)
    timings = in_turn(rounds, {"looking for mistakes": looking, "scoring alone": scoring})
    return [timings.cost(f"{count} of {count} pairs looked at", "looking for mistakes", "scoring alone", at_most=1.03)]


def run(files: Files, rounds: int, _cores: int) -> list[Row]:
    noisy, reference = files.first_pair()
    prediction = files.first_prediction()

    def ours() -> EvaluationResult:
        return evaluate(files.predictions, root=files.data, manifest=files.manifest)

    def straightforward() -> tuple[float, float]:
        _, target = published.item(noisy, reference)
        return published.scores(torch.from_numpy(np.load(prediction)), torch.from_numpy(target))

    images = ours().scores
    first = next(image for image in images if noisy.match(image.path))
    target = published.read_packed(reference)
    values = deviations(np.load(prediction), target, (first.psnr_db, first.ssim), straightforward())
    timings = in_turn(
        rounds,
        {
            "LibRaw, both files": lambda: (published.decode(noisy), published.decode(reference)),
            "eldata": ours,
            "published": straightforward,
        },
        units={"eldata": len(images)},
    )
    case = f"one of {len(images)} pairs, jobs=1"
    return [
        *looking_cost(files, rounds),
        timings.faster(case, "eldata", "published", values=values),
        timings.cost(case, "eldata", "LibRaw, both files", at_most=1.4),
    ]
