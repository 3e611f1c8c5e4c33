"""Is the light modulated from row to row? A rolling shutter turns a lamp's flicker into bands.

Each row of cells gives a relative modulation m, its weighted regression on what the reference leads to expect, in one
of two ways. Then every frequency f from one cycle per frame up is tried: ``m = a + b row + A cos(2 pi f row + phase)``
by weighted least squares. With g what the wave takes off the weighted squares and s what is left of them, v degrees of
freedom over, chance alone exceeds ``g v / s = (A / standard error)^2 = c`` with the probability
``(1 + c / v)^(-v / 2)`` (the F distribution with 2 and v), at n frequencies with n times that at most. What is left
holds the noise that the rows really have, row noise and banding included, so no noise model is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.measures import Estimate, find_kind
from capture.check.ratio import residuals_between

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.check.cells import Cells
    from capture.check.ratio import StripResiduals
    from capture.check.result import CheckedGroup

    Array = NDArray[np.float64]

_FALSE_ALARM: Final = 1e-6  # of one frame
_STEP: Final = 0.25  # cycles per frame
_LEAST_ROWS: Final = 16
_FITTED: Final = 4  # a, b, A and the phase


@dataclass(frozen=True, slots=True)
class Flicker:
    """The strongest modulation.

    Attributes
    ----------
    amplitude
        As a share of the signal, with its standard error.
    cycles
        Number of them in the frame's height.
    sigmas
        Standard errors that the strongest of these frequencies exceeds by chance once in a million frames.
    """

    amplitude: Estimate
    cycles: float
    sigmas: float


def flicker_of_contrast(residuals: StripResiduals) -> Flicker | None:
    """Measure the modulation of the scene's contrast within each row.

    Offsets of rows, such as row noise and banding of the sensor, drop out: right for dark frames. It needs a scene with
    contrast along its rows.
    """
    weight = residuals.sigma_dn**-2.0
    total = np.maximum(weight.sum(axis=2, keepdims=True), 1e-300)
    expected = residuals.expected_dn - (weight * residuals.expected_dn).sum(axis=2, keepdims=True) / total
    return _strongest(*_modulation(weight, expected, residuals.residual_dn))


def flicker_of_level(residuals: StripResiduals) -> Flicker | None:
    """Measure the modulation of the rows' whole signal: right for bright frames, and for flats without contrast."""
    weight = residuals.sigma_dn**-2.0
    return _strongest(*_modulation(weight, residuals.expected_dn, residuals.residual_dn))


def flicker_between(first: Cells, second: Cells, ratios: Sequence[Estimate | None]) -> Flicker | None:
    """Measure the modulation between two bright frames, given the ratio of brightness of each channel.

    ``None`` if a channel has no ratio, or too little is well exposed.
    """
    known = [ratio.value for ratio in ratios if ratio is not None]
    residuals = residuals_between(first, second, known) if len(known) == len(ratios) else None
    return None if residuals is None else flicker_of_level(residuals)


def add_flicker(group: CheckedGroup, path: str, flicker: Flicker | None, kind: str = "flicker", **words: str) -> None:
    """Add what flicker was measured in a frame, if it was, judged by this frame's own chance."""
    if flicker is not None:
        own = replace(find_kind(kind), sigmas=flicker.sigmas)
        group.measure(own, path, flicker.amplitude.in_percent(), cycles=f"{flicker.cycles:g}", **words)


def _modulation(weight: Array, expected: Array, residual: Array) -> tuple[Array, Array]:
    """Return the relative modulation of each row, and the inverse of its variance."""
    information = (weight * expected**2).sum(axis=(0, 2))
    return (weight * expected * residual).sum(axis=(0, 2)) / np.maximum(information, 1e-300), information


def _strongest(modulation: Array, information: Array) -> Flicker | None:
    rows = len(modulation)
    if rows < _LEAST_ROWS or np.count_nonzero(information > information.max() / 100) < _LEAST_ROWS:
        return None
    cycles = np.arange(1, rows / 2 - 1, _STEP)
    place = (np.arange(rows) + 0.5) / rows
    base = np.stack([np.ones(rows), place - 0.5], axis=1)
    gram = base.T @ (information[:, None] * base)

    def without_trend(columns: Array) -> Array:
        trend: Array = base @ np.linalg.solve(gram, base.T @ (information[:, None] * columns))
        return columns - trend

    turns = 2 * np.pi * place[:, None] * cycles
    cosine, sine = without_trend(np.cos(turns)), without_trend(np.sin(turns))
    values = without_trend(modulation[:, None])[:, 0]
    weighted = information[:, None]
    cc, cs, ss = (
        (weighted * first * second).sum(axis=0) for first, second in ((cosine,) * 2, (cosine, sine), (sine,) * 2)
    )
    determinant = cc * ss - cs**2
    regular = determinant > 1e-6 * cc * ss
    determinant = np.where(regular, determinant, np.inf)

    by_cosine, by_sine = ((information * values) @ wave for wave in (cosine, sine))
    in_cosine = (ss * by_cosine - cs * by_sine) / determinant
    in_sine = (cc * by_sine - cs * by_cosine) / determinant
    gained = np.where(regular, in_cosine * by_cosine + in_sine * by_sine, 0)
    best = int(np.argmax(gained))
    amplitude = float(np.hypot(in_cosine[best], in_sine[best]))
    freedom = int(np.count_nonzero(information)) - _FITTED
    noise = (float((information * values**2).sum()) - float(gained[best])) / freedom
    # From what is gained, so that amplitude over standard error is the root of it over the noise.
    error = amplitude / math.sqrt(gained[best] / noise) if gained[best] > 0 and noise > 0 else math.inf
    sigmas = math.sqrt(freedom * ((len(cycles) / _FALSE_ALARM) ** (2 / freedom) - 1))
    return Flicker(Estimate(amplitude, error), float(cycles[best]), sigmas)
