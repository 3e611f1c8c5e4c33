"""The probability plots as the paper takes them: of one bias frame less its rows' means, with its fixed pattern in it.

The estimate takes each pixel's own mean off first (:mod:`eldata.calibration.core.read_noise`), so its R^2 is another
number: non-uniformity, which is not noise, takes part in the published one. Both follow the extreme tails, since a
probability plot weighs a residual by its square; defects are left out of both, or a handful of hot pixels would be all
they show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._frames import sums_by_row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core.defects import FixedPattern

_UNITS = 256  # of a DN: rows' means are rounded to them
_CELLS_PER_SIGMA = 20
_HALF = 8192  # cells on each side of 0: 400 standard deviations


@dataclass(frozen=True, slots=True)
class SingleFramePlot:
    """Coefficients of determination of one frame's probability plots.

    Attributes
    ----------
    r_squared_tl, r_squared_gauss
        Against Tukey lambda at the shape that fits best (PPCC), and against the normal distribution.
    tukey_lambda
        That shape.
    """

    r_squared_tl: float
    r_squared_gauss: float
    tukey_lambda: float


def single_frame_plot(mosaic: NDArray[np.uint16], fixed: FixedPattern) -> SingleFramePlot:
    """Return R^2 of the probability plots of a bias frame's sound pixels less their channels' and their rows' means."""
    from eldata.calibration.core._kernels import residual_histogram
    from eldata.calibration.core._tukey_lambda import correlation, normal_correlation
    from eldata.calibration.core.read_noise import ppcc

    sound = ~fixed.defects
    sums, pixels = sums_by_row(mosaic * sound, fixed.pattern), sums_by_row(sound, fixed.pattern)
    level = sums.sum(axis=0) / np.maximum(pixels.sum(axis=0), 1)
    row = (sums - pixels * level).sum(axis=1) / np.maximum(pixels.sum(axis=1), 1)
    phases = np.arange(len(row)) % len(fixed.pattern)
    offsets = np.rint(_UNITS * (row[:, None] + level[fixed.pattern[phases]])).astype(np.int64)
    sigma = math.sqrt(float(np.mean(fixed.temporal_variance_dn2)) + max(fixed.summary.dsnu_dn) ** 2)
    step = max(1, round(_UNITS * sigma / _CELLS_PER_SIGMA)) | 1  # odd: cell 0 is symmetric
    of_group = np.zeros((1, 2 * _HALF + 1), dtype=np.int64)
    nothing = np.zeros(mosaic.shape, dtype=np.uint32)
    residual_histogram(mosaic, nothing, fixed.defects, _UNITS, offsets, step, of_group)
    counts = of_group[0]
    filled = np.flatnonzero(counts)
    values = np.asarray((filled - _HALF) * (step / _UNITS), dtype=np.float64)
    number = counts[filled].astype(np.float64)
    shape, _, _ = ppcc(values, number)
    return SingleFramePlot(
        r_squared_tl=correlation(values, number, shape)[0] ** 2,
        r_squared_gauss=normal_correlation(values, number)[0] ** 2,
        tukey_lambda=shape,
    )
