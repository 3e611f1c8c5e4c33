"""What the checklist says, held against what the files say: names settle which file is a shot, ticks what was skipped.

A file name that was written down at the tripod is better evidence than the order of files, and is used; where the two
disagree, that is said. A shot without a file that is not ticked either was skipped. That is known only as long as the
ticks can be trusted: as long as every shot that has a file is ticked.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from capture.matching import Match, MatchRemark, can_be, match, no_file
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from capture.checklist_progress import Progress, ShotProgress
    from capture.matching import Repeated, Slot
    from capture.observed import Observed, ObservedFrame
    from capture.plan import Plan

    Frames = dict[Slot, ObservedFrame]

# What a file is called that no shot has; it no longer holds for one whose shot is known by its name.
_LEFT_OVER: Final = ("extra", "repeated", "wrong-setting", "out-of-order")


def match_noted(plan: Plan, observed: Observed, progress: Progress, *, repeated: Repeated = "last") -> Match:
    """Match files to a plan's shots with what the checklist knows: file names, repeats, what was skipped, remarks.

    Parameters
    ----------
    plan
        The plan, or a part of it, with the checklist's metered times.
    observed
        The files, in the order in which they were taken.
    progress
        The checklist's.
    repeated
        As of :func:`~capture.matching.match`.
    """
    found = match(plan, observed, repeated=repeated)
    begun = {name for name, rows in progress.parts if any(row.taken_at is not None for row in rows)}
    names = [name for name in dict.fromkeys(scene for scene, _ in plan.shots) if name in begun]
    if names:
        # Of scenes of equal exposures, those that are ticked were taken, if they explain the files as well.
        ticked = match(plan.only(names), observed, repeated=repeated)
        found = ticked if len(ticked.frames) == len(found.frames) else found
    return _as_noted(plan, observed, found, progress)


def _as_noted(plan: Plan, observed: Observed, found: Match, progress: Progress) -> Match:
    shots = {(scene, shot.number) for scene, shot in plan.shots}
    rows = {slot: row for slot, row in _slots(progress) if slot in shots}
    frames, remarks = _with_names(plan, observed, found.frames, rows)
    before, used = _paths(found.frames), _paths(frames)
    kept = [
        _expected(one, rows)
        for one in found.remarks
        if one.kind != "missing" and not (one.kind in _LEFT_OVER and one.path in used - before)
    ]
    remarks += [
        MatchRemark("extra", f"{path.name}: the checklist names other files; not used", path=path)
        for path in sorted(before - used)
    ]
    remarks += _without_files(plan, found, frames, rows)
    remarks += [
        MatchRemark("note", f"{slot[0]} frame {slot[1]}: {row.remark}", *slot)
        for slot, row in rows.items()
        if row.remark and slot[1] == row.number
    ]
    return Match(frames, (*kept, *remarks))


def _slots(progress: Progress) -> Iterator[tuple[Slot, ShotProgress]]:
    """Yield every shot with the row that it belongs to: one of calibration frames stands for several."""
    for name, rows in progress.parts:
        for row in rows:
            for number in range(row.number, row.number + row.count):
                yield (name, number), row


def _paths(frames: Frames) -> set[Path]:
    return {frame.path for frame in frames.values()}


def _expected(remark: MatchRemark, rows: dict[Slot, ShotProgress]) -> MatchRemark:
    """Return a remark on a repeated shot as one that needs no answer, if the checklist has it as repeated."""
    row = None if remark.number is None else rows.get((remark.scene, remark.number))
    if remark.kind != "repeated" or row is None or not row.repeats:
        return remark
    return replace(remark, kind="retaken", text=f"{remark.text}; repeated on the checklist too")


def _without_files(plan: Plan, found: Match, frames: Frames, rows: dict[Slot, ShotProgress]) -> list[MatchRemark]:
    ticked = {slot for slot, row in rows.items() if row.taken_at is not None}
    trusted = set(frames) <= ticked
    remarks = []
    known = {(one.scene, one.number): one.text for one in found.missing}
    begun = {scene for scene, _ in frames}
    sizes = Counter(scene for scene, _ in plan.shots)
    for scene, shot in plan.shots:
        slot = (scene, shot.number)
        if slot in frames:
            continue
        of_scene = f"{scene}: none of its {sizes[scene]} frames"
        text = known.get(slot, no_file(scene, shot) if scene in begun else of_scene)
        if slot in ticked:
            remarks.append(MatchRemark("missing", f"{text}; ticked on the checklist", *slot))
        elif trusted:
            remarks.append(MatchRemark("skipped", f"{text}; not ticked on the checklist either", *slot))
        else:
            remarks.append(MatchRemark("missing", text, *slot))
    if ticked and not trusted and remarks:
        number = len(set(frames) - ticked)
        text = f"{number} of the shots that have files are not ticked, so that ticks do not say what was skipped"
        remarks.append(MatchRemark("note", text))
    return remarks


# --- names --------------------------------------------------------------------------------------------------------


def _with_names(
    plan: Plan, observed: Observed, frames: Frames, rows: dict[Slot, ShotProgress]
) -> tuple[Frames, list[MatchRemark]]:
    """Return the shots' files with those that were written down, and what of the names is not as the order has it."""
    shots = {(scene, shot.number): shot for scene, shot in plan.shots}
    remarks: list[MatchRemark] = []
    named: Frames = {}
    for slot, row in rows.items():
        if not row.file or slot[1] != row.number:  # of several shots the first one's file is named
            continue
        fitting = [frame for frame in observed.frames if _is_named(frame, row.file)]
        there = frames.get(slot)
        if there in fitting:
            continue
        problem = ""
        if len(fitting) != 1:
            problem = f"the name of {len(fitting)} files" if fitting else "not among the files given"
        elif not can_be(shots[slot], fitting[0]):
            problem = f"taken at {fitting[0].settings}, where the plan has {shots[slot].settings}"
        elif row.count > 1 or fitting[0] in named.values():
            problem = "which is another shot's"
        else:
            named[slot] = fitting[0]
        order = f"by the order of the files it {'has none' if there is None else f'is {there.path.name}'}"
        said = f"{problem}; {order}" if problem else f"used, where {order}"
        text = f"{slot[0]} frame {slot[1]}: the checklist says {row.file}, {said}"
        remarks.append(MatchRemark("checklist", text, *slot, path=None if problem else fitting[0].path))
    result = {slot: frame for slot, frame in frames.items() if frame not in named.values()} | named
    for slot, frame in named.items():
        # Two files whose order was wrong change places.
        left = next((one for one, there in frames.items() if there is frame and one not in named), None)
        spare = frames.get(slot)
        if left is not None and spare is not None and spare not in result.values() and can_be(shots[left], spare):
            result[left] = spare
    return result, remarks


def _is_named(frame: ObservedFrame, written: str) -> bool:
    """Return whether a name, as people write it, is that of a file: with its ending, without, or its number alone."""
    if written.casefold() in (frame.path.name.casefold(), frame.path.stem.casefold()):
        return True
    digits = re.findall(r"[0-9]+", frame.path.stem)
    return written.isascii() and written.isdecimal() and bool(digits) and int(digits[-1]) == int(written)


# --- scenes metered at another time -----------------------------------------------------------------------------------


def explain_metering(plan: Plan, observed: Observed, found: Match) -> Match:
    """Return a match that says of scenes which lack most of their frames at which other metered time these are there.

    Of the frames that this explains, nothing else is said. Only times of frames at the base ISO are tried: references
    are taken at the metered time.
    """
    used = {frame.path for frame in found.frames.values()}
    left = tuple(frame for frame in observed.frames if frame.path not in used)
    dials = {
        setting.nominal_s: setting.dial
        for frame in left
        if frame.iso == plan.protocol.base_iso and frame.exposure_s
        if (setting := plan.camera.nearest(frame.exposure_s)) is not None
    }
    remarks: list[MatchRemark] = []
    explained: set[Path] = set()
    for scene in plan.scenes:
        count = len(scene.shots)
        if 2 * sum(remark.scene == scene.name for remark in found.missing) <= count:
            continue
        rest = replace(observed, frames=left, unusable=())
        tried = [
            (_frames_at(time_s, plan.only([scene.name]), rest), time_s)
            for time_s in sorted(dials.keys() - {scene.metered_s})
        ]
        frames, time_s = max(tried, key=lambda one: len(one[0]), default=(frozenset[Path](), scene.metered_s))
        if 2 * len(frames) > count:
            text = (
                f"{scene.name}: planned for a metered time of {scene.metered_s} s; {len(frames)} of its {count} frames "
                f"are there if it was metered at {dials[time_s]} s. If so: capture plan PLAN --remeter "
                f"{scene.name}={dials[time_s]}, and this again"
            )
            remarks.append(MatchRemark("metered", text, scene.name))
            explained |= frames
    remarks += [one for one in found.remarks if one.path not in explained or one.kind not in ("extra", "wrong-setting")]
    return replace(found, remarks=tuple(remarks))


def _frames_at(time_s: Fraction, scene: Plan, observed: Observed) -> frozenset[Path]:
    """Return the files that are frames of a plan's scene if it was metered at this time."""
    try:
        again = scene.remeter(scene.scenes[0].name, time_s)
    except EldataError:  # some of its shots are beyond the camera
        return frozenset()
    return frozenset(frame.path for frame in match(again, observed).frames.values())
