"""How predictions are scored, from top to bottom: pairs into units, each reference decoded once, each prediction of it.

A unit of work is a reference with the pairs, or windows of clips, that are compared with it, and their predictions in
one folder or in several. Folders share the decoded reference and nothing else; predictions are in memory one at a time.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast, get_args

import numpy as np

from eldata.base.fields import named_object
from eldata.base.files import inside
from eldata.base.workers import Failed, require_files
from eldata.errors import ArgumentError, DatasetError, EldataError, FileError, PredictionError
from eldata.evaluation.diagnosis import Inspection, choose_frames, find_mistake, sketch
from eldata.evaluation.mistakes import Circumstances
from eldata.evaluation.predictions import load_colours, load_dng, load_prediction
from eldata.evaluation.scores import EvaluationProblem, FrameScore, Pair, UnitScore, mean
from eldata.isp.libraw import render_libraw
from eldata.isp.rendering import render_pair_for_scoring, render_to_8_bits
from eldata.manifest.clips import ClipRecord
from eldata.metrics.image_score import Score, ScoringRules, as_compared, factor_by, score_by
from eldata.metrics.registry import OF_FRAMES
from eldata.metrics.similarity import treated
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.protocol import NO_SHADING, Amplification, ClipProtocol, Levels, Protocol
from eldata.raw.levels import check_in_dn, packed_black_level_dn, unpack
from eldata.sources.frames import Files, Frame
from eldata.sources.pairs import PairOpener, find_ratio

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.request import Request
    from eldata.evaluation.tasks import Shown, Task, TaskImages
    from eldata.manifest.catalogue import FrameFiles
    from eldata.records import Sensor

    Image: TypeAlias = NDArray[Any]
    Reference: TypeAlias = tuple[Frame, Image]  # a frame without its pixels, and its image (C, h, w)
    Predictions: TypeAlias = Mapping[str, Path] | None  # by place; None: the noisy inputs themselves are scored


@dataclass(frozen=True, slots=True)
class Scoring:
    """How one run scores.

    Attributes
    ----------
    files
        The dataset's, below an absolute folder.
    protocol
        One for all.
    dark_shading
        The file of what is subtracted from inputs.
    task
        One of the user's own, if one is wanted.
    threads
        Of a unit.
    start
        Where relative paths of predictions begin, in workers too.
    """

    files: FrameFiles
    protocol: Protocol
    dark_shading: Path | None = None
    task: Task | None = None
    threads: int | None = None
    start: Path = field(default_factory=Path.cwd)

    @property
    def opener(self) -> PairOpener:
        """Opens pairs as the protocol states, with its dark shading."""
        path, stated = self.dark_shading, self.protocol.dark_shading
        shading = None if path is None else dark_shading_in(path)
        digest = NO_SHADING if shading is None else shading.digest
        if digest != stated:
            raise ArgumentError(f"inputs are less the dark shading {stated}, and {path or 'no file'} is {digest}")
        return PairOpener(Files(self.files), self.protocol.levels, self.protocol.amplification, shading)


@dataclass(frozen=True, slots=True)
class ScoringUnit:
    """What shares a reference: pairs, with the files of their predictions by place, by the number of the folder."""

    reference: str
    pairs: tuple[Pair, ...]
    predictions: dict[int, Predictions]
    files: FrameFiles

    def __str__(self) -> str:
        return self.reference


@dataclass(slots=True)
class PairOutcome:
    """What became of a pair: its score, or what kept it from being scored.

    Attributes
    ----------
    lacks_channel_whites
        Whether the protocol takes the white level of each channel, and LibRaw has none of the reference's.
    white_levels_dn
        The white level that the reference's file states, and the protocol's constant, if it has one.
    equal_choices
        By the protocol's field: its values that would have given the same score.
    inspection
        Of a prediction that was looked at for mistakes.
    """

    path: str
    score: UnitScore | None = None
    problems: list[EvaluationProblem] = field(default_factory=list)
    lacks_channel_whites: bool = False
    white_levels_dn: tuple[float, float] | None = None
    equal_choices: dict[str, frozenset[str]] | None = None
    inspection: Inspection | None = None


# --- all pairs --------------------------------------------------------------------------------------------------------


def score_predictions(
    request: Request, files: FrameFiles, pairs: Sequence[Pair], predictions: Sequence[Predictions]
) -> list[list[PairOutcome]]:
    """Score the pairs of each folder that have all of their predictions there.

    Parameters
    ----------
    request
        Who works, under which protocol, and what is wanted beyond it.
    files
        The dataset's files.
    pairs
        The pairs, or windows of clips, that the protocol scores, in order.
    predictions
        Of each folder its prediction files by place; ``None``: the noisy inputs are scored.

    Returns
    -------
    list of list of PairOutcome
        Of each folder the outcomes of its pairs, in order.

    Raises
    ------
    Exception
        What a unit raised that is neither an :class:`~eldata.errors.EldataError` nor an :class:`OSError`, and so no
        problem of the data; a note names the unit.
    """
    how = _prepare_scoring(request, files)
    inspected = choose_frames((pair.path, pair.camera, pair.nominal_ratio, float(pair.iso or 0)) for pair in pairs)
    outcomes: list[dict[str, PairOutcome]] = [{} for _ in predictions]
    units = _plan_units(how.files, pairs, predictions)
    work = partial(_score_unit, replace(how, files=how.files.only(())), inspected)  # each unit brings its own files
    while units:
        again: list[ScoringUnit] = []
        for result in request.workers.attempt(work, units, label="scoring", unit="reference"):
            if not isinstance(result, Failed):
                for number, outcome in result:
                    outcomes[number][outcome.path] = outcome
                continue
            unit, error = result.unit, result.error
            if len(unit.predictions) > 1:  # one folder's file may have ended the worker: the others keep their scores
                again += [replace(unit, predictions={folder: those}) for folder, those in unit.predictions.items()]
            elif isinstance(error, (EldataError, OSError)):
                for number, by_place in unit.predictions.items():
                    for pair in unit.pairs:
                        if _is_whole(pair, by_place):
                            outcomes[number][pair.path] = _report_reference(pair, result.reason)
            else:
                error.add_note(f"while the predictions for the reference {unit} were scored")
                raise error
        units = again
    return [[by_path[pair.path] for pair in pairs if pair.path in by_path] for by_path in outcomes]


def _prepare_scoring(request: Request, files: FrameFiles) -> Scoring:
    """Make the settings that workers score by: files, protocol, dark shading, task, threads."""
    threads = request.workers.threads_within
    return Scoring(files.absolute(), request.protocol, request.dark_shading, request.task, threads)


def _plan_units(files: FrameFiles, pairs: Sequence[Pair], predictions: Sequence[Predictions]) -> list[ScoringUnit]:
    """Make a unit of work for each reference: its pairs, and each folder's predictions of them."""
    sharing: dict[str, list[Pair]] = defaultdict(list)
    for pair in pairs:
        sharing[pair.reference or ""].append(pair)
    units = []
    for reference, members in sharing.items():
        places = [pair.place(frame) for pair in members for frame in pair.frames]
        by_folder: dict[int, Predictions] = {}
        for number, by_place in enumerate(predictions):
            if any(_is_whole(pair, by_place) for pair in members):
                by_folder[number] = by_place and {place: by_place[place] for place in places if place in by_place}
        if by_folder:
            needed = files.only([path for pair in members for path in pair.files])
            units.append(ScoringUnit(reference, tuple(members), by_folder, needed))
    return units


def _is_whole(pair: Pair, predictions: Predictions) -> bool:
    """Check that each frame of a pair has a prediction."""
    return predictions is None or all(pair.place(frame) in predictions for frame in pair.frames)


def _report_reference(pair: Pair, reason: str) -> PairOutcome:
    """Make the outcome of a pair whose reference cannot be used."""
    problem = EvaluationProblem(pair.path, f"its reference {pair.reference} cannot be used: {reason}")
    return PairOutcome(pair.path, problems=[problem])


def _score_unit(how: Scoring, inspected: frozenset[str], unit: ScoringUnit) -> list[tuple[int, PairOutcome]]:
    """Return the outcome of each pair of a unit with the number of its folder; in a worker."""
    how = replace(how, files=unit.files)
    files = [file for by_place in unit.predictions.values() for file in (by_place or {}).values()]
    require_files(inside(how.files.folder, unit.reference), *(how.start / file for file in files))
    read = _keep_last(how)
    return [
        (number, _score_pair(how, pair, predictions, read, is_inspected=pair.path in inspected))
        for pair in unit.pairs
        for number, predictions in unit.predictions.items()
        if _is_whole(pair, predictions)
    ]


def _keep_last(how: Scoring) -> Callable[[str], Reference]:
    """Return a function that reads references, and keeps the last one as long as the frames share it."""
    known: dict[str, Reference] = {}

    def read_once(path: str) -> Reference:
        """Decode a reference, unless it is the last one again."""
        if path not in known:
            known.clear()
            known[path] = read_reference(how, path)
        return known[path]

    return read_once


def yield_compared(
    request: Request, files: FrameFiles, pairs: Sequence[Pair], predictions: Predictions
) -> Iterator[tuple[Image, Image, Pair]]:
    """Yield prediction and reference that the score of each pair is of, of a window of a clip the frames of both."""
    how = _prepare_scoring(request, files)
    read = _keep_last(how)
    for pair in pairs:
        if not _is_whole(pair, predictions):
            continue
        images = []
        for path in pair.frames:
            frame, target = read(pair.reference_of(path) or "")
            file = None if predictions is None else predictions[pair.place(path)]
            prediction, _ = read_prediction(how, pair, path, file, (frame, target))
            factor = _find_factor(how, prediction, target)
            images.append(_as_planes(how, frame, *treat_images(how, frame, prediction, target, factor)))
        first, second = zip(*images, strict=True)
        is_clip = isinstance(pair, ClipRecord)
        yield np.stack(first) if is_clip else first[0], np.stack(second) if is_clip else second[0], pair


# --- one pair ---------------------------------------------------------------------------------------------------------


def _score_pair(
    how: Scoring, pair: Pair, predictions: Predictions, read: Callable[[str], Reference], *, is_inspected: bool
) -> PairOutcome:
    """Score each frame of a pair against its reference, and take the means; of a window of a clip ST-RRED too."""
    outcome, protocol = PairOutcome(pair.path), how.protocol
    values: list[dict[str, float]] = []
    frames: list[FrameScore] = []
    grey: tuple[Image, Image] | None = None
    for place, path in enumerate(pair.frames):
        file = None if predictions is None else predictions[pair.place(path)]
        try:
            reference = read(pair.reference_of(path) or "")
        except (ArgumentError, DatasetError, FileError) as error:
            return _report_reference(pair, error.reason if isinstance(error, FileError) else str(error))
        try:
            prediction, source = read_prediction(how, pair, path, file, reference)
            score, others = _score_frame(how, path, prediction, reference)
        except FileError as error:
            named = file if isinstance(error, PredictionError) else error.path
            outcome.problems.append(EvaluationProblem(str(named), error.reason))
        except DatasetError as error:  # the noisy file, or the prediction in DN
            reason = str(error).removeprefix(f"{how.files.folder / path}: ").removeprefix(f"{path}: ")
            outcome.problems.append(EvaluationProblem(path, reason))
        except ArgumentError as error:
            reason = f"protocol {protocol.name} cannot score it: {error}"
            return PairOutcome(pair.path, problems=[EvaluationProblem(pair.path, reason)])
        else:
            values.append(asdict(score) | others)
            frames.append(FrameScore(path, score.psnr_db, score.ssim, score.rescale))
            _note_choices(how.protocol, pair, reference[0], source, outcome, is_input=file is None)
            if isinstance(pair, ClipRecord):
                grey = _keep_grey(how, pair, place, prediction, reference[1], score.rescale, grey)
            if is_inspected and file is not None and place == len(pair.frames) // 2:
                outcome.inspection = _inspect(how, pair, path, prediction, reference, score.psnr_db)
            del prediction
        del reference  # before the next one is decoded
    if outcome.problems:
        return PairOutcome(pair.path, problems=outcome.problems)
    means = {name: mean([frame[name] for frame in values]) for name in values[0]}
    iso = float(pair.iso or 0)
    outcome.score = UnitScore(pair.path, pair.camera, pair.scene, iso, pair.nominal_ratio, means)
    if isinstance(pair, ClipRecord) and isinstance(protocol, ClipProtocol) and grey is not None:
        means |= _score_motion(protocol, *grey, how.threads)
        outcome.score = replace(outcome.score, split=pair.split, start=pair.start, frames=tuple(frames))
    return outcome


def _score_frame(how: Scoring, path: str, prediction: Image, reference: Reference) -> tuple[Score, dict[str, float]]:
    """Return the score of a frame, and the values of other metrics and of the task by their names."""
    frame, target = reference
    score = score_image(how, frame, prediction, target)
    named = {field.name for field in fields(Score)}
    metrics = [figure for figure in OF_FRAMES.values() if figure.name not in named]
    others = {}
    if metrics:
        compared = treat_images(how, frame, prediction, target, score.rescale)
        others = {figure.name: float(named_object(figure.computed_by)(*compared)) for figure in metrics}
    if how.task is not None:
        shown = treat_images(how, frame, prediction, target, score.rescale, how.task.images)
        others["task"] = how.task.score(shown, path)
    return score, others


def _keep_grey(
    how: Scoring, window: ClipRecord, place: int, prediction: Image, target: Image, factor: float,
    kept: tuple[Image, Image] | None,
) -> tuple[Image, Image]:  # fmt: skip
    """Keep the grey images of a frame's prediction, as it was scored, and of its reference: of a still once."""
    from eldata.metrics.st_rred import raw_to_grey

    crop = how.protocol.crop(target.shape)
    if kept is None:
        size = target[crop].shape[1:]
        kept = np.empty((len(window.frames), *size)), np.empty((len(window.references) or 1, *size))
    kept[0][place] = raw_to_grey(treat_prediction(prediction[crop], how.protocol.rules, factor, prediction.dtype))
    if place < len(kept[1]):
        kept[1][place] = raw_to_grey(target[crop])
    return kept


def _score_motion(protocol: ClipProtocol, grey: Image, targets: Image, threads: int | None) -> dict[str, float]:
    """Compute ST-RRED of a clip's grey frames, (frames, h, w), and its two parts."""
    from eldata.metrics.st_rred import st_rred

    targets = np.broadcast_to(targets, grey.shape)  # a still stands for every frame
    video = st_rred(grey, targets, peak=protocol.st_rred_peak, threads=threads)
    return {"st_rred": video.st_rred, "spatial_rred": video.spatial, "temporal_rred": video.temporal}


def _note_choices(
    protocol: Protocol, pair: Pair, clean: Frame, source: Frame | None, outcome: PairOutcome, *, is_input: bool
) -> None:
    """Note which levels the reference states, and which other choices of the protocol come to the same.

    ``source`` is the noisy frame or the DNG that a prediction is, if it is one.
    """
    choices: dict[str, frozenset[str]] = {}
    if protocol.is_of_packed and clean.sensor is not None:
        is_by_channel = protocol.levels == "metadata-per-channel"
        outcome.lacks_channel_whites = is_by_channel and clean.channel_white_levels_dn is None
        if not is_by_channel and protocol.levels != "metadata":
            outcome.white_levels_dn = clean.sensor.white_level_dn, clean.white_level_dn
        frames = [clean] if source is None else [clean, source]
        beside = clean if is_input else None
        own = [frame.levels_dn(protocol.levels, beside) for frame in frames]
        choices["levels"] = frozenset(
            levels for levels in get_args(Levels) if [frame.levels_dn(levels, beside) for frame in frames] == own
        )
        if source is not None and is_input:
            choices["amplification"] = _equal_ratios(protocol.amplification, pair, clean, source)
    kept = choices if outcome.equal_choices is None else outcome.equal_choices
    outcome.equal_choices = {name: values & kept[name] for name, values in choices.items()}


def _equal_ratios(chosen: Amplification, pair: Pair, clean: Frame, noisy: Frame) -> frozenset[str]:
    """Return the ways to amplify a pair's input that come to the chosen one."""
    ratios = {}
    for amplification in get_args(Amplification):
        try:
            ratios[amplification] = find_ratio(pair, clean, noisy, amplification)
        except EldataError:  # no exposure, or no nominal ratio, is stated
            continue
    return frozenset(name for name, ratio in ratios.items() if ratio == ratios.get(chosen))


def _inspect(
    how: Scoring, pair: Pair, path: str, prediction: Image, reference: Reference, psnr_db: float
) -> Inspection:
    """Look at a prediction for mistakes."""
    frame, target = reference
    now = Circumstances(
        protocol=how.protocol,
        sensor=frame.sensor if how.protocol.pixels == "packed" else None,
        ratio=pair.nominal_ratio,
        score=lambda other: score_image(how, frame, other, target),
        amplified=lambda: read_input(how, pair, path, frame)[0],
    )
    try:
        mistake = find_mistake(prediction, target, psnr_db, now)
    except (FileError, DatasetError):  # the noisy file, which scoring does not need
        mistake = None
    return Inspection(path, pair.camera, pair.nominal_ratio, psnr_db, mistake, sketch(prediction), sketch(target))


# --- one frame: what is read, as the protocol has it ------------------------------------------------------------------


def read_reference(how: Scoring, path: str) -> Reference:
    """Decode a reference: the frame without its pixels, and what predictions are compared with, (C, h, w)."""
    protocol = how.protocol
    if protocol.pixels == "srgb" and not protocol.is_of_packed:
        codes = render_libraw(inside(how.files.folder, path)).transpose(2, 0, 1)
        image = np.ascontiguousarray(codes).astype(np.float32)
        image /= np.float32(255)
        return Frame.of_rgb(image, path).without_pixels(), image
    frame = how.opener.open_target(path)
    return frame.without_pixels(), _render_if_srgb(frame.normalise(protocol.reference_clip), frame, protocol)


def read_input(how: Scoring, pair: Pair, path: str, frame: Frame) -> tuple[Image, Frame]:
    """Decode a noisy frame by its reference's levels: amplified (C, h, w), and the frame without its pixels."""
    opened = how.opener.open_pair(pair, frame, path)
    image = opened.input.normalise(how.protocol.input_clip, opened.gain)
    return _render_if_srgb(image, opened.input, how.protocol), opened.input.without_pixels()


def _render_if_srgb(image: Image, frame: Frame, protocol: Protocol) -> Image:
    """Render a packed image by the ELD paper's pipeline, with its file's colours, where predictions are in sRGB.

    In float64, since float32 would move 256 levels by more than scores differ.
    """
    if protocol.pixels != "srgb":
        return image
    return render_to_8_bits(image, _require_sensor(frame), response=protocol.curve) / 255.0


def _require_sensor(frame: Frame) -> Sensor:
    """Return the sensor of a raw frame; refuse a frame without one."""
    if frame.sensor is None:
        raise DatasetError(f"{frame.name}: is not a raw file, which its colours are needed of")
    return frame.sensor


def read_prediction(
    how: Scoring, pair: Pair, path: str, file: Path | None, reference: Reference
) -> tuple[Image, Frame | None]:
    """Load a prediction, (C, h, w); without a file it is the noisy input itself.

    Of the input, and of a DNG, that frame is returned too, without its pixels.
    """
    protocol, (frame, target) = how.protocol, reference
    source: Frame | None = None
    if file is None:
        values, source = read_input(how, pair, path, frame)
    elif protocol.pixels != "packed":
        values = load_colours(how.start / file, cast("tuple[int, int, int]", target.shape), protocol.pixels)
    elif file.suffix.lower() == ".dng":
        source = load_dng(how.start / file, _require_sensor(frame))
        values, source = source.with_levels(protocol.levels).normalise("none"), source.without_pixels()
    else:
        values = load_prediction(how.start / file, _require_sensor(frame), protocol.levels)
    shading = how.opener.dark_shading
    if file is not None and shading is not None and frame.sensor is not None:  # the inputs' sensor is the reference's
        shading.check_sensor(path, frame.shape, frame.cfa, frame.sensor.model)
    if protocol.quantisation == "none":
        return values, source
    check_in_dn(frame.name, _require_sensor(frame), f"protocol {protocol.name!r}, which cuts down to whole DN,")
    dtype = np.float32 if protocol.quantisation == "dn-truncated-float32" else np.float64
    return cut_to_dn(values, frame, dtype), source


def cut_to_dn(packed: Image, levels: Frame | Sensor, dtype: type[np.floating[Any]]) -> NDArray[np.float32]:
    """Clip packed normalised values, (C, h, w), to [0, 1], and cut them down to whole DN of these levels.

    The arithmetic is of ``dtype``: a whole level that was divided and multiplied in float32 is whole again in float32,
    and in float64 half of them lie just below.
    """
    black = packed_black_level_dn(levels.cfa, levels.black_level_dn).astype(dtype)[:, None, None]
    span = dtype(levels.white_level_dn) - black
    dn = np.floor(np.clip(packed.astype(dtype), 0, 1) * span + black)
    return cast("NDArray[np.float32]", ((dn - black) / span).astype(np.float32))


# --- one frame: what is compared --------------------------------------------------------------------------------------


def score_image(how: Scoring, frame: Frame, prediction: Image, target: Image) -> Score:
    """Score the region of a prediction, (C, h, w), against its reference; ``frame`` is the reference's."""
    protocol, rules, crop = how.protocol, how.protocol.rules, how.protocol.crop(target.shape)
    factor = _find_factor(how, prediction, target)
    if _compares_renderings(protocol):  # the prediction was rescaled in raw, and codes are compared
        codes = _render_codes(how, frame, prediction[crop], target[crop], factor)
        of_codes = replace(rules, rescaling="none", prediction_clamp="none", rounding="none", data_range=255.0)
        return replace(score_by(*codes, of_codes, threads=how.threads), rescale=factor)
    planes = _as_planes(how, frame, prediction[crop], target[crop])
    return score_by(*planes, rules, factor=factor, threads=how.threads)


def _find_factor(how: Scoring, prediction: Image, target: Image) -> float:
    """Find the factor that brings a prediction nearest to its reference, both (C, h, w)."""
    part = how.protocol.factor_crop(target.shape)
    return factor_by(prediction[part], target[part], how.protocol.rules, threads=how.threads)


def _compares_renderings(protocol: Protocol) -> bool:
    """Check whether raw predictions are compared as renderings."""
    return protocol.rendering == "eld-isp" and protocol.pixels == "packed"


def _as_planes(how: Scoring, frame: Frame, prediction: Image, target: Image) -> tuple[Image, Image]:
    """Return the images, or where SSIM is of the mosaic these as one plane, (1, H, W)."""
    if how.protocol.ssim_planes != "mosaic":
        return prediction, target
    first, second = (unpack(np.ascontiguousarray(image), frame.cfa)[np.newaxis] for image in (prediction, target))
    return first, second


def _render_codes(
    how: Scoring, frame: Frame, prediction: Image, target: Image, factor: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Render a packed raw prediction, rescaled in raw, and its reference: sRGB codes of 8 bits, (3, h, w)."""
    treated = treat_prediction(prediction, how.protocol.rules, factor, np.float64)
    codes = render_pair_for_scoring(treated, target, _require_sensor(frame), response=how.protocol.curve)
    return codes[0].astype(np.float32), codes[1].astype(np.float32)


def treat_images(
    how: Scoring, frame: Frame, prediction: Image, target: Image, factor: float, images: TaskImages = "compared"
) -> Shown:
    """Return prediction and reference of the region as the protocol compares them, or in sRGB or packed raw."""
    protocol, crop = how.protocol, how.protocol.crop(target.shape)
    p, g = prediction[crop], target[crop]
    is_rendered = _compares_renderings(protocol)
    if protocol.pixels == "packed" and (images == "srgb" or (images == "compared" and is_rendered)):
        first, second = _render_codes(how, frame, p, g, factor)
        return first / np.float32(255), second / np.float32(255)
    if is_rendered:  # the rounding of its rules is that of renderings
        return treat_prediction(p, protocol.rules, factor, np.float32), g
    return as_compared(p, g, protocol.rules, factor)


def treat_prediction(prediction: Image, rules: ScoringRules, factor: float, dtype: Any) -> Image:
    """Return a prediction clamped and multiplied as rules have it, (C, h, w); the arithmetic is float64."""
    result = np.empty(prediction.shape, dtype)
    for channel, plane in enumerate(prediction):  # the float64 intermediates are 8 bytes per pixel
        result[channel] = treated(plane, rules.treatment(factor))
    return result
