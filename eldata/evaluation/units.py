"""The one scoring loop: images and windows of clips under a protocol.

A unit of work is a reference with the predictions that are compared with it: those of the noisy frames of an image
scene, or of the frames of a clip's window (each of which may have its own), in one folder or in several. Each file is
read once, and what folders share is computed once; predictions are in memory one at a time, however many folders there
are.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.workers import Failed, require_files
from eldata.errors import ArgumentError, DatasetError, EldataError, FileError, PredictionError
from eldata.evaluation.diagnosis import Inspection, chosen_frames
from eldata.evaluation.frames import ComparedFrame, NoisyInput, Reference, ScoringJob, as_scored
from eldata.evaluation.scores import (
    EvaluationProblem,
    FrameScore,
    Pair,
    UnitScore,
    files_of,
    frames_of,
    iso_of,
    mean,
    place_of,
    ratio_of,
    reference_of,
)
from eldata.manifest.clips import ClipRecord
from eldata.protocols.protocol import ClipProtocol

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.originals import Originals
    from eldata.evaluation.request import Request
    from eldata.metrics.image_score import Score

Value = TypeVar("Value")


@dataclass(slots=True)
class PairScores:
    """What pairs scored, by path, and what kept others from being scored.

    ``without_channel_whites``: noisy frames whose reference LibRaw has no white level per channel of, where the
    protocol takes it. ``white_levels_dn``: of each noisy frame, the white level that its reference's file states, and
    the constant that the protocol has in its place, if any. ``equal_choices``: the values of a protocol's field, by the
    field, that came to the same for each score, the protocol's own among them; ``None`` as long as there is no score.
    ``inspections``: of frames whose predictions were looked at for mistakes.
    """

    scores: dict[str, UnitScore] = field(default_factory=dict)
    problems: list[EvaluationProblem] = field(default_factory=list)
    without_channel_whites: list[str] = field(default_factory=list)
    white_levels_dn: dict[str, tuple[float, float] | None] = field(default_factory=dict)
    equal_choices: dict[str, frozenset[str]] | None = None
    inspections: list[Inspection] = field(default_factory=list)

    def add(self, others: PairScores) -> None:
        """Take in what other pairs scored."""
        self.scores |= others.scores
        self.problems += others.problems
        self.without_channel_whites += others.without_channel_whites
        self.white_levels_dn |= others.white_levels_dn
        self.inspections += others.inspections
        self.equal_choices = _in_common(self.equal_choices, others.equal_choices)


def _in_common(
    first: dict[str, frozenset[str]] | None, second: dict[str, frozenset[str]] | None
) -> dict[str, frozenset[str]] | None:
    if first is None or second is None:
        return first if second is None else second
    return {name: values & second.get(name, frozenset()) for name, values in first.items()}


@dataclass(frozen=True, slots=True)
class Contender:
    """Whose predictions are scored: a folder's, or the input.

    Attributes
    ----------
    pairs
        Of which pairs, in order.
    files
        The file of each prediction by its place; pairs without all of theirs are left out. ``None``: the noisy inputs
        themselves are scored.
    """

    pairs: tuple[Pair, ...]
    files: dict[str, Path] | None

    def has(self, pair: Pair) -> bool:
        """Return whether a pair can be scored."""
        files = self.files
        return files is None or all(place_of(pair, frame) in files for frame in frames_of(pair))

    def predictions_of(self, pair: Pair) -> tuple[Path, ...] | None:
        """Return the files of a pair's predictions; ``None``: its input itself."""
        files = self.files
        return None if files is None else tuple(files[place_of(pair, frame)] for frame in frames_of(pair))


@dataclass(frozen=True, slots=True)
class _Member:
    """A pair, the number of the contender, the files of the predictions (``None``: the input itself).

    ``is_looked_at``: for mistakes.
    """

    pair: Pair
    contender: int
    files: tuple[Path, ...] | None
    is_looked_at: bool


@dataclass(frozen=True, slots=True)
class _Unit:
    """What shares a reference, so that it is decoded once."""

    reference: str
    members: tuple[_Member, ...]
    originals: Originals

    def __str__(self) -> str:
        return self.reference

    def by_contender(self) -> list[_Unit]:
        """Return a unit for each contender."""
        numbers = dict.fromkeys(member.contender for member in self.members)
        return [replace(self, members=tuple(m for m in self.members if m.contender == number)) for number in numbers]


def score_contenders(
    request: Request, originals: Originals, pairs: Sequence[Pair], contenders: Sequence[Contender]
) -> list[PairScores]:
    """Score the pairs of each contender, which find what they would find alone.

    Parameters
    ----------
    request
        Who works, under which protocol, and what is wanted beyond it.
    originals
        The dataset's frames.
    pairs
        Those of all contenders, in order.
    contenders
        Whose predictions of them.

    Raises
    ------
    Exception
        What a unit raised that is neither an :class:`~eldata.errors.EldataError` nor an :class:`OSError`, and so no
        problem of the data; a note names the unit.
    """
    job = _job_of(request, originals)
    found: list[dict[str, PairScores]] = [{} for _ in contenders]
    waiting = _units(originals, contenders)
    while waiting:
        units, waiting = waiting, []
        for outcome in request.workers.attempt(partial(_score_unit, job), units, label="scoring", unit="reference"):
            if not isinstance(outcome, Failed):
                scored = outcome
            elif len(apart := outcome.unit.by_contender()) > 1:
                waiting += apart  # one folder's file may have ended the worker: it is not to cost the others' scores
                continue
            elif isinstance(outcome.error, (EldataError, OSError)):
                scored = _unusable(outcome.unit, outcome.reason)
            else:
                outcome.error.add_note(f"while the predictions for the reference {outcome.unit} were scored")
                raise outcome.error
            for number, path, scores in scored:
                found[number][path] = scores
    return [_in_order(pairs, scores) for scores in found]


def _job_of(request: Request, originals: Originals) -> ScoringJob:
    threads = request.workers.threads_within
    return ScoringJob(Path.cwd(), originals, request.protocol, threads, request.dark_shading, request.task)


def _in_order(pairs: Sequence[Pair], found: dict[str, PairScores]) -> PairScores:
    """Return what pairs found, in their order."""
    scores = PairScores()
    for pair in pairs:
        if pair.path in found:
            scores.add(found[pair.path])
    return scores


def _units(originals: Originals, contenders: Sequence[Contender]) -> list[_Unit]:
    of_pair: dict[str, list[_Member]] = defaultdict(list)
    for number, one in enumerate(contenders):
        looked: frozenset[str] = frozenset()
        if one.files is not None:
            looked = chosen_frames((pair.path, pair.camera, ratio_of(pair), iso_of(pair)) for pair in one.pairs)
        for pair in filter(one.has, one.pairs):
            of_pair[pair.path].append(_Member(pair, number, one.predictions_of(pair), pair.path in looked))
    members: dict[str, list[_Member]] = defaultdict(list)
    for of in of_pair.values():
        members[of[0].pair.reference or ""] += of
    return [
        _Unit(reference, tuple(sharing), originals.of(_frames(reference, sharing)))
        for reference, sharing in members.items()
    ]


def _frames(reference: str, members: Sequence[_Member]) -> list[str]:
    """Return the dataset's frames that a unit may ask for."""
    return list(dict.fromkeys((reference, *(frame for member in members for frame in files_of(member.pair)))))


def _unusable(unit: _Unit, reason: str) -> list[tuple[int, str, PairScores]]:
    """Return the problem of each pair of a unit that was lost as a whole."""
    return [(one.contender, one.pair.path, _without_reference(one.pair, reason)) for one in unit.members]


def _without_reference(pair: Pair, reason: str) -> PairScores:
    problem = EvaluationProblem(pair.path, f"its reference {pair.reference} cannot be used: {reason}")
    return PairScores(problems=[problem])


# --- in a worker ------------------------------------------------------------------------------------------------------


def _score_unit(job: ScoringJob, unit: _Unit) -> list[tuple[int, str, PairScores]]:
    """Return what each pair of a unit scored for each contender."""
    job = replace(job, originals=unit.originals)
    job.originals.require(unit.reference)
    require_files(*(job.start / file for member in unit.members for file in member.files or ()))
    references = {unit.reference: Reference(job.originals, unit.reference)}
    found: list[tuple[int, str, PairScores]] = []
    for path, of_pair in groupby(unit.members, key=lambda member: member.pair.path):
        noisy: dict[str, NoisyInput] = {}  # what several folders' predictions of this pair are held against
        members = list(of_pair)
        for member in members:
            scorer = _Scorer(job, member)
            for index, frame in enumerate(frames_of(member.pair)):
                reference = _reference(job, references, reference_of(member.pair, frame) or unit.reference)
                given = noisy.get(frame) or NoisyInput(job, reference, member.pair, frame)
                if len(members) > 1:
                    noisy[frame] = given
                file = None if member.files is None else member.files[index]
                scorer.take(ComparedFrame(job, reference, member.pair, given, file))
            found.append((member.contender, path, scorer.finished()))
    return found


def _reference(job: ScoringJob, known: dict[str, Reference], path: str) -> Reference:
    """Return a reference; the one that was asked for last is kept, as long as a clip's frames share it."""
    if path not in known:
        known.clear()
        known[path] = Reference(job.originals, path)
    return known[path]


def compared_images(
    request: Request, originals: Originals, contender: Contender
) -> Iterator[tuple[NDArray[Any], NDArray[Any], Pair]]:
    """Yield prediction and reference that the score of each pair is of, of a window of a clip the frames of both."""
    job = _job_of(request, originals)
    references: dict[str, Reference] = {}
    for pair in filter(contender.has, contender.pairs):
        files = contender.predictions_of(pair)
        images = []
        for index, frame in enumerate(frames_of(pair)):
            reference = _reference(job, references, reference_of(pair, frame) or "")
            noisy = NoisyInput(job, reference, pair, frame)
            compared = ComparedFrame(job, reference, pair, noisy, None if files is None else files[index])
            images.append(compared.scored_images(job.protocol))
        first, second = zip(*images, strict=True)
        is_clip = isinstance(pair, ClipRecord)
        yield np.stack(first) if is_clip else first[0], np.stack(second) if is_clip else second[0], pair


# --- one pair -------------------------------------------------------------------------------------------------------


class _Scorer:
    """Scores a pair: means over its frames, and of a window of a clip ST-RRED.

    For that the grey image of each frame alone is kept.
    """

    def __init__(self, job: ScoringJob, member: _Member) -> None:
        frames = frames_of(member.pair)
        self._pair, self._protocol, self._job = member.pair, job.protocol, job
        self._looked = frames[len(frames) // 2] if member.is_looked_at else None  # at, for mistakes
        self._found = PairScores()
        self._frames: list[FrameScore] = []
        self._values: list[dict[str, float]] = []  # of each frame
        self._of_task: list[float] = []
        self._grey = self._seen = np.empty(0)

    def take(self, frame: ComparedFrame) -> None:
        """Score a frame; what is wrong with it is kept."""
        protocol, task, kept, path = self._protocol, self._job.task, self._found, self._pair.path
        try:
            target = frame.target(protocol)
            kept.without_channel_whites = [path] * frame.reference.lacks_channel_whites(protocol)
            kept.white_levels_dn[path] = frame.reference.white_levels_dn(protocol)
        except (ArgumentError, DatasetError, FileError) as error:
            reason = error.reason if isinstance(error, FileError) else str(error)
            self._found = _without_reference(self._pair, reason)
            return
        try:
            found = frame.score(protocol, target)
            others = frame.other_values(protocol, target, found.rescale)
            if task is not None:
                shown = frame.shown(protocol, target, found.rescale, task.images)
                self._of_task.append(task.score(shown, frame.path))
        except FileError as error:
            file = frame.file if isinstance(error, PredictionError) else error.path
            kept.problems.append(EvaluationProblem(str(file), error.reason))
        except ArgumentError as error:
            problem = EvaluationProblem(path, f"protocol {protocol.name} cannot score it: {error}")
            self._found = PairScores(problems=[problem])
        else:
            if isinstance(self._pair, ClipRecord):
                self._keep_grey(self._pair, frame, target, found)
            kept.equal_choices = _in_common(kept.equal_choices, frame.equal_choices(protocol))
            self._values.append(asdict(found) | others)
            self._frames.append(FrameScore(frame.path, found.psnr_db, found.ssim, found.rescale))
            if frame.path == self._looked:
                kept.inspections.append(frame.inspected(protocol, target, found.psnr_db))

    def _keep_grey(self, window: ClipRecord, frame: ComparedFrame, target: NDArray[Any], found: Score) -> None:
        from eldata.metrics.st_rred import raw_to_grey

        place, crop = len(self._frames), self._protocol.crop(target.shape)
        if not place:
            self._grey = np.empty((len(window.paths), *target[crop].shape[1:]))
            self._seen = np.empty((len(window.references) or 1, *target[crop].shape[1:]))
        if place < len(self._seen):
            self._seen[place] = raw_to_grey(target[crop])
        prediction = frame.prediction(self._protocol)[crop]
        scored = as_scored(prediction, self._protocol.rules, found.rescale, prediction.dtype)
        self._grey[place] = raw_to_grey(scored)

    def finished(self) -> PairScores:
        """Return the scores of the pair, or what is wrong with its frames."""
        found = self._found
        if found.problems:
            return PairScores(problems=found.problems)
        found.scores[self._pair.path] = self._score()
        return found

    def _score(self) -> UnitScore:
        pair, protocol = self._pair, self._protocol
        values = {name: mean([of[name] for of in self._values]) for name in self._values[0]}
        if self._job.task is not None:
            values["task"] = mean(self._of_task)
        score = UnitScore(pair.path, pair.camera, pair.scene, iso_of(pair), ratio_of(pair), values)
        if not (isinstance(pair, ClipRecord) and isinstance(protocol, ClipProtocol)):
            return score
        from eldata.metrics.st_rred import st_rred

        seen = np.broadcast_to(self._seen, self._grey.shape)  # of a still, for every frame
        video = st_rred(self._grey, seen, peak=protocol.st_rred_peak, threads=self._job.threads)
        values |= {"st_rred": video.st_rred, "spatial_rred": video.spatial, "temporal_rred": video.temporal}
        return replace(score, split=pair.split, start=pair.start, frames=tuple(self._frames))
