"""A picture of what the demo did: reference, input and denoised side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PIL import Image, ImageDraw, ImageFont

from eldata.base.files import atomic_write

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_MARGIN = 16
_CAPTION = 26
_INK, _PAPER = (225, 225, 225), (24, 24, 26)


def write_contact_sheet(path: Path, rows: Sequence[Sequence[tuple[str, NDArray[np.uint8]]]]) -> None:
    """Write rows of captioned pictures, each (h, w, 3) uint8 and all of one size, as a PNG, whole or not at all."""
    height, width = rows[0][0][1].shape[:2]
    columns = max(len(row) for row in rows)
    cell_height, cell_width = height + _CAPTION + _MARGIN, width + _MARGIN
    sheet = Image.new("RGB", (columns * cell_width + _MARGIN, len(rows) * cell_height + _MARGIN), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=15)
    for y, row in enumerate(rows):
        for x, (caption, picture) in enumerate(row):
            left, top = _MARGIN + x * cell_width, _MARGIN + y * cell_height
            draw.text((left, top), caption, fill=_INK, font=font)
            sheet.paste(Image.fromarray(picture), (left, top + _CAPTION))
    with atomic_write(path) as file:
        sheet.save(file, "PNG")
