"""What those who look at a result see of it: groups of scores with their intervals, the worst and the best."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from eldata.evaluation.scores import FrameScore
from eldata.evaluation.statistics import interval_of_scores

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.statistics import Interval
    from eldata.protocols.kinds import Kind

Grouping = Literal["camera", "iso"]


@dataclass(frozen=True, slots=True)
class Column:
    """Scores of one group at one factor; ``place`` is the group's among all."""

    place: int
    group: str
    ratio: float | None
    scores: tuple[UnitScore, ...]

    def interval(self, name: str) -> Interval:
        """Return the mean of a value with its interval over scenes."""
        return interval_of_scores(self.scores, name)


def columns_of(scores: Iterable[UnitScore], by: Grouping) -> tuple[Column, ...]:
    """Return scores by camera or ISO, and by factor; ISOs in the order of their numbers, cameras as they come."""
    ordered = sorted(scores, key=lambda score: score.iso) if by == "iso" else list(scores)
    members: dict[tuple[str, float | None], list[UnitScore]] = defaultdict(list)
    for score in ordered:
        members[_group_of(score, by), score.ratio].append(score)
    places = {name: place for place, name in enumerate(dict.fromkeys(name for name, _ in members))}
    return tuple(Column(places[name], name, ratio, tuple(of)) for (name, ratio), of in members.items())


def _group_of(score: UnitScore, by: Grouping) -> str:
    if by == "camera":
        return score.camera
    return f"ISO {score.iso:g}" if score.iso else "not known"


def factors_of(scores: Iterable[UnitScore]) -> list[float | None]:
    """Return the factors of scores, in order; ``None`` alone of clips."""
    ratios = {score.ratio for score in scores}
    return sorted(ratios, key=lambda ratio: -1.0 if ratio is None else ratio)


def finite_scores(scores: Iterable[UnitScore], kind: Kind) -> tuple[UnitScore, ...]:
    """Return the scores whose metrics are all finite."""
    return tuple(score for score in scores if all(math.isfinite(score.values[metric.name]) for metric in kind.metrics))


def worst_and_best(scores: Iterable[UnitScore], each: int) -> tuple[list[UnitScore], list[UnitScore]]:
    """Return the worst and the best by PSNR, at most one per scene of each kind, worst and best first.

    None is both: of few, the worst come first.
    """
    known = sorted((score for score in scores if not math.isnan(score.psnr_db)), key=lambda score: score.psnr_db)
    worst = _one_per_scene(known, each)
    return worst, _one_per_scene([score for score in reversed(known) if score not in worst], each)


def _one_per_scene(scores: Sequence[UnitScore], most: int) -> list[UnitScore]:
    first: dict[tuple[str, str], UnitScore] = {}
    for score in scores:
        first.setdefault(score.place, score)
    return list(first.values())[:most]


def worst_frame(score: UnitScore) -> FrameScore:
    """Return the frame of a clip with the lowest PSNR; of an image, itself."""
    only = FrameScore(score.path, score.psnr_db, score.ssim, score.rescale)
    return min(score.frames, key=lambda frame: frame.psnr_db, default=only)
