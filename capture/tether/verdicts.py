"""A scene, or a set of calibration frames, checked as soon as its last frame is here, while the tripod still stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capture.manifest import in_place
from capture.matching import Match
from capture.observed import observe_one
from eldata.base.workers import Workers
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from capture.check.result import CheckedGroup
    from capture.matching import Slot
    from capture.plan import Plan


def check_taken(plan: Plan, files: Mapping[Slot, Path]) -> tuple[CheckedGroup, ...]:
    """Check the frames of some shots by their pixels, as ``capture check`` does.

    Raises
    ------
    EldataError
        If a frame cannot be read any more.
    """
    from capture.check.checking import check_unit, units_of

    frames = {slot: observe_one(path) for slot, path in files.items()}
    dataset = in_place(plan, Match(frames, ()))
    return tuple(check_unit(unit) for unit in units_of(dataset.records, dataset.folder, Workers(1)))


def verdict_text(plan: Plan, files: Mapping[Slot, Path]) -> tuple[str, bool]:
    """Return what a check of some shots says, and whether all can be kept.

    Nothing that is wrong with the check ends a session: the frames are here and can be checked again.
    """
    try:
        groups = check_taken(plan, files)
    except EldataError as error:
        return f"could not be checked: {error}", False
    text = "\n".join(group.format_text() for group in groups)
    ok = all(group.verdict == "keep" for group in groups)
    if any(group.verdict == "shoot again" for group in groups):
        names = ", ".join(sorted({path.name.rpartition("_")[0] for path in files.values()}))
        text += f"\n    to take frames again: Ctrl-C, delete those of {names} that are spoiled, run the same command"
    return text, ok
