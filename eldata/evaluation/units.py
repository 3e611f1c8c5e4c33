"""The one scoring loop: images and windows of clips under one or several protocols at once.

A unit of work is a reference with the predictions that are compared with it: those of the noisy frames of an image
scene, or of the frames of a clip's window. Each file is read once, and what protocols share is computed once.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args

import numpy as np

from eldata.base.files import inside
from eldata.base.png import rgb_frame
from eldata.base.workers import Failed, require_files
from eldata.errors import ArgumentError, EldataError, FileError, PredictionError, RawFileError
from eldata.evaluation.diagnosis import mistake_in
from eldata.evaluation.inspected_frame import Circumstances
from eldata.evaluation.pairs import Pair, frames_of, iso_of, place_of, ratio_of
from eldata.evaluation.predictions import load_colours, load_dng, load_prediction
from eldata.evaluation.references import levels_dn, normalised_frame, rendered_reference
from eldata.evaluation.scores import EvaluationProblem, FrameScore, UnitScore, mean
from eldata.evaluation.suspicions import Inspection, chosen_frames, sketch
from eldata.manifest.clips import ClipRecord
from eldata.protocols.clips import ClipProtocol
from eldata.protocols.protocol import Amplification, Levels

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.planning import ScoringPlan
    from eldata.evaluation.request import Request
    from eldata.metrics.image_score import Score, ScoringRules
    from eldata.metrics.lpips import LpipsWeights
    from eldata.protocols.protocol import Protocol
    from eldata.records import RawFrame, Sensor

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
    job = _Job(Path.cwd(), request.folder.absolute(), protocols, workers.threads_within, request.lpips)
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

    def key(self, protocol: Protocol) -> Hashable:
        """Return what decides :meth:`target`: of levels the numbers, since two choices may come to the same."""
        if protocol.pixels != "packed":
            return protocol.pixels
        return levels_dn(self.frame, protocol.levels), protocol.reference_clip

    def target(self, protocol: Protocol) -> NDArray[Any]:
        """Return what predictions are compared with, (C, h, w) of the whole frame."""
        return self._shared.get(self.key(protocol), lambda: self._target(protocol))

    def _target(self, protocol: Protocol) -> NDArray[Any]:
        if protocol.pixels == "srgb":
            return rendered_reference(self._path)
        if protocol.pixels == "rgb":
            return rgb_frame(self._path)
        return normalised_frame(self.frame, protocol.levels, clip=protocol.reference_clip)


@dataclass(frozen=True, slots=True)
class _Job:
    """What all units share: where predictions' paths begin, the dataset's folder, protocols, threads of a unit.

    ``lpips``: the folder of its weights, if LPIPS is wanted.
    """

    start: Path
    folder: Path
    protocols: tuple[Protocol, ...]
    threads: int | None
    lpips: Path | None = None


def _score_unit(job: _Job, unit: _Unit) -> list[tuple[int, PlanScores]]:
    """Return what each pair of a unit scored under each of its plans."""
    path = inside(job.folder, unit.reference)
    files = [file for member in unit.members for file in member.files or ()]
    require_files(path, *(job.start / file for file in files))
    reference = _Reference(path)
    found: list[tuple[int, PlanScores]] = []
    for member in unit.members:
        scorers = [_scorer(job, member, plan) for plan in member.plans]
        for index, frame in enumerate(frames_of(member.pair)):
            file = None if member.files is None else member.files[index]
            shared = _Frame(job, reference, member.pair, frame, file)
            for scorer in scorers:
                scorer.take(shared)
        found += [(plan, scorer.finished()) for plan, scorer in zip(member.plans, scorers, strict=True)]
    return found


class _Frame:
    """A noisy frame and its prediction, of which protocols share what they have in common.

    ``changed`` stands for what is in the prediction's file.
    """

    def __init__(
        self,
        job: _Job,
        reference: _Reference,
        pair: Pair,
        path: str,
        file: Path | None,
        changed: NDArray[Any] | None = None,
    ) -> None:
        self.reference, self.path, self.file = reference, path, file
        self._job, self._pair, self._shared, self._changed = job, pair, _Shared(), changed

    def prediction(self, protocol: Protocol) -> tuple[Hashable, NDArray[Any]]:
        """Return the prediction of the whole frame, and what decides it."""
        key: Hashable
        if self._changed is not None:
            return "changed", self._changed
        if self.file is None:
            return self.input(protocol)
        file, levels = self._job.start / self.file, protocol.levels
        if protocol.pixels == "packed" and self._is_dng:
            key = "dng", levels_dn(self._dng, levels)
            return key, self._shared.get(key, lambda: normalised_frame(self._dng, levels, clip="none"))
        if protocol.pixels == "packed":
            return "raw", self._shared.get("raw", lambda: load_prediction(file, self.reference.frame.sensor, levels))
        pixels, (channels, height, width) = protocol.pixels, self.reference.target(protocol).shape
        return pixels, self._shared.get(pixels, lambda: load_colours(file, (channels, height, width), pixels))

    def input(self, protocol: Protocol) -> tuple[Hashable, NDArray[Any]]:
        """Return the amplified noisy input as a protocol has it, and what decides it."""
        if protocol.pixels == "rgb":  # amplified by its authors
            return "input", self._shared.get("input", lambda: rgb_frame(inside(self._job.folder, self.path)))
        ratio = self._ratio(protocol.amplification)
        key = ("input", levels_dn(self._noisy, protocol.levels), protocol.input_clip, ratio)
        return key, self._shared.get(
            key, lambda: normalised_frame(self._noisy, protocol.levels, clip=protocol.input_clip, gain=ratio)
        )

    @property
    def _is_dng(self) -> bool:
        return self.file is not None and self.file.suffix.lower() == ".dng"

    @property
    def _dng(self) -> RawFrame:
        """The prediction, a DNG."""
        file = self._job.start / cast("Path", self.file)
        return self._shared.get("frame", lambda: load_dng(file, self.reference.frame.sensor))

    @property
    def _noisy(self) -> RawFrame:
        """The noisy frame, which has to be like its reference."""
        return self._shared.get("noisy", self._read_noisy)

    def _read_noisy(self) -> RawFrame:
        from eldata.raw.reading import read_raw

        path = inside(self._job.folder, self.path)
        noisy, clean = read_raw(path), self.reference.frame
        if noisy.mosaic.shape != clean.mosaic.shape or noisy.sensor.cfa != clean.sensor.cfa:
            raise RawFileError(
                path,
                f"expected {clean.mosaic.shape} pixels with CFA {clean.sensor.cfa} like its reference, found "
                f"{noisy.mosaic.shape} with {noisy.sensor.cfa}",
            )
        return noisy

    def _ratio(self, amplification: Amplification) -> float:
        """Return what the input is multiplied by; windows of clips have no ratio but the files'."""
        from eldata.raw.reading import exposure_ratio

        nominal = None if amplification == "metadata" else ratio_of(self._pair)
        return float(exposure_ratio(self.reference.frame, self._noisy)) if nominal is None else nominal

    def equal_choices(self, protocol: Protocol) -> dict[str, frozenset[str]]:
        """Return the values of a protocol's fields that would have given the same score, by the field."""
        if protocol.pixels != "packed":
            return {}
        frames = [self.reference.frame, *([self._dng] if self._is_dng else [])]
        if self.file is not None:
            return {"levels": _equal_levels(protocol, frames)}
        return {
            "levels": _equal_levels(protocol, [*frames, self._noisy]),
            "amplification": self._equal_ratios(protocol),
        }

    def _equal_ratios(self, protocol: Protocol) -> frozenset[str]:
        taken = self._ratio(protocol.amplification)

        def is_equal(amplification: Amplification) -> bool:
            try:
                return self._ratio(amplification) == taken
            except RawFileError:  # a file that states no exposure
                return False

        return frozenset(filter(is_equal, get_args(Amplification)))

    def inspected(self, protocol: Protocol, target: NDArray[Any], psnr_db: float) -> Inspection:
        """Return what the prediction shows of mistakes."""
        source, prediction = self.prediction(protocol)
        regions = protocol.region, protocol.factor_region
        key = ("inspected", source, self.reference.key(protocol), regions, protocol.rules, protocol.rendering)
        return self._shared.get(key, lambda: self._inspected(protocol, prediction, target, psnr_db))

    def _inspected(
        self, protocol: Protocol, prediction: NDArray[Any], target: NDArray[Any], psnr_db: float
    ) -> Inspection:
        def score(changed: NDArray[Any]) -> Score:
            other = _Frame(self._job, self.reference, self._pair, self.path, self.file, changed)
            return other.score(protocol, target)[0]

        now = Circumstances(
            protocol=protocol,
            sensor=self.reference.frame.sensor if protocol.pixels == "packed" else None,
            ratio=ratio_of(self._pair),
            score=score,
            amplified=lambda: self.input(protocol)[1],
        )
        try:
            mistake = mistake_in(prediction, target, psnr_db, now)
        except RawFileError:  # the noisy file, which scoring does not need
            mistake = None
        return Inspection(
            path=self.path,
            camera=self._pair.camera,
            ratio=now.ratio,
            psnr_db=psnr_db,
            mistake=mistake,
            prediction=sketch(prediction),
            reference=sketch(target),
        )

    def score(self, protocol: Protocol, target: NDArray[Any]) -> tuple[Score, NDArray[Any]]:
        """Return the scores, and the prediction that got them, of the region."""
        from eldata.metrics.image_score import factor_by, score_by

        rules, threads, shape = protocol.rules, self._job.threads, target.shape
        source, prediction = self.prediction(protocol)
        compared = (source, self.reference.key(protocol))
        finding = (rules.rescaling, rules.rescaling_mask, rules.prediction_clamp == "none", protocol.factor_region)

        def find() -> float:
            part = protocol.factor_crop(shape)
            return factor_by(prediction[part], target[part], rules, threads=threads)

        crop = protocol.crop(shape)
        p, g = prediction[crop], target[crop]
        factor = self._shared.get(("factor", compared, finding), find)
        if protocol.rendering == "eld-isp":
            score = partial(_score_rendered, p, g, self.reference.frame.sensor, rules, factor, threads)
        else:
            score = partial(score_by, p, g, rules, factor=factor, threads=threads)
        key = ("score", compared, protocol.region, rules, factor, protocol.rendering)
        return self._shared.get(key, score), p

    def extras(self, protocol: Protocol, target: NDArray[Any], factor: float) -> dict[str, float]:
        """Return what was asked for beyond the protocol's own scores: LPIPS of the renderings that it compares."""
        if self._job.lpips is None:
            return {}
        from eldata.metrics.image_score import as_compared
        from eldata.metrics.lpips import lpips

        crop, rules = protocol.crop(target.shape), protocol.rules
        p, g = self.prediction(protocol)[1][crop], target[crop]
        if protocol.rendering == "eld-isp":
            p, g = (codes / np.float32(255) for codes in _rendered(p, g, self.reference.frame.sensor, rules, factor))
        else:
            p, g = as_compared(p, g, rules, factor)
        return {"lpips": lpips(p, g, _lpips_weights(self._job.lpips))}


def _equal_levels(protocol: Protocol, frames: Sequence[RawFrame]) -> frozenset[str]:
    """Return the choices of levels that normalise each of these frames as the protocol's does."""
    return frozenset(
        levels
        for levels in get_args(Levels)
        if all(levels_dn(frame, levels) == levels_dn(frame, protocol.levels) for frame in frames)
    )


@lru_cache(maxsize=1)
def _lpips_weights(folder: Path) -> LpipsWeights:
    """Return the weights of LPIPS; a process loads them once."""
    from eldata.metrics.lpips import LpipsWeights

    return LpipsWeights.load(folder)


def _rendered(
    prediction: NDArray[Any], target: NDArray[Any], sensor: Sensor, rules: ScoringRules, factor: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a packed raw prediction, rescaled in raw, and its reference in sRGB, (3, h, w) of the codes of 8 bits."""
    from eldata.isp.srgb_pairs import render_pair_for_scoring

    treated = as_scored(prediction, rules, factor, np.float64)
    first, second = render_pair_for_scoring(treated, target, sensor)
    return first.astype(np.float32), second.astype(np.float32)


def _score_rendered(
    prediction: NDArray[Any],
    target: NDArray[Any],
    sensor: Sensor,
    rules: ScoringRules,
    factor: float,
    threads: int | None,
) -> Score:
    """Score a packed raw prediction in sRGB: rescaled in raw, rendered, truncated to 8 bits."""
    from eldata.metrics.image_score import score_by

    codes = _rendered(prediction, target, sensor, rules, factor)
    of_codes = replace(rules, rescaling="none", prediction_clamp="none", rounding="none", data_range=255.0)
    found = score_by(codes[0], codes[1], of_codes, threads=threads)
    return replace(found, rescale=factor)


def as_scored(prediction: NDArray[Any], rules: ScoringRules, factor: float, dtype: Any) -> NDArray[Any]:
    """Return a prediction clamped and multiplied as rules have it, (C, h, w); the arithmetic is float64."""
    low, high, _, final_low, final_high = rules.treatment(factor)
    result = np.empty(prediction.shape, dtype)
    for channel, plane in enumerate(prediction):  # the float64 intermediates are 8 bytes per pixel
        result[channel] = np.clip(np.clip(plane.astype(np.float64), low, high) * factor, final_low, final_high)
    return result


# --- what differs between images and clips ------------------------------------------------------------------------


def _scorer(job: _Job, member: _Member, plan: int) -> _Scorer:
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

    def take(self, frame: _Frame) -> None:
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


# --- for those who look at it ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class ScoredArrays:
    """One frame as it was scored: arrays (C, h, w) of the whole frame.

    Attributes
    ----------
    amplified
        The noisy input; ``None`` where predictions are renderings.
    prediction
        Rescaled and clamped.
    reference
        What it was compared with.
    sensor
        Of packed raw; ``None`` of colours.
    """

    amplified: NDArray[Any] | None
    prediction: NDArray[Any]
    reference: NDArray[Any]
    sensor: Sensor | None

    @property
    def error(self) -> NDArray[Any]:
        """The absolute error, mean over channels, (h, w)."""
        return cast("NDArray[Any]", np.abs(self.prediction - self.reference).mean(axis=0))


def scored_arrays(folder: Path, protocol: Protocol, pair: Pair, frame: FrameScore, file: Path | None) -> ScoredArrays:
    """Return what was compared, decoded once more.

    Parameters
    ----------
    folder
        The dataset's.
    protocol, pair
        What was scored, and how.
    frame
        Which frame of the pair, and the factor that it was given.
    file
        Its prediction; ``None`` if the noisy input itself was scored.

    Raises
    ------
    RawFileError, PredictionError, ManifestError
        If a file is no longer what was scored.
    """
    job = _Job(Path.cwd(), folder.absolute(), (protocol,), None)
    reference = _Reference(inside(folder, pair.reference or ""))
    shared = _Frame(job, reference, pair, frame.path, file)
    target = reference.target(protocol)
    factor = 1.0 if np.isnan(frame.rescale) else frame.rescale
    prediction = as_scored(shared.prediction(protocol)[1], protocol.rules, factor, np.float32)
    return ScoredArrays(
        amplified=None if protocol.pixels == "srgb" else shared.input(protocol)[1],
        prediction=prediction,
        reference=target,
        sensor=reference.frame.sensor if protocol.pixels == "packed" else None,
    )
