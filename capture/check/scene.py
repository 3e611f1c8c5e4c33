"""Check one scene: references against the first, noisy frames against their reference.

What is found of a pair is one row; the manifest keeps two of its values. The exposure ratio that the pixels show is
held against the nominal one, which only names the frame, and against what EXIF states, by which an input is amplified.
Names of shutter times are rounded (30 s are 32 s, 1/200 s is 1/203 s), so a conflict with EXIF need not be anybody's
mistake; but it costs as much of a score as light that changed, so it is settled only where the manifest holds the
measured ratio.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.check.common_shift import common_shift, fine_noise
from capture.check.flicker import add_flicker, flicker_between, flicker_of_contrast
from capture.check.frames import ReducedFrame, Unit, change_picture, file_name, reduced_frames, scene_picture
from capture.check.measures import (
    LIGHT_AGAIN,
    LIGHT_LOOK,
    RATIO_AGAIN,
    RATIO_LOOK,
    SHIFT_AGAIN_PX,
    SIGMAS,
    Estimate,
    find_kind,
)
from capture.check.ratio import brightest_level, brightness_ratios, changed_share, fit_ratio
from capture.check.result import CheckedGroup, CheckedPair, SheetPicture
from capture.check.shift import make_tiles, measure_focus, measure_shift, moved_tiles
from capture.observed import f_text, same_aperture
from capture.shutter import ladder
from eldata.errors import RawFileError
from eldata.manifest.clips import moment_of
from eldata.manifest.pairs import UNCERTAIN_ISO

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capture.check.cells import Cells
    from capture.check.measures import MeasureKind, Verdict
    from capture.check.shift import Shift, Tiles
    from eldata.records import Exposure, FrameRecord, RawHeader

_INFINITE: Final = float("inf")
_STEPS: Final = (Fraction(1, 3), Fraction(1, 2))
_RECORD_IT: Final = (
    'capture check --write puts the measured ratio into the manifest, and amplification="measured" uses it'
)


@dataclass(frozen=True, slots=True, eq=False)
class SeenReference:
    """What is kept of a reference while the noisy frames pass: cells, header, and tiles if it has the size for any."""

    cells: Cells
    header: RawHeader
    tiles: Tiles | None


def check_scene(unit: Unit) -> CheckedGroup:
    """Check the frames of one scene, references first, each decoded once."""
    group = CheckedGroup(unit.name, len(unit.records))
    noisy = [record for record in unit.records if record.role == "noisy"]
    references: dict[str, SeenReference] = {}
    first: ReducedFrame | None = None
    tiles_of_first: Tiles | None = None
    last: ReducedFrame | None = None
    changes: list[SheetPicture] = []
    apertures: dict[str, Fraction] = {}
    for frame in reduced_frames(unit, group):
        path = frame.record.path
        _compare_aperture(frame, apertures, group)
        if frame.record.role == "noisy":
            named = frame.record.reference or (unit.records[0].path if len(noisy) < len(unit.records) else "")
            check_pair(frame, named, references, noisy, group)
            group.pictures.append(scene_picture(frame, float(frame.record.ratio or 1)))
            continue
        tiles = make_tiles(frame.luminance)
        references[path] = SeenReference(frame.cells, frame.header, tiles)
        group.measure("clipped", path, Estimate(frame.cells.clipped_share).in_percent())
        if first is None:
            first, tiles_of_first = frame, tiles
            _compare_moments(unit, frame, group)
            level = brightest_level(frame.cells)
            if level is None:
                group.remark(path, "is too small to tell how bright it is")
            else:
                group.measure("brightness", path, Estimate(level).in_percent())
            group.pictures.append(scene_picture(frame, 1.0))
        else:
            if last is not None and not _well(group, last):
                changes.append(change_picture(first, last))  # the last one always has one
            _compare(first, tiles_of_first, frame, group)
            last = frame
    if last is not None and first is not None:
        group.pictures[1:1] = [scene_picture(last, 1.0), *changes, change_picture(first, last)]
    if len(references) == 1 and first is not None:
        text = "is the only reference: whether the light changed or the camera moved cannot be told"
        group.remark(first.record.path, text)
    return group


def _compare_aperture(frame: ReducedFrame, known: dict[str, Fraction], group: CheckedGroup) -> None:
    """Remark on a frame whose EXIF states another aperture than the scene's first file that states one."""
    path, f_number = frame.record.path, frame.header.exposure.f_number
    if f_number is None:
        return
    known.setdefault(path, f_number)
    first, expected = next(iter(known.items()))
    if not same_aperture(f_number, expected):
        text = (
            f"EXIF states {f_text(f_number)}, expected {f_text(expected)} as in {file_name(first)}: the exposure ratio "
            "is computed from ISO and time alone; keep the aperture fixed"
        )
        group.remark(path, text, "shoot again")


def _well(group: CheckedGroup, frame: ReducedFrame) -> bool:
    return all(one.verdict == "keep" for one in group.measures if one.path == frame.record.path)


# --- references ---------------------------------------------------------------------------------------------------


def _compare(first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, group: CheckedGroup) -> None:
    """Measure a later reference against the first: light, place and focus, what moved, and flicker."""
    path, against = frame.record.path, file_name(first.record.path)
    brightness, ratios = _measure_light(first, frame, "drift", against, group)
    place = _measure_place(tiles, frame, "shift", against, group)
    if place is not None:
        here, there, shift, verdict = place
        if verdict != "keep":
            return  # what is measured pixel by pixel would show the shift again
        focus = measure_focus(here, there, shift, brightness)
        # Out of focus, edges differ everywhere.
        if focus is None or group.measure("focus", path, focus.in_percent(1), against=against).verdict == "keep":
            changed = changed_share(first.cells, frame.cells, brightness)
            # Without an error: only what exceeds eight of them is counted.
            group.measure("movement", path, Estimate(changed).in_percent(), against=f"since {against}")
    add_flicker(group, path, flicker_between(first.cells, frame.cells, ratios))


def _measure_light(
    first: ReducedFrame, frame: ReducedFrame, kind: str, against: str, group: CheckedGroup
) -> tuple[float, Sequence[Estimate | None]]:
    """Measure the change of brightness; return its mean over the channels that tell it, and that of each channel."""
    path, ratios = frame.record.path, brightness_ratios(first.cells, frame.cells)
    known = [(colour, one) for colour, one in zip(first.cells.colours, ratios, strict=True) if one is not None]
    if not known:
        group.remark(path, f"too little is well exposed to compare it with {against}")
        return 1.0, ratios
    colour, worst_one = max(known, key=lambda pair: abs(pair[1].value - 1))
    group.measure(kind, path, worst_one.in_percent(1), colour=colour, against=against)
    return sum(one.value for _, one in known) / len(known), ratios


def _measure_place(
    tiles: Tiles | None, frame: ReducedFrame, kind: str, against: str, group: CheckedGroup
) -> tuple[Tiles, Tiles, Shift, Verdict] | None:
    """Measure the shift; return the tiles that show the same, and the verdict; ``None`` where nothing tells it."""
    path = frame.record.path
    cut = None if tiles is None else moved_tiles(tiles, frame.luminance)
    shift = None if cut is None else measure_shift(cut[0], cut[1])
    if cut is None or shift is None:
        text = "has too little detail to tell whether the camera moved: put something with edges into the scene"
        group.remark(path, text)
        return None
    measure = group.measure(kind, path, shift.length(cut[2], frame.scale), against=against)
    return cut[0], cut[1], shift, measure.verdict


def _compare_moments(unit: Unit, frame: ReducedFrame, group: CheckedGroup) -> None:
    """Measure a moment's first reference against the moment before: camera and light rest, something has moved."""
    if unit.before is None:
        return
    path, number = frame.record.path, (moment_of(frame.record.scene) or ("", 0))[1]
    earlier = (moment_of(unit.before.scene) or ("", 0))[1]
    if earlier < number - 1:
        lacking = f"moment {number - 1} is" if earlier == number - 2 else f"moments {earlier + 1} to {number - 1} are"
        group.remark(path, f"{lacking} missing: it is compared with moment {earlier}")
    before = next(reduced_frames(replace(unit, records=(unit.before,)), CheckedGroup("", 1)), None)
    if before is None:
        return  # which is said where it belongs
    against = f"moment {earlier} ({file_name(before.record.path)})"
    brightness, _ = _measure_light(before, frame, "moment drift", against, group)
    place = _measure_place(make_tiles(before.luminance), frame, "moment shift", against, group)
    if place is not None and place[3] != "keep":
        return  # edges differ everywhere
    changed = 100 * changed_share(before.cells, frame.cells, brightness)
    least = find_kind("movement").look
    if changed < least:
        group.remark(
            path,
            f"nothing moved since {against}: {changed:.2g} % of the picture changed, expected {least:g} % or "
            "more; was moving forgotten, or this moment taken twice? Move something, and take this moment again",
        )


# --- pairs ------------------------------------------------------------------------------------------------------------


def check_pair(
    frame: ReducedFrame,
    named: str,
    references: Mapping[str, SeenReference],
    noisy: list[FrameRecord],
    group: CheckedGroup,
) -> None:
    """Measure a noisy frame against its reference, ``named``: the scene that it shows, place, exposure ratio, flicker.

    ``noisy`` are all noisy frames of the scene.
    """
    record, path = frame.record, frame.record.path
    pair = CheckedPair(path, named)
    group.pairs.append(pair)
    group.measure("gaps", path, Estimate(frame.empty_share).in_percent())
    reference = references.get(named)
    if reference is None:
        text = f"its reference {file_name(named)} cannot be used" if named else "the scene has no reference"
        group.remark(path, text, "shoot again")
        return
    fit = fit_ratio(reference.cells, frame.cells)
    if fit is None:
        text = "too few pixels that are neither saturated nor clipped at black: its exposure ratio cannot be measured"
        group.remark(path, text)
        return
    against = file_name(named)
    if group.measure("match", path, fit.match.in_percent(), against=against).verdict == "shoot again":
        return  # with another scene there is neither shift nor ratio
    if _measure_pairs_place(frame, reference, against, pair, group) == "shoot again":
        return  # what is measured pixel by pixel would show the shift again
    exif_ratio = _exif_ratio(reference.header, frame.header)
    nominal = record.ratio
    if fit.ratio is None:
        expected = nominal or exif_ratio
        if expected is not None:
            scale = 100 * float(expected)
            signal = Estimate(scale * fit.slope.value, scale * fit.slope.standard_error)
            group.measure("signal", path, signal, ratio=_number(expected))
        return
    pair.ratio = fit.ratio
    if nominal is not None:
        kind = _nominal_kind(nominal, _ratio_advice(record, fit.ratio, exif_ratio, noisy))
        group.measure(kind, path, fit.ratio, against=against, ratio=_number(nominal))
    if exif_ratio is not None:
        kind = _exif_kind(record, fit.ratio, exif_ratio, _given_ratio(reference.header.exposure, frame.header.exposure))
        group.measure(kind, path, fit.ratio, against=against, ratio=_number(exif_ratio))
    fine = group.row(pair).get("fine noise")
    if fine is None or fine.verdict == "keep":  # else edges differ everywhere
        changed = changed_share(reference.cells, frame.cells, fit.slope.value, fit.offset_dn)
        # Without an error: only what exceeds eight of them is counted.
        group.measure("movement", path, Estimate(changed).in_percent(), against=f"to {against}")
    add_flicker(group, path, flicker_of_contrast(fit.residuals))


def _measure_pairs_place(
    frame: ReducedFrame, reference: SeenReference, against: str, pair: CheckedPair, group: CheckedGroup
) -> str:
    """Measure how far the frame lies from its reference; return the verdict."""
    found = None if reference.tiles is None else common_shift(reference.tiles, frame.luminance)
    if found is None:
        pair.notes.append("texture or light is too weak to tell a shift")
        return "keep"
    shift, pixels, tiles = found
    pair.shift, pair.pixels_off = shift.length(pixels, frame.scale), shift.pixels_off(pixels, frame.scale)
    unseen = SIGMAS * pair.shift.standard_error
    if unseen > SHIFT_AGAIN_PX:
        pair.notes.append(f"texture or light is weak: a shift below {unseen:.1f} px may not be seen")
    verdict = group.measure("shift", pair.path, pair.shift, against=against).verdict
    fine = fine_noise(shift, *tiles) if verdict == "keep" else None  # else the scene is left over, too
    if fine is not None:
        group.measure("fine noise", pair.path, fine.in_percent())
    return verdict


# --- ratios -------------------------------------------------------------------------------------------------------


def _exif_ratio(reference: RawHeader, noisy: RawHeader) -> Fraction | None:
    from eldata.raw.reading import exposure_ratio

    try:
        return exposure_ratio(reference, noisy)
    except RawFileError:
        return None


def _given_ratio(reference: Exposure, noisy: Exposure) -> tuple[float, ...]:
    """Return the ratios by the times that shutters in steps of a third or a half give where EXIF has the names."""
    if reference.iso is None or noisy.iso is None:
        return ()
    speeds = float(reference.iso / noisy.iso)
    found = []
    for step in _STEPS:
        long, short = (ladder(step).get(one.exposure_s or Fraction(0)) for one in (reference, noisy))
        if long is not None and short is not None:
            found.append(speeds * long.true_s / short.true_s)
    return tuple(found)


def _nominal_kind(nominal: Fraction, advice: str) -> MeasureKind:
    value = float(nominal)
    kind = find_kind("ratio")
    return replace(kind, look=RATIO_LOOK * value, again=RATIO_AGAIN * value, advice=advice, expected=value)


def _exif_kind(record: FrameRecord, ratio: Estimate, exif_ratio: Fraction, given: tuple[float, ...]) -> MeasureKind:
    """Return what is expected of a ratio that EXIF states, or that the manifest holds as measured."""
    stated, recorded = float(exif_ratio), record.measured_ratio
    doubted = UNCERTAIN_ISO in record.flags
    settled = recorded is not None and (doubted or abs(float(recorded) / stated - 1) <= RATIO_AGAIN)
    expected = float(recorded) if recorded is not None and settled else stated
    again = LIGHT_AGAIN * expected
    kind = find_kind("EXIF ratio")
    advice = kind.advice
    nearest = min(given, key=lambda one: abs(ratio.value - one), default=None)
    if settled:
        advice = "it is not the ratio that the manifest holds as measured: was the file replaced? Write it again"
    elif doubted:
        again = _INFINITE
        advice = f"EXIF has the names of ISOs, whose measured speeds are others: {_RECORD_IT}"
    elif nearest is not None and abs(ratio.value - nearest) <= max(LIGHT_LOOK * nearest, SIGMAS * ratio.standard_error):
        again = _INFINITE
        advice = f"EXIF has the rounded names of the shutter's times: {_RECORD_IT}"
    return replace(kind, look=LIGHT_LOOK * expected, again=again, advice=advice, expected=expected)


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
    return f"{cause}; {find_kind('ratio').advice}"


def _fits(ratio: Estimate, expected: Fraction) -> bool:
    return abs(ratio.value - float(expected)) <= RATIO_LOOK * float(expected)


def _number(value: Fraction | None) -> str:
    return "?" if value is None else f"{float(value):.4g}"
