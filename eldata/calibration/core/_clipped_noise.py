"""What a clip at 0 makes of noise: mean recorded values by level, and what pixels and rows of many levels show of it.

A pixel of level m records ``max(0, round(m + e))``, on average H(m): m itself far above 0, and nothing far below.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._kernels import mixture_tails, smoothed_tails
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    Values: TypeAlias = NDArray[np.float64]
    Nodes: TypeAlias = tuple[Values, Values]

_TABLE = np.linspace(0.0, 9.0, 1201)  # arsinh(x / standard deviation): to 4000 standard deviations
_PER_SIGMA = 16  # points of H
_SUMMED = 12  # standard deviations; further out, the sum over whole DN is an integral
_NORMAL = np.polynomial.hermite_e.hermegauss(21)
_LAGUERRE = np.polynomial.laguerre.laggauss(12)
_NONE: Nodes = (np.zeros(1), np.ones(1))
_NO_VARIANCE = 1e-9  # DN^2


class ClippedNoise:
    """Tukey-lambda noise of a shape and scale, for levels between two limits."""

    def __init__(self, shape: float, scale: float, lowest: float, highest: float) -> None:
        from scipy.interpolate import CubicSpline

        self.sigma = scale * math.sqrt(tukey_lambda_variance(shape))
        tails = smoothed_tails(self.sigma * np.sinh(_TABLE), shape, scale, np.zeros(1), np.ones(1))
        self._table = np.log(np.maximum(tails, 1e-40))
        # H(m) is the sum of P(e > k - 1/2 - m) over whole k from 1 on, on a grid that holds all these points.
        per_dn = max(1, math.ceil(_PER_SIGMA / self.sigma))
        first = -math.ceil(highest + 1) * per_dn
        count = math.ceil(_SUMMED * self.sigma - lowest + 2) * per_dn - first
        points = np.arange(first, first + count) / per_dn + 0.5
        sums = np.cumsum(self.tails(points, _NONE).reshape(-1, per_dn)[::-1], axis=0)[::-1].ravel()
        far = (points[-1] + 0.5) * np.exp(np.linspace(0.0, 8.0, 400))
        sums += float(np.trapezoid(far * self.tails(far, _NONE), np.log(far)))
        levels = 0.5 - points
        kept = levels >= lowest - 1
        self._mean = CubicSpline(levels[kept][::-1], sums[kept][::-1])

    def tails(self, edges: Values, others: Nodes) -> Values:
        """Return P(e + z > edge) for a z of these values and chances."""
        found: Values = mixture_tails(
            np.ascontiguousarray(edges), 1.0, *others, self.sigma, float(_TABLE[1]), self._table
        )
        return found

    def recorded(self, levels: Values, over_time: Nodes = _NONE) -> Values:
        """Return H of levels, averaged over offsets that change with time."""
        values, chances = over_time
        found: Values = np.maximum(self._mean(np.add.outer(levels, values)), 0.0) @ chances
        return found


def normal(variance: float) -> Nodes:
    """Return nodes and weights of a normal distribution; of a variance below 0, which chance makes, those above."""
    if abs(variance) < _NO_VARIANCE:
        return _NONE
    return _NORMAL[0] * math.sqrt(abs(variance)), _NORMAL[1] / _NORMAL[1].sum()


def laplace(variance: float) -> Nodes:
    """Return those of a Laplace distribution."""
    if variance < _NO_VARIANCE:
        return _NONE
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
