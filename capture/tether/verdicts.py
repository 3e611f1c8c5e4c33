"""A scene, or a set of calibration frames, checked as soon as its last frame is here, while the tripod still stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capture.apertures import aperture_remarks
from capture.manifest import in_place
from capture.matching import Match
from capture.observed import observe_one
from eldata.base.workers import Workers
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from capture.check.measures import Verdict
    from capture.matching import Slot
    from capture.plan import Plan


def verdict_text(plan: Plan, files: Mapping[Slot, Path], sheet: Path) -> tuple[str, Verdict]:
    """Return what ``capture check`` says of some shots, and the worst verdict; apertures are compared with the plan's.

    The contact sheet of these shots is written, too. Nothing that is wrong with the check ends a session: the frames
    are here and can be checked again.
    """
    from capture.check.checking import check_unit, units_of
    from capture.check.measures import worst
    from capture.check.result import CheckReport
    from capture.check.sheet import write_sheet

    try:
        frames = {slot: observe_one(path) for slot, path in files.items()}
        dataset = in_place(plan, Match(frames, ()))
        groups = [check_unit(unit) for unit in units_of(dataset.records, dataset.folder, Workers(1))]
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
        names = ", ".join(sorted({path.name.rpartition("_")[0] for path in files.values()}))
        text += f"\n    to take frames again: Ctrl-C, delete those of {names} that are spoiled, run the same command"
    return text, verdict
