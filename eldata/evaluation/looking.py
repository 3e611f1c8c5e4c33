"""Parts of results that pages show: scores in groups, the worst and the best, images decoded as they were scored."""

from __future__ import annotations

import math
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.base.numbers import natural
from eldata.errors import ArgumentError, PredictionError
from eldata.evaluation.predictions import find_predictions
from eldata.evaluation.request import make_request, plan_scoring, require_folder
from eldata.evaluation.results import THE_INPUT, EvaluationResult
from eldata.evaluation.score import Scoring, read_input, read_prediction, read_reference, treat_prediction
from eldata.evaluation.scores import FrameScore, Pair, UnitScore, cameras_in_order, short_digest
from eldata.evaluation.statistics import FEWEST_SCENES, LEVEL, interval_of_scores, over_scenes
from eldata.isp.rendering import brightening, preview
from eldata.manifest.catalogue import FrameFiles
from eldata.protocols.protocol import NO_SHADING, ClipProtocol, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.plots.scores import Strip
    from eldata.records import Sensor

Grouping = Literal["camera", "iso"]


def strips_of(
    scores: Iterable[UnitScore], by: Grouping, name: str, *, scenes_shared: bool, mean: bool = True
) -> list[Strip]:
    """Return a value of each score to be drawn by camera or ISO, and by factor, with means and intervals if wanted.

    ISOs come in the order of their numbers, cameras as they come.
    """
    from eldata.plots.scores import Strip

    members: dict[tuple[str, float | None], list[UnitScore]] = defaultdict(list)
    for score in sorted(scores, key=lambda score: score.iso) if by == "iso" else scores:
        iso = f"ISO {score.iso:g}" if score.iso else "not known"
        members[score.camera if by == "camera" else iso, score.ratio].append(score)
    return [
        Strip(
            group,
            ratio,
            tuple(score.values[name] for score in alike),
            interval_of_scores(alike, name, scenes_shared=scenes_shared).ends if mean else None,
        )
        for (group, ratio), alike in members.items()
    ]


def scores_in_order(scores: Iterable[UnitScore], dataset: str) -> tuple[UnitScore, ...]:
    """Return scores of the set of this name by camera, as its paper lists them, scene (2 before 10) and path."""
    scores = tuple(scores)
    cameras = cameras_in_order((score.camera for score in scores), dataset)
    return tuple(sorted(scores, key=lambda s: (cameras.index(s.camera), natural(s.scene), natural(s.path))))


def worst_and_best(scores: Iterable[UnitScore], each: int) -> tuple[list[UnitScore], list[UnitScore]]:
    """Return the worst and the best by PSNR, at most one per scene of each kind, worst and best first.

    None is both: of few, the worst come first.
    """
    known = sorted((score for score in scores if not math.isnan(score.psnr_db)), key=lambda score: score.psnr_db)
    worst = _keep_first_of_scenes(known)[:each]
    return worst, _keep_first_of_scenes([score for score in reversed(known) if score not in worst])[:each]


def _keep_first_of_scenes(scores: Iterable[UnitScore]) -> list[UnitScore]:
    """Keep the first score of each scene."""
    first: dict[tuple[str, str], UnitScore] = {}
    for score in scores:
        first.setdefault(score.place, score)
    return list(first.values())


def worst_frame(score: UnitScore) -> FrameScore:
    """Return the frame of a clip with the lowest PSNR; of an image, itself."""
    only = FrameScore(score.path, score.psnr_db, score.ssim, score.rescale)
    return min(score.frames, key=lambda frame: frame.psnr_db, default=only)


# --- what was scored, decoded once more ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ScoredImage:
    """Where all that was compared of one image lies: small, for workers that decode it.

    Attributes
    ----------
    dataset, pair
        The dataset's files, and which pair, or window of a clip, it is.
    frames, files, protocols
        Of each method: the frame with the factor that it was given (of a clip the one with the first method's lowest
        PSNR), its prediction (``None``: the noisy input itself), and how it was scored.
    dark_shading
        The file of what was taken off the inputs, if anything was.
    """

    dataset: FrameFiles
    pair: Pair
    frames: tuple[FrameScore, ...]
    files: tuple[Path | None, ...]
    protocols: tuple[Protocol, ...]
    dark_shading: Path | None

    def decoded(self) -> SeenImage:
        """Return its pixels.

        Raises
        ------
        RawFileError, PredictionError, ManifestError
            If a file is no longer what was scored.
        """
        first, shown = self.protocols[0], self.frames[0].path
        reference = read_reference(self._make_scoring(first), self.pair.reference_of(shown) or "")
        predictions: list[NDArray[Any]] = []
        for frame, file, protocol in zip(self.frames, self.files, self.protocols, strict=True):
            values, _ = read_prediction(self._make_scoring(protocol), self.pair, frame.path, file, reference)
            factor = 1.0 if math.isnan(frame.rescale) else frame.rescale
            predictions.append(treat_prediction(values, protocol.rules, factor, np.float32))
        amplified: NDArray[Any] | None = None
        if first.pixels != "srgb" or first.is_of_packed:
            amplified, _ = read_input(self._make_scoring(first), self.pair, shown, reference[0])
        sensor = reference[0].sensor if first.pixels == "packed" else None
        return SeenImage(shown, amplified, tuple(predictions), reference[1], sensor)

    def _make_scoring(self, protocol: Protocol) -> Scoring:
        """Make the settings to decode images as a protocol scores them."""
        shading = None if protocol.dark_shading == NO_SHADING else self.dark_shading
        return Scoring(self.dataset, protocol, shading)


@dataclass(frozen=True, eq=False)
class SeenImage:
    """One image as each method was scored on it: arrays (C, h, w) of the whole frame.

    Attributes
    ----------
    frame
        The noisy frame's path; of a clip that with the lowest PSNR.
    amplified
        The noisy input; ``None`` where predictions are renderings.
    predictions
        Of each method, rescaled and clamped.
    reference
        What they were compared with.
    sensor
        Of packed raw; ``None`` of colours.
    """

    frame: str
    amplified: NDArray[Any] | None
    predictions: tuple[NDArray[Any], ...]
    reference: NDArray[Any]
    sensor: Sensor | None

    @cached_property
    def errors(self) -> tuple[NDArray[Any], ...]:
        """The absolute error of each method, mean over channels, (h, w)."""
        return tuple(np.abs(prediction - self.reference).mean(axis=0) for prediction in self.predictions)

    @cached_property
    def brighter(self) -> float:
        """The factor that makes pictures of input, predictions and reference bright enough to see; 1 of renderings."""
        return 1.0 if self.amplified is None else brightening(self.reference)

    def rendered(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Return (C, h, w) as (h, w, 3) of 8 bits, brighter: packed raw as a quick rendering, colours as they are."""
        values = values * self.brighter
        if self.sensor is not None:
            return preview(values, self.sensor)
        return np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8).transpose(1, 2, 0)


def place_of_difference(errors: Sequence[NDArray[Any]], size: tuple[int, int]) -> tuple[slice, slice]:
    """Find the window in which methods differ most: their mean squared errors lie farthest apart.

    Parameters
    ----------
    errors
        Of each method, (h, w).
    size
        Rows and columns of the window; it is no larger than the image. Windows are tried at steps of a quarter of it.
    """
    from scipy.ndimage import uniform_filter

    windows = [min(length, most) for length, most in zip(errors[0].shape, size, strict=True)]
    tops, lefts = (
        np.unique([*range(0, length - window, max(1, window // 4)), length - window])
        for length, window in zip(errors[0].shape, windows, strict=True)
    )
    middles = np.ix_(tops + windows[0] // 2, lefts + windows[1] // 2)  # the filter's output lies in the middle
    means = [uniform_filter(np.square(error, dtype=np.float64), windows)[middles] for error in errors]
    spread = np.ptp(np.stack(means), axis=0)
    row, column = np.unravel_index(int(np.argmax(spread)), spread.shape)
    top, left = int(tops[row]), int(lefts[column])
    return slice(top, top + windows[0]), slice(left, left + windows[1])


def worst_and_best_images(
    result: EvaluationResult, each: int, *, predictions: Path | None, **where: Any
) -> tuple[tuple[str, UnitScore, ScoredImage], ...]:
    """Choose a result's worst and best images, each labelled ``Worst`` or ``Best``, with its files to decode.

    Parameters
    ----------
    result
        Scores, units and protocol, just computed.
    each
        How many of either, at most.
    predictions, **where
        As for :func:`images_of`; the predictions' folder alone.

    Raises
    ------
    PredictionError
        If a prediction is no longer there.
    """
    worst, best = worst_and_best(result.scores, each)
    ranked = [*(("Worst", score) for score in worst), *(("Best", score) for score in best)]
    images = images_of([result], [(score,) for _, score in ranked], predictions=[predictions], **where)
    return tuple((rank, score, image) for (rank, score), image in zip(ranked, images, strict=True))


def images_of(
    results: Sequence[EvaluationResult],
    scores: Sequence[Sequence[UnitScore]],
    *,
    dataset_folder: Path | FrameFiles,
    predictions: Sequence[Path | None],
    dark_shading: Path | None = None,
    units: Mapping[str, Pair] | None = None,
) -> tuple[ScoredImage, ...]:
    """Return the files to decode for images that results, one of each method, have scores of.

    Parameters
    ----------
    results, scores
        Of each method; of each image the score by each.
    dataset_folder, predictions
        Where the raw files lie, and the predictions of each method; ``None`` of one that is the noisy input itself.
    dark_shading
        The file of what was taken off the inputs, if anything was.
    units
        The pairs, or windows, by their paths: of results that were read back (:func:`units_again`), which hold none.

    Raises
    ------
    ArgumentError
        If there are not as many folders as methods, or this version does not know a protocol as a result states it.
    PredictionError
        If a prediction is no longer there.
    """
    if len(predictions) != len(results):
        raise ArgumentError(f"expected a folder of predictions per method; found {len(predictions)} for {len(results)}")
    known = {unit.path: unit for unit in results[0].units} if units is None else units
    files_of_set = FrameFiles(dataset_folder) if isinstance(dataset_folder, Path) else dataset_folder
    protocols, dataset = tuple(map(protocol_of, results)), files_of_set.absolute()
    frames = [_choose_frames(of_image) for of_image in scores]
    pairs = [known[of_image[0].path] for of_image in scores]
    places = [pair.place(shown[0].path) for pair, shown in zip(pairs, frames, strict=True)]
    files = [None if folder is None else find_predictions(folder, places).files for folder in predictions]
    images = []
    for pair, shown, place in zip(pairs, frames, places, strict=True):
        for folder, of_method in zip(predictions, files, strict=True):
            if folder is not None and of_method is not None and place not in of_method:
                raise PredictionError(folder, f"the prediction of {shown[0].path} is gone since it was scored")
        paths = tuple(None if of_method is None else of_method[place].absolute() for of_method in files)
        images.append(ScoredImage(dataset, pair, shown, paths, protocols, dark_shading))
    return tuple(images)


def _choose_frames(scores: Sequence[UnitScore]) -> tuple[FrameScore, ...]:
    """Return the frame that is shown, with each method's factor: of a clip the first method's worst."""
    first, *others = scores
    shown = worst_frame(first)
    same = ([frame for frame in score.frames if frame.path == shown.path] for score in others)
    return shown, *(found[0] if found else worst_frame(score) for found, score in zip(same, others, strict=True))


# --- a result that was read back ------------------------------------------------------------------------------------


def protocol_of(result: EvaluationResult) -> Protocol:
    """Return the protocol of a result, of one that was read back as this version has it.

    Raises
    ------
    ArgumentError
        If this version scores differently from what the result states.
    """
    stated = result.protocol
    if isinstance(stated, Protocol):
        return stated
    kind = ClipProtocol if result.kind.is_of_clips else Protocol
    fields = {name: value for name, value in stated.fields.items() if name in kind.__dataclass_fields__}
    lists: dict[str, Any] = {name: tuple(value) for name, value in fields.items() if isinstance(value, list)}
    with suppress(TypeError):  # a field that this version has and the result has not
        protocol = kind(**fields | lists)
        if protocol.digest == stated.digest:
            return protocol
    raise ArgumentError(
        f"{result.source}: its protocol {stated.name!r} is of another version of eldata, which may have scored "
        "otherwise; score again with eldata evaluate --json, or with that version"
    )


def units_again(
    result: EvaluationResult, *, manifest: Path | None = None, root: Path | None = None
) -> tuple[FrameFiles, dict[str, Pair]]:
    """Return the dataset's folder, and the pairs of a result that was read back, by their paths.

    Parameters
    ----------
    result
        Read back.
    manifest
        The manifest's file; by default that of the dataset that the result names.
    root
        The folder above the dataset's.

    Raises
    ------
    ArgumentError
        If the manifest is not the one that the scores are of.
    ManifestError, DatasetError
        If it is malformed, or the dataset is not there.
    """
    stated = result.provenance
    cameras, ids = stated.get("cameras", "all"), stated.get("ids")
    chosen: dict[str, Any] = {
        "cameras": None if cameras == "all" else cameras,
        "subset": stated.get("subset") if ids is None else None,
        "ids": ids,
    }
    # Which pairs there are does not depend on what was taken off their inputs.
    protocol = replace(protocol_of(result), dark_shading=NO_SHADING)
    request = make_request(Path(), result.dataset, protocol, root=root, manifest=manifest, **chosen)
    digest, wanted = request.manifest.digest, stated["manifest_sha256"]
    if digest != wanted:
        raise ArgumentError(
            f"{request.manifest.path} is not the manifest that {result.source} was scored with "
            f"({short_digest(wanted)}, this is {short_digest(digest)}); give that one with --manifest"
        )
    require_folder(request)
    return request.files, {pair.path: pair for pair in plan_scoring(request).pairs}


def stated_predictions(result: EvaluationResult) -> Path | None:
    """Return the folder of predictions that a result states; ``None``: the noisy input itself."""
    stated = str(result.provenance.get("predictions", ""))
    return None if stated == THE_INPUT else Path(stated)


# --- intervals in words -------------------------------------------------------------------------------------------

INTERVAL = f"{LEVEL:.0%} interval"
"""Head of a column of intervals."""

TOO_FEW = f"no interval with fewer than {FEWEST_SCENES} scenes"


def interval_note(result: EvaluationResult) -> str:
    """Explain the intervals in a sentence or two."""
    return (
        f"Intervals: {LEVEL:.0%}, Student's t over {over_scenes(shared=result.scenes_shared)}, because "
        f"{result.kind.units} of one scene have correlated errors. There is none below {FEWEST_SCENES} scenes. "
        "They say how far the mean would move with other scenes like these, not how exact a score is."
    )
