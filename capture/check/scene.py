"""Check one scene: references against the first, noisy frames against their reference."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from capture.apertures import f_text, same_aperture
from capture.check.drift import brightest_level, brightness_ratios
from capture.check.flicker import flicker_between
from capture.check.frames import ReducedFrame, Unit, file_name, reduced_frames
from capture.check.kinds import BRIGHTNESS, CLIPPED, DRIFT, FOCUS, MOMENT_DRIFT, MOMENT_SHIFT, MOVEMENT, SHIFT
from capture.check.pair import SeenReference, add_flicker, check_pair
from capture.check.pictures import change_picture, scene_picture
from capture.check.ratio import changed_share
from capture.check.result import CheckedGroup, SheetPicture
from capture.check.shift import make_tiles, measure_focus, measure_shift, moved_tiles
from eldata.manifest.clips import moment_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from capture.check.measures import Estimate, MeasureKind, Verdict
    from capture.check.shift import Shift, Tiles


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
        group.measure(CLIPPED, path, "saturated pixels", 100 * frame.cells.clipped_share)
        if first is None:
            first, tiles_of_first = frame, tiles
            _compare_moments(unit, frame, group)
            level = brightest_level(frame.cells)
            if level is None:
                group.remark(path, "is too small to tell how bright it is")
            else:
                group.measure(BRIGHTNESS, path, "share of the range that the bright parts reach", 100 * level)
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
    """Measure a later reference against the first."""
    path, against = frame.record.path, file_name(first.record.path)
    ratios = brightness_ratios(first.cells, frame.cells)
    brightness = _measure_light(first, frame, ratios, DRIFT, against, group)
    if _compare_places(first, tiles, frame, brightness, group):
        add_flicker(group, path, flicker_between(first.cells, frame.cells, ratios))


def _measure_light(
    first: ReducedFrame,
    frame: ReducedFrame,
    ratios: Sequence[Estimate | None],
    kind: MeasureKind,
    against: str,
    group: CheckedGroup,
) -> float:
    """Measure the change of brightness; return its mean over the channels that tell it."""
    path = frame.record.path
    known = [(colour, one) for colour, one in zip(first.cells.colours, ratios, strict=True) if one is not None]
    if not known:
        group.remark(path, f"too little is well exposed to compare it with {against}")
        return 1.0
    colour, worst_one = max(known, key=lambda pair: abs(pair[1].value - 1))
    text = f"change of brightness ({colour}) since {against}"
    group.measure(kind, path, text, 100 * (worst_one.value - 1), 100 * worst_one.standard_error)
    return sum(one.value for _, one in known) / len(known)


def _measure_place(
    tiles: Tiles | None, frame: ReducedFrame, kind: MeasureKind, against: str, group: CheckedGroup
) -> tuple[Tiles, Tiles, Shift, Verdict] | None:
    """Measure the shift; return the tiles that show the same, and the verdict; ``None`` where nothing tells it."""
    path = frame.record.path
    cut = None if tiles is None else moved_tiles(tiles, frame.luminance)
    shift = None if cut is None else measure_shift(cut[0], cut[1])
    if cut is None or shift is None:
        text = "has too little detail to tell whether the camera moved: put something with edges into the scene"
        group.remark(path, text)
        return None
    length = shift.length(cut[2], frame.scale)
    measure = group.measure(kind, path, f"distance from {against}", length.value, length.standard_error)
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
    ratios = brightness_ratios(before.cells, frame.cells)
    brightness = _measure_light(before, frame, ratios, MOMENT_DRIFT, against, group)
    place = _measure_place(make_tiles(before.luminance), frame, MOMENT_SHIFT, against, group)
    if place is not None and place[3] != "keep":
        return  # edges differ everywhere
    changed = 100 * changed_share(before.cells, frame.cells, brightness)
    if changed < MOVEMENT.look:
        group.remark(
            path,
            f"nothing moved since {against}: {changed:.2g} % of the picture changed, expected {MOVEMENT.look:g} % or "
            "more; was moving forgotten, or this moment taken twice? Move something, and take this moment again",
        )


def _compare_places(
    first: ReducedFrame, tiles: Tiles | None, frame: ReducedFrame, brightness: float, group: CheckedGroup
) -> bool:
    """Measure shift and focus; return whether the frames lie on each other."""
    path, against = frame.record.path, file_name(first.record.path)
    place = _measure_place(tiles, frame, SHIFT, against, group)
    if place is None:
        return True
    here, there, shift, verdict = place
    if verdict != "keep":
        return False  # what is measured pixel by pixel would show the shift again
    focus = measure_focus(here, there, shift, brightness)
    if focus is not None:
        text = f"change of the contrast of fine detail since {against}"
        measure = group.measure(FOCUS, path, text, 100 * (focus.value - 1), 100 * focus.standard_error)
        if measure.verdict != "keep":
            return True  # edges differ everywhere
    text = f"share of the picture that changed differently from the whole since {against}"
    # Without an error: only what exceeds eight of them is counted.
    group.measure(MOVEMENT, path, text, 100 * changed_share(first.cells, frame.cells, brightness))
    return True
