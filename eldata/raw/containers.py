"""Where a raw file keeps its EXIF, and whether it holds what its container declares.

TIFF-based files are read where they stand (:mod:`eldata.raw.tiff` checks their extents). Around the others is a
container: Fujifilm's RAF (a JPEG with the EXIF), Canon's CR3 (an ISO base media file, ISO/IEC 14496-12, whose boxes
CMT1 and CMT2 are TIFF files of IFD0 and of the EXIF IFD), Minolta's MRW (its TTW block is a TIFF file). Canon's older
CRW has no EXIF at all (:mod:`eldata.raw.ciff`).
"""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, BinaryIO

from eldata.errors import RawFileError
from eldata.raw import tiff

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

# TIFF files that call themselves something else: Olympus and OM System (ORF), Panasonic and Leica (RW2, RWL, RAW).
_TIFF_LIKE = (*tiff.MAGIC, b"IIRO", b"IIRS", b"MMOR", b"IIU\0")
_RAF = b"FUJIFILMCCD-RAW"
_RAF_EXTENTS = 84  # offset and length of the JPEG, the CFA header and the CFA data, big-endian
_MRW = b"\0MRM"
_CR3 = b"ftypcrx "  # after the four bytes of the first box's size
_CANON_UUID = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
_CMT = {b"CMT1": "Image", b"CMT2": "EXIF"}

_MOST_BOXES = 1000  # or blocks, of one level; a file with more is damaged, or made to keep a reader busy
_MOST_BYTES = 1 << 24  # of one block of EXIF: cameras write some kilobytes, a RAF's JPEG some megabytes


def exif_blocks(path: Path) -> Iterator[tuple[str | None, BinaryIO]]:
    """Yield each TIFF or JPEG file that holds EXIF, open while it is looked at.

    Yields
    ------
    ifd, file
        ``ifd``: what its first directory is, ``"Image"`` or ``"EXIF"``; ``None`` for a file whose directories say so
        themselves. Nothing for a container that has no EXIF.

    Raises
    ------
    RawFileError
        If the container is damaged before its EXIF.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(108)
        if head.startswith(_TIFF_LIKE):
            yield None, file
        elif head.startswith(_RAF) and len(head) == 108:
            yield None, _block(path, file, *struct.unpack_from(">II", head, _RAF_EXTENTS))
        elif head.startswith(_MRW):
            for kind, start, end in _mrw_blocks(path, file, size):
                if kind == b"\0TTW":
                    yield None, _block(path, file, start, end - start)
        elif head[4:12] == _CR3:
            for kind, start, end in _canon_boxes(path, file, size):
                if kind in _CMT:
                    yield _CMT[kind], _block(path, file, start, end - start)


def check_container(path: Path) -> None:
    """Raise a RawFileError if a RAF or a CR3 lacks data that it declares."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(108)
        if head.startswith(_RAF) and len(head) == 108:
            end = max(sum(struct.unpack_from(">II", head, at)) for at in (_RAF_EXTENTS, 92, 100))
            tiff.require(path, size, end)
        elif head[4:12] == _CR3:
            for kind, _, _ in _boxes(path, file, 0, size):
                if kind == b"mdat":  # the pixels, which come last
                    break


def _block(path: Path, file: BinaryIO, offset: int, length: int) -> io.BytesIO:
    if length > _MOST_BYTES:
        raise RawFileError(path, f"damaged: it declares {length} bytes of EXIF, and no camera writes {_MOST_BYTES}")
    file.seek(offset)
    return io.BytesIO(file.read(length))


def _canon_boxes(path: Path, file: BinaryIO, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the boxes of Canon's own box inside a CR3's ``moov``."""
    for kind, start, end in _boxes(path, file, 0, size):
        if kind != b"moov":
            continue
        for inner, inner_start, inner_end in _boxes(path, file, start, end):
            file.seek(inner_start)
            if inner == b"uuid" and file.read(16) == _CANON_UUID:
                yield from _boxes(path, file, inner_start + 16, inner_end)
        return


def _boxes(path: Path, file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield type, begin and end of the content of each box of a part of an ISO base media file."""
    whole = path.stat().st_size
    for _ in range(_MOST_BOXES):
        if start + 8 > end:  # what is left cannot be a box
            return
        file.seek(start)
        head = file.read(16)
        size, kind = struct.unpack_from(">I4s", head)
        content = start + 8
        if size == 1 and len(head) == 16:
            size = struct.unpack_from(">Q", head, 8)[0]
            content = start + 16
        elif size == 0:  # to the end
            size = end - start
        if start + size < content:
            raise RawFileError(path, f"damaged: its box at byte {start} declares {size} bytes, less than its own head")
        tiff.require(path, whole, start + size)
        if start + size > end:
            raise RawFileError(path, f"damaged: its box at byte {start} reaches beyond the box that it stands in")
        yield kind, content, start + size
        start += size
    raise RawFileError(path, f"damaged: it declares more than {_MOST_BOXES} boxes")


def _mrw_blocks(path: Path, file: BinaryIO, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, begin and end of each block of an MRW's header."""
    file.seek(4)
    end = 8 + struct.unpack(">I", file.read(4).ljust(4, b"\0"))[0]
    tiff.require(path, size, end)
    at = 8
    for _ in range(_MOST_BOXES):
        if at + 8 > end:
            return
        file.seek(at)
        name, length = struct.unpack(">4sI", file.read(8))
        if at + 8 + length > end:
            raise RawFileError(path, f"damaged: its block at byte {at} reaches beyond its header of {end} bytes")
        yield name, at + 8, at + 8 + length
        at += 8 + length
    raise RawFileError(path, f"damaged: it declares more than {_MOST_BOXES} blocks")
