"""The joint distribution of the parameters over the gain: lines of ln(scale) over ln K."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.audit import Finding
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.profile import LogLogFit

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray


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


_BY_CHANCE = 0.002  # of one fit: a calibration has three


@dataclass(frozen=True, slots=True)
class _Step:
    """A step between two neighbours in a line of ln(scale) over ln(K), which ``place`` points lie below."""

    place: int
    height: float
    statistic: float
    threshold: float
    spread_without: float


def step_findings(
    points: Mapping[str, Sequence[tuple[float, float]]], iso_of: Mapping[float, float]
) -> Iterator[Finding]:
    """Yield a remark if ``ln(scale)`` over ``ln(K)`` has a step, as where a camera switches its conversion gain.

    For each place with two ISOs or more on either side, a step is fitted beside slope and intercept. The largest of
    their ratios to their standard errors is held against Student's quantile for n - 3 degrees of freedom, with the
    chance divided among the places. A step must also explain more than a parabola does, so that read noise of two
    parts, before and after the amplifier, which bends the line, is not taken for one.

    Parameters
    ----------
    points
        K and scale by the scale's name; scales of 0 are left out.
    iso_of
        The ISO of each K.
    """
    found: dict[tuple[float, float], list[tuple[str, _Step, float]]] = {}
    for name, measured in points.items():
        usable = sorted((gain, scale) for gain, scale in measured if scale > 0 and math.isfinite(scale))
        if len(usable) < 5 or len({gain for gain, _ in usable}) < len(usable):
            continue
        gains, scales = zip(*usable, strict=True)
        step = _step(gains, scales)
        if step is not None:
            place = (iso_of[gains[step.place - 1]], iso_of[gains[step.place]])
            found.setdefault(place, []).append((name, step, fit_log_log(gains, scales).fit.sigma))
    for (below, above), steps in found.items():
        heights = " and ".join(f"{name} ({math.expm1(step.height):+.0%})" for name, step, _ in steps)
        spreads = " and ".join(f"{spread:.2g} ({step.spread_without:.2g} without it)" for _, step, spread in steps)
        largest = max((step for _, step, _ in steps), key=lambda step: step.statistic / step.threshold)
        yield Finding(
            "a step in a joint fit",
            (),
            "remark",
            largest.statistic,
            largest.threshold,
            f"between ISO {below:g} and {above:g} there is a step over K of {heights}, as where a camera switches its "
            f"conversion gain; it makes the spread around the line larger, {spreads}, and noise drawn from the fit "
            "more varied than the camera's: calibrate the ISOs on either side by themselves (--iso)",
        )


def _step(gains: Sequence[float], scales: Sequence[float]) -> _Step | None:
    from scipy.special import stdtrit

    count = len(gains)
    x, y = np.log(np.asarray(gains)), np.log(np.asarray(scales))
    line = np.stack([np.ones(count), x - x.mean()])
    places, freedom = range(2, count - 1), count - 3
    threshold = float(-stdtrit(freedom, _BY_CHANCE / (2 * len(places))))
    steps = []
    for place in places:
        height, power, rest = _added(line, (np.arange(count) >= place).astype(np.float64), y)
        error = math.sqrt(max(rest, 1e-24) / freedom / power)  # points on a line, to rounding
        steps.append((abs(height) / error, place, height, rest))
    statistic, place, height, rest = max(steps)
    _, _, bent = _added(line, (x - x.mean()) ** 2, y)
    if statistic <= threshold or rest >= bent:
        return None
    return _Step(place, height, statistic, threshold, math.sqrt(rest / freedom))


def _added(
    line: NDArray[np.float64], regressor: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Return the coefficient of a regressor beside those of a line, its own power, and the squares that are left."""
    solved = np.linalg.solve(line @ line.T, np.stack([line @ regressor, line @ y]).T)
    own, rest = regressor - line.T @ solved[:, 0], y - line.T @ solved[:, 1]
    power = float(own @ own)
    found = float(own @ rest) / power
    return found, power, float(((rest - found * own) ** 2).sum())
