"""One frame against its reference: what files hold is read once, and what protocols share is computed once."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np

from eldata.errors import RawFileError
from eldata.evaluation.diagnosis import Inspection, mistake_in, sketch
from eldata.evaluation.diagnosis.places import Circumstances
from eldata.evaluation.pairs import Pair, ratio_of
from eldata.evaluation.predictions import load_colours, load_dng, load_prediction
from eldata.evaluation.references import levels_dn, normalised_frame
from eldata.evaluation.shared_frames import NoisyInput, Reference, ScoringJob, Shared, file_problem_of
from eldata.protocols.protocol import Levels

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.tasks import TaskImages
    from eldata.metrics.image_score import Score, ScoringRules
    from eldata.protocols.protocol import Protocol
    from eldata.records import RawFrame, Sensor


class ComparedFrame:
    """A noisy frame and its prediction, of which protocols share what they have in common.

    ``changed`` stands for what is in the prediction's file.
    """

    def __init__(
        self,
        job: ScoringJob,
        reference: Reference,
        pair: Pair,
        noisy: NoisyInput,
        file: Path | None,
        changed: NDArray[Any] | None = None,
    ) -> None:
        self.reference, self.path, self.file = reference, noisy.path, file
        self._job, self._pair, self._noisy, self._shared, self._changed = job, pair, noisy, Shared(), changed

    def prediction(self, protocol: Protocol) -> tuple[Hashable, NDArray[Any]]:
        """Return the prediction of the whole frame, and what decides it."""
        key: Hashable
        if self._changed is not None:
            return "changed", self._changed
        if self.file is None:
            return self.input(protocol)
        if protocol.pixels == "packed":
            self._check_shading()
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
        return self._noisy.amplified(protocol)

    def _check_shading(self) -> None:
        """Refuse a dark shading of another sensor than the reference's, which is the inputs'."""
        shading = self._job.shading
        if shading is not None:
            mosaic, sensor = self.reference.frame.mosaic, self.reference.frame.sensor
            with file_problem_of(self.path):
                shading.check_sensor(self.path, (mosaic.shape[0], mosaic.shape[1]), sensor.cfa, sensor.model)

    @property
    def _is_dng(self) -> bool:
        return self.file is not None and self.file.suffix.lower() == ".dng"

    @property
    def _dng(self) -> RawFrame:
        """The prediction, a DNG."""
        file = self._job.start / cast("Path", self.file)
        return self._shared.get("frame", lambda: load_dng(file, self.reference.frame.sensor))

    def equal_choices(self, protocol: Protocol) -> dict[str, frozenset[str]]:
        """Return the values of a protocol's fields that would have given the same score, by the field."""
        if protocol.pixels != "packed":
            return {}
        frames = [self.reference.frame, *([self._dng] if self._is_dng else [])]
        if self.file is not None:
            return {"levels": _equal_levels(protocol, frames)}
        return {
            "levels": _equal_levels(protocol, [*frames, self._noisy.frame]),
            "amplification": self._noisy.equal_ratios(protocol),
        }

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
            other = ComparedFrame(self._job, self.reference, self._pair, self._noisy, self.file, changed)
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
        """Return what was asked for beyond the protocol's own scores: a task of the user's own."""
        task = self._job.task
        if task is None:
            return {}
        return {"task": task.score(*self._shown(protocol, target, factor, task.images), self.path)}

    def _shown(
        self, protocol: Protocol, target: NDArray[Any], factor: float, images: TaskImages
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return prediction and reference of the region as the protocol compares them, or in sRGB or packed raw."""
        from eldata.metrics.image_score import as_compared

        crop, rules = protocol.crop(target.shape), protocol.rules
        p, g = self.prediction(protocol)[1][crop], target[crop]
        is_rendered = protocol.rendering == "eld-isp"
        if protocol.pixels == "packed" and (images == "srgb" or (images == "compared" and is_rendered)):
            first, second = _rendered(p, g, self.reference.frame.sensor, rules, factor)
            return first / np.float32(255), second / np.float32(255)
        if is_rendered:  # the rounding of its rules is that of renderings
            return as_scored(p, rules, factor, np.float32), g
        return as_compared(p, g, rules, factor)


def _equal_levels(protocol: Protocol, frames: Sequence[RawFrame]) -> frozenset[str]:
    """Return the choices of levels that normalise each of these frames as the protocol's does."""
    return frozenset(
        levels
        for levels in get_args(Levels)
        if all(levels_dn(frame, levels) == levels_dn(frame, protocol.levels) for frame in frames)
    )


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
