"""Small pictures of frames for the contact sheet, from their cells."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.frames import file_name
from capture.check.result import SheetPicture
from capture.observed import exposure_text
from eldata.isp.preview import srgb_encode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.check.cells import Cells
    from capture.check.frames import ReducedFrame

_WIDEST: Final = 480  # pixels: thumbnails are shown at a third of it, and enlarge
_CHANGE_SHOWN: Final = 0.05  # the strongest colour of a difference map, as a share
_QUALITY: Final = 85


def scene_picture(frame: ReducedFrame, gain: float) -> SheetPicture:
    """Return a frame as a picture, amplified."""
    iso, time = frame.header.exposure.iso, frame.header.exposure.exposure_s
    settings = f"ISO {float(iso):g}" if iso is not None else "ISO ?"
    settings += f", {exposure_text(time)}" if time is not None else ""
    amplified = f", x{gain:g}" if gain != 1 else ""
    caption = f"{file_name(frame.record.path)}: {settings}{amplified}"
    light = _three_colours(frame.cells) * gain / frame.cells.range_dn
    balance = frame.sensor.white_balance
    if balance is not None:
        light *= np.array(balance[:3], dtype=np.float32)
    return SheetPicture(caption, frame.record.path, _jpeg(255 * srgb_encode(np.clip(light, 0, 1))))


def change_picture(first: ReducedFrame, last: ReducedFrame) -> SheetPicture:
    """Return where the last reference is brighter (red) or darker (blue) than the first."""
    before, after = (_three_colours(frame.cells)[..., 1] for frame in (first, last))
    floor = 0.01 * first.cells.range_dn
    change = (after - before) / np.maximum(before, floor)
    caption = f"{file_name(last.record.path)} over {file_name(first.record.path)}, ±{100 * _CHANGE_SHOWN:g} %"
    return SheetPicture(caption, last.record.path, _jpeg(_diverging(change / _CHANGE_SHOWN)))


def map_picture(caption: str, path: str, values: NDArray[np.floating], full: float) -> SheetPicture:
    """Return a map of values, blue at ``-full``, red at ``+full``."""
    scale = max(1, _WIDEST // (2 * values.shape[1]))
    larger = np.kron(values, np.ones((scale, scale)))
    return SheetPicture(caption, path, _jpeg(_diverging(larger / full)))


def _three_colours(cells: Cells) -> NDArray[np.float32]:
    """Return the means of R, G and B, (rows, columns, 3), in as many cells as a small picture has pixels."""
    group = max(1, -(-cells.mean_dn.shape[2] // _WIDEST))
    mean, _ = cells.pooled(group, group)
    colours = np.array(cells.colours)
    return np.stack([mean[colours == colour].mean(axis=0) for colour in "RGB"], axis=-1)


def _diverging(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return -1 as blue, 0 as light grey and 1 as red, 0 to 255."""
    strength = np.clip(values, -1, 1)[..., None]
    grey, red, blue = (np.array(colour) for colour in ((235, 235, 235), (190, 20, 30), (20, 70, 190)))
    colours: NDArray[np.floating] = np.where(
        strength >= 0, grey + strength * (red - grey), grey - strength * (blue - grey)
    )
    return colours


def _jpeg(colours: NDArray[np.floating]) -> bytes:
    from PIL import Image

    image = Image.fromarray(np.rint(colours).astype(np.uint8))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()
