"""Pictures of a comparison, in files beside its page: input, predictions, reference and errors of every image."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from eldata.base.workers import Workers
from eldata.errors import EldataError
from eldata.isp.preview import brightening
from eldata.reports.evaluation.pictures import CROP, heat, jpeg_of, reduced

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.evaluation.seen_methods import MethodsImage

_QUALITY: Final = 80
_WHOLE_WIDTH: Final = 240
_OURS = re.compile(r"\d{4,}-(?:input|reference|whole|(?:method|error)-\d+)\.jpg")


@dataclass(frozen=True, slots=True)
class DrawnImage:
    """What a page has to know of the pictures of one image.

    Attributes
    ----------
    number
        Its place in the comparison, which its files' names begin with.
    layers
        Names of its pictures: ``input`` (but for sRGB predictions), ``method-1`` and so on, ``reference``, ``error-1``.
    top, left, rows, columns
        What part of the image they show, in packed pixels, or those of sRGB predictions.
    height, width
        Of the whole image.
    brighter
        What input, predictions and reference were multiplied by to be seen.
    error_limit
        The error of the lightest colour, of the normalised signal.
    """

    number: int
    layers: tuple[str, ...]
    top: int
    left: int
    rows: int
    columns: int
    height: int
    width: int
    brighter: float
    error_limit: float


@dataclass(frozen=True, slots=True)
class DrawnImages:
    """Pictures of all images of a comparison, in its order, and the address of their folder from the page."""

    folder: str
    images: tuple[DrawnImage, ...]


@dataclass(frozen=True, slots=True)
class _Task:
    number: int
    image: MethodsImage
    folder: Path
    whole: bool


def draw_images(
    images: Sequence[MethodsImage], page: Path | str, *, whole: bool = False, workers: Workers | None = None
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
    tasks = [_Task(number, image, folder, whole) for number, image in enumerate(images, start=1)]
    drawn = tuple((workers or Workers()).run(_draw, tasks, label="pictures", unit="image"))
    current = {picture_file(one, layer) for one in drawn for layer in (*one.layers, "whole")}
    for path in folder.iterdir():
        if _OURS.fullmatch(path.name) and path.name not in current:
            path.unlink()
    return DrawnImages(quote(folder.name), drawn)


def picture_file(image: DrawnImage, layer: str) -> str:
    """Return the name of the file that a layer of an image is in."""
    return f"{image.number:04d}-{layer}.jpg"


def _draw(task: _Task) -> DrawnImage:
    seen = task.image.decoded()
    errors = seen.errors
    height, width = errors[0].shape
    where = (slice(0, height), slice(0, width)) if task.whole else seen.part(CROP)
    brighter = brightening(seen.reference) if seen.amplified is not None else 1.0
    limit = seen.error_limit(where)

    def colours(values: Any) -> bytes:
        return jpeg_of(seen.rendered(values * brighter), _QUALITY)

    layers = {} if seen.amplified is None else {"input": colours(seen.amplified[(slice(None), *where)])}
    for index, prediction in enumerate(seen.predictions, start=1):
        layers[f"method-{index}"] = colours(prediction[(slice(None), *where)])
    layers["reference"] = colours(seen.reference[(slice(None), *where)])
    for index, error in enumerate(errors, start=1):
        layers[f"error-{index}"] = jpeg_of(heat(error[where], limit), _QUALITY)
    drawn = DrawnImage(
        number=task.number,
        layers=tuple(layers),
        top=where[0].start,
        left=where[1].start,
        rows=where[0].stop - where[0].start,
        columns=where[1].stop - where[1].start,
        height=height,
        width=width,
        brighter=brighter,
        error_limit=limit,
    )
    layers["whole"] = colours(reduced(seen.reference, _WHOLE_WIDTH))
    for name, jpeg in layers.items():
        # Not synced one by one: the page, which is written last and whole, is what says that all are there.
        (task.folder / picture_file(drawn, name)).write_bytes(jpeg)
    return drawn
