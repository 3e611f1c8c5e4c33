"""Check one scene: references against the first, noisy frames against their reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capture.apertures import f_text, same_aperture
from capture.check.drift import brightest_level, brightness_ratios
from capture.check.flicker import flicker_between
from capture.check.frames import ReducedFrame, Unit, file_name, reduced_frames
from capture.check.kinds import BRIGHTNESS, CLIPPED, DRIFT, FOCUS, MOVEMENT, SHIFT
from capture.check.pair import SeenReference, add_flicker, check_pair
from capture.check.pictures import change_picture, scene_picture
from capture.check.ratio import changed_share
from capture.check.result import CheckedGroup, SheetPicture
from capture.check.shift import make_tiles, measure_focus, measure_shift, moved_tiles

if TYPE_CHECKING:
    from fractions import Fraction

    from capture.check.shift import Tiles


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
        add_flicker(group, path, flicker_between(first.cells, frame.cells, ratios))


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
