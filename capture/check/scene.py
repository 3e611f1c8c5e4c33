"""Check one scene: references against the first, noisy frames against their reference.

What is found of a pair is one row. The exposure ratio that the pixels show is held against the nominal one, which only
names the frame, and against what EXIF states, by which an input is amplified. Names of shutter times are rounded (30 s
are 32 s, 1/200 s is 1/203 s), so a conflict with EXIF need not be anybody's mistake; but where predictions are not
rescaled it costs as much of a score as light that changed, so it is always reported.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.camera import ladder
from capture.check.frames import Cells, ReducedFrame, Unit, draw_change, draw_scene, file_name, reduce_frames
from capture.check.ratio import RatioFit, fit_ratio, measure_brightest, measure_brightness, measure_change
from capture.check.result import (
    LIGHT_AGAIN,
    LIGHT_LOOK,
    RATIO_AGAIN,
    RATIO_LOOK,
    SIGMAS,
    CheckedGroup,
    Estimate,
    find_kind,
)
from capture.check.shift import Tiles, cut_moved_tiles, make_tiles, measure_focus, measure_shift, shift_length
from capture.observed import format_f_number, same_aperture
from eldata.manifest.pairs import UNCERTAIN_ISO
from eldata.raw.levels import mean_levels, packing_sites, white_remark

if TYPE_CHECKING:
    from capture.check.result import MeasureKind
    from eldata.records import Exposure, FrameRecord

_STEPS: Final = (Fraction(1, 3), Fraction(1, 2))


def check_scene(unit: Unit) -> CheckedGroup:
    """Check the frames of one scene, references first, each decoded once."""
    group = CheckedGroup(unit.name, len(unit.records))
    noisy = [record for record in unit.records if record.role == "noisy"]
    references: dict[str, ReducedFrame] = {}
    apertures: list[tuple[str, Fraction]] = []
    tiles: Tiles | None = None
    for frame in reduce_frames(unit, group):
        path = frame.record.path
        _compare_aperture(frame, apertures, group)
        if frame.record.role == "noisy":
            named = frame.record.reference or (unit.records[0].path if len(noisy) < len(unit.records) else "")
            _check_pair(frame, named, references.get(named), noisy, group)
            group.pictures.append(draw_scene(frame, float(frame.record.ratio or 1)))
            continue
        group.measure("clipped", path, Estimate(frame.cells.clipped_share).in_percent())
        if references:
            _compare_references(next(iter(references.values())), tiles, frame, group)
        else:
            tiles = make_tiles(frame.luminance)
            level = measure_brightest(frame.cells)
            if level is None:
                group.remark(path, "is too small to tell how bright it is")
            else:
                group.measure("brightness", path, Estimate(level).in_percent())
        references[path] = replace(frame, luminance=frame.luminance[:0])
    if references:
        first, *later = references.values()
        shown = [frame for frame in later if frame is later[-1] or group.verdict_of(frame.record.path) != "keep"]
        group.pictures[:0] = [
            *(draw_scene(frame, 1.0) for frame in (first, *later[-1:])),
            *(draw_change(first, replace(frame, cells=frame.scale_cells_to(first.sensor))) for frame in shown),
        ]
        if not later:
            text = "is the only reference: whether the light changed or the camera moved cannot be told"
            group.remark(first.record.path, text)
    return group


def _compare_aperture(frame: ReducedFrame, known: list[tuple[str, Fraction]], group: CheckedGroup) -> None:
    """Remark on a frame whose EXIF states another aperture than the scene's first file that states one."""
    path, f_number = frame.record.path, frame.exposure.f_number
    if f_number is None:
        return
    known.append((path, f_number))
    first, expected = known[0]
    if not same_aperture(f_number, expected):
        states = f"EXIF states {format_f_number(f_number)}, expected {format_f_number(expected)}"
        advice = "the exposure ratio is computed from ISO and time alone; keep the aperture fixed"
        group.remark(path, f"{states} as in {file_name(first)}: {advice}", "shoot again")


# --- references ---------------------------------------------------------------------------------------------------


def _compare_references(first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, group: CheckedGroup) -> None:
    """Measure a later reference against the first: light, place and focus, and what moved."""
    frame = replace(frame, cells=frame.scale_cells_to(first.sensor))
    path, against = frame.record.path, file_name(first.record.path)
    brightness = _measure_light(first, frame, against, group)
    cut = None if tiles is None else cut_moved_tiles(tiles, frame.luminance)
    shift = None if cut is None else measure_shift(cut[0], cut[1])
    if cut is None or shift is None:
        text = "has too little detail to tell whether the camera moved: put something with edges into the scene"
        group.remark(path, text)
        return
    length = shift_length(shift, cut[2], packing_sites(frame.sensor.cfa).scale)
    if group.measure("shift", path, length, against=against).verdict != "keep":
        return  # measures pixel by pixel would show the shift again
    focus = measure_focus(cut[0], cut[1], shift, brightness)
    # Out of focus, edges differ everywhere.
    if focus is None or group.measure("focus", path, focus.in_percent(1), against=against).verdict == "keep":
        changed = measure_change(first.cells, frame.cells, brightness)
        # Without an error: only what exceeds eight of them is counted.
        group.measure("movement", path, Estimate(changed).in_percent(), against=f"since {against}")


def _measure_light(first: ReducedFrame, frame: ReducedFrame, against: str, group: CheckedGroup) -> float:
    """Measure the change of brightness; return its mean over the channels that tell it."""
    path, ratios = frame.record.path, measure_brightness(first.cells, frame.cells)
    known = [(colour, ratio) for colour, ratio in zip(first.cells.colours, ratios, strict=True) if ratio is not None]
    if not known:
        group.remark(path, f"too little is well exposed to compare it with {against}")
        return 1.0
    colour, worst_one = max(known, key=lambda pair: abs(pair[1].value - 1))
    group.measure("drift", path, worst_one.in_percent(1), colour=colour, against=against)
    return sum(ratio.value for _, ratio in known) / len(known)


# --- pairs ------------------------------------------------------------------------------------------------------------


def _check_pair(
    frame: ReducedFrame, named: str, reference: ReducedFrame | None, noisy: list[FrameRecord], group: CheckedGroup
) -> None:
    """Measure a noisy frame against its reference, ``named``: the scene that it shows, and the exposure ratio.

    ``noisy`` are all noisy frames of the scene.
    """
    record, path, against = frame.record, frame.record.path, file_name(named)
    group.pairs[path] = named
    group.measure("gaps", path, Estimate(frame.empty_share).in_percent())
    if reference is None:
        text = f"its reference {against} cannot be used" if named else "the scene has no reference"
        group.remark(path, text, "shoot again")
        return
    remark = white_remark(mean_levels(frame.sensor), mean_levels(reference.sensor))
    if remark is not None:
        group.remark(path, remark, "keep")
    cells = frame.scale_cells_to(reference.sensor)
    exif_ratio = _compute_exif_ratio(reference.exposure, frame.exposure)
    nominal = record.ratio
    expected = nominal or exif_ratio
    fit = fit_ratio(reference.cells, cells, None if expected is None else float(expected))
    if fit is None:
        text = "too few pixels that are neither saturated nor clipped at black: its exposure ratio cannot be measured"
        group.remark(path, text)
        return
    if group.measure("match", path, fit.match.in_percent(), against=against).verdict == "shoot again":
        return  # with another scene there is no ratio
    ratio = fit.ratio
    if expected is not None or ratio is not None:
        _measure_black(frame, reference, cells, fit, float(expected or 1 / fit.slope.value), group)
    if ratio is None:
        if expected is not None:
            scale = 100 * float(expected)
            signal = Estimate(scale * fit.slope.value, scale * fit.slope.standard_error)
            group.measure("signal", path, signal, ratio=_format_number(expected))
        return
    if nominal is not None:
        advice = _choose_advice(record, ratio, exif_ratio, noisy)
        kind = _make_ratio_kind("ratio", nominal, RATIO_LOOK, RATIO_AGAIN, advice)
        group.measure(kind, path, ratio, against=against, ratio=_format_number(nominal))
    if exif_ratio is not None:
        again, advice = _judge_exif(record, ratio, _list_dial_ratios(reference.exposure, frame.exposure))
        kind = _make_ratio_kind("EXIF ratio", exif_ratio, LIGHT_LOOK, again, advice)
        group.measure(kind, path, ratio, against=against, ratio=_format_number(exif_ratio))
    changed = measure_change(reference.cells, cells, fit.slope.value, fit.offset_dn)
    # Without an error: only what exceeds eight of them is counted.
    group.measure("movement", path, Estimate(changed).in_percent(), against=f"to {against}")


def _measure_black(
    frame: ReducedFrame, reference: ReducedFrame, cells: Cells, fit: RatioFit, ratio: float, group: CheckedGroup
) -> None:
    """Measure how far a noisy frame's black is off its stated level, as a share of white once amplified."""
    share = ratio / reference.cells.range_dn
    off = Estimate(share * fit.black.value, share * fit.black.standard_error)
    stated = mean_levels(frame.sensor)[0]
    black = stated + fit.black.value * frame.cells.range_dn / cells.range_dn
    words = {"black": f"{black:.1f}".removesuffix(".0"), "stated": f"{stated:g}", "ratio": f"{ratio:.4g}"}
    kind = find_kind("offset")  # a camera's colour bias may come to its limit: beyond it is what surely is
    kind = replace(kind, look=kind.look + 100 * SIGMAS * off.standard_error)
    group.measure(kind, frame.record.path, off.in_percent(), **words)


# --- ratios -------------------------------------------------------------------------------------------------------


def _compute_exif_ratio(reference: Exposure, noisy: Exposure) -> Fraction | None:
    """Divide a reference's ISO x time by a noisy frame's; ``None`` if EXIF lacks one."""
    if not (reference.iso and reference.exposure_s and noisy.iso and noisy.exposure_s):
        return None
    return reference.iso * reference.exposure_s / (noisy.iso * noisy.exposure_s)


def _list_dial_ratios(reference: Exposure, noisy: Exposure) -> list[float]:
    """List the ratios by the true times of shutters in thirds or halves of a stop, whose names EXIF has."""
    ratios = []
    for step in _STEPS:
        long, short = (ladder(step).get(frame.exposure_s or Fraction(0)) for frame in (reference, noisy))
        if reference.iso is not None and noisy.iso is not None and long is not None and short is not None:
            ratios.append(float(reference.iso / noisy.iso) * long.true_s / short.true_s)
    return ratios


def _make_ratio_kind(name: str, expected: Fraction, look: float, again: float, advice: str) -> MeasureKind:
    """Return a kind of ratio with its limits, given as shares of the expected one."""
    value = float(expected)
    return replace(find_kind(name), look=look * value, again=again * value, advice=advice, expected=value)


def _judge_exif(record: FrameRecord, ratio: Estimate, dial_ratios: list[float]) -> tuple[float, str]:
    """Find the share off EXIF's ratio from which to shoot again, and the advice."""
    if UNCERTAIN_ISO in record.flags:
        advice = 'EXIF has the names of ISOs, whose measured speeds are others: amplification="nominal" is the plan\'s'
        return math.inf, advice
    nearest = min(dial_ratios, key=lambda dial: abs(ratio.value - dial), default=math.inf)
    if abs(ratio.value - nearest) <= max(LIGHT_LOOK * nearest, SIGMAS * ratio.standard_error) < math.inf:
        advice = "EXIF has the rounded names of the shutter's times: scores of rescaled predictions do not change"
        return math.inf, advice
    return LIGHT_AGAIN, find_kind("EXIF ratio").advice


def _choose_advice(record: FrameRecord, ratio: Estimate, exif_ratio: Fraction | None, noisy: list[FrameRecord]) -> str:
    """Explain a frame whose ratio is not the nominal one."""
    cause = "EXIF does not show it"
    if exif_ratio is not None and _fits_ratio(ratio, exif_ratio):
        cause = "EXIF says the same: taken with another setting, or under another frame's name"
    for other in noisy:
        if other is not record and other.iso == record.iso and other.ratio and _fits_ratio(ratio, other.ratio):
            return f"{cause}; it fits {file_name(other.path)} (x{_format_number(other.ratio)}): swapped?"
    return f"{cause}; {find_kind('ratio').advice}"


def _fits_ratio(ratio: Estimate, expected: Fraction) -> bool:
    """Check that a ratio is within the tolerance of the expected one."""
    return abs(ratio.value - float(expected)) <= RATIO_LOOK * float(expected)


def _format_number(value: Fraction) -> str:
    """Write a fraction in four digits."""
    return f"{float(value):.4g}"
