"""The joint distribution of the parameters over the gain: lines of ln(scale) over ln K."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.core.findings import STEP
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.gain_modes import GainMode, LogLogFit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.calibration.core.findings import Finding


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

    Examples
    --------
    >>> from eldata.calibration import fit_log_log
    >>> line = fit_log_log([1, 4, 16, 64], [2, 4, 8, 16])
    >>> round(line.fit.slope, 6), line.points
    (0.5, 4)
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
            f"a line with its residual deviation needs three ISOs of different gain or more; found "
            f"{counted(len(gains), 'measurement')} at {counted(len(set(gains.tolist())), 'gain')}"
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


@dataclass(frozen=True, slots=True)
class FittedMode:
    """A gain mode with the uncertainty of its lines.

    Attributes
    ----------
    mode
        As the profile has it.
    tukey_lambda_fit, gauss_fit, row_fit
        The estimates; ``None`` where fewer than three of the mode's ISOs can be fitted.
    """

    mode: GainMode
    tukey_lambda_fit: LogLogEstimate | None
    gauss_fit: LogLogEstimate | None
    row_fit: LogLogEstimate | None


_BY_CHANCE = 0.002  # of one fit: a calibration has three
_ROUNDING = 1e-24  # squares that are left of points on a line


@dataclass(frozen=True, slots=True)
class _Step:
    """A step between two neighbours in a line of ln(scale) over ln(K), which ``place`` points lie below."""

    place: int
    height: float
    statistic: float
    threshold: float
    spread_without: float


@dataclass(frozen=True, slots=True)
class GainStep:
    """A step in joint fits between two neighbouring gains, as where a camera switches its conversion gain.

    Attributes
    ----------
    below_dn_per_e, above_dn_per_e
        The last K before it and the first one after it.
    steps
        By the scale's name, with the spread around a line that goes through.
    """

    below_dn_per_e: float
    above_dn_per_e: float
    steps: tuple[tuple[str, _Step, float], ...]

    def finding(self, iso_of: Mapping[float, float], *, is_taken: bool) -> Finding:
        """Return the remark on it: that the profile has modes on either side, or what its lines suffer."""
        below, above = iso_of[self.below_dn_per_e], iso_of[self.above_dn_per_e]
        heights = " and ".join(f"{name} ({math.expm1(step.height):+.0%})" for name, step, _ in self.steps)
        spreads = " and ".join(f"{spread:.2g} ({step.spread_without:.2g} without it)" for _, step, spread in self.steps)
        largest = max((step for _, step, _ in self.steps), key=lambda step: step.statistic / step.threshold)
        seen = (
            f"between ISO {below:g} and {above:g} there is a step over K of {heights}, as where a camera switches its "
            "conversion gain"
        )
        if is_taken:
            outcome = (
                ": the profile has a gain mode on either side, each with lines of its own, and knows nothing between "
                "them; where the camera switches can be stated (--mode ISO)"
            )
        else:
            outcome = (
                f"; it makes the spread around the line larger, {spreads}, and noise drawn from the fit more varied "
                "than the camera's: state the modes (--mode ISO), or calibrate the ISOs on either side by themselves "
                "(--iso)"
            )
        return STEP.seen(largest.statistic, largest.threshold, seen + outcome)


def gain_steps(points: Mapping[str, Sequence[tuple[float, float]]]) -> tuple[GainStep, ...]:
    """Return the steps of ``ln(scale)`` over ``ln(K)``, ascending, as where a camera switches its conversion gain.

    For each place with two ISOs or more on either side, a step is fitted beside slope and intercept. The largest ratio
    to its standard error is held against Student's quantile for n - 3 degrees of freedom, with the chance divided among
    the places. A step must also be likelier by that chance than a parabola and than any elbow, since read noise of two
    parts, before and after the amplifier, bends the line from one slope to another. On either side of the clearest step
    further ones are looked for.

    Parameters
    ----------
    points
        K and scale by the scale's name; scales of 0 are left out.
    """
    found: dict[tuple[float, float], list[tuple[str, _Step, float]]] = {}
    for name, measured in points.items():
        usable = sorted((gain, scale) for gain, scale in measured if scale > 0 and math.isfinite(scale))
        if len(usable) < 5 or len({gain for gain, _ in usable}) < len(usable):
            continue
        gains, scales = zip(*usable, strict=True)
        step = _step(gains, scales)
        if step is not None:
            place = (gains[step.place - 1], gains[step.place])
            found.setdefault(place, []).append((name, step, fit_log_log(gains, scales).fit.sigma))
    if not found:
        return ()
    below, above = max(found, key=lambda place: max(step.statistic / step.threshold for _, step, _ in found[place]))
    before, after = (
        gain_steps(
            {name: [one for one in measured if (one[0] >= above) == is_after] for name, measured in points.items()}
        )
        for is_after in (False, True)
    )
    return (*before, GainStep(below, above, tuple(found[below, above])), *after)


def _step(gains: Sequence[float], scales: Sequence[float]) -> _Step | None:
    """Return the clearest step, if it is one and says more than a bend."""
    from scipy.special import stdtrit

    count = len(gains)
    x, y = np.log(np.asarray(gains)), np.log(np.asarray(scales))
    centred = x - x.mean()
    line = np.stack([np.ones(count), centred])
    places = range(2, count - 1)
    after = {place: (np.arange(count) >= place).astype(np.float64) for place in places}
    bends = [centred**2, *(np.logaddexp(0.0, 2 * (x - elbow)) for elbow in _elbows(x))]
    freedom = count - 3
    threshold = float(-stdtrit(freedom, _BY_CHANCE / (2 * len(places))))
    rest, place = min((_rest(np.stack([*line, after[place]]), y), place) for place in places)
    statistic = math.sqrt(max(_rest(line, y) - rest, 0.0) * freedom / max(rest, _ROUNDING))
    # Were there a bend, a step of given place would be 1 / p times as likely with a chance of p at most (Markov).
    bent = min(_rest(np.stack([*line, bend]), y) for bend in bends)
    is_likelier = count * math.log(max(bent, _ROUNDING) / max(rest, _ROUNDING)) > 2 * math.log(len(places) / _BY_CHANCE)
    if statistic <= threshold or not is_likelier:
        return None
    height = float(_solved(np.stack([*line, after[place]]), y)[-1])
    return _Step(place, height, statistic, threshold, math.sqrt(rest / freedom))


def _elbows(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where noise after the amplifier may equal that before it: at each point, between, and just beyond."""
    between = (x[1:] + x[:-1]) / 2
    return np.concatenate([x, between, [2 * x[0] - between[0], 2 * x[-1] - between[-1]]])


def _solved(curve: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of a curve's parts, by least squares."""
    return np.asarray(np.linalg.lstsq(curve.T, y, rcond=None)[0])


def _rest(curve: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the squares that a curve leaves."""
    left = y - _solved(curve, y) @ curve
    return float(left @ left)
