"""Check one scene: references against the first, noisy frames against their reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capture.check.drift import brightest_level, brightness_ratios, changed_share
from capture.check.flicker import Flicker, flicker_between, flicker_of_contrast
from capture.check.frames import ReducedFrame, Unit, file_name, reduced_frames
from capture.check.measures import (
    BRIGHTNESS_AGAIN,
    BRIGHTNESS_LOOK,
    BRIGHTNESS_SOURCE,
    RATIO_AGAIN,
    RATIO_LOOK,
    RATIO_SOURCE,
    Estimate,
    MeasureKind,
)
from capture.check.pictures import change_picture, scene_picture
from capture.check.ratio import fit_ratio
from capture.check.result import CheckedGroup, SheetPicture
from capture.check.shift import Tiles, make_tiles, measure_focus, measure_shift, moved_tiles
from eldata.errors import RawFileError

if TYPE_CHECKING:
    from fractions import Fraction

    from capture.check.cells import Cells
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
    "practical: one part in a thousand of the picture; what moved may not matter, so look",
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
    "expose the references less (and plan the scene again), or shade the highlights",
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
    "the tolerance of eldata verify; to shoot again: half of the signal is missing",
    "no light, or far too little: was the lens capped, the exposure right?",
    expected=100.0,
)


def check_scene(unit: Unit) -> CheckedGroup:
    """Check the frames of one scene, references first, each decoded once."""
    group = CheckedGroup(unit.name, len(unit.records))
    noisy = [record for record in unit.records if record.role == "noisy"]
    references: dict[str, tuple[Cells, RawHeader]] = {}
    first: ReducedFrame | None = None
    tiles: Tiles | None = None
    last: ReducedFrame | None = None
    changes: list[SheetPicture] = []
    for frame in reduced_frames(unit, group):
        path = frame.record.path
        if frame.record.role == "noisy":
            named = frame.record.reference or (unit.records[0].path if len(noisy) < len(unit.records) else "")
            _check_noisy(frame, named, references.get(named), noisy, group)
            group.pictures.append(scene_picture(frame, float(frame.record.ratio or 1)))
            continue
        references[path] = (frame.cells, frame.header)
        group.measure(CLIPPED, path, "saturated pixels", 100 * frame.cells.clipped_share)
        if first is None:
            first, tiles = frame, make_tiles(frame.luminance)
            level = brightest_level(frame.cells)
            if level is None:
                group.remark(path, "is too small to tell how bright it is")
            else:
                group.measure(BRIGHTNESS, path, "share of the range that the bright parts reach", 100 * level)
            group.pictures.append(scene_picture(frame, 1.0))
        else:
            if last is not None and not _well(group, last):
                changes.append(change_picture(first, last))  # the last one always has one
            _compare(first, tiles, frame, group)
            last = frame
    if last is not None and first is not None:
        group.pictures[1:1] = [scene_picture(last, 1.0), *changes, change_picture(first, last)]
    if len(references) == 1 and first is not None:
        text = "is the only reference: whether the light changed or the camera moved cannot be told"
        group.remark(first.record.path, text)
    return group


def _well(group: CheckedGroup, frame: ReducedFrame) -> bool:
    return all(one.verdict == "keep" for one in group.measures if one.path == frame.record.path)


# --- references ---------------------------------------------------------------------------------------------------


def _compare(first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, group: CheckedGroup) -> None:
    """Measure a later reference against the first."""
    path, against = frame.record.path, file_name(first.record.path)
    ratios = brightness_ratios(first.cells, frame.cells)
    known = [(colour, one) for colour, one in zip(first.cells.colours, ratios, strict=True) if one is not None]
    brightness = 1.0
    if not known:
        group.remark(path, "too little is well exposed to compare it with the first reference")
    else:
        colour, worst_one = max(known, key=lambda pair: abs(pair[1].value - 1))
        brightness = sum(one.value for _, one in known) / len(known)
        text = f"change of brightness ({colour}) since {against}"
        group.measure(DRIFT, path, text, 100 * (worst_one.value - 1), 100 * worst_one.standard_error)
    if _compare_places(first, tiles, frame, brightness, group):
        _add_flicker(group, path, flicker_between(first.cells, frame.cells, ratios))


def _compare_places(
    first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, brightness: float, group: CheckedGroup
) -> bool:
    """Measure shift and focus; return whether the frames lie on each other."""
    path, against = frame.record.path, file_name(first.record.path)
    cut = None if tiles is None else moved_tiles(tiles, frame.luminance)
    shift = None if cut is None else measure_shift(cut[0], cut[1])
    if cut is None or shift is None:
        text = "has too little detail to tell whether the camera moved: put something with edges into the scene"
        group.remark(path, text)
        return True
    length = shift.length(cut[2], frame.scale)
    measure = group.measure(SHIFT, path, f"distance from {against}", length.value, length.standard_error)
    if measure.verdict != "keep":
        return False  # what is measured pixel by pixel would show the shift again
    focus = measure_focus(cut[0], cut[1], shift, brightness)
    if focus is not None:
        text = f"change of the contrast of fine detail since {against}"
        measure = group.measure(FOCUS, path, text, 100 * (focus.value - 1), 100 * focus.standard_error)
        if measure.verdict != "keep":
            return True  # edges differ everywhere
    text = f"share of the picture that changed differently from the whole since {against}"
    # Without an error: only what exceeds eight of them is counted.
    group.measure(MOVEMENT, path, text, 100 * changed_share(first.cells, frame.cells, brightness))
    return True


def _add_flicker(group: CheckedGroup, path: str, flicker: Flicker | None) -> None:
    if flicker is not None:
        text = f"bands across the picture, {flicker.cycles:g} per frame, amplitude"
        group.measures.append(flicker.measure(FLICKER, path, text))


# --- noisy frames -------------------------------------------------------------------------------------------------


def _check_noisy(
    frame: ReducedFrame,
    named: str,
    reference: tuple[Cells, RawHeader] | None,
    noisy: list[FrameRecord],
    group: CheckedGroup,
) -> None:
    """Measure a noisy frame against its reference: the scene that it shows, its exposure ratio, flicker."""
    from eldata.raw.reading import exposure_ratio

    record, path = frame.record, frame.record.path
    if reference is None:
        text = f"its reference {file_name(named)} cannot be used" if named else "the scene has no reference"
        group.remark(path, text, "shoot again")
        return
    cells, header = reference
    try:
        exif_ratio = exposure_ratio(header, frame.header)
    except RawFileError:
        exif_ratio = None
    fit = fit_ratio(cells, frame.cells)
    if fit is None:
        text = "too few pixels that are neither saturated nor clipped at black: its exposure ratio cannot be measured"
        group.remark(path, text)
        return
    against = file_name(record.reference or "its reference")
    text = f"how much of the scene in {against} it shows"
    match = group.measure(MATCH, path, text, 100 * fit.match.value, 100 * fit.match.standard_error)
    if match.verdict == "shoot again":
        return  # with another scene there is no ratio
    nominal = record.ratio
    if fit.ratio is None:
        expected = nominal or exif_ratio
        if expected is not None:
            text = f"signal, as a share of that at a ratio of {_number(expected)}; too little to measure the ratio by"
            scale = 100 * float(expected)
            group.measure(SIGNAL, path, text, scale * fit.slope.value, scale * fit.slope.standard_error)
        return
    if nominal is not None:
        text = f"exposure ratio to {against} by the pixels, nominally {_number(nominal)}"
        kind = _ratio_kind("ratio", nominal, _ratio_advice(record, fit.ratio, exif_ratio, noisy))
        group.measure(kind, path, text, fit.ratio.value, fit.ratio.standard_error)
    if exif_ratio is not None and exif_ratio != nominal:
        text = f"exposure ratio to {against} by the pixels, {_number(exif_ratio)} by EXIF"
        advice = "EXIF does not say how this file was exposed: is it the file that the camera wrote?"
        kind = _ratio_kind("EXIF ratio", exif_ratio, advice)
        group.measure(kind, path, text, fit.ratio.value, fit.ratio.standard_error)
    _add_flicker(group, path, flicker_of_contrast(fit.residuals))


def _ratio_kind(name: str, expected: Fraction, advice: str) -> MeasureKind:
    nominal = float(expected)
    return MeasureKind(name, "", RATIO_LOOK * nominal, RATIO_AGAIN * nominal, RATIO_SOURCE, advice, expected=nominal)


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
