"""Pictures of the worst and the best predictions: input, prediction, reference and error, as the protocol saw them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from PIL import Image

from eldata.isp.preview import brightening

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.looking import SeenFrame
    from eldata.evaluation.scores import UnitScore

EACH: Final = 4
"""How many of the worst and of the best are shown."""

CROP: Final = (320, 480)
"""Rows and columns of packed pixels that are shown one to one; of smaller images, all."""

_WHOLE_WIDTH = 288
# Without subsampling, nothing is to be seen of the first. Noise is large in any format: if the pictures of a page have
# more bytes than this, the next is tried, so that the page stays below 10 MB.
_JPEG_QUALITIES = (92, 85, 75, 60)
_MOST_BYTES = 6_000_000


@dataclass(frozen=True, slots=True)
class Layer:
    """One picture: a key, what it is called, what it shows in words, and its JPEG."""

    key: str
    label: str
    alt: str
    jpeg: bytes


@dataclass(frozen=True, slots=True)
class ShownImage:
    """The pictures of one scored image, or of a clip's worst frame.

    Attributes
    ----------
    rank
        Such as ``Worst``.
    score, frame
        Its scores; the path of what is shown.
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
    score: UnitScore
    frame: str
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


def shown_images(seen: Sequence[SeenFrame]) -> ShownImages:
    """Draw frames as they were scored, on one scale of errors."""
    errors = [one.arrays.error[_centre(one.arrays.error.shape)].ravel() for one in seen]
    limit = float(np.quantile(np.concatenate(errors), 0.998)) if errors else 0.0
    limit = max(limit, 1e-6)
    images: tuple[ShownImage, ...] = ()
    for quality in _JPEG_QUALITIES:
        images = tuple(_drawn(one, limit, quality) for one in seen)
        if sum(len(layer.jpeg) for image in images for layer in (*image.layers, *image.whole)) <= _MOST_BYTES:
            break
    return ShownImages(images, limit)


# --- drawing ------------------------------------------------------------------------------------------------------


def _drawn(one: SeenFrame, limit: float, quality: int) -> ShownImage:
    arrays, error = one.arrays, one.arrays.error
    _, height, width = arrays.reference.shape
    crop = _centre((height, width))
    size = (crop[0].stop - crop[0].start, crop[1].stop - crop[1].start)
    brighter = brightening(arrays.reference) if arrays.amplified is not None else 1.0
    what = f"{one.frame}: {one.score.psnr_db:.2f} dB"

    def layer(key: str, label: str, alt: str, array: NDArray[Any], place: str) -> Layer:
        pixels = heat(array[0], limit) if key == "error" else one.rendered(array * brighter)
        return Layer(key, label, f"{alt} of {what}, {place}", jpeg_of(pixels, quality))

    layers = []
    if arrays.amplified is not None:
        ratio = one.score.ratio
        label, alt = (
            ("Input", "Noisy input") if ratio is None else (f"Input ×{ratio:g}", f"Noisy input times {ratio:g}")
        )
        layers.append(layer("input", label, alt, arrays.amplified[(slice(None), *crop)], "centre crop"))
    for key, label, alt, array in (
        ("prediction", "Prediction", "Prediction", arrays.prediction),
        ("reference", "Reference", "Reference", arrays.reference),
        ("error", "Error", "Absolute error", error[None]),
    ):
        layers.append(layer(key, label, alt, array[(slice(None), *crop)], "centre crop"))
    whole: tuple[Layer, ...] = ()
    if size != (height, width):
        whole = (
            layer("prediction", "Prediction", "Prediction", reduced(arrays.prediction, _WHOLE_WIDTH), "whole"),
            layer("error", "Error", "Absolute error", reduced(error[None], _WHOLE_WIDTH), "whole"),
        )
    return ShownImage(one.rank, one.score, one.frame, tuple(layers), size, (height, width), whole, brighter)


def _centre(shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (min(most, length) for most, length in zip(CROP, shape, strict=True))
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    return slice(top, top + rows), slice(left, left + columns)


def reduced(packed: NDArray[Any], most: int) -> NDArray[Any]:
    """Return means of blocks of (C, h, w), so that it has at most so many columns."""
    step = max(1, -(-packed.shape[2] // most))
    height, width = (length // step * step for length in packed.shape[1:])
    blocks = packed[:, :height, :width].reshape(len(packed), height // step, step, width // step, step)
    return cast("NDArray[Any]", blocks.mean(axis=(2, 4)))


def heat(error: NDArray[Any], limit: float) -> NDArray[np.uint8]:
    """Return errors as colours from black over red to white, by their square root."""
    steps = np.rint(np.sqrt(np.clip(error / limit, 0, 1)) * 255).astype(np.intp)
    return cast("NDArray[np.uint8]", heat_colours()[steps])


def heat_colours() -> NDArray[np.uint8]:
    """Return the 256 colours of :func:`heat`, (256, 3)."""
    from matplotlib import colormaps

    colours = np.asarray(colormaps["inferno"](np.linspace(0, 1, 256)))[:, :3]
    return cast("NDArray[np.uint8]", np.rint(colours * 255).astype(np.uint8))


def heat_gradient() -> str:
    """Return the colours of :func:`heat` as a CSS gradient from 0 to the limit."""
    stops = np.linspace(0, 1, 11)
    colours = heat_colours()[np.rint(np.sqrt(stops) * 255).astype(np.intp)]
    return ", ".join(f"rgb({r} {g} {b}) {100 * stop:.0f}%" for (r, g, b), stop in zip(colours, stops, strict=True))


def jpeg_of(pixels: NDArray[np.uint8], quality: int) -> bytes:
    """Return (h, w, 3) as a JPEG whose colours are as fine as its brightness: noise of single pixels stays."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="JPEG", quality=quality, subsampling=0)
    return buffer.getvalue()
