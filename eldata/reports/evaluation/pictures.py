"""Pictures of the worst and the best predictions: input, prediction, reference and error, as the protocol saw them."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from PIL import Image

from eldata.base.files import inside
from eldata.errors import ArgumentError, PredictionError
from eldata.evaluation.predictions import find_predictions, load_prediction, load_srgb_prediction
from eldata.evaluation.references import normalised_frame, rendered_reference
from eldata.isp.preview import preview

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.saved import SavedResult, SavedScore
    from eldata.protocols.protocol import Clip, Levels
    from eldata.records import PairRecord, Sensor

EACH: Final = 4
"""How many of the worst and of the best are shown."""

CROP: Final = (320, 480)
"""Rows and columns of packed pixels that are shown one to one; of smaller images, all."""

_WHOLE_WIDTH = 288
# Without subsampling, nothing is to be seen of the first. Noise is large in any format: if the pictures of a page have
# more bytes than this, the next is tried, so that the page stays below 10 MB.
_JPEG_QUALITIES = (92, 85, 75, 60)
_MOST_BYTES = 6_000_000
_DARK, _BRIGHT, _MOST_BRIGHTER = 0.4, 0.6, 8.0


@dataclass(frozen=True, slots=True)
class Layer:
    """One picture: a key, what it is called, what it shows in words, and its JPEG."""

    key: str
    label: str
    alt: str
    jpeg: bytes


@dataclass(frozen=True, slots=True)
class ShownImage:
    """The pictures of one scored image.

    Attributes
    ----------
    rank
        Such as ``Worst``.
    score
        Its scores.
    layers
        Input (but for sRGB predictions), prediction, reference and error of the centre crop, one to one.
    size, full_size
        (rows, columns) of the crop and of the whole, in packed pixels, or those of sRGB predictions.
    whole
        Prediction and error of the whole image, reduced; empty if the crop is all of it.
    brighter
        What the first three layers were multiplied by to be seen.
    """

    rank: str
    score: SavedScore
    layers: tuple[Layer, ...]
    size: tuple[int, int]
    full_size: tuple[int, int]
    whole: tuple[Layer, ...]
    brighter: float

    @property
    def crop_box(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the crop in the whole, in per cent."""
        (rows, columns), (height, width) = self.size, self.full_size
        top, left = (height - rows) // 2, (width - columns) // 2
        return 100 * left / width, 100 * top / height, 100 * columns / width, 100 * rows / height


@dataclass(frozen=True, slots=True)
class ShownImages:
    """Pictures on one scale of errors: ``error_limit``, of the normalised signal, is the lightest colour."""

    images: tuple[ShownImage, ...]
    error_limit: float


@dataclass(frozen=True, slots=True)
class _Decoded:
    """Arrays (C, h, w) of one image, prediction as scored and reference, and input unless predictions are sRGB."""

    rank: str
    score: SavedScore
    amplified: NDArray[Any] | None
    prediction: NDArray[Any]
    reference: NDArray[Any]
    sensor: Sensor

    @property
    def error(self) -> NDArray[Any]:
        return cast("NDArray[Any]", np.abs(self.prediction - self.reference).mean(axis=0))

    def drawn(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Return packed raw as a quick rendering, sRGB as it is."""
        if self.amplified is not None:
            return preview(values, self.sensor)
        return cast("NDArray[np.uint8]", np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8).transpose(1, 2, 0))


def chosen_images(images: Sequence[SavedScore], each: int = EACH) -> list[tuple[str, SavedScore]]:
    """Return the worst and the best images by PSNR, at most one a scene of each kind, worst and best first.

    None is both: of few images the worst come first.
    """
    known = sorted((image for image in images if not math.isnan(image.psnr_db)), key=lambda image: image.psnr_db)
    worst = _one_a_scene(known, each)
    best = _one_a_scene([image for image in reversed(known) if image not in worst], each)
    return [("Worst", image) for image in worst] + [("Best", image) for image in best]


def _one_a_scene(images: Sequence[SavedScore], most: int) -> list[SavedScore]:
    first: dict[tuple[str, str], SavedScore] = {}
    for image in images:
        first.setdefault(image.place, image)
    return list(first.values())[:most]


def shown_images(
    result: SavedResult, pairs: Sequence[PairRecord], *, dataset_folder: Path, predictions: Path | None
) -> ShownImages:
    """Decode and draw the worst and the best images of a result.

    Parameters
    ----------
    result
        Scores and protocol.
    pairs
        The pairs that were scored, for their references.
    dataset_folder, predictions
        Where the raw files and the predictions lie; ``None`` if the noisy input itself was scored.

    Raises
    ------
    RawFileError, PredictionError, ManifestError
        If a file is no longer what was scored.
    """
    by_path = {pair.path: pair for pair in pairs}
    chosen = chosen_images(result.images)
    wanted = [by_path[score.path] for _, score in chosen]
    files = {} if predictions is None else find_predictions(predictions, wanted, ()).files
    protocol = result.protocol
    decode = _decoded_srgb if protocol.get("rendering") == "libraw" else partial(_decoded_raw, protocol)
    decoded = []
    for (rank, score), pair in zip(chosen, wanted, strict=True):
        if predictions is not None and pair.path not in files:
            raise PredictionError(predictions, f"the prediction of {pair.path} is gone since it was scored")
        decoded.append(decode(rank, score, pair, dataset_folder, files.get(pair.path)))
    errors = [one.error[_centre(one.error.shape)].ravel() for one in decoded]
    limit = float(np.quantile(np.concatenate(errors), 0.998)) if errors else 0.0
    limit = max(limit, 1e-6)
    images: tuple[ShownImage, ...] = ()
    for quality in _JPEG_QUALITIES:
        images = tuple(_drawn(one, limit, quality) for one in decoded)
        if sum(len(layer.jpeg) for image in images for layer in (*image.layers, *image.whole)) <= _MOST_BYTES:
            break
    return ShownImages(images, limit)


def _decoded_raw(
    protocol: dict[str, Any], rank: str, score: SavedScore, pair: PairRecord, folder: Path, prediction: Path | None
) -> _Decoded:
    from eldata.raw.reading import exposure_ratio, read_raw

    levels = cast("Levels", protocol["levels"])
    reference = read_raw(inside(folder, pair.reference))
    noisy = read_raw(inside(folder, pair.path))
    ratio = exposure_ratio(reference, noisy) if protocol.get("amplification") == "metadata" else pair.ratio
    # Clipped before and after it is multiplied, as the protocol gives it to a network.
    clip = cast("Clip", protocol.get("input_clip", "both"))
    amplified = normalised_frame(noisy, levels, clip=clip, gain=float(ratio))
    clip = cast("Clip", protocol.get("reference_clip", "both"))
    target = normalised_frame(reference, levels, clip=clip)
    values = amplified if prediction is None else load_prediction(prediction, reference.sensor, levels)
    found = _as_scored(values, score)
    return _Decoded(rank, score, amplified, found, target, reference.sensor)


def _decoded_srgb(rank: str, score: SavedScore, pair: PairRecord, folder: Path, prediction: Path | None) -> _Decoded:
    from eldata.raw.reading import read_raw

    if prediction is None:
        raise ArgumentError("the raw input is no rendering, so a protocol of renderings has no such baseline")

    path = inside(folder, pair.reference)
    target = rendered_reference(path)
    rows, columns = target.shape[1:]
    found = _as_scored(load_srgb_prediction(prediction, (3, rows, columns)), score)
    return _Decoded(rank, score, None, found, target, read_raw(path).sensor)


def _as_scored(prediction: NDArray[Any], score: SavedScore) -> NDArray[np.float32]:
    factor = 1.0 if math.isnan(score.rescale) else score.rescale
    scored: NDArray[np.float32] = np.clip(np.clip(prediction, 0, 1) * factor, 0, 1).astype(np.float32)
    return scored


# --- drawing ------------------------------------------------------------------------------------------------------


def _drawn(one: _Decoded, limit: float, quality: int) -> ShownImage:
    _, height, width = one.reference.shape
    crop = _centre((height, width))
    size = (crop[0].stop - crop[0].start, crop[1].stop - crop[1].start)
    brighter = _brighter(one.reference) if one.amplified is not None else 1.0
    what = f"{one.score.path}: {one.score.psnr_db:.2f} dB"
    factor = f"{one.score.ratio:g}"

    def layer(key: str, label: str, alt: str, array: NDArray[Any], place: str) -> Layer:
        pixels = _heat(array[0], limit) if key == "error" else one.drawn(array * brighter)
        return Layer(key, label, f"{alt} of {what}, {place}", _jpeg(pixels, quality))

    layers = []
    if one.amplified is not None:
        cut = one.amplified[(slice(None), *crop)]
        layers.append(layer("input", f"Input ×{factor}", f"Noisy input times {factor}", cut, "centre crop"))
    for key, label, alt, array in (
        ("prediction", "Prediction", "Prediction", one.prediction),
        ("reference", "Reference", "Reference", one.reference),
        ("error", "Error", "Absolute error", one.error[None]),
    ):
        layers.append(layer(key, label, alt, array[(slice(None), *crop)], "centre crop"))
    whole: tuple[Layer, ...] = ()
    if size != (height, width):
        whole = (
            layer("prediction", "Prediction", "Prediction", _reduced(one.prediction, _WHOLE_WIDTH), "whole"),
            layer("error", "Error", "Absolute error", _reduced(one.error[None], _WHOLE_WIDTH), "whole"),
        )
    return ShownImage(one.rank, one.score, tuple(layers), size, (height, width), whole, brighter)


def _centre(shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (min(most, length) for most, length in zip(CROP, shape, strict=True))
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    return slice(top, top + rows), slice(left, left + columns)


def _brighter(reference: NDArray[Any]) -> float:
    """Return what a dark reference is to be multiplied by to be seen, rounded to two digits; 1 of a bright one."""
    light = float(np.quantile(reference, 0.99))
    if light >= _DARK or light <= 0:
        return 1.0
    return float(f"{min(_MOST_BRIGHTER, _BRIGHT / light):.2g}")


def _reduced(packed: NDArray[Any], most: int) -> NDArray[Any]:
    """Return means of blocks of (C, h, w), so that it has at most so many columns."""
    step = max(1, -(-packed.shape[2] // most))
    height, width = (length // step * step for length in packed.shape[1:])
    blocks = packed[:, :height, :width].reshape(len(packed), height // step, step, width // step, step)
    return cast("NDArray[Any]", blocks.mean(axis=(2, 4)))


def _heat(error: NDArray[Any], limit: float) -> NDArray[np.uint8]:
    """Return errors as colours from black over red to white, by their square root."""
    steps = np.rint(np.sqrt(np.clip(error / limit, 0, 1)) * 255).astype(np.intp)
    return cast("NDArray[np.uint8]", _heat_colours()[steps])


def _heat_colours() -> NDArray[np.uint8]:
    from matplotlib import colormaps

    colours = np.asarray(colormaps["inferno"](np.linspace(0, 1, 256)))[:, :3]
    return cast("NDArray[np.uint8]", np.rint(colours * 255).astype(np.uint8))


def heat_gradient() -> str:
    """Return the colours of :func:`_heat` as a CSS gradient from 0 to the limit."""
    stops = np.linspace(0, 1, 11)
    colours = _heat_colours()[np.rint(np.sqrt(stops) * 255).astype(np.intp)]
    return ", ".join(f"rgb({r} {g} {b}) {100 * stop:.0f}%" for (r, g, b), stop in zip(colours, stops, strict=True))


def _jpeg(pixels: NDArray[np.uint8], quality: int) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="JPEG", quality=quality, subsampling=0)
    return buffer.getvalue()
