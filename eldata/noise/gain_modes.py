"""Gain modes: the ranges in which a camera keeps its conversion gain, and the noise's lines over K in each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

GAIN_ROUNDING = 0.01
"""Of ln K: gains are printed and stated with few digits."""


@dataclass(frozen=True, slots=True)
class LogLogFit:
    """The line of ln(scale in DN) over ln(K in DN/e-), and the standard deviation of its residuals."""

    slope: float
    intercept: float
    sigma: float

    def scale_dn(self, gain_dn_per_e: float, standard_normal: float) -> float:
        """Return the scale at a gain, ``standard_normal`` residual deviations off the line."""
        mean = self.slope * math.log(gain_dn_per_e) + self.intercept
        return math.exp(mean + self.sigma * standard_normal)


@dataclass(frozen=True, slots=True)
class GainMode:
    """One of the conversion gains of a camera: where it is used, and the fits over K that hold there.

    Attributes
    ----------
    gain_range_dn_per_e
        Its lowest and its highest system gain K.
    tukey_lambda_fit, gauss_fit, row_fit
        Fits of sigma_TL, of the Gaussian sigma and of sigma_row over K.
    iso_range
        Its lowest and its highest ISO, if known: those of ``gain_range_dn_per_e``, where no row has them.
    """

    gain_range_dn_per_e: tuple[float, float]
    tukey_lambda_fit: LogLogFit
    gauss_fit: LogLogFit
    row_fit: LogLogFit
    iso_range: tuple[float, float] | None = None

    @property
    def log_width(self) -> float:
        """ln(highest K / lowest K)."""
        low, high = (math.log(limit) for limit in self.gain_range_dn_per_e)
        return high - low

    def distance(self, gain_dn_per_e: float) -> float:
        """Return how far a gain lies from the range, as the absolute difference of logarithms; 0 within it."""
        low, high = self.gain_range_dn_per_e
        return max(0.0, math.log(low / gain_dn_per_e), math.log(gain_dn_per_e / high))

    def __str__(self) -> str:
        """Return the ISOs, or the gains where those are not known."""
        if self.iso_range is None:
            return "K {:.4g} to {:.4g}".format(*self.gain_range_dn_per_e)
        return "ISO {:g} to {:g}".format(*self.iso_range)


def modes_problem(
    modes: Sequence[GainMode], gain_range_dn_per_e: tuple[float, float], iso_range: tuple[float, float] | None
) -> str | None:
    """Return why modes do not go together with each other and with the ranges of their camera; ``None`` if they do."""
    if len(modes) < 2:
        return "one mode alone is the profile's own range and fits; there must be none, or two and more"
    ranges = [("gain_range_dn_per_e", gain_range_dn_per_e, [mode.gain_range_dn_per_e for mode in modes])]
    isos = [mode.iso_range for mode in modes if mode.iso_range is not None]
    if len(isos) != (0 if iso_range is None else len(modes)):
        return "all modes and the profile state an iso_range, or none of them does"
    if iso_range is not None:
        ranges.append(("iso_range", iso_range, isos))
    for name, whole, each in ranges:
        ends = [end for limits in each for end in limits]
        if any(low >= high for low, high in pairwise(ends)):
            listed = ", ".join("{:g} to {:g}".format(*limits) for limits in each)
            return f"each mode's {name} must be wider than nothing and end below the next one's; found {listed}"
        if whole != (ends[0], ends[-1]):
            return f"{name} must go from the first mode's to the last one's, {ends[0]:g} to {ends[-1]:g}"
    return None
