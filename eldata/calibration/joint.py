"""The joint distribution of the parameters over the gain: lines of ln(scale) over ln K."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError, DatasetError
from eldata.noise.profile import LogLogFit

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class LogLogEstimate:
    """A fitted line with its uncertainty.

    Attributes
    ----------
    fit
        Slope, intercept and residual standard deviation, for a camera profile.
    slope_error, intercept_error
        Standard errors; the quantile to use with them is Student's for ``points - 2``.
    sigma_error
        Of the residual standard deviation: sigma / sqrt(2 (points - 2)).
    r_squared
        Share of the variance of ln(scale) that the line explains.
    points
        Number of measurements.
    """

    fit: LogLogFit
    slope_error: float
    intercept_error: float
    sigma_error: float
    r_squared: float
    points: int


def fit_log_log(gains_dn_per_e: Sequence[float], scales_dn: Sequence[float]) -> LogLogEstimate:
    """Fit ``ln(scale) = a ln(K) + b`` by ordinary least squares (equation "sampling").

    The residual variance is unbiased: the squared residuals over n - 2.

    Raises
    ------
    ArgumentError
        If the numbers differ in length, or one is not finite and positive.
    DatasetError
        If there are fewer than three measurements, or all at one gain.
    """
    gains, scales = np.asarray(gains_dn_per_e, dtype=np.float64), np.asarray(scales_dn, dtype=np.float64)
    if gains.ndim != 1 or gains.shape != scales.shape:
        raise ArgumentError(f"gains and scales come in pairs; found shapes {gains.shape} and {scales.shape}")
    if not np.all(np.isfinite(gains) & np.isfinite(scales) & (gains > 0) & (scales > 0)):
        raise ArgumentError(
            "gains and scales must be finite and above 0; leave out ISOs at which a scale was not measurable"
        )
    if len(gains) < 3 or not np.ptp(gains) > 0:
        raise DatasetError(
            f"a line with its residual deviation needs three ISOs of different gain or more; found {len(gains)} "
            f"measurement(s) at {len(set(gains.tolist()))} gain(s)"
        )
    x, y = np.log(gains), np.log(scales)
    centred = x - x.mean()
    lever = float(centred @ centred)
    slope = float(centred @ y) / lever
    intercept = float(y.mean() - slope * x.mean())
    squares = float(((y - slope * x - intercept) ** 2).sum())
    total = float(((y - y.mean()) ** 2).sum())
    freedom = len(x) - 2
    sigma = math.sqrt(squares / freedom)
    return LogLogEstimate(
        fit=LogLogFit(slope=slope, intercept=intercept, sigma=sigma),
        slope_error=sigma / math.sqrt(lever),
        intercept_error=sigma * math.sqrt(1 / len(x) + float(x.mean()) ** 2 / lever),
        sigma_error=sigma / math.sqrt(2 * freedom),
        r_squared=1 - squares / total if total > 0 else 1.0,
        points=len(x),
    )
