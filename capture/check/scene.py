"""Check one scene: references against the first, noisy frames against their reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capture.check.drift import brightest_level, brightness_ratios, changed_share
from capture.check.flicker import Flicker, flicker_of_contrast, flicker_of_level
from capture.check.frames import ReducedFrame, file_name, other_kind, reduced_frames
from capture.check.measures import (
    BRIGHTNESS_AGAIN,
    BRIGHTNESS_LOOK,
    BRIGHTNESS_SOURCE,
    RATIO_AGAIN,
    RATIO_LOOK,
    RATIO_SOURCE,
    Estimate,
    Measure,
    MeasureKind,
    Remark,
)
from capture.check.pictures import change_picture, scene_picture
from capture.check.ratio import RatioFit, fit_ratio, residuals_between
from capture.check.result import CheckedGroup, SheetPicture, sorted_by_path
from capture.check.shift import Tiles, make_tiles, measure_focus, measure_shift, moved_tiles
from eldata.errors import RawFileError

if TYPE_CHECKING:
    from fractions import Fraction

    from capture.check.cells import Cells
    from capture.check.frames import Unit
    from eldata.records import FrameRecord, RawHeader

_INFINITE: Final = float("inf")
DRIFT: Final = MeasureKind(
    "drift",
    "%",
    100 * BRIGHTNESS_LOOK,
    100 * BRIGHTNESS_AGAIN,
    BRIGHTNESS_SOURCE,
    "the light changed: let lamps warm up, shut out daylight, keep the aperture fixed",
)
FLICKER: Final = MeasureKind(
    "flicker",
    "%",
    100 * 2**0.5 * BRIGHTNESS_LOOK,
    100 * 2**0.5 * BRIGHTNESS_AGAIN,
    "as for drift; a wave's root mean square is its amplitude over the square root of 2",
    "the lamp flickers: use daylight, a lamp on batteries or direct current, or no exposures below 1/50 s",
)
SHIFT: Final = MeasureKind(
    "shift",
    "px",
    0.2,
    0.5,
    "twice the accuracy of a tenth of a pixel that the measure is tested to; from half a pixel on, pixels of the two "
    "frames look at other points of the scene",
    "the camera moved: fix tripod and head, use a remote release, do not touch lens or focus",
)
MOVEMENT: Final = MeasureKind(
    "movement",
    "%",
    0.1,
    _INFINITE,
    "practical: one part in a thousand of the picture, what moved may be of no importance, so look",
    "something in the scene moved, or a shadow on it: look at the picture of differences",
)
FOCUS: Final = MeasureKind(
    "focus",
    "%",
    3.0,
    10.0,
    "the contrast of detail of 5 to 20 pixels; a Gaussian blur of 0.5 pixels takes 3 to 5 %, one of 1 pixel 10 to 20 %",
    "the focus changed: focus by hand, switch autofocus and stabiliser off, fix the ring with tape",
)
CLIPPED: Final = MeasureKind(
    "clipped",
    "%",
    0.5,
    5.0,
    "highlights and lamps clip in any scene; scores leave saturated pixels out, and a twentieth of the picture is too "
    "much to leave out",
    "expose the references less (and plan the scene anew), or shade the highlights",
)
BRIGHTNESS: Final = MeasureKind(
    "brightness",
    "%",
    90.0,
    _INFINITE,
    "below a tenth of the range, a frame at x200 has too little signal",
    "underexposed: meter the scene again, for a longer time",
    expected=100.0,
)
MATCH: Final = MeasureKind(
    "match",
    "%",
    10.0,
    50.0,
    "practical: 100 % but for noise in aligned frames, about 0 between scenes; halfway between, shoot again",
    "another scene, or something moved: is the file in its place?",
    expected=100.0,
)
SIGNAL: Final = MeasureKind(
    "signal",
    "%",
    100 * RATIO_LOOK,
    50.0,
    "the tolerance of eldata verify; to shoot again: half of the signal lacks",
    "no light, or far too little: was the lens capped, the exposure right?",
    expected=100.0,
)


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    cells: Cells
    header: RawHeader


@dataclass(slots=True, eq=False)
class _Found:
    """What gathers while the frames pass."""

    measures: list[Measure]
    remarks: list[Remark]
    pictures: list[SheetPicture]


def check_scene(unit: Unit) -> CheckedGroup:
    """Check the frames of one scene, references first, each decoded once."""
    references, noisy = sorted_by_path(unit.records, "reference"), sorted_by_path(unit.records, "noisy")
    found = _Found([], [], [])
    kept: dict[str, _Reference] = {}
    first: ReducedFrame | None = None
    tiles: Tiles | None = None
    last: ReducedFrame | None = None
    changes: list[SheetPicture] = []
    of_noisy: list[tuple[FrameRecord, RatioFit, Fraction | None]] = []
    for record, frame in reduced_frames(unit, [*references, *noisy]):
        if isinstance(frame, Remark):
            found.remarks.append(frame)
            continue
        remark = None if first is None else other_kind(first, frame)
        if remark is not None:
            found.remarks.append(remark)
            continue
        if record.role == "noisy":
            fitted = _noisy_fit(record, frame, kept, references, found)
            of_noisy += [] if fitted is None else [fitted]
            found.pictures.append(scene_picture(frame, float(record.ratio or 1)))
            continue
        kept[record.path] = _Reference(frame.cells, frame.header)
        found.measures.append(Measure(CLIPPED, record.path, "saturated pixels", 100 * frame.cells.clipped_share))
        if first is None:
            first, tiles = frame, make_tiles(frame.luminance)
            text = "share of the range that the bright parts reach"
            found.measures.append(Measure(BRIGHTNESS, record.path, text, 100 * brightest_level(frame.cells)))
            found.pictures.append(scene_picture(frame, 1.0))
        else:
            if last is not None and not _well(found, last):
                changes.append(change_picture(first, last))  # of the last one, there is always one
            _compare(first, tiles, frame, found)
            last = frame
    if last is not None and first is not None:
        found.pictures[1:1] = [scene_picture(last, 1.0), *changes, change_picture(first, last)]
    if len(kept) == 1 and first is not None:
        text = "the only reference: whether the light changed or the camera moved cannot be told"
        found.remarks.append(Remark(first.record.path, text, "look"))
    for record, fit, exif_ratio in of_noisy:
        found.measures += _noisy_measures(record, fit, exif_ratio, noisy)
    return CheckedGroup(
        unit.name, len(references) + len(noisy), tuple(found.measures), tuple(found.remarks), tuple(found.pictures)
    )


def _well(found: _Found, frame: ReducedFrame) -> bool:
    return all(one.verdict == "keep" for one in found.measures if one.path == frame.record.path)


# --- references ---------------------------------------------------------------------------------------------------


def _compare(first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, found: _Found) -> None:
    """Measure a later reference against the first."""
    path, against = frame.record.path, file_name(first.record.path)
    ratios = brightness_ratios(first.cells, frame.cells)
    known = [(colour, one) for colour, one in zip(first.cells.colours, ratios, strict=True) if one is not None]
    brightness = 1.0
    if not known:
        found.remarks.append(Remark(path, "too little is well exposed to compare it with the first reference", "look"))
    else:
        colour, worst_one = max(known, key=lambda pair: abs(pair[1].value - 1))
        brightness = sum(one.value for _, one in known) / len(known)
        text = f"change of brightness ({colour}) since {against}"
        change, error = 100 * (worst_one.value - 1), 100 * worst_one.standard_error
        found.measures.append(Measure(DRIFT, path, text, change, error))
    aligned = _compare_places(first, tiles, frame, brightness, found)
    if not aligned or len(known) < len(ratios):
        return
    residuals = residuals_between(first.cells, frame.cells, [one.value for _, one in known])
    flicker = None if residuals is None else flicker_of_level(residuals)
    if flicker is not None:
        found.measures.append(_flicker(path, flicker))


def _compare_places(
    first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, brightness: float, found: _Found
) -> bool:
    """Measure shift and focus; return whether the frames lie on each other."""
    path, against = frame.record.path, file_name(first.record.path)
    cut = None if tiles is None else moved_tiles(tiles, frame.luminance)
    shift = None if cut is None else measure_shift(cut[0], cut[1])
    if cut is None or shift is None:
        text = "has too little detail to tell whether the camera moved: put something with edges into the scene"
        found.remarks.append(Remark(path, text, "look"))
        return True
    length = shift.length(cut[2], frame.scale)
    measure = Measure(SHIFT, path, f"distance from {against}", length.value, length.standard_error)
    found.measures.append(measure)
    if measure.verdict != "keep":
        return False  # what is measured pixel by pixel would tell of the shift again
    focus = measure_focus(cut[0], cut[1], shift, brightness)
    if focus is not None:
        text = f"change of the contrast of fine detail since {against}"
        measure = Measure(FOCUS, path, text, 100 * (focus.value - 1), 100 * focus.standard_error)
        found.measures.append(measure)
        if measure.verdict != "keep":
            return True  # edges differ everywhere
    text = f"share of the picture that changed otherwise than the whole since {against}"
    # Without an error: only what exceeds eight of them is counted.
    found.measures.append(Measure(MOVEMENT, path, text, 100 * changed_share(first.cells, frame.cells, brightness)))
    return True


def _flicker(path: str, flicker: Flicker) -> Measure:
    return flicker.measure(FLICKER, path, f"bands across the picture, {flicker.cycles:g} a frame, amplitude")


# --- noisy frames -------------------------------------------------------------------------------------------------


def _noisy_fit(
    record: FrameRecord,
    frame: ReducedFrame,
    kept: dict[str, _Reference],
    references: list[FrameRecord],
    found: _Found,
) -> tuple[FrameRecord, RatioFit, Fraction | None] | None:
    """Return a noisy frame's fit to its reference, and the ratio that EXIF says."""
    from eldata.raw.reading import exposure_ratio

    named = record.reference or (references[0].path if references else "")
    reference = kept.get(named)
    if reference is None:
        text = f"its reference {file_name(named)} cannot be used" if named else "the scene has no reference"
        found.remarks.append(Remark(record.path, text, "shoot again"))
        return None
    try:
        exif_ratio = exposure_ratio(reference.header, frame.header)
    except RawFileError:
        exif_ratio = None
    fit = fit_ratio(reference.cells, frame.cells)
    if fit is None:
        text = "too few pixels that are neither saturated nor clipped at black: its exposure ratio cannot be measured"
        found.remarks.append(Remark(record.path, text, "look"))
        return None
    return record, fit, exif_ratio


def _noisy_measures(
    record: FrameRecord, fit: RatioFit, exif_ratio: Fraction | None, noisy: list[FrameRecord]
) -> list[Measure]:
    against = file_name(record.reference or "its reference")
    text = f"how much of the scene in {against} it shows"
    match = Measure(MATCH, record.path, text, 100 * fit.match.value, 100 * fit.match.standard_error)
    if match.verdict == "shoot again":
        return [match]  # of another scene there is no ratio
    found = [match]
    nominal = record.ratio
    if fit.ratio is None:
        expected = nominal or exif_ratio
        return found if expected is None else [*found, _signal(record, fit, expected)]
    if nominal is not None:
        advice = _ratio_advice(record, fit.ratio, exif_ratio, noisy)
        text = f"exposure ratio to {against} by the pixels, nominally {_number(nominal)}"
        found.append(_ratio("ratio", record, fit.ratio, nominal, text, advice))
    if exif_ratio is not None and exif_ratio != nominal:
        text = f"exposure ratio to {against} by the pixels, {_number(exif_ratio)} by EXIF"
        advice = "EXIF does not say how this file was exposed: is it the file that the camera wrote?"
        found.append(_ratio("EXIF ratio", record, fit.ratio, exif_ratio, text, advice))
    flicker = flicker_of_contrast(fit.residuals)
    return found if flicker is None else [*found, _flicker(record.path, flicker)]


def _signal(record: FrameRecord, fit: RatioFit, expected: Fraction) -> Measure:
    text = f"signal that it shows, of that at a ratio of {_number(expected)}; too little to measure the ratio by"
    scale = 100 * float(expected)
    return Measure(SIGNAL, record.path, text, scale * fit.slope.value, scale * fit.slope.standard_error)


def _ratio(name: str, record: FrameRecord, ratio: Estimate, expected: Fraction, text: str, advice: str) -> Measure:
    nominal = float(expected)
    kind = MeasureKind(name, "", RATIO_LOOK * nominal, RATIO_AGAIN * nominal, RATIO_SOURCE, advice, expected=nominal)
    return Measure(kind, record.path, text, ratio.value, ratio.standard_error)


def _ratio_advice(record: FrameRecord, ratio: Estimate, exif_ratio: Fraction | None, noisy: list[FrameRecord]) -> str:
    """Return what may have happened to a frame whose ratio is not the nominal one."""
    if exif_ratio is not None and _fits(ratio, exif_ratio):
        cause = "EXIF says the same: taken with another setting, or under another frame's name"
    else:
        cause = "EXIF does not show it"
    like = [
        other
        for other in noisy
        if other is not record and other.iso == record.iso and other.ratio is not None and _fits(ratio, other.ratio)
    ]
    if like:
        return f"{cause}; it fits {file_name(like[0].path)} (x{_number(like[0].ratio)}): swapped?"
    return f"{cause}; check the settings, then correct the manifest or shoot it again"


def _fits(ratio: Estimate, expected: Fraction) -> bool:
    return abs(ratio.value - float(expected)) <= RATIO_LOOK * float(expected)


def _number(value: Fraction | None) -> str:
    return "?" if value is None else f"{float(value):.4g}"
