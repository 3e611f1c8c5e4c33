"""Uncompressed mosaics in strips and tiles anywhere in the file, and byte counts that are too small."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from eldata.isp import render_libraw
from eldata.raw import read_header, read_raw
from tests.raw.helpers import add_tags, check_refused, random_mosaic, write_plain_dng

HEIGHT, WIDTH = 61, 67
COLOUR = (
    (50721, "2i", 9, (7, 10, -2, 10, -1, 10, -4, 10, 12, 10, 2, 10, -1, 10, 2, 10, 6, 10), True),
    (50728, "2I", 3, (1, 2, 1, 1, 5, 8), True),
)


def written(
    path: Path, *tags: Any, bits: int = 16, byteorder: str = "<", size: Any = (HEIGHT, WIDTH), seed: int = 0, **own: Any
) -> NDArray[Any]:
    mosaic: NDArray[Any] = random_mosaic(*size, low=1, high=1 << bits, seed=seed)
    mosaic = mosaic.astype(np.uint8) if bits == 8 else mosaic
    if bits % 8:
        own["bitspersample"] = bits
    write_plain_dng(path, mosaic, ("RG", "GB"), *tags, white=(1 << bits) - 1, byteorder=byteorder, **own)
    return mosaic


def move_blocks(path: Path, gap: int, order: Sequence[int] | None = None) -> None:
    """Write strips or tiles once more behind the file's end, the last first, with foreign bytes before each."""
    with tifffile.TiffFile(path) as tiff:
        page, byteorder = tiff.pages.first, tiff.byteorder
        tag = page.tags.get(324) or page.tags[273]
        blocks = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        place = tag.valueoffset if len(blocks) > 1 else tag.offset + 8
    content, offsets = bytearray(path.read_bytes()), [0] * len(blocks)
    for index in range(len(blocks))[::-1] if order is None else order:
        content += b"\xee" * gap
        offsets[index] = len(content)
        content += content[blocks[index][0] :][: blocks[index][1]]
    struct.pack_into(f"{byteorder}{len(blocks)}{'H' if tag.dtype == 3 else 'I'}", content, place, *offsets)
    path.write_bytes(content)


@pytest.mark.parametrize(("bits", "order"), [(8, "<"), (10, "<"), (12, "<"), (14, "<"), (16, "<"), (16, ">")])
@pytest.mark.parametrize("options", [{"rowsperstrip": 13}, {"tile": (32, 32)}, {"tile": (64, 80)}], ids=str)
def test_rows_are_found_wherever_they_stand(bits: int, order: str, options: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    mosaic = written(path, *COLOUR, bits=bits, byteorder=order, **options)
    rendering = render_libraw(path)
    move_blocks(path, gap=3)
    np.testing.assert_array_equal(read_raw(path).mosaic, mosaic)
    np.testing.assert_array_equal(render_libraw(path), rendering)


@pytest.mark.parametrize("rows", [5, 13], ids=["RowsPerStrip of another number of strips", "as it is"])
def test_strips_beside_tags_of_tiles(rows: int, tmp_path: Path) -> None:
    """PiDNG writes them."""
    mosaic = written(tmp_path / "a.dng", rowsperstrip=13)
    tags = (322, "I", 1, WIDTH, True), (323, "I", 1, HEIGHT, True), (278, "I", 1, rows, True)
    add_tags(tmp_path / "a.dng", *tags)
    np.testing.assert_array_equal(read_raw(tmp_path / "a.dng").mosaic, mosaic)


def test_strips_that_do_not_make_up_the_image_are_refused(tmp_path: Path) -> None:
    written(tmp_path / "a.dng", rowsperstrip=13)
    move_blocks(tmp_path / "a.dng", gap=2)
    add_tags(tmp_path / "a.dng", (278, "I", 1, 7, True))
    words = "has 5 strips of 7 rows and 134 bytes a row, which do not make up its 61 x 67 pixels of 16 bits"
    check_refused(tmp_path / "a.dng", words)
    # Five strips that are all of the file's pixels, of an image five times as high.
    whole = (273, "I", 5, (336,) * 5, True), (279, "I", 5, (134 * HEIGHT,) * 5, True)
    add_tags(tmp_path / "a.dng", (257, "I", 1, 5 * HEIGHT, True), *whole, (278, "I", 1, HEIGHT, True))
    check_refused(tmp_path / "a.dng", "damaged: its strips share the same bytes")


@pytest.mark.parametrize(("bits", "row_bytes"), [(16, 134), (10, 84)])
@pytest.mark.parametrize("stated_rows", [0, 1, 60])
@pytest.mark.parametrize("tail", [0, 3, 1600, -2])
def test_a_byte_count_that_is_too_small(bits: int, row_bytes: int, stated_rows: int, tail: int, tmp_path: Path) -> None:
    """Whole files of a Raspberry Pi state one; else the rows beyond it are whatever follows, and never read."""
    path, needed, stated = tmp_path / "a.dng", row_bytes * HEIGHT, row_bytes * stated_rows
    mosaic = written(path, bits=bits)
    with tifffile.TiffFile(path) as tiff:
        entry, start = tiff.pages.first.tags[279].offset, tiff.pages.first.dataoffsets[0]
    content = bytearray(path.read_bytes()) + b"\x11" * max(tail, 0)
    struct.pack_into("<HHII", content, entry, 279, 4, 1, stated)
    path.write_bytes(content[: len(content) + min(tail, 0)])
    said = f"its strip at byte {start} states {stated} bytes, and its rows take {needed}"
    if tail in (0, 3):
        frame = read_raw(path)
        np.testing.assert_array_equal(frame.mosaic, mosaic)
        assert frame.remarks == read_header(path).remarks
        assert frame.remarks == (f"{said}: all are read, since the file has just as many there",)
        return
    words = f"{'damaged' if tail > 0 else 'truncated'}: {said}; the file has {needed + tail} bytes there"
    check_refused(path, re.escape(words), read_raw, read_header, render_libraw)
