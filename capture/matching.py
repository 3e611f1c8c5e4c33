"""Which file is which shot of the plan, and everything that did not go as planned.

Frames are matched by their settings and by the order in which they were taken (:mod:`capture.alignment`). What that
leaves over is explained: a repeated shot is usually a retake, a shot that is missing here and found there was taken
out of order, the rest are test shots or wrong settings. Nothing is dropped without a word.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from capture.alignment import Stretch, align
from capture.plan import CALIBRATION
from capture.shutter import STOPS_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.observed import Observed, ObservedFrame
    from capture.plan import Plan
    from capture.shots import Shot
    from eldata.records import FrameRecord

_NEAR_STOPS: Final = 1.05  # a wrong setting that was meant for a shot: up to a stop off

Repeated = Literal["last", "first"]
Kind = Literal[
    "missing",
    "repeated",
    "out-of-order",
    "extra",
    "wrong-setting",
    "unusable",
    "ambiguous",
    "scene-order",
    "no-times",
    "aperture",
    "metered",
    "copies",
    "note",
]
# For information only: there is nothing to decide.
_HARMLESS: Final = ("scene-order", "no-times", "copies", "note")
Slot = tuple[str, int]


@dataclass(frozen=True, slots=True)
class MatchRemark:
    """One thing that did not go as planned: what kind, which shot or file, and how it was resolved."""

    kind: Kind
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
class _Block:
    """Shots that are taken in one go: a scene, or the bias frames or flats of one ISO."""

    scene: str
    title: str
    shots: tuple[Shot, ...]

    @property
    def settings(self) -> tuple[tuple[int, str], ...]:
        return tuple((shot.iso, shot.setting.dial) for shot in self.shots)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a block was found, and the frames among which its forgotten shots may be: up to its neighbours' own."""

    block: _Block
    stretch: Stretch
    window: range


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
    matcher = _Matcher(plan, observed.frames, repeated, by_clock=observed.order == "clock")
    remarks = [
        MatchRemark("unusable", f"{Path(file.path).name}: {file.reason}", path=Path(file.path))
        for file in observed.unusable
    ]
    if not observed.by_time:
        remarks.append(
            MatchRemark("no-times", "not every file says when it was taken; the order is that of the file names")
        )
    if observed.copies:
        (path, original), *more = observed.copies
        text = f"{path} shows the shot of {original}; not used again"
        text += f", nor are {len(more)} others alike" if more else ""
        remarks.append(MatchRemark("copies", text, path=path))
    frames, found = matcher.run()
    return Match(frames, (*remarks, *found))


def other_reading(plan: Plan, observed: Observed, found: Match, *, repeated: Repeated = "last") -> Match | None:
    """Return what the files are by their numbers, if that is another reading and no less whole than the clock's.

    Where all scenes have equal exposures, a clock that was put back between two of them exchanges them, and nothing but
    the camera's counter contradicts it. ``found`` is what :func:`match` made of the same files by the clock.
    """
    numbered = observed.numbered if observed.by_time else None
    if numbered is None or numbered.frames == observed.frames:
        return None
    other = match(plan, numbered, repeated=repeated)
    return other if len(other.frames) >= len(found.frames) and other.frames != found.frames else None


def can_be(shot: Shot, frame: ObservedFrame | FrameRecord) -> bool:
    """Return whether a frame has a shot's settings."""
    if frame.exposure_s is None:
        return False
    return frame.iso == shot.iso and shot.setting.stops_off(frame.exposure_s) <= STOPS_TOLERANCE


def no_file(title: str, shot: Shot) -> str:
    """Return the sentence that a shot of a scene has no file."""
    return f"{title} frame {shot.number} ({shot.role}, {shot.settings}): no file"


def blocks_of(plan: Plan) -> tuple[_Block, ...]:
    """Return what is taken in one go: scenes, then bias frames and flats by ISO."""
    blocks = [_Block(scene.name, scene.name, scene.shots) for scene in plan.scenes]
    groups: dict[tuple[str, int, str], list[Shot]] = defaultdict(list)
    for shot in () if plan.calibration is None else plan.calibration.shots:
        groups[shot.role, shot.iso, shot.series].append(shot)
    for (role, iso, series), shots in groups.items():
        title = f"{role} frames of ISO {iso}{f' ({series})' if series else ''}"
        blocks.append(_Block(CALIBRATION, title, tuple(shots)))
    return tuple(blocks)


class _Matcher:
    def __init__(self, plan: Plan, frames: Sequence[ObservedFrame], repeated: Repeated, *, by_clock: bool) -> None:
        self.blocks = blocks_of(plan)
        self.frames = frames
        self.repeated = repeated
        self.remarks: list[MatchRemark] = []
        self.used: dict[int, tuple[_Block, Shot]] = {}
        shots = {(shot.iso, shot.setting.dial): shot for block in self.blocks for shot in block.shots}
        self.fitting = {
            settings: {index for index, frame in enumerate(frames) if can_be(shot, frame)}
            for settings, shot in shots.items()
        }
        start = frames[0].taken if frames and by_clock else None
        self.times_s = [
            (frame.taken - start).total_seconds() if start is not None and frame.taken is not None else 0.0
            for frame in frames
        ]

    def can_be(self, shot: Shot, index: int) -> bool:
        return index in self.fitting[shot.iso, shot.setting.dial]

    def run(self) -> tuple[dict[Slot, ObservedFrame], list[MatchRemark]]:
        places = self.places()
        for place in places:
            for shot, index in zip(place.block.shots, place.stretch.frames, strict=True):
                if index is not None:
                    self.used[index] = (place.block, shot)
        self.settle_repeats()
        self.fill_gaps(places)
        self.name_missing(places)
        self.name_extra(places)
        frames = {(block.scene, shot.number): self.frames[index] for index, (block, shot) in self.used.items()}
        return frames, self.remarks

    # --- which stretch is which block ---------------------------------------------------------------------------------

    def places(self) -> list[_Place]:
        """Return the blocks that were found, in the order of time."""
        kinds: dict[tuple[tuple[int, str], ...], list[_Block]] = defaultdict(list)
        for block in self.blocks:
            kinds[block.settings].append(block)
        alike = list(kinds.values())
        stretches = align(
            [len(blocks[0].shots) for blocks in alike],
            lambda sequence, shot, frame: self.can_be(alike[sequence][0].shots[shot], frame),
            self.times_s,
        )
        found: list[tuple[_Block, Stretch]] = []
        for sequence, blocks in enumerate(alike):
            kept = self.most_whole([one for one in stretches if one.sequence == sequence], blocks)
            found += zip(blocks, kept, strict=False)
            if 0 < len(kept) < len(blocks):
                titles = ", ".join(block.title for block in blocks)
                lost = ", ".join(block.title for block in blocks[len(kept) :])
                verb = "is" if len(blocks) - len(kept) == 1 else "are"
                self.note(
                    "ambiguous",
                    f"{titles} have equal exposures, and {len(kept)} of these {len(blocks)} were found: taken for "
                    f"the first ones, so {lost} {verb} missing. If another one is, edit the mapping",
                )
        found.sort(key=lambda pair: pair[1].first)
        self.note_order([block.title for block, _ in found])
        starts = [0, *(stretch.last + 1 for _, stretch in found)]
        stops = [*(stretch.first for _, stretch in found[1:]), len(self.frames)]
        return [_Place(*pair, range(*window)) for pair, *window in zip(found, starts, stops, strict=False)]

    def most_whole(self, places: list[Stretch], blocks: Sequence[_Block]) -> list[Stretch]:
        """Return as many stretches as there are blocks: those with the most shots; of two equal ones, the later."""
        spare = len(places) - len(blocks)
        if spare <= 0:
            return places
        ranked = sorted(places, key=lambda place: (place.matched, place.first))
        dropped, kept = ranked[:spare], ranked[spare:]
        if len(blocks) > 1:
            titles = ", ".join(block.title for block in blocks)
            names = ", ".join(f"{self.name(place.first)} to {self.name(place.last)}" for place in dropped)
            self.note(
                "ambiguous",
                f"{titles} have equal exposures, and {len(places)} such series were found for {len(blocks)}: left out "
                f"as a first attempt: {names}. If another one is, edit the mapping",
            )
        return sorted(kept, key=lambda place: place.first)

    def note_order(self, taken: Sequence[str]) -> None:
        if taken != [block.title for block in self.blocks if block.title in taken]:
            self.note("scene-order", f"taken in the order {', '.join(taken)}")

    # --- what is left over --------------------------------------------------------------------------------------------

    def settle_repeats(self) -> None:
        """Where successive frames have equal settings, take the last (or first) ones for the shots among them."""
        same_as_before = [
            index > 0 and self._settings(index) == self._settings(index - 1) for index in range(len(self.frames))
        ]
        starts = [index for index, same in enumerate(same_as_before) if not same]
        for start, stop in pairwise([*starts, len(self.frames)]):
            for run in self.by_block(range(start, stop)):
                shots = [self.used[index] for index in run if index in self.used]
                if not shots or len(shots) == len(run):
                    continue
                chosen = run[-len(shots) :] if self.repeated == "last" else run[: len(shots)]
                for index in run:
                    self.used.pop(index, None)
                for index, used in zip(chosen, shots, strict=True):
                    self.used[index] = used
                self.name_repeated([index for index in run if index not in self.used], chosen)

    def _settings(self, index: int) -> tuple[object, object]:
        return self.frames[index].iso, self.frames[index].exposure_s

    def by_block(self, run: range) -> list[list[int]]:
        """Split a run of equal settings where one scene ends and another begins: at its longest pause there.

        The reference at a scene's end and the one at the next scene's beginning may be equal, and so may be the first
        one of an abandoned attempt.
        """
        cuts = set()
        used = [index for index in run if index in self.used]
        for one, other in pairwise(used):
            if self.used[one][0] is not self.used[other][0]:
                cuts.add(max(range(one + 1, other + 1), key=self.pause))
        if used:
            block, shot = self.used[used[-1]]
            if shot is block.shots[-1]:
                cuts.update(index for index in run if index > used[-1] and self.begins(index))
            block, shot = self.used[used[0]]
            if shot is block.shots[0]:
                cuts.update(index for index in run if index <= used[0] and self.begins(index))
        borders = [run.start, *sorted(cuts - {run.start}), run.stop]
        return [list(range(first, last)) for first, last in pairwise(borders)]

    def pause(self, index: int) -> float:
        """Return the seconds before a frame."""
        return self.times_s[index] - self.times_s[index - 1] if index else 0.0

    def begins(self, index: int) -> bool:
        """Return whether a frame belongs to what follows: the pause before it is the longer one."""
        return index + 1 < len(self.frames) and self.pause(index) > 3 * self.pause(index + 1)

    def name_repeated(self, unused: Sequence[int], chosen: Sequence[int]) -> None:
        block, shot = self.used[chosen[-1]]
        for index in unused:
            taken = self.name(chosen[-1]) if len(chosen) == 1 else f"{self.name(chosen[0])} to {self.name(chosen[-1])}"
            which = "last" if self.repeated == "last" else "first"
            text = f"{block.title} frame {shot.number} was taken more than once; the {which} one is used, {taken}"
            self.note("repeated", f"{self.name(index)}: {text}", (block, shot), index)

    def indices(self, block: _Block) -> dict[int, int]:
        """Return the frame that each shot of a block has by now, by the shot's number."""
        return {shot.number: index for index, (owner, shot) in self.used.items() if owner is block}

    def unexplained(self) -> list[int]:
        """Return the frames that are neither used nor remarked on."""
        explained = {remark.path for remark in self.remarks}
        return [
            index for index, frame in enumerate(self.frames) if index not in self.used and frame.path not in explained
        ]

    def fill_gaps(self, places: Sequence[_Place]) -> None:
        """Give shots without a frame the frame with their settings that was taken elsewhere around the scene."""
        for place in places:
            at = self.indices(place.block)
            for shot in place.block.shots:
                if shot.number in at:
                    continue
                spare = [i for i in self.unexplained() if i in place.window and self.can_be(shot, i)]
                if not spare:
                    continue
                middle = max((i for number, i in at.items() if number < shot.number), default=place.stretch.first)
                chosen = min(spare, key=lambda i: abs(i - middle))
                self.used[chosen] = (place.block, shot)
                after = [number for number, i in at.items() if i < chosen]
                at[shot.number] = chosen
                where = f"after frame {max(after, key=lambda number: at[number])}" if after else "before all others"
                text = f"{self.name(chosen)}: {place.block.title} frame {shot.number}, taken out of order ({where})"
                self.note("out-of-order", text, (place.block, shot), chosen)

    def name_missing(self, places: Sequence[_Place]) -> None:
        for block in self.blocks:
            at = self.indices(block)
            for shot in block.shots:
                if not at:
                    self.note("missing", f"{block.title}: none of its {len(block.shots)} frames", (block, shot))
                elif shot.number not in at:
                    window = next(place.window for place in places if place.block is block)
                    self.name_missing_shot(block, shot, self.meant_for(shot, window, at))

    def name_missing_shot(self, block: _Block, shot: Shot, near: int | None) -> None:
        text = no_file(block.title, shot)
        if near is not None:
            frame = self.frames[near]
            text += f"; {frame.path.name} may be meant, but was taken at {frame.settings}"
            wanted = f"{block.title} frame {shot.number} asks for {shot.settings}"
            wrong = f"{frame.path.name}: {frame.settings}, where {wanted}; not used"
            self.note("wrong-setting", wrong, (block, shot), near)
        self.note("missing", text, (block, shot))

    def meant_for(self, shot: Shot, window: range, at: dict[int, int]) -> int | None:
        """Return the left-over frame that is where a missing shot should be, with the ISO or time slightly off."""
        low = max((i for number, i in at.items() if number < shot.number), default=window.start - 1)
        high = min((i for number, i in at.items() if number > shot.number), default=window.stop)
        for index in self.unexplained():
            frame = self.frames[index]
            off = shot.setting.stops_off(frame.exposure_s)
            if low < index < high and off <= (_NEAR_STOPS if frame.iso == shot.iso else STOPS_TOLERANCE):
                return index
        return None

    def name_extra(self, places: Sequence[_Place]) -> None:
        for index in self.unexplained():
            frame = self.frames[index]
            text = f"{frame.path.name}: {frame.settings}: not a shot of the plan; not used"
            kind: Kind = "extra"
            for place in places:
                same = [str(shot.number) for shot in place.block.shots if self.can_be(shot, index)]
                if same and index in place.window:
                    kind = "repeated"
                    text = (
                        f"{frame.path.name}: {frame.settings}, as {place.block.title} frame {' or '.join(same[:4])}, "
                        "for which other files in the right order are used; not used"
                    )
                    break
            self.note(kind, text, frame=index)

    def note(self, kind: Kind, text: str, of: tuple[_Block, Shot] | None = None, frame: int | None = None) -> None:
        """Remark on something, with the shot and the frame that it concerns."""
        path = None if frame is None else self.frames[frame].path
        scene, number = ("", None) if of is None else (of[0].scene, of[1].number)
        self.remarks.append(MatchRemark(kind, text, scene, number, path))

    def name(self, index: int) -> str:
        return self.frames[index].path.name
