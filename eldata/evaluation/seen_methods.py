"""Images of a comparison decoded once more: the input, each method's prediction and the reference, as scored."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError, PredictionError
from eldata.evaluation.frames import ComparedFrame, NoisyInput, Reference, ScoringJob, as_scored
from eldata.evaluation.looking import rendered_colours, worst_frame
from eldata.evaluation.originals import Originals
from eldata.evaluation.pairs import place_of, reference_of
from eldata.evaluation.predictions import find_predictions
from eldata.evaluation.reproduction import protocol_of
from eldata.protocols.protocol import NO_SHADING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.comparison import Comparison
    from eldata.evaluation.pairs import Pair
    from eldata.evaluation.scores import FrameScore
    from eldata.records import Sensor


@dataclass(frozen=True, slots=True)
class MethodsImage:
    """Where all that was compared of one image lies: small, for workers that decode it.

    Attributes
    ----------
    folder, pair
        The dataset's folder, and which pair, or window of a clip, it is.
    frames, files, protocols
        Of each method: the frame with the factor that it was given (of a clip the one with the first method's lowest
        PSNR), its prediction (``None``: the noisy input itself), and how it was scored.
    dark_shading
        The file of what was taken off the inputs, if anything was.
    """

    folder: Path
    pair: Pair
    frames: tuple[FrameScore, ...]
    files: tuple[Path | None, ...]
    protocols: tuple[Protocol, ...]
    dark_shading: Path | None

    def decoded(self) -> SeenMethods:
        """Return its pixels.

        Raises
        ------
        RawFileError, PredictionError, ManifestError
            If a file is no longer what was scored.
        """
        originals = Originals(self.folder.absolute())
        reference = Reference(originals, reference_of(self.pair, self.frames[0].path) or "")
        first = self.protocols[0]
        predictions: list[NDArray[Any]] = []
        amplified: NDArray[Any] | None = None
        for frame, file, protocol in zip(self.frames, self.files, self.protocols, strict=True):
            shading = None if protocol.dark_shading == NO_SHADING else self.dark_shading
            job = ScoringJob(Path.cwd(), originals, (protocol,), None, dark_shading=shading)
            compared = ComparedFrame(job, reference, self.pair, NoisyInput(job, reference, self.pair, frame.path), file)
            factor = 1.0 if math.isnan(frame.rescale) else frame.rescale
            predictions.append(as_scored(compared.prediction(protocol), protocol.rules, factor, np.float32))
            if protocol is first and amplified is None and first.pixels != "srgb":
                amplified = compared.input(first)
        return SeenMethods(
            amplified=amplified,
            predictions=tuple(predictions),
            reference=reference.target(first),
            sensor=reference.frame.sensor if first.pixels == "packed" else None,
        )


@dataclass(frozen=True, eq=False)
class SeenMethods:
    """One image as each method was scored on it: arrays (C, h, w) of the whole frame, as in ``ScoredArrays``."""

    amplified: NDArray[Any] | None
    predictions: tuple[NDArray[Any], ...]
    reference: NDArray[Any]
    sensor: Sensor | None

    @cached_property
    def errors(self) -> tuple[NDArray[Any], ...]:
        """The absolute error of each method, mean over channels, (h, w)."""
        return tuple(np.abs(one - self.reference).mean(axis=0) for one in self.predictions)

    def part(self, most: tuple[int, int]) -> tuple[slice, slice]:
        """Return where methods differ most, of so many rows and columns at most (:func:`place_of_difference`)."""
        return place_of_difference(self.errors, most)

    def error_limit(self, part: tuple[slice, slice]) -> float:
        """Return the error that 99.8 % of a part's stay below, those of all methods together; above 0."""
        return max(float(np.quantile(np.stack([error[part] for error in self.errors]), 0.998)), 1e-6)

    def rendered(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Return (C, h, w) as 8-bit colours."""
        return rendered_colours(values, self.sensor)


def place_of_difference(errors: Sequence[NDArray[Any]], size: tuple[int, int]) -> tuple[slice, slice]:
    """Return where methods differ most: the window in which their mean squared errors lie farthest apart.

    Parameters
    ----------
    errors
        Of each method, (h, w).
    size
        Rows and columns of the window; it is no larger than the image. Windows are tried at steps of a quarter of it.
    """
    height, width = errors[0].shape
    rows, columns = min(size[0], height), min(size[1], width)
    tops, lefts = _starts(height, rows), _starts(width, columns)
    sums = []
    for error in errors:
        total = np.zeros((height + 1, width + 1))
        np.cumsum(np.cumsum(np.square(error, dtype=np.float64), axis=0), axis=1, out=total[1:, 1:])
        below, right = tops + rows, lefts + columns
        sums.append(
            total[np.ix_(below, right)]
            - total[np.ix_(tops, right)]
            - total[np.ix_(below, lefts)]
            + total[np.ix_(tops, lefts)]
        )
    spread = np.ptp(np.stack(sums), axis=0)
    row, column = np.unravel_index(int(np.argmax(spread)), spread.shape)
    top, left = int(tops[row]), int(lefts[column])
    return slice(top, top + rows), slice(left, left + columns)


def _starts(length: int, window: int) -> NDArray[np.int64]:
    step = max(1, window // 4)
    return np.unique(np.append(np.arange(0, length - window + 1, step), length - window))


# --- where it lies ------------------------------------------------------------------------------------------------


def images_of(
    comparison: Comparison,
    *,
    dataset_folder: Path,
    predictions: Sequence[Path | None],
    dark_shading: Path | None = None,
    units: Mapping[str, Pair] | None = None,
) -> tuple[MethodsImage, ...]:
    """Return what to decode for each common image, in the comparison's order.

    Parameters
    ----------
    comparison
        Methods and their common images.
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
    results = [method.result for method in comparison.methods]
    if len(predictions) != len(results):
        raise ArgumentError(f"expected a folder of predictions per method; found {len(predictions)} for {len(results)}")
    known = {unit.path: unit for unit in results[0].units} if units is None else units
    protocols = tuple(protocol_of(result) for result in results)
    frames = [_frames_of(scores) for scores in comparison.images]
    places = [place_of(known[scores[0].path], of[0].path) for scores, of in zip(comparison.images, frames, strict=True)]
    files = [None if folder is None else find_predictions(folder, places).files for folder in predictions]
    images = []
    for scores, of_image, place in zip(comparison.images, frames, places, strict=True):
        paths = []
        for folder, found in zip(predictions, files, strict=True):
            if folder is not None and found is not None and place not in found:
                raise PredictionError(folder, f"the prediction of {of_image[0].path} is gone since it was scored")
            paths.append(None if found is None else found[place].absolute())
        images.append(
            MethodsImage(dataset_folder, known[scores[0].path], of_image, tuple(paths), protocols, dark_shading)
        )
    return tuple(images)


def _frames_of(scores: Sequence[Any]) -> tuple[FrameScore, ...]:
    """Return the frame that is shown, with each method's factor: of a clip the first method's worst."""
    shown = worst_frame(scores[0])
    every = [shown]
    for score in scores[1:]:
        same = [frame for frame in score.frames if frame.path == shown.path]
        every.append(same[0] if same else worst_frame(score))
    return tuple(every)
