"""The joint fits of a calibration: one set of lines over K, or one for each gain mode of the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from eldata.base.numbers import counted
from eldata.calibration.core.joint import FittedMode, fit_log_log, gain_steps
from eldata.noise.gain_modes import GainMode, LogLogFit, modes_problem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from eldata.calibration.core.findings import Finding, GivenFigure
    from eldata.calibration.core.joint import LogLogEstimate
    from eldata.calibration.iso_results import IsoCalibration

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
        modes are told by steps in the fits (:func:`~eldata.calibration.core.joint.gain_steps`).
    """
    known = sorted((one for one in isos if one.gain_dn_per_e is not None), key=_gain)
    iso_of = {_gain(one): one.iso for one in known}
    steps = gain_steps({name: _points(known, scale_of) for name, scale_of in _SCALES.items()})
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
    tukey_lambda, gauss, rows = (
        _fitted(f"{name}{where}", _points(part, scale_of), remarks) for name, scale_of in _SCALES.items()
    )
    if not _points(part, _SCALES["sigma_row"]):
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


_SCALES: dict[str, Callable[[IsoCalibration], GivenFigure | None]] = {
    "sigma_TL": lambda one: one.sigma_tl_dn,
    "sigma_G": lambda one: one.sigma_gauss_dn,
    "sigma_row": lambda one: one.sigma_row_dn,
}


def _points(
    isos: Sequence[IsoCalibration], scale_of: Callable[[IsoCalibration], GivenFigure | None]
) -> list[tuple[float, float]]:
    """Return K and a scale of the ISOs at which both are given."""
    return [
        (one.gain_dn_per_e, scale.value)
        for one in isos
        if one.gain_dn_per_e is not None and (scale := scale_of(one)) is not None
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
