"""Rescaling, PSNR and SSIM of one prediction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from benchmarks import published
from benchmarks.harness import Row, Spread, in_turn, peak_growth_mb
from benchmarks.oracle import deviations
from eldata.metrics import Score, score
from eldata.raw import read_raw
from eldata.raw.levels import packed_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.data import Files

_PEAK_LIMIT_MB = 200  # beyond the inputs


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    prediction: NDArray[np.float32] = np.load(files.first_prediction())
    reference = packed_frame(read_raw(files.first_pair()[1]), levels="published", clip="both")
    tensors = torch.from_numpy(prediction), torch.from_numpy(reference)

    def ours() -> Score:
        return score(prediction, reference, rescaling="scalar")

    def straightforward() -> tuple[float, float]:
        return published.scores(*tensors)

    # The memory for compiling and importing is not part of the peak.
    score(prediction[:, :64, :64], reference[:, :64, :64], rescaling="scalar")
    published.scores(*(tensor[:, :64, :64] for tensor in tensors))
    peak_mb, published_mb = peak_growth_mb(ours), peak_growth_mb(straightforward)

    result = ours()
    values = deviations(prediction, reference, (result.psnr_db, result.ssim), straightforward())
    target = np.empty_like(prediction)
    timings = in_turn(
        rounds,
        {
            "published": straightforward,
            "eldata": ours,
            "copy of the prediction": lambda: np.copyto(target, prediction),
        },
    )
    case = "rescale, PSNR, SSIM"
    return [
        timings.faster(case, "eldata", "published", at_least=20 if cores >= 4 else 10, values=values),
        timings.cost(case, "eldata", "copy of the prediction"),
        Row(case, Spread.of([peak_mb]), "published", Spread.of([published_mb]), peak_mb, " MB", _PEAK_LIMIT_MB),
    ]
