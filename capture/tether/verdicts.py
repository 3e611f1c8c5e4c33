"""A scene, or a set of calibration frames, checked as soon as its last frame is here, while the tripod still stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capture.apertures import aperture_remarks
from capture.manifest import in_place
from capture.matching import Match
from capture.observed import observe_one
from eldata.base.workers import Workers
from eldata.errors import EldataError
from eldata.manifest.clips import moment_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from capture.check.measures import Verdict
    from capture.matching import Slot
    from capture.plan import Plan


def verdict_text(plan: Plan, slots: Sequence[Slot], files: Mapping[Slot, Path], sheet: Path) -> tuple[str, Verdict]:
    """Return what ``capture check`` says of some shots, and the worst verdict; apertures are compared with the plan's.

    ``files``: of these shots and of all others that are there, in the plan's order, for a moment of a sequence is
    compared with the one before. The contact sheet of these shots is written, too. Nothing that is wrong with the check
    ends a session: the frames are here and can be checked again.
    """
    from capture.check.checking import check_unit, units_of
    from capture.check.measures import worst
    from capture.check.result import CheckReport
    from capture.check.sheet import write_sheet

    try:
        frames = {slot: observe_one(files[slot]) for slot in slots}
        earlier = {slot: observe_one(files[slot]) for slot in _earlier(slots[0][0], files)}
        dataset = in_place(plan, Match(earlier | frames, ()))
        units = units_of(dataset.records, dataset.folder, Workers(1))
        of_earlier = {scene for scene, _ in earlier}
        groups = [check_unit(unit) for unit in units if unit.records[0].scene not in of_earlier]
        sheet.parent.mkdir(exist_ok=True)
        write_sheet(sheet, CheckReport(sheet.stem, tuple(groups)))
    except (EldataError, OSError) as error:
        return f"could not be checked: {error}", "look"
    apertures = aperture_remarks(plan, frames)
    shown = f"    to look at: {sheet}"
    text = "\n".join([*(group.format_text() for group in groups), *(f"    {one.text}" for one in apertures), shown])
    wrong: list[Verdict] = ["shoot again" for one in apertures if one.kind == "aperture"]
    verdict = worst([*(group.verdict for group in groups), *wrong])
    if verdict == "shoot again":
        names = ", ".join(sorted({files[slot].name.rpartition("_")[0] for slot in slots}))
        text += f"\n    to take frames again: Ctrl-C, delete those of {names} that are spoiled, run the same command"
    return text, verdict


def _earlier(scene: str, slots: Iterable[Slot]) -> tuple[Slot, ...]:
    """Return the last shot of each earlier moment of the sequence that a scene is a moment of."""
    sequence, number = moment_of(scene) or ("", 0)
    last: dict[str, Slot] = {}
    for slot in slots:
        of, at = moment_of(slot[0]) or ("", 0)
        if of == sequence and at < number:
            last[slot[0]] = slot
    return tuple(last.values())
