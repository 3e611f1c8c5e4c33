"""The one scoring loop: images and windows of clips under one or several protocols at once.

A unit of work is a reference with the predictions that are compared with it: those of the noisy frames of an image
scene, or of the frames of a clip's window. Each file is read once, and what protocols share is computed once.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.files import inside
from eldata.base.workers import Failed, require_files
from eldata.errors import ArgumentError, EldataError, FileError, PredictionError
from eldata.evaluation.compared_frames import ComparedFrame, Reference, ScoringJob, as_scored
from eldata.evaluation.pairs import Pair, frames_of, iso_of, place_of, ratio_of
from eldata.evaluation.scores import EvaluationProblem, FrameScore, UnitScore, mean
from eldata.evaluation.suspicions import Inspection, chosen_frames
from eldata.manifest.clips import ClipRecord
from eldata.protocols.clips import ClipProtocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.planning import ScoringPlan
    from eldata.evaluation.request import Request
    from eldata.metrics.image_score import Score
    from eldata.protocols.protocol import Protocol

Value = TypeVar("Value")


@dataclass(slots=True)
class PlanScores:
    """What the pairs of one plan scored, by path, and what kept others from being scored.

    ``unfit``: pairs that the protocol cannot score whatever is predicted, such as frames too small for its region.
    ``without_channel_whites``: noisy frames whose reference LibRaw has no white level per channel of, where the
    protocol takes it. ``equal_choices``: the values of a protocol's field, by the field, that came to the same for each
    score, the protocol's own among them; ``None`` as long as there is no score. ``inspections``: of
    frames whose predictions were looked at for mistakes.
    """

    scores: dict[str, UnitScore] = field(default_factory=dict)
    problems: list[EvaluationProblem] = field(default_factory=list)
    unfit: list[EvaluationProblem] = field(default_factory=list)
    without_channel_whites: list[str] = field(default_factory=list)
    equal_choices: dict[str, frozenset[str]] | None = None
    inspections: list[Inspection] = field(default_factory=list)

    def add(self, others: PlanScores) -> None:
        """Take in what other pairs scored."""
        self.scores |= others.scores
        self.problems += others.problems
        self.unfit += others.unfit
        self.without_channel_whites += others.without_channel_whites
        self.inspections += others.inspections
        self.equal_choices = _in_common(self.equal_choices, others.equal_choices)


def _in_common(
    first: dict[str, frozenset[str]] | None, second: dict[str, frozenset[str]] | None
) -> dict[str, frozenset[str]] | None:
    if first is None or second is None:
        return first if second is None else second
    return {name: values & second.get(name, frozenset()) for name, values in first.items()}


@dataclass(frozen=True, slots=True)
class _Member:
    """A pair, the files of its frames' predictions (``None``: the input itself), and the plans, by number.

    ``looked``: the plans under which its prediction is looked at for mistakes.
    """

    pair: Pair
    files: tuple[Path, ...] | None
    plans: tuple[int, ...]
    looked: frozenset[int]


@dataclass(frozen=True, slots=True)
class _Unit:
    """What shares a reference, so that it is decoded once."""

    reference: str
    members: tuple[_Member, ...]

    def __str__(self) -> str:
        return self.reference


def score_plans(
    request: Request, plans: Sequence[ScoringPlan], files: Sequence[dict[str, Path]] | None
) -> list[PlanScores]:
    """Score the pairs of each plan.

    Parameters
    ----------
    request
        The dataset's folder, and who works.
    plans
        Protocols and their pairs.
    files
        For each plan, the file of each prediction by its place; pairs without all of theirs are left out. ``None``: the
        noisy inputs themselves are scored.

    Raises
    ------
    Exception
        What a unit raised that is neither an :class:`~eldata.errors.EldataError` nor an :class:`OSError`, and so no
        problem of the data; a note names the unit.
    """
    units = _units(plans, files)
    protocols = tuple(plan.protocol for plan in plans)
    workers = request.workers
    job = ScoringJob(Path.cwd(), request.folder.absolute(), protocols, workers.threads_within, request.lpips)
    work = partial(_score_unit, job)
    found = [PlanScores() for _ in plans]
    for outcome in workers.attempt(work, units, label="scoring", unit="reference"):
        if isinstance(outcome, Failed) and not isinstance(outcome.error, (EldataError, OSError)):
            outcome.error.add_note(f"while the predictions for the reference {outcome.unit} were scored")
            raise outcome.error
        for plan, scores in _unusable(outcome.unit, outcome.reason) if isinstance(outcome, Failed) else outcome:
            found[plan].add(scores)
    return found


def _units(plans: Sequence[ScoringPlan], files: Sequence[dict[str, Path]] | None) -> list[_Unit]:
    pairs: dict[str, Pair] = {}
    scoring: dict[str, list[int]] = defaultdict(list)
    looked = [frozenset() if files is None else _looked_at(plan.pairs) for plan in plans]
    for number, plan in enumerate(plans):
        for pair in plan.pairs:
            if files is None or all(place_of(pair, frame) in files[number] for frame in frames_of(pair)):
                pairs[pair.path] = pair
                scoring[pair.path].append(number)
    members: dict[str, list[_Member]] = defaultdict(list)
    for path, pair in pairs.items():
        of = None if files is None else files[scoring[path][0]]
        found = None if of is None else tuple(of[place_of(pair, frame)] for frame in frames_of(pair))
        chosen = frozenset(number for number in scoring[path] if path in looked[number])
        members[pair.reference or ""].append(_Member(pair, found, tuple(scoring[path]), chosen))
    return [_Unit(reference, tuple(sharing)) for reference, sharing in members.items()]


def _looked_at(pairs: Sequence[Pair]) -> frozenset[str]:
    """Return the paths of the pairs whose predictions are looked at for mistakes."""
    return chosen_frames((pair.path, pair.camera, ratio_of(pair), iso_of(pair)) for pair in pairs)


def _unusable(unit: _Unit, reason: str) -> list[tuple[int, PlanScores]]:
    """Return for each plan the problem of each pair of a unit that was lost as a whole."""
    return [(plan, _without_reference(member.pair, reason)) for member in unit.members for plan in member.plans]


def _without_reference(pair: Pair, reason: str) -> PlanScores:
    problem = EvaluationProblem(pair.path, f"its reference {pair.reference} cannot be used: {reason}")
    return PlanScores(problems=[problem])


# --- in a worker ------------------------------------------------------------------------------------------------------


def _score_unit(job: ScoringJob, unit: _Unit) -> list[tuple[int, PlanScores]]:
    """Return what each pair of a unit scored under each of its plans."""
    path = inside(job.folder, unit.reference)
    files = [file for member in unit.members for file in member.files or ()]
    require_files(path, *(job.start / file for file in files))
    reference = Reference(path)
    found: list[tuple[int, PlanScores]] = []
    for member in unit.members:
        scorers = [_scorer(job, member, plan) for plan in member.plans]
        for index, frame in enumerate(frames_of(member.pair)):
            file = None if member.files is None else member.files[index]
            shared = ComparedFrame(job, reference, member.pair, frame, file)
            for scorer in scorers:
                scorer.take(shared)
        found += [(plan, scorer.finished()) for plan, scorer in zip(member.plans, scorers, strict=True)]
    return found


# --- what differs between images and clips ------------------------------------------------------------------------


def _scorer(job: ScoringJob, member: _Member, plan: int) -> _Scorer:
    pair, protocol, frames = member.pair, job.protocols[plan], frames_of(member.pair)
    looked = frames[len(frames) // 2] if plan in member.looked else None
    if isinstance(pair, ClipRecord) and isinstance(protocol, ClipProtocol):
        return _ClipScorer(pair, protocol, looked, job.threads)
    return _Scorer(pair, protocol, looked)


class _Scorer:
    """Scores a pair under one protocol: PSNR and SSIM of its frame; ``looked`` is looked at for mistakes."""

    def __init__(self, pair: Pair, protocol: Protocol, looked: str | None) -> None:
        self._pair, self._protocol, self._looked = pair, protocol, looked
        self._inspections: list[Inspection] = []
        self._frames: list[FrameScore] = []
        self._found = PlanScores()
        self._bare = False
        self._extras: dict[str, float] = {}
        self._equal: dict[str, frozenset[str]] | None = None

    def take(self, frame: ComparedFrame) -> None:
        """Score a frame; what is wrong with it is kept."""
        protocol = self._protocol
        try:
            target = frame.reference.target(protocol)
            self._bare = frame.reference.lacks_channel_whites(protocol)
        except (ArgumentError, FileError) as error:
            reason = error.reason if isinstance(error, FileError) else str(error)
            self._found = _without_reference(self._pair, reason)
            return
        try:
            found, prediction = frame.score(protocol, target)
            self._extras = frame.extras(protocol, target, found.rescale)
        except FileError as error:
            file = frame.file if isinstance(error, PredictionError) else error.path
            self._found.problems.append(EvaluationProblem(str(file), error.reason))
        except ArgumentError as error:
            problem = EvaluationProblem(self._pair.path, f"protocol {protocol.name} cannot score it: {error}")
            self._found = PlanScores(unfit=[problem])
        else:
            self._keep(prediction, target, found)
            self._equal = _in_common(self._equal, frame.equal_choices(protocol))
            self._frames.append(FrameScore(frame.path, found.psnr_db, found.ssim, found.rescale))
            if frame.path == self._looked:
                self._inspections.append(frame.inspected(protocol, target, found.psnr_db))

    def _keep(self, prediction: NDArray[Any], target: NDArray[Any], found: Score) -> None:
        """Keep of a frame what metrics of the whole clip need."""

    def finished(self) -> PlanScores:
        """Return the scores of the pair, or what is wrong with its frames."""
        path = self._pair.path
        if self._found.problems or self._found.unfit:
            return self._found
        return PlanScores(
            {path: self._score()},
            without_channel_whites=[path] * self._bare,
            equal_choices=self._equal,
            inspections=self._inspections,
        )

    def _score(self) -> UnitScore:
        pair = self._pair
        return UnitScore(pair.path, pair.camera, pair.scene, iso_of(pair), ratio_of(pair), self._means())

    def _means(self) -> dict[str, float]:
        names = ("psnr_db", "ssim", "rescale")
        return {name: mean([getattr(frame, name) for frame in self._frames]) for name in names} | self._extras


class _ClipScorer(_Scorer):
    """Scores a window: means over its frames, and ST-RRED, for which the grey image of each frame alone is kept."""

    def __init__(self, window: ClipRecord, protocol: ClipProtocol, looked: str | None, threads: int | None) -> None:
        super().__init__(window, protocol, looked)
        self._window, self._peak, self._threads = window, protocol.st_rred_peak, threads
        self._grey = self._still = np.empty(0)

    def _keep(self, prediction: NDArray[Any], target: NDArray[Any], found: Score) -> None:
        from eldata.metrics.st_rred import raw_to_grey

        if not self._grey.size:
            self._still = raw_to_grey(target)
            self._grey = np.empty((len(self._window.paths), *self._still.shape))
        scored = as_scored(prediction, self._protocol.rules, found.rescale, prediction.dtype)
        self._grey[len(self._frames)] = raw_to_grey(scored)

    def _score(self) -> UnitScore:
        from eldata.metrics.st_rred import st_rred

        motionless = np.broadcast_to(self._still, self._grey.shape)
        video = st_rred(self._grey, motionless, peak=self._peak, threads=self._threads)
        values = self._means() | {
            "st_rred": video.st_rred,
            "spatial_rred": video.spatial,
            "temporal_rred": video.temporal,
        }
        window = self._window
        return replace(
            super()._score(), values=values, split=window.split, start=window.start, frames=tuple(self._frames)
        )
