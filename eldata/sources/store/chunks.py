"""Chunks that are not compressed, read by their place in the file.

HDF5 reads under one lock, whole chunks. Where they lie it says once; then threads read the wanted rows side by side,
in half the time. What is compressed, or has another byte order, HDF5 reads.
"""

from __future__ import annotations

import os
import sys
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import h5py
    from numpy.typing import NDArray

_PIXEL_BYTES = 2


class ChunkError(ValueError):
    """A chunk does not hold what it should."""


@dataclass(frozen=True, slots=True, eq=False)
class ChunkTable:
    """Where the chunks of one frame lie in the file.

    Attributes
    ----------
    height, width
        Of a whole chunk; those at the edges are as large.
    offsets, sizes
        First byte and number of bytes of each chunk, (planes, rows of chunks, columns of chunks).
    """

    height: int
    width: int
    offsets: NDArray[np.int64]
    sizes: NDArray[np.int64]


def chunk_table(dataset: h5py.h5d.DatasetID) -> ChunkTable | None:
    """Return where a frame's chunks lie; ``None`` if only HDF5 can read them."""
    properties = dataset.get_create_plist()
    if properties.get_nfilters() or dataset.dtype != np.dtype("<u2") or sys.byteorder != "little":
        return None
    *planes, height, width = dataset.shape
    *_, chunk_height, chunk_width = properties.get_chunk()
    shape = (planes[0] if planes else 1, -(-height // chunk_height), -(-width // chunk_width))
    offsets, sizes = np.zeros(shape, np.int64), np.zeros(shape, np.int64)

    def note(chunk: Any) -> None:
        *plane, top, left = chunk.chunk_offset
        place = plane[0] if plane else 0, top // chunk_height, left // chunk_width
        offsets[place], sizes[place] = chunk.byte_offset, chunk.size

    dataset.chunk_iter(note)
    return ChunkTable(chunk_height, chunk_width, offsets, sizes)


def read_part(
    descriptor: int, table: ChunkTable, plane: int, rows: range, columns: range, pixels: NDArray[np.uint16]
) -> None:
    """Fill ``pixels`` (rows, columns) with a part of one plane of a frame.

    Raises
    ------
    ChunkError
        If a chunk is missing or cut off.
    OSError
        If the file cannot be read.
    """
    for chunk_row in range(rows.start // table.height, -(-rows.stop // table.height)):
        top = chunk_row * table.height
        first, last = max(rows.start - top, 0), min(rows.stop - top, table.height)
        above = pixels[top + first - rows.start : top + last - rows.start]
        for chunk_column in range(columns.start // table.width, -(-columns.stop // table.width)):
            left = chunk_column * table.width
            begin, end = max(columns.start - left, 0), min(columns.stop - left, table.width)
            part = _rows(descriptor, table, (plane, chunk_row, chunk_column), first, last)
            above[:, left + begin - columns.start : left + end - columns.start] = part[:, begin:end]


def _rows(descriptor: int, table: ChunkTable, place: tuple[int, int, int], first: int, last: int) -> NDArray[np.uint16]:
    """Read the rows of a chunk from ``first`` to ``last`` into memory that the thread's next call overwrites."""
    row_bytes = table.width * _PIXEL_BYTES
    if table.sizes[place] != table.height * row_bytes:
        raise ChunkError(f"a chunk of {table.sizes[place]} bytes, expected {table.height * row_bytes}")
    length = (last - first) * row_bytes
    scratch: NDArray[np.uint8] | None = getattr(_OF_THREAD, "bytes", None)
    if scratch is None or scratch.size < length:
        scratch = _OF_THREAD.bytes = np.empty(length, np.uint8)
    offset, done = int(table.offsets[place]) + first * row_bytes, 0
    while done < length:
        count = os.preadv(descriptor, [scratch.data[done:length]], offset + done)
        if count == 0:
            raise ChunkError("a chunk beyond the end of the file")
        done += count
    return scratch[:length].view(np.uint16).reshape(last - first, table.width)


_OF_THREAD = threading.local()
