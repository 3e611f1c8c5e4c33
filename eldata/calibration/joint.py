"""The joint distribution of the parameters over the gain: lines of ln(scale) over ln K, one set for each gain mode.

Source: Wei et al., TPAMI 2021, section 3.2.2, figure 9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.flats import straight_line
from eldata.calibration.iso_results import SCALES, STEP, Finding, IsoCalibration, MeasuredFigure, fill_sentence
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.profile import GainMode, LogLogFit, modes_problem

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    _Noisy = tuple[IsoCalibration, MeasuredFigure]


@dataclass(frozen=True, slots=True)
class LogLogEstimate:
    """A fitted line with its uncertainty.

    Attributes
    ----------
    fit
        Slope, intercept and standard deviation of the points around the line, for a camera profile: the camera's own
        and that of the points' errors, which it is never below.
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


_LEAST_ERROR = 1e-3  # of a point's logarithm, in the first weights


def fit_log_log(
    gains_dn_per_e: Sequence[float],
    scales_dn: Sequence[float],
    gain_errors: Sequence[float] | None = None,
    scale_errors: Sequence[float] | None = None,
) -> LogLogEstimate:
    """Fit ``ln(scale) = a ln(K) + b`` by least squares (equation "sampling"), weighted by the errors if they are given.

    A point's variance is that of its errors, ``(error / scale)^2 + a^2 (error / K)^2``, and the camera's own around the
    line, which the weighted squares of the residuals show beyond those (DerSimonian and Kacker's moments in two steps,
    2007). Without errors it is ordinary least squares, and the residual variance the squared residuals over n - 2.

    Parameters
    ----------
    gains_dn_per_e, scales_dn
        K and scale of each ISO, above 0.
    gain_errors, scale_errors
        Their standard errors, in the same units.

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
    if not (gains.shape == scales.shape and np.all(np.isfinite(gains * scales) & (gains > 0) & (scales > 0))):
        raise ArgumentError("gains and scales come in pairs, finite and above 0; leave out ISOs without a scale")
    if len(gains) < 3 or not np.ptp(gains) > 0:
        raise DatasetError("a line with its residual deviation needs three ISOs of different gain or more")
    x, y = np.log(gains), np.log(scales)
    freedom, even = len(x) - 2, np.ones(len(x))
    slope, intercept, _ = straight_line(x, y, even, even)
    of_gains, of_scales = (
        np.zeros(len(x)) if errors is None else np.asarray(errors, dtype=np.float64) / values
        for errors, values in ((gain_errors, gains), (scale_errors, scales))
    )
    known = of_scales**2 + (slope * of_gains) ** 2
    own = _LEAST_ERROR**2
    for _ in range(2):
        weights = 1 / (known + own)
        slope, intercept, _ = straight_line(x, y, weights, even)
        apart = x - float(weights @ x) / float(weights.sum())
        free = weights * (1 - weights * (1 / weights.sum() + apart**2 / float(weights @ apart**2)))
        squares = float(weights @ (y - slope * x - intercept) ** 2)
        own = max((squares - float(free @ known)) / float(free.sum()), 1e-24)
    variances = known + own
    slope, intercept, (of_slope, of_intercept) = straight_line(x, y, 1 / variances, variances)
    squares = float(((y - slope * x - intercept) ** 2 / variances).sum())
    sigma = math.sqrt(len(x) / float((1 / variances).sum()))
    total = float(((y - np.average(y, weights=1 / variances)) ** 2 / variances).sum())
    return LogLogEstimate(
        fit=LogLogFit(slope=slope, intercept=intercept, sigma=sigma),
        slope_error=math.sqrt(of_slope),
        intercept_error=math.sqrt(of_intercept),
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

    @property
    def estimates(self) -> dict[str, LogLogEstimate | None]:
        """The estimates by the figure that the line is of."""
        return dict(zip(SCALES, (self.tukey_lambda_fit, self.gauss_fit, self.row_fit), strict=True))


# --- steps over the ISOs ----------------------------------------------------------------------------------------------

_LEAST_STEP_OF_GAIN, _LEAST_STEP_OF_NOISE = 0.1, 0.35  # of ln
_SURELY = 5.0  # standard errors
_OF_OTHERS = 4.0  # of the median of the other ISOs' steps
_SAME_GAIN = 0.05  # of ln K: an extended ISO has the K of its neighbour


def find_steps(isos: Sequence[IsoCalibration]) -> list[tuple[float, Finding]]:
    """Return steps of K over the ISO or of the read noise between neighbouring ISOs, each with the upper one.

    K goes with the ISO. Read noise of parts before and after the amplifier grows over ln K with a slope that goes from
    0 to 1, and between two ISOs lies between those on either side; between the lowest two and the highest two it is
    anywhere from 0 to 1. A camera that switches its conversion gain leaves both.
    """
    known = sorted((record for record in isos if record.gain is not None), key=attrgetter("iso"))
    steps = []
    for before, after in pairwise(known):
        off = math.log(_find_k(after) / _find_k(before) * before.iso / after.iso)
        error = math.hypot(_relative_error(before.gain), _relative_error(after.gain))
        threshold = max(_LEAST_STEP_OF_GAIN, _SURELY * error)
        if abs(off) > threshold:
            change = f"K over the ISO changes by {math.expm1(off):+.0%}"
            steps.append(_describe_step(before, after, change, off, threshold))
    noisy = [(record, noise) for record in known if (noise := record.sigma_gauss_dn) is not None and noise.value > 0]
    for (before, noise), (after, its_noise), off, threshold in _noise_steps(sorted(noisy, key=lambda n: _find_k(n[0]))):
        words = {"before": noise.text, "after": its_noise.text, "off": math.expm1(off)}
        change = fill_sentence("findings.noise-step", **words)
        steps.append(_describe_step(before, after, change, off, threshold))
    return sorted(steps, key=lambda step: step[0])


def _describe_step(
    before: IsoCalibration, after: IsoCalibration, change: str, off: float, threshold: float
) -> tuple[float, Finding]:
    """Make the finding on a step between two neighbouring ISOs, after the upper ISO."""
    low, high = sorted((before.iso, after.iso))
    return high, STEP.find(abs(off), threshold, fill_sentence("findings.step", low=low, high=high, change=change))


def _noise_steps(noisy: Sequence[_Noisy]) -> Iterator[tuple[_Noisy, _Noisy, float, float]]:
    """Yield the clearest step of sigma_G over K, then those on either side of it."""
    pairs = [pair for pair in pairwise(noisy) if _find_k(pair[1][0]) > _find_k(pair[0][0]) * math.exp(_SAME_GAIN)]
    if not pairs:
        return
    gains = [math.log(_find_k(after) / _find_k(before)) for (before, _), (after, _) in pairs]
    rises = [math.log(after.value / before.value) for (_, before), (_, after) in pairs]
    slopes = [min(max(rise / gain, 0.0), 1.0) for gain, rise in zip(gains, rises, strict=True)]
    steps = []
    for place, (gain, rise) in enumerate(zip(gains, rises, strict=True)):
        around = [0.0, 1.0] if place in (0, len(slopes) - 1) else sorted((slopes[place - 1], slopes[place + 1]))
        steps.append(rise - min(max(rise, around[0] * gain), around[1] * gain))
    at = int(np.argmax(np.abs(steps)))
    below, above = pairs[at]
    error = math.hypot(_relative_error(below[1]), _relative_error(above[1]))
    others = [abs(step) for place, step in enumerate(steps) if abs(place - at) > 1]
    threshold = max(_LEAST_STEP_OF_NOISE, _SURELY * error, _OF_OTHERS * float(np.median(others or [0.0])))
    if abs(steps[at]) > threshold:
        yield from _noise_steps([record for record in noisy if _find_k(record[0]) <= _find_k(below[0])])
        yield below, above, steps[at], threshold
        yield from _noise_steps([record for record in noisy if _find_k(record[0]) >= _find_k(above[0])])


def _find_k(record: IsoCalibration) -> float:
    """Return K of an ISO, in DN/e-; nan if it is not known."""
    return record.gain_dn_per_e or math.nan


def _error(figure: MeasuredFigure) -> float:
    """Return the error of a figure; 0 of one that is stated."""
    return figure.error if math.isfinite(figure.error) else 0.0


def _relative_error(figure: MeasuredFigure | None) -> float:
    """Compute the error of a figure as a share of its value; 0 if it is stated, or missing."""
    return 0.0 if figure is None else _error(figure) / figure.value


# --- gain modes -------------------------------------------------------------------------------------------------------

_NO_NOISE_DN = 1e-9  # a scale that a log-log line can hold instead of 0


def fit_modes(
    isos: Sequence[IsoCalibration], starts: Sequence[float] | None, remarks: list[str]
) -> tuple[tuple[FittedMode, ...], str]:
    """Fit lines of the scales over K, in each gain mode; add to the remarks.

    Parameters
    ----------
    isos
        What was measured.
    starts
        The first ISO of each gain mode but the lowest, as somebody states them, ascending; none for one mode. ``None``:
        one mode too, and steps over the ISOs are remarked.

    Returns
    -------
    tuple
        One mode, or each that is stated, none if no ISO has K; and why no profile can hold them, empty if it can.
    """
    known = sorted((record for record in isos if record.gain_dn_per_e is not None), key=_find_k)
    ends = [-math.inf, *(starts or ()), math.inf]
    parts = [[record for record in known if low <= record.iso < high] for low, high in pairwise(ends)]
    if starts is None or starts:
        stated = {min(record.iso for record in part) for part in parts[1:] if part}
        remarks += [step.remark for iso, step in find_steps(isos) if iso not in stated]
    if not known:
        return (), ""
    for place, part in enumerate(parts if starts else ()):
        # Of two ISOs of different gain, all that a row of the profile needs.
        complete = [record for record in part if record.sigma_tl_dn is not None and record.colour_bias_dn is not None]
        if len({_find_k(record) for record in complete}) < 2:
            which = f"from ISO {ends[place]:g} on" if place else f"below ISO {ends[1]:g}"
            return (), fill_sentence("no-profile.short-mode", which=which)
    fitted = [_fit_mode(part, start, len(parts) > 1, remarks) for start, part in zip(ends, parts, strict=False)]
    limits = [end for lines in fitted for end in lines.mode.iso_range or ()]
    if limits != sorted(limits):  # K does not go with the ISO
        fitted = [replace(lines, mode=replace(lines.mode, iso_range=None)) for lines in fitted]
    modes = [lines.mode for lines in fitted]
    if len(modes) > 1 and (problem := modes_problem(modes, *whole_ranges(modes))) is not None:
        return (), problem
    return tuple(fitted), ""


def whole_ranges(modes: Sequence[GainMode]) -> tuple[tuple[float, float], tuple[float, float] | None]:
    """Return the range of K, and of the ISOs if known, from the first mode to the last."""
    first, last = modes[0], modes[-1]
    isos = None if first.iso_range is None or last.iso_range is None else (first.iso_range[0], last.iso_range[1])
    return (first.gain_range_dn_per_e[0], last.gain_range_dn_per_e[1]), isos


def _fit_mode(part: Sequence[IsoCalibration], start: float, is_one_of_several: bool, remarks: list[str]) -> FittedMode:
    """Fit a gain mode: ranges of K and ISO, a line over K for each scale; add to the remarks.

    It begins where somebody states that it does (``start``), if that is below its first measured ISO.
    """
    # Where the read noise is withheld, nothing is known. An extended ISO has the K of its neighbour, and by chance the
    # larger or the smaller one.
    ends = [record for record in part if record.sigma_tl_dn and record.sigma_gauss_dn] or part
    isos = [record.iso for record in ends]
    lowest, highest = min(isos), max(isos)
    where = f" from ISO {lowest:g} to {highest:g}" if is_one_of_several else ""
    fits = [_fit_scale(part, name, f"{label}{where}", remarks) for name, label in SCALES.items()]
    if all(record.sigma_row_dn is None for record in part):
        which = f"at ISO {lowest:g} to {highest:g}: that gain mode" if where else "wherever K is known: the profile"
        remarks.append(fill_sentence("remarks.no-row-noise", where=which))
    first, least = lowest, _find_k(ends[0])
    if math.isfinite(start) and start != lowest:
        first, least = start, least * start / lowest
        remarks.append(fill_sentence("remarks.begins", lowest=lowest, highest=highest, start=start))
    tukey_lambda, gauss, row = (line for _, line in fits)
    mode = GainMode((least, _find_k(ends[-1])), tukey_lambda, gauss, row, (first, highest))
    return FittedMode(mode, *(estimate for estimate, _ in fits))


def _fit_scale(
    part: Sequence[IsoCalibration], name: str, label: str, remarks: list[str]
) -> tuple[LogLogEstimate | None, LogLogFit | None]:
    """Return the fit of a scale over K, and the line that the profile has; add to the remarks."""
    pairs = ((record.gain, record.find_figure(name)) for record in part)
    known = [(gain, scale) for gain, scale in pairs if gain is not None and scale is not None]
    usable = [(gain, scale) for gain, scale in known if 0 < scale.value < math.inf]
    if lost := len(known) - len(usable):
        what = f"{counted(lost, 'ISO')}, which its fit leaves out" if usable else "every ISO; the profile has none"
        remarks.append(fill_sentence("remarks.zero", label=label, where=what))
    if not usable:
        return None, LogLogFit(0.0, math.log(_NO_NOISE_DN), 0.0)
    if len({gain.value for gain, _ in usable}) < 3:
        remarks.append(fill_sentence("remarks.no-line", label=label, isos=counted(len(usable), "ISO")))
        return None, None
    values, errors = (
        [[read(figure) for figure in figures] for figures in zip(*usable, strict=True)]
        for read in (attrgetter("value"), _error)
    )
    estimate = fit_log_log(*values, *errors)
    return estimate, estimate.fit
