"""Pages of a stranger's TIFF file, walked before tifffile does.

tifffile follows the chain of pages as far as it goes, in a circle too, logs what is wrong with them, and fills strips
that a file does not hold with zeros.
"""

from __future__ import annotations

import math
import struct
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    import tifffile

COMPRESSIONS = {
    1: "none",
    5: "LZW",
    8: "deflate",
    32946: "deflate",
    32773: "PackBits",
    34925: "LZMA",
    50000: "Zstandard",
}
"""Those of which a decoder can be told how much to make: none that holds a picture of its own."""

_MOST_PAGES = 64  # the planes of a packed frame are 4 to 36
_MOST_TAGS = 256
_MOST_TAG_BYTES = 16 << 20  # of all pages; 100,000 strips of offsets and lengths take 1.6 MB
_LARGEST_TILE = 1 << 20  # pixels, where the image is smaller
_SUB_IFDS = 330
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}


class TiffError(ValueError):
    """A TIFF file is damaged, or made to keep its reader busy."""


class _Form:
    """How a file writes its numbers: classic TIFF or BigTIFF, in either byte order."""

    def __init__(self, head: bytes) -> None:
        order = {b"II": "<", b"MM": ">"}.get(head[:2])
        version = struct.unpack(f"{order}H", head[2:4])[0] if order and len(head) == 16 else 0
        if version not in (42, 43):
            raise TiffError("does not begin as a TIFF file does")
        is_big = version == 43
        self.count = struct.Struct(f"{order}{'Q' if is_big else 'H'}")
        self.entry = struct.Struct(f"{order}{'HHQQ' if is_big else 'HHII'}")
        self.offset = struct.Struct(f"{order}{'Q' if is_big else 'I'}")
        self.first = self.offset.unpack_from(head, 8 if is_big else 4)[0]


def check_pages(path: Path) -> None:
    """Walk the chain of pages before anything else does.

    Raises
    ------
    TiffError
        If it is not TIFF, a page or a value lies beyond the end, or there are more of them than an array needs.
    OSError
        If the file cannot be read.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        form = _Form(file.read(16))
        at, left = form.first, _MOST_TAG_BYTES
        seen: set[int] = set()
        while at:
            if at in seen or len(seen) == _MOST_PAGES:
                raise TiffError(f"its pages go in a circle, or are more than {_MOST_PAGES}")
            seen.add(at)
            at, used = _next_page(file, form, at, size)
            left -= used
            if left < 0:
                raise TiffError(f"the tags of its pages take more than {_MOST_TAG_BYTES} bytes")
    if not seen:
        raise TiffError("has no page")


def _next_page(file: IO[bytes], form: _Form, at: int, size: int) -> tuple[int, int]:
    """Return where the page after one is, and how many bytes the one's tags take."""
    file.seek(min(at, size))
    head = file.read(form.count.size)
    count = form.count.unpack(head)[0] if len(head) == form.count.size else 0
    if not 0 < count <= _MOST_TAGS:
        raise TiffError(f"a page at byte {at} of {size} has {count} tags; expected 1 to {_MOST_TAGS}")
    table = file.read(count * form.entry.size + form.offset.size)
    if len(table) < count * form.entry.size + form.offset.size:
        raise TiffError(f"ends within the tags of a page at byte {at} of {size}")
    used = 0
    for tag, kind, number, value in form.entry.iter_unpack(table[: -form.offset.size]):
        length = number * _TYPE_BYTES.get(kind, 1)
        if length > form.offset.size and value + length > size:
            raise TiffError(f"its tag {tag} lies beyond the end of the file")
        if tag == _SUB_IFDS:
            raise TiffError("has pages within its pages")
        used += length
    following: int = form.offset.unpack(table[-form.offset.size :])[0]
    return following, used


def check_segments(series: tifffile.TiffPageSeries, size: int) -> None:
    """Check the strips or tiles of all pages of an array.

    Parameters
    ----------
    series
        The pages.
    size
        Bytes of the file.

    Raises
    ------
    TiffError
        If one is missing, or lies beyond the end; a tile is much larger than its page; or the compression is none of
        :data:`COMPRESSIONS`.
    """
    pages: list[Any] = list(series.pages)
    if not all(pages) or math.prod(series.shape) != sum(math.prod(page.shape) for page in pages):
        raise TiffError("its pages do not hold as many values as it declares")
    for page in pages:
        keyframe = page.keyframe
        if int(keyframe.compression) not in COMPRESSIONS:
            known = ", ".join(dict.fromkeys(COMPRESSIONS.values()))
            raise TiffError(f"compression {int(keyframe.compression)}; expected {known}")
        tile = keyframe.tilewidth * keyframe.tilelength * max(keyframe.tiledepth, 1) if keyframe.is_tiled else 0
        if tile > max(4 * keyframe.imagewidth * keyframe.imagelength, _LARGEST_TILE):
            raise TiffError(f"tiles of {keyframe.tilewidth} x {keyframe.tilelength} pixels in a smaller page")
        extents = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        if not _is_whole(keyframe, extents):
            raise TiffError("strips or tiles are missing")
        if max(offset + count for offset, count in extents) > size:
            raise TiffError("its data lie beyond the end of the file: truncated?")


def _is_whole(keyframe: Any, extents: list[tuple[int, int]]) -> bool:
    """Return whether a page has all its strips or tiles; tifffile joins those that follow each other."""
    if not all(offset > 0 and count > 0 for offset, count in extents):
        return False
    if keyframe.is_contiguous or len(extents) == 1 < math.prod(keyframe.chunked):
        return int(keyframe.compression) == 1 and sum(count for _, count in extents) >= int(keyframe.nbytes)
    return bool(len(extents) == math.prod(keyframe.chunked))
