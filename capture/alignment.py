"""Which stretch of the frames that were taken is which scene: alignment of sequences by dynamic programming.

The planned sequences (one per scene) and the frames in the order of time are aligned so that as little as possible is
left over: a planned shot without a frame costs something, a frame without a shot costs more. Scenes may stand in any
order, with any frames in between. The caller says which frames *can* be a shot (ISO and exposure time); the order
decides the rest. So a skipped shot, a test shot or a retake shifts nothing, as it would if frames were counted.

Every path through the frames is considered, in time proportional to (frames x planned shots of distinct sequences).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

# A scene of which a third was taken is still that scene and not a heap of test shots: (K - m) missing < m extra.
_MISSING: Final = 0.5
_EXTRA: Final = 1.0
# Where frames alone leave it open, such as the one reference between two scenes of equal exposure, a scene ends at the
# longer pause. All pauses together weigh less than one shot.
_PAUSES: Final = 0.25


@dataclass(frozen=True, slots=True)
class Stretch:
    """A sequence as found: ``sequence`` is its index, ``frames`` the frame index of each of its shots or ``None``."""

    sequence: int
    frames: tuple[int | None, ...]

    @property
    def first(self) -> int:
        """Index of its first frame."""
        return min(index for index in self.frames if index is not None)

    @property
    def last(self) -> int:
        """Index of its last frame."""
        return max(index for index in self.frames if index is not None)

    @property
    def matched(self) -> int:
        """Number of its shots that have a frame."""
        return sum(index is not None for index in self.frames)


# (sequence, shots done, frames done); sequence -1 stands between sequences, with no shots done.
_Cell: TypeAlias = tuple[int, int, int]
# How a cell was reached: the cell before, and the frame that became this shot, if one did.
_Step: TypeAlias = tuple[_Cell, int | None]
_BETWEEN: Final = -1


def align(
    sequences: Sequence[int], can_be: Callable[[int, int, int], bool], times_s: Sequence[float]
) -> tuple[Stretch, ...]:
    """Find planned sequences among frames.

    Parameters
    ----------
    sequences
        Number of shots of each distinct sequence. Each may be found any number of times.
    can_be
        ``can_be(sequence, shot, frame)``: whether a frame has the settings of a shot, all counted from 0.
    times_s
        Time of each frame in seconds, rising; their number is that of the frames.

    Returns
    -------
    tuple of Stretch
        In the order of time. Of several alignments of equal cost, that with the latest frames: the second take of a
        scene that was begun twice.
    """
    count = len(times_s)
    pauses = _weights(times_s)
    cost: dict[_Cell, float] = {(_BETWEEN, 0, 0): 0.0}
    steps: dict[_Cell, _Step] = {}

    def offer(cell: _Cell, value: float, before: _Cell, frame: int | None = None) -> None:
        # Offered in the order of preference: what comes later must be better, not equal.
        if value < cost.get(cell, math.inf) - 1e-12:
            cost[cell] = value
            steps[cell] = (before, frame)

    for done in range(1, count + 1):
        frame = done - 1
        outside, between = (_BETWEEN, 0, frame), (_BETWEEN, 0, done)
        for sequence, length in enumerate(sequences):
            for shots in range(1, length + 1):
                cell = (sequence, shots, done)
                before, same = (sequence, shots - 1, frame), (sequence, shots, frame)
                if can_be(sequence, shots - 1, frame):
                    # Going on with the sequence, or beginning it here with the shots up to this one missing.
                    if before in cost:
                        offer(cell, cost[before] + pauses[frame], before, frame)
                    offer(cell, cost[outside] + _MISSING * (shots - 1), outside, frame)
                if same in cost and shots < length:
                    offer(cell, cost[same] + _EXTRA + pauses[frame], same)
                skipped = (sequence, shots - 1, done)
                if skipped in cost:
                    offer(cell, cost[skipped] + _MISSING, skipped)
            end = (sequence, length, done)
            if end in cost:
                offer(between, cost[end], end)
        offer(between, cost[outside] + _EXTRA, outside)
    return _found(steps, count)


def _found(steps: dict[_Cell, _Step], count: int) -> tuple[Stretch, ...]:
    stretches: list[Stretch] = []
    frames: list[int | None] = []
    cell = (_BETWEEN, 0, count)
    while cell in steps:
        before, frame = steps[cell]
        sequence, shots, _ = cell
        if sequence != _BETWEEN:
            if before[0] == _BETWEEN:  # its beginning
                frames += [frame, *[None] * (shots - 1)]
                stretches.append(Stretch(sequence, tuple(reversed(frames))))
                frames = []
            elif before[1] == shots - 1:
                frames.append(frame)
        cell = before
    return tuple(reversed(stretches))


def _weights(times_s: Sequence[float]) -> list[float]:
    """Return what the pause before each frame costs inside of a sequence."""
    span = times_s[-1] - times_s[0] if times_s else 0.0
    if span <= 0:
        return [0.0] * len(times_s)
    pauses = [0.0, *(max(0.0, b - a) for a, b in pairwise(times_s))]
    return [_PAUSES * pause / span for pause in pauses]
