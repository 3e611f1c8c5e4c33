"""Pictures of scored images, as the protocol saw them: input, predictions, reference and errors of each.

An evaluation's worst and best are in its page; all images of a comparison lie in files beside it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from eldata.base.workers import Workers
from eldata.errors import EldataError
from eldata.evaluation.looking import ScoredImage, SeenImage, place_of_difference
from eldata.plots.pictures import block_means, error_limit, heat, jpeg_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

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


@dataclass(frozen=True, slots=True)
class DrawnImage:
    """Pictures of one scored image, or of a clip's worst frame.

    Attributes
    ----------
    frame
        The path of what is shown.
    layers
        JPEGs of a part, one to one: ``input`` (but for sRGB predictions), ``method-1`` and so on, ``reference``,
        ``error-1``. Where they were written to files, the files' addresses from the page instead.
    whole
        The same of the whole image, reduced: what the page shows of it.
    part, size
        Rows and columns of ``layers``, and how many there are, in packed pixels or those of sRGB predictions.
    brighter
        What input, predictions and reference were multiplied by to be seen.
    error_limit
        The error of the lightest colour, of the normalised signal.
    """

    frame: str
    layers: dict[str, Any]
    whole: dict[str, Any]
    part: tuple[slice, slice]
    size: tuple[int, int]
    brighter: float
    error_limit: float

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, width and height of the part."""
        rows, columns = self.part
        return columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start


def _draw_layers(seen: SeenImage, part: tuple[slice, slice], limit: float, quality: int) -> dict[str, bytes]:
    """Draw a part of an image as JPEGs, by the names of :class:`DrawnImage`."""
    where = (slice(None), *part)
    arrays = {} if seen.amplified is None else {"input": seen.amplified}
    arrays |= {f"method-{index}": prediction for index, prediction in enumerate(seen.predictions, start=1)}
    arrays["reference"] = seen.reference
    colours = {name: seen.rendered(array[where]) for name, array in arrays.items()}
    colours |= {f"error-{index}": heat(error[part], limit) for index, error in enumerate(seen.errors, start=1)}
    return {name: jpeg_of(pixels, quality) for name, pixels in colours.items()}


def _reduce(values: NDArray[Any], most: int) -> NDArray[Any]:
    """Average blocks of (..., h, w), so that it has at most so many columns."""
    return block_means(values, max(1, -(-values.shape[-1] // most)))


# --- in the page of an evaluation ---------------------------------------------------------------------------------


def show_images(ranked: Iterable[tuple[str, UnitScore, ScoredImage]]) -> tuple[tuple[str, UnitScore, DrawnImage], ...]:
    """Decode images as they were scored, each with its rank and score, and draw their centres on one scale of errors.

    ``whole`` are prediction and error of the whole image; empty if the centre is all of it.
    """
    decoded = [(rank, score, image.decoded()) for rank, score, image in ranked]
    limit = error_limit([seen.errors[0][_cut_centre(seen.errors[0].shape)] for _, _, seen in decoded])
    images: list[DrawnImage] = []
    for quality in _QUALITIES:
        images = [_draw_centre(seen, limit, quality) for _, _, seen in decoded]
        jpegs = (jpeg for image in images for jpeg in (*image.layers.values(), *image.whole.values()))
        if sum(map(len, jpegs)) <= _MOST_BYTES:
            break
    return tuple((rank, score, image) for (rank, score, _), image in zip(decoded, images, strict=True))


def _draw_centre(seen: SeenImage, limit: float, quality: int) -> DrawnImage:
    """Draw an image's centre, and all of it smaller where the centre is not the whole."""
    height, width = seen.reference.shape[1:]
    part = _cut_centre((height, width))
    whole = {}
    if part != (slice(0, height), slice(0, width)):
        reduced = seen.rendered(_reduce(seen.predictions[0], _WHOLE_WIDTH))
        colours = {"method-1": reduced, "error-1": heat(_reduce(seen.errors[0], _WHOLE_WIDTH), limit)}
        whole = {name: jpeg_of(pixels, quality) for name, pixels in colours.items()}
    layers = _draw_layers(seen, part, limit, quality)
    return DrawnImage(seen.frame, layers, whole, part, (height, width), seen.brighter, limit)


def _cut_centre(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Cut the middle of an image: its rows and columns, :data:`CROP` at most."""
    rows, columns = (min(most, length) for most, length in zip(CROP, shape, strict=True))
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    return slice(top, top + rows), slice(left, left + columns)


# --- beside the page of a comparison ------------------------------------------------------------------------------


def draw_images(
    images: Sequence[ScoredImage], page: Path | str, *, whole: bool = False, workers: Workers | None = None
) -> tuple[DrawnImage, ...]:
    """Draw every image into the folder ``<page>-pictures`` beside the page.

    Parameters
    ----------
    images
        In the comparison's order.
    page
        The page's file. Pictures of an earlier page of this name are replaced, and removed where there are fewer now.
    whole
        Draw all of each image, one to one, instead of the part in which the methods differ most.
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
    drawn = tuple((workers or Workers()).run(_write_layers, tasks, label="pictures", unit="image"))
    current = {file for image in drawn for file in (*image.layers.values(), *image.whole.values())}
    for path in folder.iterdir():
        if _OURS.fullmatch(path.name) and f"{quote(folder.name)}/{path.name}" not in current:
            path.unlink()
    return drawn


def _write_layers(task: tuple[int, ScoredImage, Path, bool]) -> DrawnImage:
    """Draw an image's layers, whole or where the predictions differ most, into JPEG files of the folder."""
    number, image, folder, is_whole = task
    seen = image.decoded()
    height, width = seen.reference.shape[1:]
    part = (slice(0, height), slice(0, width)) if is_whole else place_of_difference(seen.errors, CROP)
    limit = error_limit([error[part] for error in seen.errors])
    layers = _draw_layers(seen, part, limit, _QUALITY_BESIDE)
    layers["whole"] = jpeg_of(seen.rendered(_reduce(seen.reference, _WHOLE_WIDTH_BESIDE)), _QUALITY_BESIDE)
    for name, jpeg in layers.items():
        # Not synced one by one: the page, which is written last and whole, is what says that all are there.
        (folder / f"{number:04d}-{name}.jpg").write_bytes(jpeg)
    files = {name: f"{quote(folder.name)}/{number:04d}-{name}.jpg" for name in layers}
    whole = {"whole": files.pop("whole")}
    return DrawnImage(seen.frame, files, whole, part, (height, width), seen.brighter, limit)
