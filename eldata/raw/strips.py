"""The rows of a DNG's uncompressed mosaic, by the offsets of its strips or tiles.

LibRaw takes all strips for one run of bytes that begins where the first does, whatever their offsets and byte counts
say, and a single tile for rows of the image. :meth:`StoredRows.rearrange` gives it the same file with its rows in one
run.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eldata.errors import RawFileError, UnusableRawError
from eldata.raw import tiff

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.raw.tiff import Directory

_MOST_BITS = 16
_MOST_PADDING = 16  # bytes that a writer may leave so that what follows begins at a whole number of words
_NO_TAG, _LONG = 0xFFFF, 4
_TILE_TAGS = {tiff.TILE_WIDTH, tiff.TILE_HEIGHT, *tiff.TILES}


class Block(NamedTuple):
    """A strip or a tile: its first row and byte of a row in the image; where it begins in the file; bytes of rows."""

    top: int
    left: int
    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class StoredRows:
    """Where the rows of a mosaic stand in its file.

    Attributes
    ----------
    main
        The mosaic's directory.
    row_bytes, block_bytes
        Bytes of a row of pixels, which begins at a whole byte, and of a row of a strip or tile.
    blocks
        Its strips or tiles, row by row of the image.
    remarks
        What there is to say of byte counts that are too small.
    """

    main: Directory
    row_bytes: int
    block_bytes: int
    blocks: tuple[Block, ...]
    remarks: tuple[str, ...]

    @property
    def are_found(self) -> bool:
        """Whether LibRaw finds them all by itself."""
        tags = self.main.entries.keys()
        if self._are_tiles:
            return len(self.blocks) > 1 and tiff.STRIPS[0] not in tags
        return not tags & _TILE_TAGS and _are_one_run([(block.offset, block.length) for block in self.blocks])

    @property
    def _are_tiles(self) -> bool:
        return tiff.TILES[0] in self.main.values

    def gather(self, content: bytes | bytearray) -> NDArray[np.uint8]:
        """Return the rows, (H, bytes of a row), of the whole file's bytes."""
        image = np.empty((self.main.shape[0], self.row_bytes), np.uint8)
        for top, left, offset, length in self.blocks:
            block = np.frombuffer(content, np.uint8, length, offset).reshape(-1, self.block_bytes)
            part = image[top : top + len(block), left : left + self.block_bytes]
            part[:] = block[:, : part.shape[1]]
        return image

    def rearrange(self, content: bytes | bytearray) -> bytes:
        """Return the whole file's bytes with the rows once more at the end, as its one strip."""
        rows, copy, entries = self.gather(content).tobytes(), bytearray(content), self.main.entries
        used = tiff.TILES if self._are_tiles else tiff.STRIPS
        for tag in entries.keys() & {*tiff.STRIPS, *_TILE_TAGS}:
            struct.pack_into(f"{self.main.order}H", copy, entries[tag][0], _NO_TAG)
        for tag, old, value in zip(tiff.STRIPS, used, (len(copy), len(rows)), strict=True):
            struct.pack_into(f"{self.main.order}HHII", copy, entries[old][0], tag, _LONG, 1, value)
        return bytes(copy) + rows


def _are_one_run(extents: Sequence[tuple[int, int]]) -> bool:
    return all(sum(extent) == offset for extent, (offset, _) in pairwise(extents))


def find_rows(path: Path, directories: Sequence[Directory]) -> StoredRows | None:
    """Return where the rows of a DNG's uncompressed mosaic stand; None of any other file.

    Raises
    ------
    RawFileError
        If its strips or tiles are not as many as its size takes or share bytes; or if their byte counts are less than
        their rows take, and something else than these rows follows.
    """
    main = next(iter(tiff.main_mosaics(directories)), None)
    if main is None or not tiff.is_dng(directories) or main.compression != tiff.UNCOMPRESSED:
        return None
    (height, width), bits = main.shape, main.number(tiff.BITS, _MOST_BITS)
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
        Block(top, left, offset, block_bytes * min(rows, height - top))
        for (top, left), (offset, _) in zip(corners, extents, strict=True)
    )
    short = [(block, stated) for block, (_, stated) in zip(blocks, extents, strict=True) if stated < block.length]
    remarks = _check_short(path, directories, name, short) if short else ()
    if sum(block.length for block in blocks) > path.stat().st_size:
        raise RawFileError(path, f"damaged: its {name}s share the same bytes")
    return StoredRows(main, row_bytes, block_bytes, blocks, remarks)


def _check_short(
    path: Path, directories: Sequence[Directory], name: str, short: Sequence[tuple[Block, int]]
) -> tuple[str, ...]:
    """Refuse strips that state fewer bytes than their rows take, unless the file has just as many bytes there.

    Up to what it declares next, or its end: then it is whole, and its writer counted wrong, which is remarked on.
    """
    starts = sorted(
        {start for one in directories for start in (*one.starts, *(offset for offset, _ in one.extents))}
        | {path.stat().st_size}
    )
    for block, stated in short:
        room = starts[bisect_right(starts, block.offset, hi=len(starts) - 1)] - block.offset
        found = f"its {name} at byte {block.offset} states {stated} bytes, and its rows take {block.length}"
        if not 0 <= room - block.length < _MOST_PADDING:
            raise RawFileError(
                path,
                f"{'truncated' if room < block.length else 'damaged'}: {found}; the file has {room} bytes there before "
                "something else, so which of them are pixels is not known: copy it again, or correct the byte count",
            )
    return (f"{found}: all are read, since the file has just as many there",)
