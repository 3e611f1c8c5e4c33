"""Pictures of scored images, as the protocol saw them: input, predictions, reference and errors of each.

Those of an evaluation's worst and best are in its page; those of all images of a comparison lie in files beside it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from eldata.base.workers import Workers
from eldata.errors import EldataError
from eldata.evaluation.looking import place_of_difference
from eldata.plots.pictures import block_means, error_limit, heat, jpeg_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.looking import ScoredImage, SeenImage
    from eldata.evaluation.scores import UnitScore

CROP: Final = (320, 480)
"""Rows and columns of packed pixels that are shown one to one; of smaller images, all."""

# Without subsampling, nothing is to be seen of the first. Noise is large in any format: if the pictures of a page have
# more bytes than this, the next is tried, so that the page stays below 10 MB.
_QUALITIES = (92, 85, 75, 60)
_MOST_BYTES = 6_000_000
_WHOLE_WIDTH = 288

_QUALITY_BESIDE, _WHOLE_WIDTH_BESIDE = 80, 240
_OURS = re.compile(r"\d{4,}-(?:input|reference|whole|(?:method|error)-\d+)\.jpg")


def _draw_layers(seen: SeenImage, part: tuple[slice, slice], limit: float, quality: int) -> dict[str, bytes]:
    """Return a part of an image as JPEGs, by their names: those of :class:`DrawnImage`."""
    where = (slice(None), *part)
    arrays = {} if seen.amplified is None else {"input": seen.amplified}
    arrays |= {f"method-{index}": prediction for index, prediction in enumerate(seen.predictions, start=1)}
    arrays["reference"] = seen.reference
    colours = {name: seen.rendered(array[where]) for name, array in arrays.items()}
    colours |= {f"error-{index}": heat(error[part], limit) for index, error in enumerate(seen.errors, start=1)}
    return {name: jpeg_of(pixels, quality) for name, pixels in colours.items()}


def _reduce(values: NDArray[Any], most: int) -> NDArray[Any]:
    """Return means of blocks of (..., h, w), so that it has at most so many columns."""
    return block_means(values, max(1, -(-values.shape[-1] // most)))


# --- in the page of an evaluation ---------------------------------------------------------------------------------


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


def show_images(ranked: Iterable[tuple[str, UnitScore, ScoredImage]]) -> ShownImages:
    """Decode and draw images, each with its rank and score, as they were scored, on one scale of errors."""
    seen = [(rank, score, image.decoded()) for rank, score, image in ranked]
    limit = error_limit([one.errors[0][_centre(one.errors[0].shape)] for _, _, one in seen])
    images: tuple[ShownImage, ...] = ()
    for quality in _QUALITIES:
        images = tuple(_show(rank, score, one, limit, quality) for rank, score, one in seen)
        if sum(len(layer.jpeg) for image in images for layer in (*image.layers, *image.whole)) <= _MOST_BYTES:
            break
    return ShownImages(images, limit)


def _show(rank: str, score: UnitScore, seen: SeenImage, limit: float, quality: int) -> ShownImage:
    height, width = seen.reference.shape[1:]
    crop = _centre((height, width))
    size = (crop[0].stop - crop[0].start, crop[1].stop - crop[1].start)
    times = ("", "") if score.ratio is None else (f" ×{score.ratio:g}", f" times {score.ratio:g}")
    said = {
        "input": ("input", f"Input{times[0]}", f"Noisy input{times[1]}"),
        "method-1": ("prediction", "Prediction", "Prediction"),
        "reference": ("reference", "Reference", "Reference"),
        "error-1": ("error", "Error", "Absolute error"),
    }

    def layer(name: str, place: str, jpeg: bytes) -> Layer:
        key, label, alt = said[name]
        return Layer(key, label, f"{alt} of {seen.frame}: {score.psnr_db:.2f} dB, {place}", jpeg)

    drawn = _draw_layers(seen, crop, limit, quality)
    whole = {}
    if size != (height, width):
        whole["method-1"] = seen.rendered(_reduce(seen.predictions[0], _WHOLE_WIDTH))
        whole["error-1"] = heat(_reduce(seen.errors[0], _WHOLE_WIDTH), limit)
    return ShownImage(
        rank=rank,
        score=score,
        frame=seen.frame,
        layers=tuple(layer(name, "centre crop", jpeg) for name, jpeg in drawn.items()),
        size=size,
        full_size=(height, width),
        whole=tuple(layer(name, "whole", jpeg_of(pixels, quality)) for name, pixels in whole.items()),
        brighter=seen.brighter,
    )


def _centre(shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (min(most, length) for most, length in zip(CROP, shape, strict=True))
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    return slice(top, top + rows), slice(left, left + columns)


# --- beside the page of a comparison ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DrawnImage:
    """What a page has to know of the pictures of one image.

    Attributes
    ----------
    number
        Its place in the comparison, which its files' names begin with.
    layers
        Names of its pictures: ``input`` (but for sRGB predictions), ``method-1`` and so on, ``reference``, ``error-1``.
    part
        What rows and columns of the image they show, in packed pixels, or those of sRGB predictions.
    size
        (rows, columns) of the whole image.
    brighter
        What input, predictions and reference were multiplied by to be seen.
    error_limit
        The error of the lightest colour, of the normalised signal.
    """

    number: int
    layers: tuple[str, ...]
    part: tuple[slice, slice]
    size: tuple[int, int]
    brighter: float
    error_limit: float


@dataclass(frozen=True, slots=True)
class DrawnImages:
    """Pictures of all images of a comparison, in its order, and the address of their folder from the page."""

    folder: str
    images: tuple[DrawnImage, ...]


def draw_images(
    images: Sequence[ScoredImage], page: Path | str, *, whole: bool = False, workers: Workers | None = None
) -> DrawnImages:
    """Draw every image into the folder ``<page>-pictures`` beside the page.

    Parameters
    ----------
    images
        In the comparison's order.
    page
        The page's file. Pictures of an earlier page of this name are replaced, and removed where there are fewer now.
    whole
        Draw all of each image, one to one, in place of the part in which the methods differ most.
    workers
        Where to decode and draw; one image at a time in this process by default.

    Raises
    ------
    RawFileError, PredictionError, EldataError
        If a file is no longer what was scored, or a picture cannot be written.
    """
    page = Path(page)
    folder = page.with_name(f"{page.stem}-pictures")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise EldataError(f"{folder}: cannot be made for the page's pictures: {error.strerror}") from error
    tasks = [(number, image, folder, whole) for number, image in enumerate(images, start=1)]
    drawn = tuple((workers or Workers()).run(_draw_beside, tasks, label="pictures", unit="image"))
    current = {picture_file(one, layer) for one in drawn for layer in (*one.layers, "whole")}
    for path in folder.iterdir():
        if _OURS.fullmatch(path.name) and path.name not in current:
            path.unlink()
    return DrawnImages(quote(folder.name), drawn)


def picture_file(image: DrawnImage, layer: str) -> str:
    """Return the name of the file that a layer of an image is in."""
    return f"{image.number:04d}-{layer}.jpg"


def _draw_beside(task: tuple[int, ScoredImage, Path, bool]) -> DrawnImage:
    number, image, folder, whole = task
    seen = image.decoded()
    height, width = seen.reference.shape[1:]
    part = (slice(0, height), slice(0, width)) if whole else place_of_difference(seen.errors, CROP)
    limit = error_limit([error[part] for error in seen.errors])
    layers = _draw_layers(seen, part, limit, _QUALITY_BESIDE)
    drawn = DrawnImage(number, tuple(layers), part, (height, width), seen.brighter, limit)
    layers["whole"] = jpeg_of(seen.rendered(_reduce(seen.reference, _WHOLE_WIDTH_BESIDE)), _QUALITY_BESIDE)
    for name, jpeg in layers.items():
        # Not synced one by one: the page, which is written last and whole, is what says that all are there.
        (folder / picture_file(drawn, name)).write_bytes(jpeg)
    return drawn
