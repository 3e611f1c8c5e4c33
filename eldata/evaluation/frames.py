"""One noisy frame against its reference: files are decoded once, and a protocol makes of them what it states.

Nothing here lists by hand what a value depends on. What is kept is what a file holds, or what a function returned, by
all of its arguments.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args

import numpy as np

from eldata.base.fields import named_object
from eldata.errors import ArgumentError, DatasetError, EldataError, RawFileError, ShadingError
from eldata.evaluation.diagnosis import Inspection, mistake_in, sketch
from eldata.evaluation.mistakes import Circumstances
from eldata.evaluation.originals import less_shading, levels_dn, normalised_frame, rendered_frame
from eldata.evaluation.predictions import load_colours, load_dng, load_prediction
from eldata.evaluation.scores import Pair, amplified_by, ratio_of
from eldata.isp.response import response_of
from eldata.metrics.registry import OF_FRAMES
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.protocol import NO_SHADING, Amplification, Levels
from eldata.raw.levels import check_in_dn, packed_black_level_dn, unpack, with_levels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.originals import Originals
    from eldata.evaluation.tasks import Shown, Task, TaskImages
    from eldata.metrics.image_score import Score, ScoringRules
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Protocol
    from eldata.records import RawFrame, Sensor

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class ScoringJob:
    """What all units share: where predictions' paths begin, the dataset's frames, the protocol, threads of a unit.

    ``dark_shading``: the file of what is taken off inputs. ``task``: one of the user's own, if one is wanted.
    """

    start: Path
    originals: Originals
    protocol: Protocol
    threads: int | None
    dark_shading: Path | None = None
    task: Task | None = None

    @property
    def shading(self) -> DarkShading | None:
        """The dark shading, which is the one that the protocol states."""
        stated, path = self.protocol.dark_shading, self.dark_shading
        if path is None and stated != NO_SHADING:
            raise ArgumentError(f"the inputs are less the dark shading {stated}; its file is needed to show them")
        found = None if path is None else dark_shading_in(path)
        if path is not None and found is not None and found.digest != stated:
            raise ShadingError(path, f"is {found.digest}, and was {stated} as the evaluation began: was it replaced?")
        return found


def read_once(read: Callable[[], Value]) -> Callable[[], Value]:
    """Return a function that reads when it is first asked, and then gives what came of that, be it an error."""
    found: list[Value] = []
    failed: list[EldataError] = []

    def ask() -> Value:
        if not (found or failed):
            try:
                found.append(read())
            except EldataError as error:
                failed.append(error)
        if failed:
            raise failed[0]
        return found[0]

    return ask


class Reference:
    """A reference, decoded once, as each protocol takes it."""

    def __init__(self, originals: Originals, path: str) -> None:
        raw = read_once(partial(originals.raw, path))
        self._raw = raw
        self._rgb, self._rendered = (read_once(partial(read, path)) for read in (originals.rgb, originals.rendered))
        # Not through self: in a circle with it, a frame lives on beside the next one until Python looks for circles.
        normalised = cache(lambda levels, clip: normalised_frame(raw(), levels, clip=clip))
        self._normalised = normalised
        self._shown = cache(lambda curve, *how: rendered_frame(normalised(*how), raw(), response_of(curve)))

    @property
    def frame(self) -> RawFrame:
        """The decoded file."""
        return self._raw()

    def lacks_channel_whites(self, protocol: Protocol) -> bool:
        """Return whether a protocol takes the white level of each channel and LibRaw has none."""
        return protocol.levels == "metadata-per-channel" and self.frame.channel_white_levels_dn is None

    def white_levels_dn(self, protocol: Protocol) -> tuple[float, float] | None:
        """Return the white level that the file states, and the constant that a protocol has in its place, if any."""
        if not protocol.is_of_packed or protocol.levels in ("metadata", "metadata-per-channel"):
            return None
        sensor = self.frame.sensor
        return sensor.white_level_dn, with_levels(sensor, protocol.frame_levels).white_level_dn

    def target(self, protocol: Protocol) -> NDArray[Any]:
        """Return what predictions are compared with, (C, h, w) of the whole frame."""
        if not protocol.is_of_packed:
            return self._rendered() if protocol.pixels == "srgb" else self._rgb()
        how = protocol.levels, protocol.reference_clip
        made = self._shown(protocol.response, *how) if protocol.pixels == "srgb" else self._normalised(*how)
        return cast("NDArray[Any]", made)


class NoisyInput:
    """A noisy frame of a pair, decoded once, whatever is scored of it, and when it is first asked for.

    It has to be like its reference.
    """

    def __init__(self, job: ScoringJob, reference: Reference, pair: Pair, path: str) -> None:
        self.path = path
        self._reference, self._pair = reference, pair
        raw = read_once(partial(_read_noisy, job.originals, reference, path))
        corrected = read_once(lambda: _less_dark_shading(job, raw(), path))
        self._raw, self._rgb = raw, read_once(partial(job.originals.rgb, path))
        self._normalised = cache(
            lambda levels, clip, gain: normalised_frame(
                corrected(), levels, clip=clip, gain=gain, reference=reference.frame.sensor
            )
        )

    def amplified(self, protocol: Protocol) -> NDArray[Any]:
        """Return the amplified noisy input as a protocol has it, rendered where predictions are in sRGB."""
        if protocol.pixels == "rgb":  # amplified by its authors
            return self._rgb()
        ratio = self._ratio(protocol.amplification)
        taken = self._normalised(protocol.levels, protocol.input_clip, ratio)
        return cast(
            "NDArray[Any]", taken if protocol.pixels != "srgb" else rendered_frame(taken, self.frame, protocol.curve)
        )

    @property
    def frame(self) -> RawFrame:
        """The decoded file."""
        return self._raw()

    def _ratio(self, amplification: Amplification) -> float:
        """Return what the input is multiplied by; windows of clips have no ratio but the files'."""
        from eldata.raw.reading import exposure_ratio

        stated = amplified_by(self._pair, amplification)
        return float(exposure_ratio(self._reference.frame, self.frame)) if stated is None else stated

    def equal_ratios(self, protocol: Protocol) -> frozenset[str]:
        """Return the choices of amplification that come to the protocol's own."""
        taken = self._ratio(protocol.amplification)

        def is_equal(amplification: Amplification) -> bool:
            try:
                return self._ratio(amplification) == taken
            except RawFileError:  # a file that states no exposure
                return False

        return frozenset(filter(is_equal, get_args(Amplification)))


def _read_noisy(originals: Originals, reference: Reference, path: str) -> RawFrame:
    noisy, clean = originals.raw(path), reference.frame
    if noisy.mosaic.shape != clean.mosaic.shape or noisy.sensor.cfa != clean.sensor.cfa:
        raise RawFileError(
            originals.place(path),
            f"expected {clean.mosaic.shape} pixels with CFA {clean.sensor.cfa} like its reference, found "
            f"{noisy.mosaic.shape} with {noisy.sensor.cfa}",
        )
    return noisy


def _less_dark_shading(job: ScoringJob, noisy: RawFrame, path: str) -> RawFrame:
    shading = job.shading
    if shading is None:
        return noisy
    with _file_problem_of(path):
        return less_shading(noisy, shading, path)


@contextmanager
def _file_problem_of(path: str) -> Iterator[None]:
    """Make what a dark shading has against a noisy file a problem of that file."""
    try:
        yield
    except DatasetError as error:
        raise RawFileError(path, str(error).removeprefix(f"{path}: ")) from error


class ComparedFrame:
    """A noisy frame, its reference, and its prediction, whose file is read once; without a file, the input itself."""

    def __init__(self, job: ScoringJob, reference: Reference, pair: Pair, noisy: NoisyInput, file: Path | None) -> None:
        self.reference, self.path, self.file = reference, noisy.path, file
        self._job, self._pair, self._noisy = job, pair, noisy
        place, levels = job.start / (file or ""), job.protocol.levels  # which words of an error depend on
        dng = read_once(lambda: load_dng(place, reference.frame.sensor))
        self._dng = dng
        self._dng_normalised = cache(lambda levels: normalised_frame(dng(), levels, clip="none"))
        self._raw = read_once(lambda: load_prediction(place, reference.frame.sensor, levels))
        self._colours = cache(lambda pixels, shape: load_colours(place, shape, pixels))

    def target(self, protocol: Protocol) -> NDArray[Any]:
        """Return what the prediction is compared with, (C, h, w)."""
        return self.reference.target(protocol)

    def prediction(self, protocol: Protocol) -> NDArray[Any]:
        """Return the prediction, (C, h, w)."""
        values = self._values(protocol)
        if protocol.quantisation == "none":
            return values
        clean = self.reference.frame
        with _file_problem_of(self.path):
            check_in_dn(str(clean.path), clean.sensor, f"protocol {protocol.name!r}, which cuts down to whole DN,")
        dtype = np.float32 if protocol.quantisation == "dn-truncated-float32" else np.float64
        return cut_to_dn(values, with_levels(clean.sensor, protocol.frame_levels), dtype)

    def _values(self, protocol: Protocol) -> NDArray[Any]:
        """Return the values that the file has."""
        if self.file is None:
            return self._noisy.amplified(protocol)
        if protocol.is_of_packed:
            self._check_shading()
        if protocol.pixels != "packed":
            return self._colours(protocol.pixels, self.reference.target(protocol).shape)
        if self._is_dng:
            return cast("NDArray[Any]", self._dng_normalised(protocol.levels))
        return self._raw()

    def input(self, protocol: Protocol) -> NDArray[Any]:
        """Return the amplified noisy input as a protocol has it, or what both frames show of it."""
        return self._noisy.amplified(protocol)

    def _check_shading(self) -> None:
        """Refuse a dark shading of another sensor than the reference's, which is the inputs'."""
        shading = self._job.shading
        if shading is not None:
            mosaic, sensor = self.reference.frame.mosaic, self.reference.frame.sensor
            with _file_problem_of(self.path):
                shading.check_sensor(self.path, (mosaic.shape[0], mosaic.shape[1]), sensor.cfa, sensor.model)

    @property
    def _is_dng(self) -> bool:
        return self.file is not None and self.file.suffix.lower() == ".dng"

    def equal_choices(self, protocol: Protocol) -> dict[str, frozenset[str]]:
        """Return the values of a protocol's fields that would have given the same score, by the field."""
        if not protocol.is_of_packed:
            return {}
        clean = self.reference.frame
        if self.file is not None:
            return {"levels": _equal_levels(protocol, [clean, *([self._dng()] if self._is_dng else [])])}
        return {
            "levels": _equal_levels(protocol, [clean, self._noisy.frame], clean.sensor),
            "amplification": self._noisy.equal_ratios(protocol),
        }

    def score(self, protocol: Protocol, target: NDArray[Any]) -> Score:
        """Return the scores of the region."""
        return self._score(protocol, target, self.prediction(protocol))

    def _score(self, protocol: Protocol, target: NDArray[Any], prediction: NDArray[Any]) -> Score:
        from eldata.metrics.image_score import score_by

        rules, threads, crop = protocol.rules, self._job.threads, protocol.crop(target.shape)
        factor = self._factor(protocol, target, prediction)
        p, g = prediction[crop], target[crop]
        if protocol.ssim_planes == "mosaic":
            cfa = self.reference.frame.sensor.cfa
            p, g = (unpack(np.ascontiguousarray(image), cfa)[np.newaxis] for image in (p, g))
        if protocol.rendering == "eld-isp" and protocol.pixels == "packed":
            codes = _rendered(p, g, self.reference.frame.sensor, protocol, factor)
            return _score_codes(*codes, rules, factor, threads)
        return score_by(p, g, rules, factor=factor, threads=threads)

    def _factor(self, protocol: Protocol, target: NDArray[Any], prediction: NDArray[Any]) -> float:
        from eldata.metrics.image_score import factor_by

        part = protocol.factor_crop(target.shape)
        return factor_by(prediction[part], target[part], protocol.rules, threads=self._job.threads)

    def scored_images(self, protocol: Protocol) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return prediction and reference that the score of the region is of; those of 256 levels as float32."""
        target = self.target(protocol)
        p, g = self.shown(protocol, target, self._factor(protocol, target, self.prediction(protocol)), "compared")
        if protocol.ssim_planes == "mosaic":
            cfa = self.reference.frame.sensor.cfa
            p, g = (unpack(np.ascontiguousarray(image), cfa)[np.newaxis] for image in (p, g))
        return p, g

    def inspected(self, protocol: Protocol, target: NDArray[Any], psnr_db: float) -> Inspection:
        """Return what the prediction shows of mistakes."""
        prediction = self.prediction(protocol)
        now = Circumstances(
            protocol=protocol,
            sensor=self.reference.frame.sensor if protocol.pixels == "packed" else None,
            ratio=ratio_of(self._pair),
            score=partial(self._score, protocol, target),
            amplified=partial(self.input, protocol),
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

    def other_values(self, protocol: Protocol, target: NDArray[Any], factor: float) -> dict[str, float]:
        """Return the values of registered metrics that are not found with the score."""
        from eldata.metrics.image_score import Score

        found_already = {field.name for field in fields(Score)}
        values = {}
        for figure in OF_FRAMES.values():
            if figure.name not in found_already:
                compute = named_object(figure.computed_by)
                values[figure.name] = float(compute(*self.shown(protocol, target, factor, "compared")))
        return values

    def shown(self, protocol: Protocol, target: NDArray[Any], factor: float, images: TaskImages) -> Shown:
        """Return prediction and reference of the region as the protocol compares them, or in sRGB or packed raw."""
        from eldata.metrics.image_score import as_compared

        crop, rules = protocol.crop(target.shape), protocol.rules
        p, g = self.prediction(protocol)[crop], target[crop]
        is_rendered = protocol.rendering == "eld-isp" and protocol.pixels == "packed"
        if protocol.pixels == "packed" and (images == "srgb" or (images == "compared" and is_rendered)):
            first, second = _rendered(p, g, self.reference.frame.sensor, protocol, factor)
            return first / np.float32(255), second / np.float32(255)
        if is_rendered:  # the rounding of its rules is that of renderings
            return as_scored(p, rules, factor, np.float32), g
        return as_compared(p, g, rules, factor)


def _equal_levels(protocol: Protocol, frames: Sequence[RawFrame], reference: Sensor | None = None) -> frozenset[str]:
    """Return the choices of levels that normalise each of these frames as the protocol's does."""
    return frozenset(
        levels
        for levels in get_args(Levels)
        if all(levels_dn(one, levels, reference) == levels_dn(one, protocol.levels, reference) for one in frames)
    )


def cut_to_dn(packed: NDArray[np.floating[Any]], sensor: Sensor, dtype: type[np.floating[Any]]) -> NDArray[np.float32]:
    """Clip packed normalised values, (C, h, w), to [0, 1], and cut them down to whole DN of the sensor's levels.

    The arithmetic is of ``dtype``: a whole level that was divided and multiplied in float32 is whole again in float32,
    and in float64 half of them lie just below.
    """
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn).astype(dtype)[:, None, None]
    span = dtype(sensor.white_level_dn) - black
    dn = np.floor(np.clip(packed.astype(dtype), 0, 1) * span + black)
    return cast("NDArray[np.float32]", ((dn - black) / span).astype(np.float32))


def _rendered(
    prediction: NDArray[Any], target: NDArray[Any], sensor: Sensor, protocol: Protocol, factor: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a packed raw prediction, rescaled in raw, and its reference in sRGB, (3, h, w) of the codes of 8 bits."""
    from eldata.isp.rendering import render_pair_for_scoring

    treated = as_scored(prediction, protocol.rules, factor, np.float64)
    first, second = render_pair_for_scoring(treated, target, sensor, response=protocol.curve)
    return first.astype(np.float32), second.astype(np.float32)


def _score_codes(
    prediction: NDArray[Any], target: NDArray[Any], rules: ScoringRules, factor: float, threads: int | None
) -> Score:
    """Score codes of 8 bits of a rendered prediction, which was rescaled in raw."""
    from eldata.metrics.image_score import score_by

    of_codes = replace(rules, rescaling="none", prediction_clamp="none", rounding="none", data_range=255.0)
    return replace(score_by(prediction, target, of_codes, threads=threads), rescale=factor)


def as_scored(prediction: NDArray[Any], rules: ScoringRules, factor: float, dtype: Any) -> NDArray[Any]:
    """Return a prediction clamped and multiplied as rules have it, (C, h, w); the arithmetic is float64."""
    from eldata.metrics.similarity import treated

    result = np.empty(prediction.shape, dtype)
    for channel, plane in enumerate(prediction):  # the float64 intermediates are 8 bytes per pixel
        result[channel] = treated(plane, rules.treatment(factor))
    return result
