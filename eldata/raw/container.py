"""What a raw file states of its camera and exposure, exactly. What it does not state is ``None``: nothing is guessed.

LibRaw's figures are not taken, because LibRaw makes some up: 1 s at f/1 from an APEX value of 0, an ISO from its own
table of models, float32 for a fraction. Asking it would also decode the pixels.

A TIFF-based file is walked once, for its extents and its EXIF. Around the EXIF of the others is a container: Fujifilm's
RAF (a JPEG with the EXIF), Canon's CR3 (an ISO base media file, ISO/IEC 14496-12, whose boxes CMT1 and CMT2 are TIFF
files of IFD0 and of the EXIF IFD), Minolta's MRW (its TTW block is a TIFF file).

Kinds, compressions and layouts that cannot be used are refused by name (:func:`refuse_unsupported`).
"""

from __future__ import annotations

import io
import math
import mmap
import os
import struct
from bisect import bisect_right
from dataclasses import dataclass, replace
from datetime import datetime
from fractions import Fraction
from functools import cached_property
from itertools import pairwise, product
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from eldata.base.numbers import counted
from eldata.errors import RawFileError, UnusableRawError
from eldata.raw import tiff
from eldata.raw.damage import find_stream
from eldata.raw.levels import cfa_of_letters
from eldata.raw.tiff import Directory, TiffReader
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


_FIRST_YEAR = 1990  # no camera wrote raw files before: an earlier time is of a clock that was never set
# By EXIF's SensitivityType, which says which of them the ISO repeats.
_SENSITIVITIES = {2: tiff.EXPOSURE_INDEX, 1: tiff.OUTPUT_SENSITIVITY, 3: tiff.ISO_SPEED}
_ISO_BEYOND_16_BITS = 65535  # what EXIF 2.3 puts in 16 bits where the speed is stated elsewhere
# TIFF files that call themselves something else: Olympus and OM System (ORF), Panasonic and Leica (RW2, RWL, RAW).
_TIFF_LIKE = (b"IIRO", b"IIRS", b"MMOR", b"IIU\0")
_RAF = b"FUJIFILMCCD-RAW"
_RAF_EXTENTS = (84, 92, 100)  # offset and length of the JPEG, the CFA header and the CFA data, big-endian
_RAF_SECOND = 120  # of a second CFA header, if the JPEG does not begin before
_HEAD = 124
_MRW = b"\0MRM"
_CR3 = b"ftypcrx "  # after the four bytes of the first box's size
_CANON_UUID = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")

_MOST_BOXES = 1000  # or blocks, or segments, of one level; a file with more is damaged, or made to keep a reader busy
_LARGEST_BLOCK = 1 << 24  # of one block of EXIF: cameras write some kilobytes, a RAF's JPEG some megabytes
_SONY, _LOSSY_JPEG = 32767, 34892


@dataclass(frozen=True)
class RawContainer:
    """What the container of a raw file states, read once.

    Attributes
    ----------
    path
        The file.
    head
        Its first bytes.
    directories
        Of a TIFF-based file, in LibRaw's order; none of another.
    header
        Camera, exposure and time.
    version
        What tells it from another file under its name.
    """

    path: Path
    head: bytes
    directories: tuple[Directory, ...]
    header: RawHeader
    version: tuple[int, ...]

    @cached_property
    def main(self) -> Directory | None:
        """Directory of the mosaic; None where none is named."""
        return next(iter(tiff.main_mosaics(self.directories)), None)

    @cached_property
    def is_dng(self) -> bool:
        """Whether it is a DNG."""
        return tiff.is_dng(self.directories)

    @cached_property
    def rows(self) -> StoredRows | None:
        """Where the rows of an uncompressed mosaic of a TIFF-based or RAF file lie, or a DNG's JPEG tiles; else None.

        Raises
        ------
        RawFileError
            If a DNG's strips or tiles are not as many as its size takes or share bytes; or if their byte counts are
            less than their rows take, and something else than these rows follows.
        """
        main = self.main
        if self.head.startswith(_RAF):
            return _find_raf_rows(self.path, self.head) if len(self.head) == _HEAD else None
        if main is None or not self.is_dng:
            return None if main is None else _find_camera_rows(self.path, main, self.directories)
        if main.compression == tiff.JPEG:
            return _find_jpegs(self.path, main)
        is_plain = main.compression == tiff.UNCOMPRESSED
        bits = main.number(tiff.BITS, _MOST_BITS)
        return _find_rows(self.path, main, self.directories, bits) if is_plain else None


def read_container(path: Path) -> RawContainer:
    """Read directories, camera and exposure of a raw file, whether or not its pixels are there.

    Raises
    ------
    RawFileError
        If its tables are damaged.
    """
    directories: tuple[Directory, ...] = ()
    exif = image = Directory({})
    with path.open("rb") as file:
        head, version = file.read(_HEAD), version_of(os.fstat(file.fileno()))
        for kind, block in _exif_blocks(path, file, head):
            reader = TiffReader(path, block)
            if head.startswith(tiff.MAGIC):
                directories = reader.walk()
                image = directories[0] if directories else image
                place = image.number(tiff.EXIF_IFD, 0)
                exif = next((directory for directory in directories if directory.starts[0] == place), exif)
            elif kind == b"CMT2":
                exif, _ = reader.read_first()
            else:
                image, exif = reader.read_first()
    return RawContainer(path, head, directories, _read_header(path, image, exif), version)


def version_of(status: os.stat_result) -> tuple[int, ...]:
    """Return the size and what else tells a file from another one under its name."""
    return status.st_size, status.st_mtime_ns, status.st_dev, status.st_ino


def check_container(file: RawContainer) -> None:
    """Raise a RawFileError if a file lacks data that it declares."""
    path, size = file.path, file.path.stat().st_size
    tiff.check_images(path, file.directories)
    if file.head.startswith(_RAF) and len(file.head) == _HEAD:
        tiff.require(path, size, max(sum(struct.unpack_from(">II", file.head, at)) for at in _RAF_EXTENTS))
    elif file.head[4:12] == _CR3:
        with path.open("rb") as content:
            for kind, _, _ in _boxes(path, content, 0, size):
                if kind == b"mdat":  # the pixels, which come last
                    break


# --- camera and exposure ----------------------------------------------------------------------------------------------


def _read_header(path: Path, image: Directory, exif: Directory) -> RawHeader:
    """Read camera, exposure, time and orientation from the first and the EXIF directory."""
    make, model = image.texts.get(tiff.MAKE, ""), image.texts.get(tiff.MODEL, "")
    if not make and not model:
        model = image.texts.get(tiff.UNIQUE_MODEL, "")
    orientation = image.number(tiff.ORIENTATION, 1)
    times = (_positive(image, exif, tag) for tag in (tiff.EXPOSURE_TIME, tiff.F_NUMBER))
    return RawHeader(
        path, make, model, Exposure(_read_iso(image, exif), *times), _read_taken(exif) or _read_taken(image),
        orientation=orientation if 1 <= orientation <= 8 else 1,
    )  # fmt: skip


def _read_taken(directory: Directory) -> datetime | None:
    """DateTimeOriginal with its SubSecTime; ``None`` if there is none, or of a clock that was never set."""
    try:
        taken = datetime.strptime(directory.texts.get(tiff.TAKEN, ""), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 # as stated
    except ValueError:
        return None
    digits = directory.texts.get(tiff.TAKEN_FRACTION, "")
    fraction = digits[:6].ljust(6, "0") if digits.isascii() and digits.isdecimal() else "0"
    return taken.replace(microsecond=int(fraction)) if taken.year >= _FIRST_YEAR else None


def _read_iso(image: Directory, exif: Directory) -> Fraction | None:
    """Read the ISO: its own tag, beyond 16 bits EXIF's sensitivity tags, else Panasonic's; None if none states it."""
    stated = _positive(image, exif, tiff.ISO)
    if stated is not None and stated != _ISO_BEYOND_16_BITS:
        return stated
    first = _SENSITIVITIES.get(int(_positive(image, exif, tiff.SENSITIVITY_TYPE) or 0), 0)
    for tag in (first, *_SENSITIVITIES.values()):
        iso = _positive(image, exif, tag)
        if iso is not None:
            return iso
    if tiff.PANASONIC in image.entries:
        isos = (image.number(tag, 0) for tag in tiff.PANASONIC_ISOS)
        iso = next((Fraction(iso) for iso in isos if iso > 0), None)
        return None if iso == _ISO_BEYOND_16_BITS else iso
    return None


def _positive(image: Directory, exif: Directory, tag: int) -> Fraction | None:
    """First value of a tag, from the EXIF directory or else from the first one, if it is a positive number."""
    for directory in (exif, image):
        value = next(iter(directory.values.get(tag, ())), 0)
        if value > 0:
            return Fraction(value)
    return None


# --- where it stands --------------------------------------------------------------------------------------------------


def _exif_blocks(path: Path, file: BinaryIO, head: bytes) -> Iterator[tuple[bytes, BinaryIO]]:
    """Yield each TIFF file that holds EXIF, and the name of its block; none of a container that has no EXIF."""
    if head.startswith((*tiff.MAGIC, *_TIFF_LIKE)):
        yield b"", file
    elif head.startswith(_RAF) and len(head) == _HEAD:
        block = _exif_of_jpeg(_read_block(path, file, *struct.unpack_from(">II", head, _RAF_EXTENTS[0])))
        if block:
            yield b"", io.BytesIO(block)
    elif head.startswith(_MRW) or head[4:12] == _CR3:
        read_blocks = _mrw_blocks if head.startswith(_MRW) else _canon_boxes
        for kind, start, end in read_blocks(path, file, path.stat().st_size):
            if kind in (b"\0TTW", b"CMT1", b"CMT2"):
                yield kind, io.BytesIO(_read_block(path, file, start, end - start))


def _exif_of_jpeg(content: bytes) -> bytes:
    """TIFF file in a JPEG's segment APP1; empty if it has none."""
    at = 2
    for _ in range(_MOST_BOXES):
        if content[at : at + 1] != b"\xff" or len(content) < at + 4:
            break
        marker, length = struct.unpack_from(">xBH", content, at)
        if marker == 0xE1 and content[at + 4 : at + 10] == b"Exif\0\0":
            return content[at + 10 : at + 2 + length]
        at += 2 + length
    return b""


def _read_block(path: Path, file: BinaryIO, offset: int, length: int) -> bytes:
    """Read a block of EXIF; refuse one longer than any camera writes."""
    if length > _LARGEST_BLOCK:
        raise RawFileError(path, f"damaged: it declares {length} bytes of EXIF, and no camera writes {_LARGEST_BLOCK}")
    file.seek(offset)
    return file.read(length)


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


# --- the rows of an uncompressed mosaic -------------------------------------------------------------------------------

_MOST_BITS = 16
_MOST_PADDING = 16  # bytes that a writer may leave so that what follows begins at a whole number of words
_TABLES = 1 << 14  # first bytes of a RAF's pixels, where their tags stand, or of a JPEG, where its tables do
_WORD = 4  # bytes of a RAF's packed pixels, which lie in it from the highest bit on
_FEW_TILES = 8
_NO_TAG, _LONG = 0xFFFF, 4
_ROWS_TO_KNOW = 48  # of a picture: LibRaw knows no mosaic of some 20 rows
_PHASES = 24  # rows after which each pattern repeats: of a CFA 2, 4 or 6, of black levels up to 8
_TILE_TAGS = {tiff.TILE_WIDTH, tiff.TILE_HEIGHT, *tiff.TILES}


@dataclass(frozen=True, slots=True)
class StoredRows:
    """Where the rows of a mosaic stand, by the offsets of its strips or tiles, which are uncompressed or lossless JPEG.

    LibRaw takes all strips for one run of bytes that begins where the first does, whatever their offsets and byte
    counts say, and a single tile for rows of the image. :meth:`rearrange` gives it the same file with its rows in one
    run, or with few rows, for who asks what else it states.

    Attributes
    ----------
    main
        The mosaic's directory.
    bits
        Of a pixel, as it is stored.
    row_bytes, block_bytes
        Bytes of a row of pixels, which begins at a whole byte, and of a row of a strip or tile.
    blocks
        Its strips or tiles, row by row of the image: first row, first byte of a row, offset in the file, bytes.
    remarks
        Says it of byte counts that are too small.
    word_bytes
        Of the little-endian words in which packed pixels lie; 1: they follow one another byte by byte.
    jpeg
        What the first tile states of its code, if each is a lossless JPEG, decoded to 16 bits; else empty.
    """

    main: Directory
    bits: int
    row_bytes: int
    block_bytes: int
    blocks: tuple[tuple[int, int, int, int], ...]
    remarks: tuple[str, ...]
    word_bytes: int = 1
    jpeg: bytes = b""

    @property
    def are_found(self) -> bool:
        """Whether LibRaw finds all rows by itself."""
        tags = self.main.entries.keys()
        if self.jpeg:
            return True
        if tiff.TILES[0] in self.main.values:
            return len(self.blocks) > 1 and tiff.STRIPS[0] not in tags
        return not tags & _TILE_TAGS and self.are_one_run

    @property
    def are_one_run(self) -> bool:
        """Whether its blocks are strips that follow one another without a gap."""
        are_strips = self.block_bytes == self.row_bytes and not self.jpeg
        return are_strips and _are_one_run([block[2:] for block in self.blocks])

    def rearrange(self, path: Path, *, short: bool) -> tuple[mmap.mmap, int | None]:
        """Copy the file with its rows, in order, as its only strip, behind all else; if ``short`` a few rows of zeros.

        It has so many rows less that no pattern of a CFA or of black levels changes its phase at the bottom. The copy
        is sparse, and comes with its descriptor, to be closed, where the system has such files without a name.
        """
        (height, _), size = self.main.shape, path.stat().st_size
        area = self.main.values.get(tiff.ACTIVE_AREA, (0, 0, height, 0))
        least = min(height, _ROWS_TO_KNOW + height - int(area[2] - area[0])) if short else height
        less = (height - least) // _PHASES * _PHASES
        length = size + (height - less) * self.row_bytes
        copy, descriptor = _reserve_copy(length)
        at = 0
        with path.open("rb") as file:
            for _, _, offset, held in sorted((*self.blocks, (0, 0, size, 0)), key=lambda block: block[2]):
                if at < offset:
                    file.seek(at)
                    copy[at:offset] = file.read(offset - at)
                at = max(at, offset + held)
        if not short:
            self._copy_rows(path, np.ndarray((height, self.row_bytes), np.uint8, copy, size))
        for tag in (self.main.entries.keys() & {tiff.HEIGHT, tiff.ROWS_PER_STRIP}) if less else ():
            self._state(copy, tag, tag, height - less)
        if less and tiff.ACTIVE_AREA in self.main.entries:
            entry, kind = self.main.entries[tiff.ACTIVE_AREA]
            (at,) = struct.unpack_from(f"{self.main.order}I", copy, entry + 8)
            code, width = ("H", 2) if kind == tiff.SHORT else ("I", 4)
            struct.pack_into(self.main.order + code, copy, at + 2 * width, int(area[2]) - less)
        used = tiff.TILES if tiff.TILES[0] in self.main.values else tiff.STRIPS
        for tag in self.main.entries.keys() & {*tiff.STRIPS, *_TILE_TAGS}:
            struct.pack_into(f"{self.main.order}H", copy, self.main.entries[tag][0], _NO_TAG)
        for tag, old, value in zip(tiff.STRIPS, used, (size, length - size), strict=True):
            self._state(copy, old, tag, value)
        if self.jpeg:
            self._state(copy, tiff.COMPRESSION, tiff.COMPRESSION, tiff.UNCOMPRESSED)
        return copy, descriptor

    def _copy_rows(self, path: Path, image: NDArray[np.uint8]) -> None:
        """Copy all rows, as bytes, into an image (rows, bytes)."""
        content = np.memmap(path, np.uint8, "r")
        for top, left, offset, length in self.blocks:
            part = image[top : top + length // self.block_bytes, left : left + self.block_bytes]
            part[:] = content[offset : offset + length].reshape(-1, self.block_bytes)[:, : part.shape[1]]

    def _state(self, copy: mmap.mmap, old: int, tag: int, value: int) -> None:
        """State a number in a tag, instead of what another tag states."""
        struct.pack_into(f"{self.main.order}HHII", copy, self.main.entries[old][0], tag, _LONG, 1, value)


def _reserve_copy(length: int) -> tuple[mmap.mmap, int | None]:
    """Reserve memory of this length, as a file without a name where the system has such and lets it be so long."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("eldata-copy")
        try:
            os.ftruncate(descriptor, length)
            return mmap.mmap(descriptor, length), descriptor
        except OSError:  # ulimit -f holds for it too
            os.close(descriptor)
    return mmap.mmap(-1, length), None


def _are_one_run(extents: Sequence[tuple[int, ...]]) -> bool:
    """Tell whether strips follow one another without a gap, given offset and length of each."""
    return all(sum(extent) == offset for extent, (offset, _) in pairwise(extents))


def _find_camera_rows(path: Path, main: Directory, directories: Sequence[Directory]) -> StoredRows | None:
    """Find the rows of a camera's own mosaic: its bytes, not what it states, tell its bits, which Sony states as 14."""
    (height, width), bits = main.shape, main.number(tiff.BITS, _MOST_BITS)
    if main.held == 2 * main.pixels:
        bits = _MOST_BITS
    elif main.held != -(-width * bits // 8) * height:
        return None
    if main.compression not in (tiff.UNCOMPRESSED, _SONY) or tiff.TILES[0] in main.values:
        return None
    try:
        return _find_rows(path, main, directories, bits)
    except RawFileError:  # whatever they are, LibRaw may know them
        return None


def _find_raf_rows(path: Path, head: bytes) -> StoredRows | None:
    """Find the rows of a RAF's only mosaic: 16 bits, or fewer, packed in words of 32 bits, as its own tags say."""
    jpeg, _, _, _, start = struct.unpack_from(">5I", head, _RAF_EXTENTS[0])
    if jpeg > _RAF_SECOND and any(head[_RAF_SECOND:]):
        return None
    try:
        with path.open("rb") as file:
            file.seek(start)
            _, own = TiffReader(path, io.BytesIO(file.read(_TABLES))).read_first(tiff.FUJI_IFD)
    except RawFileError:  # whatever they are, LibRaw may know them
        return None
    values: dict[int, tiff.Numbers] = {tag: (own.number(fuji, 0),) for fuji, tag in tiff.FUJI_TAGS.items()}
    values[tiff.STRIPS[0]] = (start + values[tiff.STRIPS[0]][0],)
    rows = _find_camera_rows(path, Directory(values, own.order), ())
    if rows is None or rows.bits == _MOST_BITS:
        return rows
    in_words = rows.row_bytes % _WORD == 0 and (rows.bits == 14 or own.number(tiff.FUJI_WORDS, 0))
    return replace(rows, word_bytes=_WORD) if in_words else None


def _find_jpegs(path: Path, main: Directory) -> StoredRows | None:
    """Find the tiles of a mosaic in lossless JPEG; None of few, most of which any crop would take."""
    extents, fault = main.extents_of(tiff.TILES), ""
    if not extents and len(main.extents) > 1:
        fault = f"is a DNG in {len(main.extents)} strips of lossless JPEG, of which LibRaw decodes the first alone"
    if main.number(tiff.TILE_WIDTH, 0) > main.shape[1]:
        fault = "is a DNG whose tiles of lossless JPEG are wider than it, which LibRaw takes for rows of its own width"
    if fault:
        raise UnusableRawError(path, fault, "convert it with Adobe DNG Converter, or write narrower tiles")
    if len(extents) < _FEW_TILES:
        return None
    try:
        rows = _find_rows(path, main, (), _MOST_BITS)
        with path.open("rb") as file:
            file.seek(extents[0][0])
            stream = find_stream(file.read(min(extents[0][1], _TABLES)))
    except (RawFileError, ValueError):  # whatever they are, LibRaw may know them
        return None
    return None if rows is None or stream is None else replace(rows, jpeg=stream.code)


def _find_rows(path: Path, main: Directory, directories: Sequence[Directory], bits: int) -> StoredRows | None:
    """Find the rows of a mosaic of so many bits a pixel; None if its size or these are not known."""
    height, width = main.shape
    if not main.pixels or not 0 < bits <= _MOST_BITS:
        return None
    name, row_bytes = "strip", -(-width * bits // 8)
    extents, rows, block_bytes = main.extents_of(tiff.STRIPS), main.number(tiff.ROWS_PER_STRIP, height), row_bytes
    if tiff.TILES[0] in main.values:
        name, extents = "tile", main.extents_of(tiff.TILES)
        rows, block_bytes = main.number(tiff.TILE_HEIGHT, 0), main.number(tiff.TILE_WIDTH, 0) * bits // 8
    elif -(-height // max(rows, 1)) != len(extents) > 0 and _are_one_run(extents):  # whatever RowsPerStrip says
        extents, rows = ((extents[0][0], sum(count for _, count in extents)),), height
    if min(rows, block_bytes) < 1 or -(-height // rows) * -(-row_bytes // block_bytes) != len(extents):
        raise UnusableRawError(
            path,
            f"has {len(extents)} {name}s of {rows} rows and {block_bytes} bytes a row, which do not make up its "
            f"{height} x {width} pixels of {bits} bits",
            "write it again with tags that fit, or as one strip",
        )
    corners = product(range(0, height, rows), range(0, row_bytes, block_bytes))
    blocks = tuple(
        (top, left, offset, count if main.compression == tiff.JPEG else block_bytes * min(rows, height - top))
        for (top, left), (offset, count) in zip(corners, extents, strict=True)
    )
    short = [(*block[2:], stated) for block, (_, stated) in zip(blocks, extents, strict=True) if stated < block[3]]
    remarks = _check_short(path, directories, name, short) if short else ()
    if sum(block[3] for block in blocks) > path.stat().st_size:
        raise RawFileError(path, f"damaged: its {name}s share the same bytes")
    return StoredRows(main, bits, row_bytes, block_bytes, blocks, remarks)


def _check_short(
    path: Path, directories: Sequence[Directory], name: str, short: Sequence[tuple[int, int, int]]
) -> tuple[str, ...]:
    """Refuse strips that state fewer bytes than their rows take, unless the file has just as many bytes there.

    Up to what it declares next, or its end: then it is whole, and its writer counted wrong, which is remarked on.
    """
    starts = {path.stat().st_size}
    for directory in directories:
        starts |= {*directory.starts, *(offset for offset, _ in directory.extents)}
    following = sorted(starts)
    for offset, needed, stated in short:
        room = following[bisect_right(following, offset, hi=len(following) - 1)] - offset
        text = f"its {name} at byte {offset} states {stated} bytes, and its rows take {needed}"
        if not 0 <= room - needed < _MOST_PADDING:
            raise RawFileError(
                path,
                f"{'truncated' if room < needed else 'damaged'}: {text}; the file has {room} bytes there before "
                "something else, so which of them are pixels is not known: copy it again, or correct the byte count",
            )
    return (f"{text}: all are read, since the file has just as many there",)


# --- files that cannot be used ----------------------------------------------------------------------------------------
# A mosaic is one plane of whole numbers in order, with one black level for each channel of its CFA. The DNG
# specification (1.7.1) allows more: LibRaw does not decode that, or as other pixels than are meant. LibRaw also takes
# the colours of a declared pattern of 4 x 4 for one of 8 x 2: it may come out as Bayer.

NEEDED = "a mosaic of a Bayer, quad-Bayer, nona-Bayer or X-Trans sensor is needed"

_STATE = "state them in the mosaics of its set's card (docs/manifests.md)"
_ARRAY = ("is an array, which states no colour filter array and neither black nor white level", _STATE)
_BY_HEAD = {
    **dict.fromkeys((b"\x93NUM", b"MATL", b"\x89HDF"), _ARRAY),
    b"FOVb": ("is a Sigma X3F, whose Foveon sensor has no colour filter array", NEEDED),
    b"\xff\xd8\xff": ("is a JPEG picture whatever its name says", "use the raw file that the camera wrote with it"),
    b"PK\x03\x04": ("is a ZIP archive (Capture One's EIP is one)", "unpack it and use the raw file inside"),
    b"II\x1a\0\0\0HEAPCCDR": ("is a CRW (Canon's CIFF), which has no EXIF", "convert it with Adobe DNG Converter"),
}
_GREY_TIFF = (
    "is a grey TIFF, which states no colour filter array and neither black nor white level",
    f"use the camera's raw file, or {_STATE}",
)
# What only a camera's raw file has in a directory: a DNG's version, a CFA, and Kodak's, Leaf's, Imacon's, Sinar's and
# Hasselblad's own tags, by which LibRaw knows raws that call themselves grey.
_OF_CAMERAS = frozenset(
    (
        *(tiff.DNG_VERSION, tiff.CFA_REPEAT, tiff.CFA_PATTERN, 33405, 33424, *range(34303, 34311), 46275, 46279),
        *(50454, 50455, 50458, 50459, 61450, 64772, 65024, 65026),
    )
)
_GREY = (0, 1)  # of tiff.PHOTOMETRIC: white or black at 0

_WRITE = "read its pixels with tifffile and write a DNG whose mosaic is one uint16 plane (eldata.raw.write_dng)"
_NO_JPEG_XL = "convert it to a DNG of a version before 1.7 (Compatibility in Adobe DNG Converter), which has no JPEG XL"
_NO_DEFLATE = "convert it to one with lossless JPEG compression or without any (Adobe DNG Converter)"
_NO_GPR = "convert it to DNG with GoPro's gpr_tools (gpr_tools -i NAME.GPR -o NAME.DNG; github.com/gopro/gpr)"
# A mosaic's tag; which of its numbers are refused (none: every one but 1, which counts where the tag is not there);
# what is said, what to do.
_REFUSED: tuple[tuple[int, tuple[int, ...], str, str], ...] = (
    (tiff.SAMPLE_FORMAT, (3,), "has pixels that are floating-point numbers (its SampleFormat is {})", _WRITE),
    (tiff.COMPRESSION, (tiff.JPEG_XL,), "has pixels in JPEG XL (its Compression is {})", _NO_JPEG_XL),
    (tiff.COMPRESSION, (8, 32946), "is a DNG of whole numbers in Deflate compression", _NO_DEFLATE),
    (tiff.COMPRESSION, (9,), "is a GPR (GoPro, VC-5 compression)", _NO_GPR),
    (tiff.SAMPLES, (), "has several samples of each pixel, as of dual pixels (its SamplesPerPixel is {})", _WRITE),
    (tiff.ROW_INTERLEAVE, (), "has interleaved rows (its RowInterleaveFactor is {})", _WRITE),
    (tiff.COLUMN_INTERLEAVE, (), "has interleaved columns (its ColumnInterleaveFactor is {})", _WRITE),
    (tiff.CFA_LAYOUT, (), "unsupported colour filter array: its CFALayout is {} (staggered, as a Super CCD's)", NEEDED),
)
_OF_ANY_IMAGE = _REFUSED[:2]  # demosaiced ones too: LibRaw makes other numbers of floats


def refuse_unsupported(container: RawContainer) -> None:
    """Refuse a file that is known not to work, from its first bytes and its directories (of a TIFF-based file).

    Raises
    ------
    UnusableRawError
        If the file is of a kind, a compression, a layout or a colour filter array that cannot be used; it says which.
    """
    path, directories = container.path, container.directories
    for magic, of_kind in _BY_HEAD.items():
        if container.head.startswith(magic):
            raise UnusableRawError(path, *of_kind)
    if _is_grey_tiff(directories):
        raise UnusableRawError(path, *_GREY_TIFF)
    mosaics = tiff.main_mosaics(directories)
    if not mosaics:
        if tiff.is_dng(directories):
            _refuse_layout(path, max(directories, key=lambda image: image.pixels), _OF_ANY_IMAGE)
        return
    main = mosaics[0]
    _refuse_layout(path, main, _REFUSED)
    if len(mosaics) > 1:
        text = f"holds {len(mosaics)} mosaics of one size (PhotometricInterpretation 32803), as of a pixel shift"
        raise UnusableRawError(path, text, _WRITE)
    if tiff.is_dng(directories):
        _refuse_black(path, main)
    pattern = main.cfa_letters  # without one LibRaw's word counts
    monochrome = pattern is not None and len(set("".join(pattern))) == 1  # said of the decoded samples
    if pattern is not None and not monochrome and cfa_of_letters(pattern) is None:
        raise make_cfa_error(path, pattern)


def _refuse_layout(path: Path, image: Directory, refused: tuple[tuple[int, tuple[int, ...], str, str], ...]) -> None:
    """Refuse an image by its tags' numbers: the listed ones of each tag or, with none listed, all but 1."""
    for tag, numbers, text, advice in refused:
        number = image.number(tag, 1)
        if number in numbers or (not numbers and number != 1):
            raise UnusableRawError(path, text.format(number), advice)


def _refuse_black(path: Path, main: Directory) -> None:
    """Refuse a DNG whose black level is not stated by the site of the CFA."""
    levels, expected = main.values.get(tiff.BLACK_LEVEL, ()), math.prod(main.black_repeat)
    if len(levels) not in (0, expected):
        raise UnusableRawError(
            path,
            f"its BlackLevel has {counted(len(levels), 'number')}, expected {expected} by its BlackLevelRepeatDim: "
            "which is of which pixel is not known",
            "write it again with a BlackLevelRepeatDim that fits, such as 2 2 for four levels",
        )
    for tag, name in zip(tiff.BLACK_DELTAS, ("BlackLevelDeltaH", "BlackLevelDeltaV"), strict=True):
        if any(main.values.get(tag, ())):
            raise UnusableRawError(path, f"has a black level that differs by row or column (its {name})", _WRITE)
    if not levels and main.values.get(tiff.MASKED_AREAS):
        raise UnusableRawError(
            path,
            "states no BlackLevel, only the MaskedAreas to measure it in",
            "measure it there and state it (exiftool -SubIFD:BlackLevel=64 NAME.dng, or -IFD0:BlackLevel)",
        )


def _is_grey_tiff(directories: Sequence[Directory]) -> bool:
    """Whether the largest image of a TIFF-based file is grey, and nothing says that a camera wrote it as raw."""
    largest = max(directories, key=lambda image: image.pixels, default=Directory({}))
    by_camera = any(_OF_CAMERAS & directory.entries.keys() for directory in directories)
    return largest.pixels > 0 and not by_camera and largest.number(tiff.PHOTOMETRIC, -1) in _GREY


def make_cfa_error(path: Path, rows: Sequence[str]) -> UnusableRawError:
    """Make the error of a colour filter array, one period of it in letters by row, that cannot be used."""
    colours = "".join(sorted(set("".join(rows))))
    size = f"{len(rows)} x {len(rows[0]) if rows else 0}"
    return UnusableRawError(path, f"unsupported colour filter array: {size} sites of {colours}", NEEDED)


# --- lossy compression ------------------------------------------------------------------------------------------------


def lossy_compression(path: Path) -> str | None:
    """Name a raw file's lossy compression; ``None`` if it has none that is known.

    Known are Sony's compressed ARW 2 (one byte per pixel: 11 of 14 bits by a curve, differences within 16 pixels) and
    the lossy JPEG of DNG. Nikon's lossy NEF says so in its maker notes alone, Canon's CRAW in a container that is not
    TIFF: the gaps that such compression leaves between the values show it.

    Raises
    ------
    RawFileError
        If the file is truncated or damaged.
    """
    for directory in tiff.read_directories(path):
        if directory.is_mosaic and directory.compression == _SONY and directory.held == directory.pixels:
            return "Sony's lossy compression (choose uncompressed raw in the camera)"
        if directory.is_mosaic and directory.compression == _LOSSY_JPEG:
            return "a DNG's lossy JPEG compression (convert from the original without it)"
    return None
