"""Which file is which shot of the plan, and everything that did not go as planned.

Files go four steps to a dataset: they are observed (:mod:`capture.observed`), matched to shots here, confirmed by a
person (:mod:`capture.mapping`), and placed with their manifest (:mod:`capture.manifest`).

Frames are matched by their settings and by the order in which they were taken: an alignment of sequences by dynamic
programming. The planned sequences (one per scene) and the frames in the order of time are aligned so that as little as
possible is left over: a planned shot without a frame costs something, a frame without a shot costs more. Scenes may
stand in any order, with any frames in between. So a skipped shot, a test shot or a retake shifts nothing, as it would
if frames were counted. What that leaves over is explained: a repeated shot is usually a retake, a shot that is missing
here and found there was taken out of order, the rest are test shots or wrong settings. Nothing is dropped without a
word.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from capture.camera import STOPS_TOLERANCE
from capture.plan import CALIBRATION, Plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from capture.observed import Observed, ObservedFrame
    from capture.shots import Shot
    from eldata.records import FrameRecord

    Slot = tuple[str, int]
    Stretch = tuple[int, tuple[int | None, ...]]
    Cell = tuple[int, int, int]

# A scene of which a third was taken is still that scene and not a heap of test shots: (K - m) missing < m extra.
_MISSING: Final = 0.5
_EXTRA: Final = 1.0
# Where frames alone leave it open, such as the one reference between two scenes of equal exposure, a scene ends at the
# longer pause. All pauses together weigh less than one shot.
_PAUSES: Final = 0.25
_NEAR_STOPS: Final = 1.05  # a wrong setting that was meant for a shot: up to a stop off

Repeated = Literal["last", "first"]
# Kinds of remarks for information only: there is nothing to decide.
_HARMLESS: Final = ("scene-order", "no-times", "copies")


@dataclass(frozen=True, slots=True)
class MatchRemark:
    """One thing that did not go as planned.

    Attributes
    ----------
    kind
        A word, such as ``"missing"``, ``"repeated"`` or ``"out-of-order"``.
    text
        Which shot or file, and how it was resolved.
    scene, number, path
        The shot and the file that it concerns, where there are such.
    """

    kind: str
    text: str
    scene: str = ""
    number: int | None = None
    path: Path | None = None


@dataclass(frozen=True, slots=True)
class Match:
    """Files and shots, matched.

    Attributes
    ----------
    frames
        The file of each shot that has one, by scene (or ``"calibration"``) and number.
    remarks
        What did not go as planned.
    """

    frames: dict[Slot, ObservedFrame]
    remarks: tuple[MatchRemark, ...]

    @property
    def missing(self) -> tuple[MatchRemark, ...]:
        """The shots that have no file."""
        return tuple(remark for remark in self.remarks if remark.kind == "missing")

    @property
    def doubtful(self) -> bool:
        """Whether something was decided that a person should confirm."""
        return any(remark.kind not in _HARMLESS for remark in self.remarks)


@dataclass(frozen=True, slots=True)
class ShotBlock:
    """Shots that are taken in one go: a scene, or the bias frames or flats of one ISO."""

    scene: str
    title: str
    shots: tuple[Shot, ...]


def match(plan: Plan, observed: Observed, *, repeated: Repeated = "last") -> Match:
    """Match files to a plan's shots.

    Parameters
    ----------
    plan
        The plan, or a part of it (:meth:`~capture.plan.Plan.only`).
    observed
        The files, in the order in which they were taken.
    repeated
        Which frame to use of a shot that was taken several times in a row.
    """
    remarks = [
        MatchRemark("unusable", f"{Path(file.path).name}: {file.reason}", path=Path(file.path))
        for file in observed.unusable
    ]
    if not observed.by_time:
        text = "not every file says when it was taken; the order is that of the file names"
        remarks.append(MatchRemark("no-times", text))
    if observed.copies:
        (path, original), *more = observed.copies
        text = f"{path} shows the shot of {original}; not used again"
        text += f", nor are {len(more)} others alike" if more else ""
        remarks.append(MatchRemark("copies", text, path=path))
    matcher = _Matcher(plan, observed, repeated)
    windows = matcher.find_blocks()
    matcher.choose_repeats()
    matcher.fill_gaps(windows)
    matcher.note_missing(windows)
    matcher.note_extra(windows)
    frames = {(block.scene, shot.number): observed.frames[i] for i, (block, shot) in matcher.used.items()}
    return Match(frames, (*remarks, *matcher.remarks))


def can_be(shot: Shot, frame: ObservedFrame | FrameRecord) -> bool:
    """Check that a frame has a shot's settings."""
    if frame.exposure_s is None:
        return False
    return frame.iso == shot.iso and shot.setting.stops_off(frame.exposure_s) <= STOPS_TOLERANCE


def describe_missing(title: str, shot: Shot) -> str:
    """Describe a shot of a scene that has no file."""
    return f"{title} frame {shot.number} ({shot.role}, {shot.settings}): no file"


def list_blocks(plan: Plan) -> tuple[ShotBlock, ...]:
    """List the blocks: scenes, then bias frames and flats by ISO."""
    blocks = [ShotBlock(scene.name, scene.name, scene.shots) for scene in plan.scenes]
    groups: dict[str, list[Shot]] = defaultdict(list)
    for shot in () if plan.calibration is None else plan.calibration.shots:
        groups[f"{shot.role} frames of ISO {shot.iso}"].append(shot)
    return (*blocks, *(ShotBlock(CALIBRATION, title, tuple(shots)) for title, shots in groups.items()))


class _Matcher:
    """The frame of each shot so far, and what there is to remark on; frames are named by their index."""

    def __init__(self, plan: Plan, observed: Observed, repeated: Repeated) -> None:
        self.blocks = list_blocks(plan)
        self.frames = observed.frames
        self.repeated = repeated
        self.remarks: list[MatchRemark] = []
        self.used: dict[int, tuple[ShotBlock, Shot]] = {}
        shots = {shot.settings: shot for block in self.blocks for shot in block.shots}
        self.fitting = {
            settings: {index for index, frame in enumerate(self.frames) if can_be(shot, frame)}
            for settings, shot in shots.items()
        }
        times = [frame.taken for frame in self.frames if frame.taken is not None]
        known = len(times) == len(self.frames)
        self.times_s = [(time - times[0]).total_seconds() for time in times] if known else [0.0] * len(self.frames)

    def find_blocks(self) -> dict[ShotBlock, range]:
        """Find each block's stretch of frames, in the order of time, and use these frames for its shots.

        Returns the frames among which a block's forgotten shots may be: up to its neighbours' own.
        """
        kinds: dict[tuple[str, ...], list[ShotBlock]] = defaultdict(list)
        for block in self.blocks:
            kinds[tuple(shot.settings for shot in block.shots)].append(block)
        alike = list(kinds)
        stretches = align(
            [len(settings) for settings in alike],
            lambda sequence, shot, index: index in self.fitting[alike[sequence][shot]],
            self.times_s,
        )
        placed: list[tuple[ShotBlock, tuple[int | None, ...]]] = []
        for sequence, blocks in enumerate(kinds.values()):
            kept = self._keep_most_whole([frames for number, frames in stretches if number == sequence], blocks)
            placed += zip(blocks, kept, strict=False)
            if 0 < len(kept) < len(blocks):
                lost = blocks[len(kept) :]
                text = (
                    f"{_join_titles(blocks)} have equal exposures, and {len(kept)} of these {len(blocks)} were found: "
                    f"taken for the first ones, so {_join_titles(lost)} {'is' if len(lost) == 1 else 'are'} missing. "
                    "If another one is, edit the mapping"
                )
                self._note("ambiguous", text)
        placed.sort(key=lambda pair: _find_ends(pair[1])[0])
        blocks = [block for block, _ in placed]
        if blocks != [block for block in self.blocks if block in blocks]:
            self._note("scene-order", f"taken in the order {_join_titles(blocks)}")
        self.used = {
            index: (block, shot)
            for block, frames in placed
            for shot, index in zip(block.shots, frames, strict=True)
            if index is not None
        }
        ends = [_find_ends(frames) for _, frames in placed]
        starts = [0, *(last + 1 for _, last in ends)]
        stops = [*(first for first, _ in ends[1:]), len(self.frames)]
        return {block: range(*ends) for block, *ends in zip(blocks, starts, stops, strict=False)}

    def _keep_most_whole(
        self, stretches: list[tuple[int | None, ...]], blocks: Sequence[ShotBlock]
    ) -> list[tuple[int | None, ...]]:
        """Keep as many stretches as there are blocks: those with the most shots; of two equal ones, the later."""
        spare = len(stretches) - len(blocks)
        if spare <= 0:
            return stretches
        ranked = sorted(stretches, key=lambda frames: (sum(i is not None for i in frames), _find_ends(frames)[0]))
        if len(blocks) > 1:
            names = ", ".join(" to ".join(map(self._name_file, _find_ends(frames))) for frames in ranked[:spare])
            self._note(
                "ambiguous",
                f"{_join_titles(blocks)} have equal exposures, and {len(stretches)} such series were found for "
                f"{len(blocks)}: left out as a first attempt: {names}. If another one is, edit the mapping",
            )
        return sorted(ranked[spare:], key=_find_ends)

    # --- what is left over --------------------------------------------------------------------------------------------

    def choose_repeats(self) -> None:
        """Where successive frames have equal settings, take the last (or first) ones for the shots among them."""
        settings = [(frame.iso, frame.exposure_s) for frame in self.frames]
        starts = [index for index in range(len(settings)) if index == 0 or settings[index] != settings[index - 1]]
        for start, stop in pairwise([*starts, len(settings)]):
            for run in self._split_run(range(start, stop)):
                shots = [self.used[index] for index in run if index in self.used]
                if not shots or len(shots) == len(run):
                    continue
                chosen = run[-len(shots) :] if self.repeated == "last" else run[: len(shots)]
                for index in run:
                    self.used.pop(index, None)
                self.used |= zip(chosen, shots, strict=True)
                block, shot = shots[-1]
                taken = " to ".join(dict.fromkeys(map(self._name_file, (chosen[0], chosen[-1]))))
                text = f"{block.title} frame {shot.number} was taken more than once; the {self.repeated} one is used"
                for index in (index for index in run if index not in chosen):
                    self._note("repeated", f"{self._name_file(index)}: {text}, {taken}", (block, shot), index)

    def _split_run(self, run: range) -> list[range]:
        """Split a run of equal settings where one scene ends and another begins: at its longest pause there.

        The reference at a scene's end and the one at the next scene's beginning may be equal, and so may be the first
        one of an abandoned attempt.
        """
        used = [index for index in run if index in self.used]
        cuts = {
            max(range(before + 1, after + 1), key=self._pause)
            for before, after in pairwise(used)
            if self.used[before][0] is not self.used[after][0]
        }
        if used:
            (first, first_shot), (last, last_shot) = self.used[used[0]], self.used[used[-1]]
            for index in run:
                outside = (index > used[-1] and last_shot is last.shots[-1]) or (
                    index <= used[0] and first_shot is first.shots[0]
                )
                # It belongs to what follows if the pause before it is the longer one.
                if outside and index + 1 < len(self.frames) and self._pause(index) > 3 * self._pause(index + 1):
                    cuts.add(index)
        return [range(*ends) for ends in pairwise([run.start, *sorted(cuts - {run.start}), run.stop])]

    def _pause(self, index: int) -> float:
        """Compute the seconds between a frame and the one before; 0 for the first."""
        return self.times_s[index] - self.times_s[index - 1] if index else 0.0

    def fill_gaps(self, windows: Mapping[ShotBlock, range]) -> None:
        """Give shots without a frame the frame with their settings that was taken elsewhere around the scene."""
        for block, shot, at in self._list_missing(windows):
            spare = [i for i in self._list_unexplained(windows[block]) if i in self.fitting[shot.settings]]
            if not spare:
                continue
            middle = max((i for number, i in at.items() if number < shot.number), default=min(at.values()))
            chosen = min(spare, key=lambda i, middle=middle: abs(i - middle))  # type: ignore[misc]
            self.used[chosen] = (block, shot)
            after = [number for number, i in at.items() if i < chosen]
            where = f"after frame {max(after, key=at.__getitem__)}" if after else "before all others"
            at[shot.number] = chosen
            text = f"{self._name_file(chosen)}: {block.title} frame {shot.number}, taken out of order ({where})"
            self._note("out-of-order", text, (block, shot), chosen)

    def note_missing(self, windows: Mapping[ShotBlock, range]) -> None:
        """Name the shots without a frame, and a frame with nearly their settings that was meant for them."""
        for block, shot, at in self._list_missing(self.blocks):
            nothing = f"{block.title}: none of its {len(block.shots)} frames"
            text = describe_missing(block.title, shot) if at else nothing
            near = self._find_meant(shot, windows[block], at) if at else None
            if near is not None:
                frame = self.frames[near]
                text += f"; {frame.path.name} may be meant, but was taken at {frame.settings}"
                wanted = f"{block.title} frame {shot.number} asks for {shot.settings}"
                wrong = f"{frame.path.name}: {frame.settings}, where {wanted}; not used"
                self._note("wrong-setting", wrong, (block, shot), near)
            self._note("missing", text, (block, shot))

    def _find_meant(self, shot: Shot, window: range, at: dict[int, int]) -> int | None:
        """Find the left-over frame that is where a missing shot should be, with the ISO or time slightly off."""
        low = max((i for number, i in at.items() if number < shot.number), default=window.start - 1)
        high = min((i for number, i in at.items() if number > shot.number), default=window.stop)
        for index in self._list_unexplained(range(low + 1, high)):
            frame = self.frames[index]
            if shot.setting.stops_off(frame.exposure_s) <= (_NEAR_STOPS if frame.iso == shot.iso else STOPS_TOLERANCE):
                return index
        return None

    def note_extra(self, windows: Mapping[ShotBlock, range]) -> None:
        """Remark on frames without a shot: repeated ones, and others that are not in the plan."""
        for index in self._list_unexplained(range(len(self.frames))):
            frame = self.frames[index]
            kind, text = "extra", "not a shot of the plan"
            for block in (block for block, window in windows.items() if index in window):
                same = [str(shot.number) for shot in block.shots if index in self.fitting[shot.settings]]
                if same:
                    text = f"for {block.title} frame {' or '.join(same[:4])} other files in the right order are used"
                    kind = "repeated"
                    break
            self._note(kind, f"{frame.path.name}: {frame.settings}: {text}; not used", frame=index)

    def _list_missing(self, blocks: Iterable[ShotBlock]) -> Iterator[tuple[ShotBlock, Shot, dict[int, int]]]:
        """Yield the shots without a frame, with the indices of the frames of their block's others by number."""
        for block in blocks:
            at = {shot.number: index for index, (owner, shot) in self.used.items() if owner is block}
            yield from ((block, shot, at) for shot in block.shots if shot.number not in at)

    def _list_unexplained(self, among: range) -> list[int]:
        """Return the frames that are neither used nor remarked on."""
        explained = {remark.path for remark in self.remarks}
        return [i for i in among if i not in self.used and self.frames[i].path not in explained]

    def _note(self, kind: str, text: str, of: tuple[ShotBlock, Shot] | None = None, frame: int | None = None) -> None:
        """Remark on something, with the shot and the frame that it concerns."""
        path = None if frame is None else self.frames[frame].path
        scene, number = ("", None) if of is None else (of[0].scene, of[1].number)
        self.remarks.append(MatchRemark(kind, text, scene, number, path))

    def _name_file(self, index: int) -> str:
        """Name a frame's file."""
        return self.frames[index].path.name


def _join_titles(blocks: Sequence[ShotBlock]) -> str:
    """Write the blocks' titles with commas."""
    return ", ".join(block.title for block in blocks)


def _find_ends(frames: Sequence[int | None]) -> tuple[int, int]:
    """Return the first and the last of a stretch's frames."""
    taken = [index for index in frames if index is not None]
    return min(taken), max(taken)


# --- which stretch of the frames is which sequence of shots -----------------------------------------------------------

_BETWEEN: Final = -1  # the sequence of a cell between sequences, with no shots done


def align(
    lengths: Sequence[int], can_be: Callable[[int, int, int], bool], times_s: Sequence[float]
) -> tuple[Stretch, ...]:
    """Find planned sequences among frames, in time proportional to (frames x shots of distinct sequences).

    Parameters
    ----------
    lengths
        Number of shots of each distinct sequence. Each may be found any number of times.
    can_be
        ``can_be(sequence, shot, frame)``: whether a frame has the settings of a shot, all counted from 0.
    times_s
        Time of each frame in seconds, rising; their number is that of the frames.

    Returns
    -------
    tuple of (sequence, frames)
        In the order of time: the frame index of each of the sequence's shots, or ``None``. Of several alignments of
        equal cost, the one with the latest frames: the second take of a scene that was begun twice.
    """
    span = times_s[-1] - times_s[0] if times_s else 0.0
    pauses = [0.0, *(_PAUSES * max(0.0, b - a) / span if span > 0 else 0.0 for a, b in pairwise(times_s))]
    # A cell is (sequence, shots done, frames done); a step the cell before it, and the frame that became this shot.
    cost: dict[Cell, float] = {(_BETWEEN, 0, 0): 0.0}
    steps: dict[Cell, tuple[Cell, int | None]] = {}

    def offer_step(cell: Cell, before: Cell, added: float, frame: int | None = None) -> None:
        """Keep the step from ``before`` to ``cell`` if it makes the way there cheaper."""
        # Offered in the order of preference: what comes later must be better, not equal.
        if before in cost and cost[before] + added < cost.get(cell, math.inf) - 1e-12:
            cost[cell] = cost[before] + added
            steps[cell] = (before, frame)

    for frame in range(len(times_s)):
        done = frame + 1
        outside, between = (_BETWEEN, 0, frame), (_BETWEEN, 0, done)
        for sequence, length in enumerate(lengths):
            for shots in range(1, length + 1):
                cell = (sequence, shots, done)
                if can_be(sequence, shots - 1, frame):
                    # Going on with the sequence, or beginning it here with the shots up to this one missing.
                    offer_step(cell, (sequence, shots - 1, frame), pauses[frame], frame)
                    offer_step(cell, outside, _MISSING * (shots - 1), frame)
                if shots < length:
                    offer_step(cell, (sequence, shots, frame), _EXTRA + pauses[frame])
                offer_step(cell, (sequence, shots - 1, done), _MISSING)
            offer_step(between, (sequence, length, done), 0.0)
        offer_step(between, outside, _EXTRA)
    return _trace(steps, len(times_s))


def _trace(steps: dict[Cell, tuple[Cell, int | None]], count: int) -> tuple[Stretch, ...]:
    """Follow the steps back from the last frame."""
    stretches: list[Stretch] = []
    frames: list[int | None] = []
    cell = (_BETWEEN, 0, count)
    while cell in steps:
        before, frame = steps[cell]
        sequence, shots, _ = cell
        if sequence != _BETWEEN:
            if before[0] == _BETWEEN:  # its beginning
                stretches.append((sequence, (*[None] * (shots - 1), frame, *reversed(frames))))
                frames = []
            elif before[1] == shots - 1:
                frames.append(frame)
        cell = before
    return tuple(reversed(stretches))
