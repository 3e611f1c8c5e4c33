"""What those who look at a result see of it: groups of scores with intervals, the worst and the best as scored."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from eldata.errors import ArgumentError, PredictionError
from eldata.evaluation.frames import scored_arrays
from eldata.evaluation.ordering import cameras_in_order, natural
from eldata.evaluation.originals import Originals
from eldata.evaluation.pairs import place_of
from eldata.evaluation.predictions import find_predictions
from eldata.evaluation.scores import FrameScore
from eldata.evaluation.statistics import FEWEST_SCENES, LEVEL, interval_of_scores, over_scenes
from eldata.isp.preview import preview
from eldata.protocols.protocol import Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.frames import ScoredArrays
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.statistics import Interval
    from eldata.plots.scores import Strip
    from eldata.protocols.kinds import Kind
    from eldata.records import Sensor

Grouping = Literal["camera", "iso"]


@dataclass(frozen=True, slots=True)
class Column:
    """Scores of one group at one factor."""

    group: str
    ratio: float | None
    scores: tuple[UnitScore, ...]
    scenes_shared: bool

    def interval(self, name: str) -> Interval:
        """Return the mean of a value with its interval over scenes."""
        return interval_of_scores(self.scores, name, scenes_shared=self.scenes_shared)

    def to_draw(self, name: str, *, mean: bool = True) -> Strip:
        """Return a value of each score to be drawn, with its mean and interval, unless they are not wanted."""
        from eldata.plots.scores import Strip

        values = tuple(score.values[name] for score in self.scores)
        return Strip(self.group, self.ratio, values, self.interval(name).ends if mean else None)


def columns_of(scores: Iterable[UnitScore], by: Grouping, *, scenes_shared: bool) -> tuple[Column, ...]:
    """Return scores by camera or ISO, and by factor; ISOs in the order of their numbers, cameras as they come."""
    ordered = sorted(scores, key=lambda score: score.iso) if by == "iso" else list(scores)
    members: dict[tuple[str, float | None], list[UnitScore]] = defaultdict(list)
    for score in ordered:
        members[_group_of(score, by), score.ratio].append(score)
    return tuple(Column(name, ratio, tuple(of), scenes_shared) for (name, ratio), of in members.items())


def _group_of(score: UnitScore, by: Grouping) -> str:
    if by == "camera":
        return score.camera
    return f"ISO {score.iso:g}" if score.iso else "not known"


def scores_in_order(scores: Iterable[UnitScore], dataset: str) -> tuple[UnitScore, ...]:
    """Return scores of the set of this name by camera, as its paper lists them, scene (2 before 10) and path."""
    scores = tuple(scores)
    places = {name: place for place, name in enumerate(cameras_in_order((one.camera for one in scores), dataset))}
    return tuple(sorted(scores, key=lambda one: (places[one.camera], natural(one.scene), natural(one.path))))


def scenes_of(scores: Iterable[UnitScore]) -> list[str]:
    """Return the names of scenes once each, scene 2 before scene 10."""
    return sorted({score.scene for score in scores}, key=natural)


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


# --- the worst and the best, decoded ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """One of the worst or the best.

    Attributes
    ----------
    rank
        ``Worst`` or ``Best``.
    score, frame
        Its scores; the path of the frame, of a clip that with the lowest PSNR.
    arrays
        What was compared.
    """

    rank: str
    score: UnitScore
    frame: str
    arrays: ScoredArrays

    def rendered(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Return (C, h, w) as 8-bit colours: packed raw as a quick rendering, colours as they are."""
        return rendered_colours(values, self.arrays.sensor)


def rendered_colours(values: NDArray[Any], sensor: Sensor | None) -> NDArray[np.uint8]:
    """Return (C, h, w) in [0, 1] as (h, w, 3) of 8 bits: packed raw of a sensor as a quick rendering, else as it is."""
    if sensor is not None:
        return preview(values, sensor)
    return cast("NDArray[np.uint8]", np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8).transpose(1, 2, 0))


def seen_frames(
    result: EvaluationResult,
    each: int,
    *,
    dataset_folder: Path,
    predictions: Path | None,
    dark_shading: Path | None = None,
    store: Path | None = None,
) -> tuple[SeenFrame, ...]:
    """Decode the worst and the best of a result once more, as they were scored.

    Parameters
    ----------
    result
        Scores, units and protocol, just computed.
    each
        How many of either, at most.
    dataset_folder, predictions
        Where the raw files and the predictions lie; ``None`` if the noisy input itself was scored.
    dark_shading
        The file of what was taken off the inputs, if anything was.
    store
        The store that was read in place of the dataset's files, if one was.

    Raises
    ------
    ArgumentError
        If the result was read back.
    RawFileError, PredictionError, ManifestError
        If a file is no longer what was scored.
    """
    protocol = result.protocol
    if not isinstance(protocol, Protocol):
        raise ArgumentError("pictures are of a result that was just computed; this one was read back")
    worst, best = worst_and_best(result.scores, each)
    units = {unit.path: unit for unit in result.units}
    frames = {score.path: worst_frame(score) for score in (*worst, *best)}
    places = {path: place_of(units[path], frame.path) for path, frame in frames.items()}
    files = {} if predictions is None else find_predictions(predictions, places.values()).files
    originals = Originals.opened(dataset_folder, store)
    seen = []
    for rank, score in (*(("Worst", score) for score in worst), *(("Best", score) for score in best)):
        frame, place = frames[score.path], places[score.path]
        if predictions is not None and place not in files:
            raise PredictionError(predictions, f"the prediction of {frame.path} is gone since it was scored")
        arrays = scored_arrays(originals, protocol, units[score.path], frame, files.get(place), dark_shading)
        seen.append(SeenFrame(rank, score, frame.path, arrays))
    return tuple(seen)


# --- intervals in words -------------------------------------------------------------------------------------------

INTERVAL = f"{LEVEL:.0%} interval"
"""Head of a column of intervals."""

TOO_FEW = f"no interval with fewer than {FEWEST_SCENES} scenes"


def interval_note(result: EvaluationResult) -> str:
    """Return what the intervals are, in a sentence or two."""
    return (
        f"Intervals: {LEVEL:.0%}, Student's t over {over_scenes(shared=result.scenes_shared)}, because "
        f"{result.kind.units} of one scene err together. There is none with fewer than {FEWEST_SCENES} scenes. They "
        "say how far the mean would move with other scenes like these, not how exact a score is."
    )
