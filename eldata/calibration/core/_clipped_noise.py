"""What a clip at 0 makes of noise, and what bias frames that clip show: values by channel, what pixels and rows share.

A pixel of level m records ``max(0, round(m + e))``, on average H(m): m itself far above 0, and nothing far below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._frames import classes_of_rows, groups_of_rows, sums_by_row
from eldata.calibration.core._tukey_lambda import NOTHING, TailTable
from eldata.errors import DatasetError
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from eldata.calibration.core._frames import Counts, Values
    from eldata.calibration.core._tukey_lambda import Nodes
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.row_noise import LineMeans


_PER_SIGMA = 16  # points of H
_SUMMED = 12  # standard deviations; further out, the sum over whole DN is an integral
_NORMAL = np.polynomial.hermite_e.hermegauss(21)
_LAGUERRE = np.polynomial.laguerre.laggauss(12)
_NO_VARIANCE = 1e-9  # DN^2

_CELLS_PER_SIGMA = 20
_CORE = 6  # standard deviations over the mean; beyond, cells grow
_GROWTH = 1.05
_LEAST_IN_TAIL = 20  # values in the outermost cell of the likelihood
_LEAST_CELLS = 4


class ClippedNoise:
    """Tukey-lambda noise of a shape and scale, for levels between two limits.

    A pixel of level m records ``max(0, round(m + e))``, on average H(m): m itself far above 0, and nothing far below.
    """

    def __init__(self, shape: float, scale: float, lowest: float, highest: float) -> None:
        from scipy.interpolate import CubicSpline

        self.sigma = scale * math.sqrt(tukey_lambda_variance(shape))
        self.tails = TailTable(self.sigma, shape, scale).tails
        # H(m) is the sum of P(e > k - 1/2 - m) over whole k from 1 on, on a grid that holds all these points.
        per_dn = max(1, math.ceil(_PER_SIGMA / self.sigma))
        first = -math.ceil(highest + 1) * per_dn
        count = math.ceil(_SUMMED * self.sigma - lowest + 2) * per_dn - first
        points = np.arange(first, first + count) / per_dn + 0.5
        sums = np.cumsum(self.tails(points).reshape(-1, per_dn)[::-1], axis=0)[::-1].ravel()
        far = (points[-1] + 0.5) * np.exp(np.linspace(0.0, 8.0, 400))
        sums += float(np.trapezoid(far * self.tails(far), np.log(far)))
        levels = 0.5 - points
        kept = levels >= lowest - 1
        self._mean = CubicSpline(levels[kept][::-1], sums[kept][::-1])

    def recorded(self, levels: Values, over_time: Nodes = NOTHING) -> Values:
        """Return H of levels, averaged over offsets that change with time."""
        values, chances = over_time
        found: Values = np.maximum(self._mean(np.add.outer(levels, values)), 0.0) @ chances
        return found


def normal(variance: float) -> Nodes:
    """Return nodes and weights of a normal distribution; of a variance below 0, which chance makes, those above."""
    if abs(variance) < _NO_VARIANCE:
        return NOTHING
    return _NORMAL[0] * math.sqrt(abs(variance)), _NORMAL[1] / _NORMAL[1].sum()


def laplace(variance: float) -> Nodes:
    """Return those of a Laplace distribution."""
    if variance < _NO_VARIANCE:
        return NOTHING
    half = _LAGUERRE[0] * math.sqrt(variance / 2)
    return np.concatenate([-half[::-1], half]), np.concatenate([_LAGUERRE[1][::-1], _LAGUERRE[1]]) / 2


def summed(first: Nodes, second: Nodes) -> Nodes:
    """Return nodes and weights of the sum of two independent variables."""
    return np.add.outer(first[0], second[0]).ravel(), np.multiply.outer(first[1], second[1]).ravel()


def variance(values: Values, chances: Values) -> Values:
    """Return the variance along the last axis."""
    centred = values - (values @ chances)[..., None]
    found: Values = centred**2 @ chances
    return found


@dataclass(frozen=True, slots=True, eq=False)
class ClippedStatistics:
    """What the frames show, by group of rows.

    ``counts`` (groups, channels, cells) of values in cells that begin at ``starts``, of which the first is 0 alone;
    ``pixels`` (groups, channels); ``products`` (groups, channels) the sums over pixels of the product of deviations in
    two frames, on average over all two frames; ``rows`` (groups,) sums of the variance of rows' means over time, less
    what the pixels' noise puts there, and ``lines`` how many rows; ``drift_dn2`` variance of channels' means over time.
    """

    fixed: FixedPattern
    starts: Counts
    counts: Values
    pixels: Values
    products: Values
    rows: Values
    lines: Values
    drift_dn2: float

    @classmethod
    def of(cls, counts: Counts, lines: LineMeans) -> ClippedStatistics:
        """Sum up the frames: their values by group of rows and channel, and what their lines show."""
        fixed = lines.fixed
        frames, (groups, _, size) = fixed.frames, counts.shape
        group = groups_of_rows(len(fixed.total_dn))
        each = np.arange(size, dtype=np.int64)
        number, sums, squares = (counts @ power for power in (np.ones_like(each), each, each**2))
        mean = sums.sum(axis=0) / number.sum(axis=0)
        by_frame = np.array(lines.means_dn)
        drift = ((by_frame - by_frame.mean(axis=0)) ** 2).sum(axis=0)
        # Of the deviations' sum over frames, squared, the frames' own squares are taken off; both are of one mean, from
        # which drift moves the frames apart, to the sum 0.
        totals = sums_by_row(np.where(fixed.defects, 0, fixed.total_dn).astype(np.int64) ** 2, fixed.pattern)
        of_totals = np.stack([np.bincount(group, one, minlength=groups) for one in totals.T], axis=1)
        both = of_totals - 2 * frames * mean * sums + number * frames * mean**2
        own = squares - 2 * mean * sums + number * mean**2
        products = (both - own + number / frames * drift) / (frames * (frames - 1))

        pixels = lines.row_pixels.sum(axis=1)
        used = pixels > 0
        of_pixels = lines.squares / ((frames - 1) * float(np.maximum(pixels - 1, 0).sum()))
        kept = np.count_nonzero(used) - classes_of_rows(fixed.pattern)
        of_rows = (np.array(lines.rows_dn) ** 2).sum(axis=0) / (frames - 1) * np.count_nonzero(used) / kept
        of_rows = np.where(used, of_rows - of_pixels / np.maximum(pixels, 1), 0.0)
        starts = _cell_starts(counts.sum(axis=(0, 1)), float(mean.max()), math.sqrt(max(fixed.temporal_variance_dn2)))
        return cls(
            fixed,
            starts,
            np.add.reduceat(counts, starts, axis=2).astype(np.float64),
            number / frames,
            products,
            np.bincount(group, of_rows, minlength=groups).astype(np.float64),
            np.bincount(group, used, minlength=groups).astype(np.float64),
            max(float(np.mean(drift / (frames - 1) - np.mean(lines.row_variances_dn2, axis=0))), 0.0),
        )


def _cell_starts(counts: Counts, mean: float, sigma: float) -> Counts:
    """Return where cells begin: 0 alone, then some twentieths of the standard deviation, and ever wider far out."""
    width = max(1.0, sigma / _CELLS_PER_SIGMA)
    starts = [0, 1]
    while starts[-1] + round(width) < len(counts):
        starts.append(starts[-1] + round(width))
        width *= _GROWTH if starts[-1] > mean + _CORE * sigma else 1.0
    tail = np.cumsum(counts[::-1])[::-1]
    kept = [start for start in starts if start <= 1 or tail[start] >= _LEAST_IN_TAIL]
    if len(kept) < _LEAST_CELLS:
        raise DatasetError(
            f"next to all values of the bias frames are 0, and the others lie in {len(kept) - 1} cells: they do not "
            "show a distribution; leave the bias frames out: flats alone still give K"
        )
    return np.array(kept, dtype=np.int64)
