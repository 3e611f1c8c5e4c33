"""The scoring of pairs under one or several protocols at once: each file is read once, and shared work is done once."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.files import inside
from eldata.base.workers import Failed, Workers, require_files
from eldata.errors import ArgumentError, EldataError, FileError, PredictionError, RawFileError
from eldata.evaluation.common import EvaluationProblem
from eldata.evaluation.predictions import load_prediction, load_srgb_prediction
from eldata.evaluation.references import normalised_frame, rendered_reference
from eldata.evaluation.results import ImageScore

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.planning import Plan
    from eldata.metrics.image_score import Score, ScoringRules
    from eldata.protocols.protocol import Protocol
    from eldata.records import PairRecord, RawFrame, Sensor

Value = TypeVar("Value")


@dataclass(slots=True)
class PlanScores:
    """What the pairs of one plan scored, by path, and what kept others from being scored.

    ``unfit``: pairs that the protocol cannot score whatever is predicted, such as frames too small for its region.
    ``without_channel_whites``: noisy frames whose reference LibRaw has no white level per channel of, where the
    protocol takes it.
    """

    scores: dict[str, ImageScore] = field(default_factory=dict)
    problems: list[EvaluationProblem] = field(default_factory=list)
    unfit: list[EvaluationProblem] = field(default_factory=list)
    without_channel_whites: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Member:
    """A pair, the file of its prediction (``None``: the input itself), and the plans that score it, by number."""

    pair: PairRecord
    file: Path | None
    plans: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Unit:
    """The predictions that share a reference, so that it is decoded once."""

    reference: str
    members: tuple[_Member, ...]

    def __str__(self) -> str:
        return self.reference


@dataclass(frozen=True, slots=True)
class _Outcome:
    plan: int
    value: ImageScore | EvaluationProblem
    without_channel_whites: bool = False
    unfit: bool = False


def score_plans(
    folder: Path,
    plans: Sequence[Plan],
    files: Sequence[dict[str, Path]] | None,
    *,
    workers: Workers,
) -> list[PlanScores]:
    """Score the pairs of each plan.

    Parameters
    ----------
    folder
        The dataset's.
    plans
        Protocols and their pairs.
    files
        For each plan, the file of each prediction by the noisy frame's path; pairs without one are left out. ``None``:
        the noisy inputs themselves are scored.
    workers
        As of :func:`eldata.evaluate`.
    """
    units = _units(plans, files)
    protocols = tuple(plan.protocol for plan in plans)
    work = partial(_score_unit, _Job(Path.cwd(), folder.absolute(), protocols, workers.threads_within))
    found = [PlanScores() for _ in plans]
    for outcomes in workers.attempt(work, units, label="scoring", unit="reference"):
        if isinstance(outcomes, Failed) and not isinstance(outcomes.error, (EldataError, OSError)):
            raise outcomes.error
        for outcome in _of_unit(outcomes.unit, outcomes.reason) if isinstance(outcomes, Failed) else outcomes:
            place = found[outcome.plan]
            if outcome.without_channel_whites:
                place.without_channel_whites.append(outcome.value.path)
            if isinstance(outcome.value, ImageScore):
                place.scores[outcome.value.path] = outcome.value
            else:
                (place.unfit if outcome.unfit else place.problems).append(outcome.value)
    return found


def _units(plans: Sequence[Plan], files: Sequence[dict[str, Path]] | None) -> list[_Unit]:
    pairs: dict[str, PairRecord] = {}
    scoring: dict[str, list[int]] = defaultdict(list)
    for number, plan in enumerate(plans):
        for pair in plan.pairs:
            if files is None or pair.path in files[number]:
                pairs[pair.path] = pair
                scoring[pair.path].append(number)
    members: dict[str, list[_Member]] = defaultdict(list)
    for path, pair in pairs.items():
        file = None if files is None else files[scoring[path][0]][path]
        members[pair.reference].append(_Member(pair, file, tuple(scoring[path])))
    return [_Unit(reference, tuple(found)) for reference, found in members.items()]


def _of_unit(unit: _Unit, reason: str) -> list[_Outcome]:
    """Return the problems of all pairs of a unit."""
    return [
        _Outcome(plan, EvaluationProblem(member.pair.path, f"its reference {unit.reference} cannot be used: {reason}"))
        for member in unit.members
        for plan in member.plans
    ]


# --- in a worker ------------------------------------------------------------------------------------------------------


class _Shared:
    """Values that are computed when they are first asked for; what that raises is raised each time."""

    def __init__(self) -> None:
        self._values: dict[Hashable, Any] = {}

    def get(self, key: Hashable, compute: Callable[[], Value]) -> Value:
        if key not in self._values:
            try:
                self._values[key] = compute()
            except EldataError as error:
                self._values[key] = error
        value = self._values[key]
        if isinstance(value, EldataError):
            raise value
        return value  # type: ignore[no-any-return] # of the key's kind


class _Reference:
    """A reference, decoded once, as each protocol takes it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._shared = _Shared()

    @property
    def frame(self) -> RawFrame:
        from eldata.raw.reading import read_raw

        return self._shared.get("frame", lambda: read_raw(self._path))

    def lacks_channel_whites(self, protocol: Protocol) -> bool:
        """Return whether a protocol takes the white level of each channel and LibRaw has none."""
        return protocol.levels == "metadata-per-channel" and self.frame.channel_white_levels_dn is None

    def key(self, protocol: Protocol) -> tuple[str, ...]:
        """Return what of a protocol decides :meth:`target`."""
        if protocol.rendering == "libraw":
            return ("libraw",)
        return "metadata" if self.lacks_channel_whites(protocol) else protocol.levels, protocol.reference_clip

    def target(self, protocol: Protocol) -> NDArray[Any]:
        """Return what predictions are compared with, (C, h, w) of the whole frame."""
        return self._shared.get(self.key(protocol), lambda: self._target(protocol))

    def _target(self, protocol: Protocol) -> NDArray[Any]:
        if protocol.rendering == "libraw":
            return rendered_reference(self._path)
        return normalised_frame(self.frame, protocol.levels, clip=protocol.reference_clip)


@dataclass(frozen=True, slots=True)
class _Job:
    """What all units share: where predictions' paths begin, the dataset's folder, protocols, threads of a unit."""

    start: Path
    folder: Path
    protocols: tuple[Protocol, ...]
    threads: int | None


def _score_unit(job: _Job, unit: _Unit) -> list[_Outcome]:
    path = inside(job.folder, unit.reference)
    require_files(path, *(job.start / member.file for member in unit.members if member.file is not None))
    reference = _Reference(path)
    outcomes: list[_Outcome] = []
    for member in unit.members:
        shared = _Shared()
        outcomes += [_outcome(job, reference, unit.reference, member, plan, shared) for plan in member.plans]
    return outcomes


def _outcome(
    job: _Job, reference: _Reference, reference_path: str, member: _Member, plan: int, shared: _Shared
) -> _Outcome:
    pair, protocol = member.pair, job.protocols[plan]
    try:
        target = reference.target(protocol)
    except (ArgumentError, FileError) as error:
        reason = error.reason if isinstance(error, FileError) else str(error)
        problem = EvaluationProblem(pair.path, f"its reference {reference_path} cannot be used: {reason}")
        return _Outcome(plan, problem)
    try:
        found = _score(job, reference, target, member, protocol, shared)
    except PredictionError as error:
        return _Outcome(plan, EvaluationProblem(str(member.file), error.reason))
    except RawFileError as error:
        return _Outcome(plan, EvaluationProblem(str(error.path), error.reason))
    except ArgumentError as error:
        problem = EvaluationProblem(pair.path, f"protocol {protocol.name} cannot score it: {error}")
        return _Outcome(plan, problem, unfit=True)
    scored = ImageScore(
        path=pair.path,
        camera=pair.camera,
        scene=pair.scene,
        iso=float(pair.iso or 0),
        ratio=float(pair.ratio),
        psnr_db=found.psnr_db,
        ssim=found.ssim,
        rescale=found.rescale,
    )
    return _Outcome(plan, scored, without_channel_whites=reference.lacks_channel_whites(protocol))


def _score(
    job: _Job,
    reference: _Reference,
    target: NDArray[Any],
    member: _Member,
    protocol: Protocol,
    shared: _Shared,
) -> Score:
    from eldata.metrics.image_score import factor_by, score_by

    rules, threads = protocol.rules, job.threads
    source, prediction = _prediction(job, reference, target, member, protocol, shared)
    crop = protocol.crop(target.shape)
    compared = (source, reference.key(protocol), protocol.region)
    p, g = prediction[crop], target[crop]
    factor = 1.0
    if rules.rescaling == "scalar":
        limits = rules.prediction_clamp == "none"
        key = ("factor", compared, limits, rules.rescaling_mask)
        factor = shared.get(key, lambda: factor_by(p, g, rules, threads=threads))
    if protocol.rendering == "eld-isp":
        sensor = reference.frame.sensor
        return shared.get(
            ("srgb score", compared, rules), lambda: _score_rendered(p, g, sensor, rules, factor, threads)
        )
    return shared.get(("score", compared, rules), lambda: score_by(p, g, rules, factor=factor, threads=threads))


def _score_rendered(
    prediction: NDArray[Any],
    target: NDArray[Any],
    sensor: Sensor,
    rules: ScoringRules,
    factor: float,
    threads: int | None,
) -> Score:
    """Score a packed raw prediction in sRGB: rescaled in raw, rendered, truncated to 8 bits."""
    from eldata.isp.srgb_pairs import render_pair_for_scoring
    from eldata.metrics.image_score import score_by

    low, high, _, final_low, final_high = rules.treatment(factor)
    rescaled = np.clip(np.clip(prediction.astype(np.float64), low, high) * factor, final_low, final_high)
    codes = [image.astype(np.float32) for image in render_pair_for_scoring(rescaled, target, sensor)]
    of_codes = replace(rules, rescaling="none", prediction_clamp="none", rounding="none", data_range=255.0)
    found = score_by(codes[0], codes[1], of_codes, threads=threads)
    return replace(found, rescale=factor)


def _prediction(
    job: _Job,
    reference: _Reference,
    target: NDArray[Any],
    member: _Member,
    protocol: Protocol,
    shared: _Shared,
) -> tuple[Hashable, NDArray[Any]]:
    """Return a prediction of the whole frame, and what decides it."""
    key: Hashable
    if member.file is None:
        key = ("input", protocol.levels, protocol.input_clip, protocol.amplification)
        return key, shared.get(key, lambda: _input(job.folder, reference, member.pair, protocol, shared))
    file = job.start / member.file
    if protocol.prediction_space == "srgb":
        channels, height, width = target.shape
        return "srgb", shared.get("srgb", lambda: load_srgb_prediction(file, (channels, height, width)))
    key = ("raw", protocol.levels if file.suffix.lower() == ".dng" else "")
    return key, shared.get(key, lambda: load_prediction(file, reference.frame.sensor, protocol.levels))


def _input(folder: Path, reference: _Reference, pair: PairRecord, protocol: Protocol, shared: _Shared) -> NDArray[Any]:
    """Return the amplified noisy input as a protocol has it."""
    from eldata.raw.reading import exposure_ratio, read_raw

    path = inside(folder, pair.path)
    noisy = shared.get("noisy", lambda: read_raw(path))
    clean = reference.frame
    if noisy.mosaic.shape != clean.mosaic.shape or noisy.sensor.cfa != clean.sensor.cfa:
        raise RawFileError(
            path,
            f"expected {clean.mosaic.shape} pixels with CFA {clean.sensor.cfa} like its reference, found "
            f"{noisy.mosaic.shape} with {noisy.sensor.cfa}",
        )
    ratio = exposure_ratio(clean, noisy) if protocol.amplification == "metadata" else pair.ratio
    return normalised_frame(noisy, protocol.levels, clip=protocol.input_clip, gain=float(ratio))
