"""The joint distribution of the parameters over the gain: lines of ln(scale) over ln K, one set for each gain mode."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.core.figures import SCALES, SIGMA_ROW
from eldata.calibration.core.findings import STEP
from eldata.calibration.core.photon_transfer import straight_line
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.gain_modes import GainMode, LogLogFit, modes_problem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from eldata.calibration.core._frames import Values
    from eldata.calibration.core.figures import DarkFigure
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.iso_results import IsoCalibration


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
    even = np.ones(len(x))
    slope, intercept, (of_slope, of_intercept) = straight_line(x, y, even, even)
    squares = float(((y - slope * x - intercept) ** 2).sum())
    total = float(((y - y.mean()) ** 2).sum())
    freedom = len(x) - 2
    sigma = math.sqrt(squares / freedom)
    return LogLogEstimate(
        fit=LogLogFit(slope=slope, intercept=intercept, sigma=sigma),
        slope_error=sigma * math.sqrt(of_slope),
        intercept_error=sigma * math.sqrt(of_intercept),
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

    def estimate(self, figure: DarkFigure) -> LogLogEstimate | None:
        """Return the estimate of a scale."""
        found: LogLogEstimate | None = getattr(self, figure.fit)
        return found


_BY_CHANCE = 0.002  # of one fit: a calibration has three
_ROUNDING = 1e-24  # squares that are left of points on a line


@dataclass(frozen=True, slots=True)
class _Step:
    """A step between two neighbours in a line of ln(scale) over ln(K), and the spread around a line through both."""

    name: str
    place: tuple[float, float]
    height: float
    statistic: float
    threshold: float
    spread_without: float
    spread: float


@dataclass(frozen=True, slots=True)
class GainStep:
    """A step in joint fits between two neighbouring gains, as where a camera switches its conversion gain.

    Attributes
    ----------
    below_dn_per_e, above_dn_per_e
        The last K before it and the first one after it.
    steps
        Of each scale that has one.
    """

    below_dn_per_e: float
    above_dn_per_e: float
    steps: tuple[_Step, ...]

    def finding(self, iso_of: Mapping[float, float], *, is_taken: bool) -> Finding:
        """Return the remark on it: that the profile has modes on either side, or what its lines suffer."""
        below, above = iso_of[self.below_dn_per_e], iso_of[self.above_dn_per_e]
        heights = " and ".join(f"{step.name} ({math.expm1(step.height):+.0%})" for step in self.steps)
        spreads = " and ".join(f"{step.spread:.2g} ({step.spread_without:.2g} without it)" for step in self.steps)
        largest = max(self.steps, key=_clearness)
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
    found: dict[tuple[float, float], list[_Step]] = {}
    for name, measured in points.items():
        usable = sorted((gain, scale) for gain, scale in measured if scale > 0 and math.isfinite(scale))
        if len(usable) < 5 or len({gain for gain, _ in usable}) < len(usable):
            continue
        step = _step(name, *zip(*usable, strict=True))
        if step is not None:
            found.setdefault(step.place, []).append(step)
    if not found:
        return ()
    below, above = max(found, key=lambda place: max(map(_clearness, found[place])))
    before, after = (
        gain_steps(
            {name: [one for one in measured if (one[0] >= above) == is_after] for name, measured in points.items()}
        )
        for is_after in (False, True)
    )
    return (*before, GainStep(below, above, tuple(found[below, above])), *after)


def _clearness(step: _Step) -> float:
    return step.statistic / step.threshold


def _step(name: str, gains: Sequence[float], scales: Sequence[float]) -> _Step | None:
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
    where = gains[place - 1], gains[place]
    spreads = math.sqrt(rest / freedom), fit_log_log(gains, scales).fit.sigma
    return _Step(name, where, height, statistic, threshold, *spreads)


def _elbows(x: Values) -> Values:
    """Return where noise after the amplifier may equal that before it: at each point, between, and just beyond."""
    between = (x[1:] + x[:-1]) / 2
    return np.concatenate([x, between, [2 * x[0] - between[0], 2 * x[-1] - between[-1]]])


def _solved(curve: Values, y: Values) -> Values:
    """Return the coefficients of a curve's parts, by least squares."""
    return np.asarray(np.linalg.lstsq(curve.T, y, rcond=None)[0])


def _rest(curve: Values, y: Values) -> float:
    """Return the squares that a curve leaves."""
    left = y - _solved(curve, y) @ curve
    return float(left @ left)


# --- gain modes ---------------------------------------------------------------------------------------------------

NO_NOISE_DN = 1e-9
"""A scale that a log-log line can hold in place of 0."""


@dataclass(frozen=True, slots=True)
class JointFits:
    """What the joint fits found.

    Attributes
    ----------
    modes
        One, or each gain mode of the camera; none if no ISO has K.
    remarks
        What a person should know of them.
    problem
        Why no profile can hold the modes that somebody stated; empty if it can.
    """

    modes: tuple[FittedMode, ...]
    remarks: tuple[str, ...]
    problem: str = ""


def joint_fits(isos: Sequence[IsoCalibration], starts: Sequence[float] | None = None) -> JointFits:
    """Fit lines of the scales over K, in each gain mode.

    Parameters
    ----------
    isos
        What was measured.
    starts
        The first ISO of each gain mode but the lowest, as somebody states them, ascending; none for one mode. ``None``:
        modes are told by steps in the fits (:func:`gain_steps`).
    """
    known = sorted((one for one in isos if one.gain_dn_per_e is not None), key=_gain)
    iso_of = {_gain(one): one.iso for one in known}
    steps = gain_steps({figure.label: _points(known, figure) for figure in SCALES})
    said: list[Finding] = []
    if starts is None:
        parts = _split(known, [step.above_dn_per_e for step in steps], _gain)
        is_taken = all(map(_makes_a_mode, parts))
        if not is_taken:
            parts = [known]
        said = [step.finding(iso_of, is_taken=is_taken) for step in steps]
    else:
        parts = _split(known, starts, lambda one: one.iso)
        firsts = {_gain(part[0]) for part in parts[1:] if part}
        said = [step.finding(iso_of, is_taken=False) for step in steps if step.above_dn_per_e not in firsts]
    remarks = [one.remark for one in said]
    if not known:
        return JointFits((), tuple(remarks))
    if len(parts) > 1 and (lacking := [part for part in parts if not _makes_a_mode(part)]):
        place = parts.index(lacking[0])
        which = f"from ISO {(starts or ())[place - 1]:g} on" if place else f"below ISO {(starts or ())[0]:g}"
        problem = (
            f"the gain mode {which} has K, read noise and colour bias at fewer than two ISOs: no line can be fitted"
        )
        return JointFits((), tuple(remarks), problem)
    fitted = [_fitted_mode(part, len(parts) > 1, remarks) for part in parts]
    if starts:
        fitted = [_from(one, start, remarks) for one, start in zip(fitted, (None, *starts), strict=True)]
    modes = [one.mode for one in fitted]
    ends = [end for mode in modes for end in mode.iso_range or ()]
    if not all(low <= high for low, high in pairwise(ends)):  # K does not go with the ISO
        fitted = [replace(one, mode=replace(one.mode, iso_range=None)) for one in fitted]
        modes = [one.mode for one in fitted]
    if len(modes) > 1 and (wrong := modes_problem(modes, *whole_ranges(modes))) is not None:
        return JointFits((), tuple(remarks), wrong)
    return JointFits(tuple(fitted), tuple(remarks))


def whole_ranges(modes: Sequence[GainMode]) -> tuple[tuple[float, float], tuple[float, float] | None]:
    """Return the range of K and that of the ISOs, if known, from the first mode to the last."""
    first, last = modes[0], modes[-1]
    isos = None if first.iso_range is None or last.iso_range is None else (first.iso_range[0], last.iso_range[1])
    return (first.gain_range_dn_per_e[0], last.gain_range_dn_per_e[1]), isos


def _gain(one: IsoCalibration) -> float:
    return one.gain_dn_per_e or math.nan


def _split(
    known: Sequence[IsoCalibration], starts: Iterable[float], of: Callable[[IsoCalibration], float]
) -> list[list[IsoCalibration]]:
    """Return the ISOs below the first start, from it to the next one, and so on."""
    ends = [-math.inf, *starts, math.inf]
    return [[one for one in known if low <= of(one) < high] for low, high in pairwise(ends)]


def _makes_a_mode(part: Sequence[IsoCalibration]) -> bool:
    """Return whether two ISOs of different gain have all that a row of the profile needs."""
    complete = [one for one in part if one.sigma_tl_dn is not None and one.colour_bias_dn is not None]
    return len({_gain(one) for one in complete}) > 1


def _fitted_mode(part: Sequence[IsoCalibration], is_one_of_several: bool, remarks: list[str]) -> FittedMode:
    # An extended ISO has the K of its neighbour, and by chance the larger or the smaller one.
    isos = [one.iso for one in part]
    lowest, highest = min(isos), max(isos)
    where = f" from ISO {lowest:g} to {highest:g}" if is_one_of_several else ""
    tukey_lambda, gauss, rows = (_fitted(f"{figure.label}{where}", _points(part, figure), remarks) for figure in SCALES)
    if not _points(part, SIGMA_ROW):
        if is_one_of_several:
            remarks.append(f"sigma_row is withheld at ISO {lowest:g} to {highest:g}: that gain mode makes no row noise")
        else:
            remarks.append("sigma_row is withheld wherever K is known: the profile makes no row noise")
    mode = GainMode(
        gain_range_dn_per_e=(_gain(part[0]), _gain(part[-1])),
        tukey_lambda_fit=tukey_lambda[1],
        gauss_fit=gauss[1],
        row_fit=rows[1],
        iso_range=(lowest, highest),
    )
    return FittedMode(mode, tukey_lambda[0], gauss[0], rows[0])


def _from(one: FittedMode, start: float | None, remarks: list[str]) -> FittedMode:
    """Return a mode that begins where somebody states that it does, below its first measured ISO."""
    mode = one.mode
    if start is None or mode.iso_range is None or start == mode.iso_range[0]:
        return one
    (lowest, highest), (least, most) = mode.iso_range, mode.gain_range_dn_per_e
    remarks.append(
        f"the gain mode of ISO {lowest:g} to {highest:g} is stated to begin at ISO {start:g}: its lines go on to there"
    )
    return replace(
        one,
        mode=replace(mode, gain_range_dn_per_e=(least * start / lowest, most), iso_range=(start, highest)),
    )


def _points(isos: Sequence[IsoCalibration], figure: DarkFigure) -> list[tuple[float, float]]:
    """Return K and a scale of the ISOs at which both are given."""
    return [
        (one.gain_dn_per_e, scale.value)
        for one in isos
        if one.gain_dn_per_e is not None and (scale := figure.given(one)) is not None
    ]


def _fitted(
    name: str, points: Sequence[tuple[float, float]], remarks: list[str]
) -> tuple[LogLogEstimate | None, LogLogFit]:
    """Return the fit of a scale over K, or with too few ISOs for one the line that they do give; add to the remarks."""
    usable = sorted((gain, scale) for gain, scale in points if scale > 0 and math.isfinite(scale))
    lost = len(points) - len(usable)
    if lost:
        what = f"{counted(lost, 'ISO')}, which its fit leaves out" if usable else "every ISO; the profile has none"
        remarks.append(f"{name} was 0 at {what}")
    gains = [gain for gain, _ in usable]
    if len(usable) >= 3 and len(set(gains)) >= 3:
        estimate = fit_log_log(gains, [scale for _, scale in usable])
        return estimate, estimate.fit
    if not usable:
        return None, LogLogFit(0.0, math.log(NO_NOISE_DN), 0.0)
    (low, first), (high, last) = usable[0], usable[-1]
    slope = math.log(last / first) / math.log(high / low) if high > low else 0.0
    remarks.append(
        f"{name} is known at {counted(len(usable), 'ISO')}: the profile has the line through them, without the spread "
        "around it that three or more would show"
    )
    return None, LogLogFit(slope, math.log(first) - slope * math.log(low), 0.0)
