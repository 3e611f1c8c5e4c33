"""Compiled loops of CFA packing.

A site table says where each site of one CFA period goes: rows of (mosaic row, mosaic column, channel, packed
row, packed column), with ``period`` the CFA's size and ``sub`` the packed image's share of it (2 for X-Trans, else 1).
The Bayer loops are written out for their constant stride of two, which the compiler vectorises; what they do not
serve, numpy copies as fast (:mod:`eldata.raw.levels`). For them, and where mosaics are turned, each row of the mosaic
and of the packed channels is contiguous in memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import contiguous, kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray


@kernel
def gather_bayer(mosaic: NDArray[Any], packed: NDArray[Any], channel: NDArray[np.int64]) -> None:
    """Fill ``packed`` (4, h, w) from a Bayer ``mosaic``; ``channel`` (2, 2) names the packed channel of each site.

    The two columns of a cell stand in one loop: that is vector code, of four times the speed.
    """
    for i in range(packed.shape[1]):
        for y in range(2):
            source = contiguous(mosaic[2 * i + y])
            even, odd = contiguous(packed[channel[y, 0], i]), contiguous(packed[channel[y, 1], i])
            for j in range(packed.shape[2]):
                even[j] = source[2 * j]
                odd[j] = source[2 * j + 1]


@kernel
def scatter_bayer(
    packed: NDArray[Any], top: int, left: int, channel: NDArray[np.int64], scale: Any, mosaic: NDArray[Any]
) -> None:
    """Fill a Bayer mosaic from the part of ``packed`` that begins at (top, left), times ``scale``.

    ``channel`` (2, 2) names the packed channel of each site. The whole array comes with the part's place, for the
    compiler does not know that the rows of a part are contiguous.
    """
    for i in range(mosaic.shape[0] // 2):
        for y in range(2):
            even, odd = packed[channel[y, 0], top + i], packed[channel[y, 1], top + i]
            even, odd = even[left:], odd[left:]
            target = mosaic[2 * i + y]
            for j in range(mosaic.shape[1] // 2):
                target[2 * j] = even[j] * scale
                target[2 * j + 1] = odd[j] * scale


@kernel
def pack_bayer_normalised(
    mosaic: NDArray[Any], packed: NDArray[np.float32], channel: NDArray[np.int64], black: NDArray[np.float32],
    white: np.float32, low: np.float32, high: np.float32, gain: np.float32,
) -> None:  # fmt: skip
    """Pack and normalise a Bayer mosaic: clip(gain * clip((DN - black) / (white - black))) in float32.

    ``channel`` (2, 2) names the packed channel of each site, ``black`` (4,) has one entry per packed channel. A
    non-negative gain cannot undo the lower clip, so only the upper one is repeated. Dividing, not multiplying by
    a reciprocal, keeps the published loaders' bits. Both columns of a cell stand in one loop and the limits are
    comparisons, not min() and max(): that is what the compiler turns into vector code. In this order they let NaN and
    -0 through.
    """
    for i in range(packed.shape[1]):
        for y in range(2):
            source = contiguous(mosaic[2 * i + y])
            even = packed[channel[y, 0], i]
            odd = packed[channel[y, 1], i]
            black_even, black_odd = black[channel[y, 0]], black[channel[y, 1]]
            span_even, span_odd = white - black_even, white - black_odd
            for j in range(packed.shape[2]):
                value = (np.float32(source[2 * j]) - black_even) / span_even
                value = low if value < low else value
                value = high if value > high else value
                value = value * gain
                even[j] = high if value > high else value
                value = (np.float32(source[2 * j + 1]) - black_odd) / span_odd
                value = low if value < low else value
                value = high if value > high else value
                value = value * gain
                odd[j] = high if value > high else value


@kernel
def pack_sites_normalised(
    mosaic: NDArray[Any], packed: NDArray[np.float32], sites: NDArray[np.int64], period: int, sub: int,
    black: NDArray[np.float32], white: np.float32, low: np.float32, high: np.float32, gain: np.float32,
) -> None:  # fmt: skip
    """:func:`pack_bayer_normalised` for larger periods: each row is normalised in one vector loop, then distributed."""
    periods = packed.shape[2] // sub
    width = periods * period
    row_black = np.empty((period, width), np.float32)
    for k in range(sites.shape[0]):
        row_black[sites[k, 0], sites[k, 1] :: period] = black[sites[k, 2]]
    row = np.empty(width, np.float32)
    for i in range(packed.shape[1] // sub):
        for y in range(period):
            source = mosaic[period * i + y]
            zero = row_black[y]
            for j in range(width):
                value = (np.float32(source[j]) - zero[j]) / (white - zero[j])
                value = low if value < low else value
                value = high if value > high else value
                value = value * gain
                row[j] = high if value > high else value
            for k in range(period * y, period * (y + 1)):  # the sites are listed row by row
                target = packed[sites[k, 2], sub * i + sites[k, 3]]
                column, x = sites[k, 1], sites[k, 4]
                for j in range(periods):
                    target[x + sub * j] = row[column + period * j]


@kernel
def mirror(source: NDArray[Any], target: NDArray[Any], flip_rows: bool, flip_columns: bool) -> None:
    """Fill ``target`` with the top left part of ``source`` flipped: with (True, True) of ``source[::-1, ::-1]``."""
    rows, columns = source.shape
    for y in range(target.shape[0]):
        row = contiguous(source[rows - 1 - y if flip_rows else y])
        out = target[y]
        if flip_columns:
            for x in range(target.shape[1]):
                out[x] = row[np.uint64(columns - 1 - x)]  # unsigned: the compiler sees that none is negative
        else:
            for x in range(target.shape[1]):
                out[x] = row[x]


@kernel
def transpose(source: NDArray[Any], target: NDArray[Any], flip_rows: bool, flip_columns: bool) -> None:
    """Fill ``target`` with the top left part of ``source`` transposed and then flipped.

    Eight rows are read side by side: as many cache lines as the first cache holds at any distance between rows, and
    eight pixels to write together. Four times as fast as a copy of the transposed view.
    """
    height, width = target.shape
    first, down = source.shape[0] - 1 if flip_columns else 0, -1 if flip_columns else 1
    last = source.shape[1] - 1
    whole = width - width % 8
    for x in range(0, whole, 8):
        for y in range(height):
            column = np.uint64(last - y if flip_rows else y)  # unsigned, as above
            for k in range(8):
                target[y, np.uint64(x + k)] = source[np.uint64(first + down * (x + k)), column]
    for x in range(whole, width):
        for y in range(height):
            target[y, x] = source[first + down * x, last - y if flip_rows else y]


@kernel
def unpack_bits(stored: NDArray[np.uint8], bits: int, swap: int, first: int, out: NDArray[np.uint16]) -> None:
    """Fill ``out`` with pixels of ``bits`` bits each, highest first, from pixel ``first`` of each row of bytes on.

    ``swap``: what each byte's place is XORed with: 3 for words of four bytes, the lowest first; 0 for bytes in order.
    """
    length, mask = stored.shape[1], (1 << bits) - 1
    for y in range(out.shape[0]):
        row = stored[y]
        for x in range(out.shape[1]):
            place = (first + x) * bits
            at = place >> 3
            value = row[at ^ swap] << 16  # up to 16 bits lie in three bytes
            if at + 1 < length:
                value |= row[(at + 1) ^ swap] << 8
            if at + 2 < length:
                value |= row[(at + 2) ^ swap]
            out[y, x] = (value >> (24 - bits - (place & 7))) & mask
