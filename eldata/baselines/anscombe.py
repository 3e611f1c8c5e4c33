"""The generalised Anscombe transformation of Poisson-Gaussian values, and its exact unbiased inverse.

After M. Makitalo and A. Foi, "Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise",
IEEE Transactions on Image Processing 22 (2013). For ``z = a p + n`` with p of Poisson(y / a) and n normal of standard
deviation s, ::

    f(z) = 2 / a sqrt(max(a z + 3/8 a^2 + s^2, 0))

has a standard deviation of about 1. The exact unbiased inverse is the y whose E[f(z)] is the denoised value; inverting
f itself would make dark parts too dark. The expectation is worked out here as the definition has it, a sum over Poisson
counts and an integral over the normal part, and beyond ``_LARGEST`` counts by the paper's closed form.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.stats import poisson

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.baselines.signal_noise import SignalNoise

    Values = NDArray[np.floating[Any]]

_LARGEST = 200.0  # counts
_NODES = 801
_REACH = 8.0  # standard deviations
_POINTS = 400


def stabilised(image: Values, line: SignalNoise) -> Values:
    """Return the transform of an image: noise of standard deviation 1 wherever its signal is.

    Parameters
    ----------
    image
        Of any shape; negative values kept.
    line
        Of its noise.
    """
    if line.slope == 0:
        return np.asarray(image / np.sqrt(line.offset))
    counts, sigma = image / line.slope, np.sqrt(line.offset) / line.slope
    return np.asarray(2 * np.sqrt(np.maximum(counts + (3 / 8 + sigma**2), 0.0)))


def unstabilised(values: Values, line: SignalNoise) -> Values:
    """Return the signals whose stabilised values have these means: the exact unbiased inverse; 0 or more."""
    if line.slope == 0:
        return np.asarray(values * np.sqrt(line.offset))
    sigma = float(np.sqrt(line.offset) / line.slope)
    signals, expected = _table(sigma)
    inside = np.clip(values, expected[0], expected[-1])
    counts = PchipInterpolator(expected, signals)(inside)
    beyond = values > expected[-1]
    if beyond.any():
        d = values[beyond].astype(np.float64)
        root = np.sqrt(3 / 2)
        counts[beyond] = d**2 / 4 + root / (4 * d) - 11 / (8 * d**2) + 5 * root / (8 * d**3) - 1 / 8 - sigma**2
    return np.asarray(counts * line.slope)


@lru_cache(maxsize=16)
def _table(sigma: float) -> tuple[Values, Values]:
    """Return expected counts, ascending from 0, and E[f] of each, for a = 1."""
    signals = np.concatenate([[0.0], np.geomspace(1e-3, _LARGEST, _POINTS)])
    # f has a kink where it becomes 0, at which quadratures of higher order would be no better than this even grid.
    nodes = np.linspace(-_REACH, _REACH, _NODES)
    weights = np.exp(-0.5 * nodes**2)
    weights /= weights.sum()
    expected = np.empty_like(signals)
    for place, signal in enumerate(signals):
        low, high = (float(poisson.ppf(share, signal)) for share in (1e-12, 1 - 1e-12)) if signal else (0.0, 0.0)
        counts = np.arange(max(low, 0.0), high + 1)
        chance = poisson.pmf(counts, signal)
        inner = np.maximum(counts[:, None] + sigma * nodes + (3 / 8 + sigma**2), 0.0)
        expected[place] = (chance / chance.sum()) @ (2 * np.sqrt(inner) @ weights)
    return signals, expected
