"""Chunks of a frame, read by their place in the file and decoded outside of HDF5.

HDF5 reads under one lock and decodes whole chunks. Where they lie it says once; then threads read and decode side by
side, and of a compressed chunk only those blocks that hold wanted rows. What this does not know (a filter, a byte
order), HDF5 reads.

Through h5py alone this file would be half as long. It stays because HDF5's bitshuffle filter believes what a chunk says
of itself: of 22 chunks whose sizes or blocks lie, 10 ended the process (SIGSEGV); here those 22 are errors (a test has
them). And for its time: in a DataLoader's workers h5py takes 1.4 times as much without compression, 1.25 times with lz4
and zstd; imagecodecs' decoders, which are as careful, take 1.5 and 1.14 times as long (docs/training.md).
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.memory import scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import h5py
    from numpy.typing import NDArray

    Decoder = Callable[[int, int, int, int, int], int]

_PIXEL_BYTES = 2
_BITSHUFFLE = 32008  # HDF5's registered number of the filter; its fifth parameter is the compression
_CODECS = {2: "bshuf_decompress_lz4", 3: "bshuf_decompress_zstd"}
_HEADER = struct.Struct(">QI")  # bytes of the chunk decoded, bytes of a block decoded
_BLOCK = struct.Struct(">I")  # bytes of the block that follows
_GROUP = 8  # pixels that bitshuffle takes together; what is left at a chunk's end stands as it is


class ChunkError(ValueError):
    """A chunk does not hold what it should."""


@dataclass(frozen=True, slots=True, eq=False)
class ChunkTable:
    """Where the chunks of one frame lie in the file, and how they are decoded.

    Attributes
    ----------
    height, width
        Of a whole chunk; those at the edges are as large.
    offsets, sizes
        First byte and number of bytes of each chunk, (planes, rows of chunks, columns of chunks).
    decode
        ``None`` if they are not compressed.
    """

    height: int
    width: int
    offsets: NDArray[np.int64]
    sizes: NDArray[np.int64]
    decode: Decoder | None


def chunk_table(dataset: h5py.h5d.DatasetID) -> ChunkTable | None:
    """Return where a frame's chunks lie; ``None`` if only HDF5 can read them."""
    properties = dataset.get_create_plist()
    filters = [properties.get_filter(number) for number in range(properties.get_nfilters())]
    decode = None
    if filters:
        number, _, values, _ = filters[0]
        if len(filters) > 1 or number != _BITSHUFFLE or len(values) < 5 or values[4] not in _CODECS:
            return None
        decode = _decoder(_CODECS[values[4]])
        if decode is None:
            return None
    if dataset.dtype != np.dtype("<u2") or sys.byteorder != "little" or not hasattr(os, "preadv"):
        return None
    *planes, height, width = dataset.shape
    *_, chunk_height, chunk_width = properties.get_chunk()
    shape = (planes[0] if planes else 1, -(-height // chunk_height), -(-width // chunk_width))
    offsets, sizes = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    skipped = []

    def note(chunk: Any) -> None:
        *plane, top, left = chunk.chunk_offset
        place = plane[0] if plane else 0, top // chunk_height, left // chunk_width
        offsets[place], sizes[place] = chunk.byte_offset, chunk.size
        if chunk.filter_mask:
            skipped.append(chunk)

    dataset.chunk_iter(note)
    return None if skipped else ChunkTable(chunk_height, chunk_width, offsets, sizes, decode)


@cache
def _decoder(name: str) -> Decoder | None:
    """Return a function of the library that hdf5plugin registers with HDF5, if it lets others call it."""
    import hdf5plugin

    for path in sorted(Path(hdf5plugin.PLUGIN_PATH).glob("libh5bshuf.*")):
        try:
            function = getattr(ctypes.CDLL(str(path)), name)
        except (OSError, AttributeError):
            continue
        function.restype = ctypes.c_int64
        # Source, target, pixels, bytes of a pixel, pixels of a block; bytes read, or below 0. It releases the GIL.
        function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t, ctypes.c_size_t]
        decode: Decoder = function
        return decode
    return None


def read_parts(
    descriptor: int, table: ChunkTable, plane: int, rows: range, columns: range
) -> Iterator[tuple[int, int, NDArray[np.uint16]]]:
    """Yield a part of one plane of a frame, chunk by chunk: row and column in the part, and the pixels.

    These lie in memory that the next ones of this thread overwrite: a chunk fits into the cache.

    Raises
    ------
    ChunkError
        If a chunk is missing, cut off or cannot be decoded.
    OSError
        If the file cannot be read.
    """
    chunk_rows = range(rows.start // table.height, -(-rows.stop // table.height))
    chunk_columns = range(columns.start // table.width, -(-columns.stop // table.width))
    wanted = plane, slice(chunk_rows.start, chunk_rows.stop), slice(chunk_columns.start, chunk_columns.stop)
    offsets, sizes = table.offsets[wanted].tolist(), table.sizes[wanted].tolist()
    for chunk_row, offsets_of_row, sizes_of_row in zip(chunk_rows, offsets, sizes, strict=True):
        top = chunk_row * table.height
        first, last = max(rows.start - top, 0), min(rows.stop - top, table.height)
        for chunk_column, offset, size in zip(chunk_columns, offsets_of_row, sizes_of_row, strict=True):
            left = chunk_column * table.width
            begin, end = max(columns.start - left, 0), min(columns.stop - left, table.width)
            if table.decode is None:
                part = _stored_rows(descriptor, table, offset, size, first, last)
            else:
                part = _decoded_rows(descriptor, table, table.decode, offset, size, first, last)
            yield top + first - rows.start, left + begin - columns.start, part[:, begin:end]


def read_part(
    descriptor: int, table: ChunkTable, plane: int, rows: range, columns: range, pixels: NDArray[np.uint16]
) -> None:
    """Fill ``pixels`` (rows, columns) with a part of one plane of a frame; raises like :func:`read_parts`."""
    for top, left, part in read_parts(descriptor, table, plane, rows, columns):
        pixels[top : top + part.shape[0], left : left + part.shape[1]] = part


def _stored_rows(
    descriptor: int, table: ChunkTable, offset: int, size: int, first: int, last: int
) -> NDArray[np.uint16]:
    row_bytes = table.width * _PIXEL_BYTES
    if size != table.height * row_bytes:
        raise ChunkError(f"a chunk of {size} bytes, expected {table.height * row_bytes}")
    length = (last - first) * row_bytes
    content = scratch("stored", length).bytes[:length]
    _read(descriptor, content, offset + first * row_bytes)
    return content.view(np.uint16).reshape(-1, table.width)


def _decoded_rows(
    descriptor: int, table: ChunkTable, decode: Decoder, offset: int, size: int, first: int, last: int
) -> NDArray[np.uint16]:
    """Decode the blocks of a chunk that hold its rows from ``first`` to ``last``."""
    source = scratch("stored", size)
    content = source.bytes[:size]
    _read(descriptor, content, offset)
    count = table.height * table.width
    if size < _HEADER.size:
        raise ChunkError(f"a chunk of {size} bytes")
    whole, block_bytes = _HEADER.unpack_from(content.data)
    block = block_bytes // _PIXEL_BYTES
    if whole != count * _PIXEL_BYTES or block < _GROUP or block % _GROUP:
        raise ChunkError(f"a chunk of {whole} bytes in blocks of {block_bytes}, expected {count * _PIXEL_BYTES}")
    starts = _block_starts(content, count, block)
    from_block = first * table.width // block
    to_block = min(-(-last * table.width // block), count // block)
    is_end = last * table.width > to_block * block  # the shorter block and the rest after it
    wanted = count - from_block * block if is_end else (to_block - from_block) * block
    length = size - starts[from_block] if is_end else starts[to_block] - starts[from_block]
    target = scratch("decoded", count * _PIXEL_BYTES)
    done = decode(source.address + starts[from_block], target.address, wanted, _PIXEL_BYTES, block)
    if done != length:
        raise ChunkError(f"a chunk that cannot be decoded ({done})")
    pixels = target.bytes.view(np.uint16)
    skipped = first * table.width - from_block * block
    return pixels[skipped : skipped + (last - first) * table.width].reshape(last - first, table.width)


def _block_starts(content: NDArray[np.uint8], count: int, block: int) -> list[int]:
    """Return where each block begins, and where the last whole one ends; all of them lie inside of the chunk.

    The decoder believes the sizes that it finds, so they are looked at before.
    """
    starts = [_HEADER.size]
    sizes = [block] * (count // block)
    rest = count % block
    if rest >= _GROUP:
        sizes.append(rest)
    for _ in sizes:
        if starts[-1] + _BLOCK.size > len(content):
            raise ChunkError("a chunk that is cut off")
        starts.append(starts[-1] + _BLOCK.size + _BLOCK.unpack_from(content.data, starts[-1])[0])
    if starts[-1] + rest % _GROUP * _PIXEL_BYTES != len(content):
        raise ChunkError(f"a chunk of {len(content)} bytes whose blocks take {starts[-1]}")
    return starts[: count // block + 1]


def _read(descriptor: int, target: NDArray[np.uint8], offset: int) -> None:
    done = os.preadv(descriptor, [target.data], offset)
    while done < len(target):
        count = os.preadv(descriptor, [target[done:].data], offset + done)
        if count == 0:
            raise ChunkError("a chunk beyond the end of the file")
        done += count
