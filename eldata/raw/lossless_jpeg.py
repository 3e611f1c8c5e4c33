"""JPEG streams of raw image data (ITU-T T.81): where they end, and whether their pixels end there too.

DNG and CR2 files hold mosaics as lossless JPEG (process 14). LibRaw decodes as many differences as there are pixels and
looks at nothing else, so a stream that was damaged in the middle, or that breaks off, gives a whole frame of wrong
pixels. A stream says more: which bytes may follow 0xFF, where it ends, and, once it is walked code by code, whether its
last pixel ends where the stream does. Codes have different lengths, so damage moves that end.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

SOI = b"\xff\xd8"
_EOI = 0xD9
_SOF3, _DHT, _SOS, _DRI = 0xC3, 0xC4, 0xDA, 0xDD
_FRAMES = {*range(0xC0, 0xD0)} - {_DHT, 0xC8, 0xCC}
MOST_HEADER = 1 << 16
_MOST_SLACK = 3  # bytes between the last code and the end marker: an encoder may align to words of 4 bytes
_LEAST_TAIL = 16
_PIECE = 1 << 20  # bytes looked at together: a frame at once takes a worker 12 MB more


@dataclass(frozen=True, slots=True)
class Code:
    """A Huffman code of differences: how many codes there are of 1 to 16 bits, and what they mean, in order."""

    counts: bytes
    symbols: bytes

    @property
    def zeros_mean_no_difference(self) -> bool:
        """Whether zero bits stand for pixels that equal their neighbours, as in clipped areas."""
        return self.symbols[0] == 0

    def table(self) -> NDArray[np.uint16]:
        """Return, for each 16 bits that may come next, 256 times the code's length plus its meaning; 0: no code."""
        table = np.zeros(1 << 16, np.uint16)
        at, index = 0, 0
        for length, count in enumerate(self.counts, 1):
            for symbol in self.symbols[index : index + count]:
                table[at : at + (1 << (16 - length))] = length << 8 | symbol
                at += 1 << (16 - length)
            index += count
        return table


@dataclass(frozen=True)
class Stream:
    """The lossless JPEG of one strip or tile.

    Attributes
    ----------
    content
        Its bytes, (n,) uint8.
    start
        Where in them the codes begin.
    samples
        Rows times columns times components.
    codes
        One a component.
    restart_interval
        Pixels between restart markers; 0: there are none.
    """

    content: NDArray[np.uint8]
    start: int
    samples: int
    codes: tuple[Code, ...]
    restart_interval: int

    @cached_property
    def marker(self) -> tuple[int, int] | None:
        """Position and value of the first marker behind the codes, which must be the end's; None: there is no marker.

        Among the codes 0xFF is followed by 0x00, or is part of a restart marker.
        """
        inside = self.content[self.start :]
        for begin in range(0, len(inside) - 1, _PIECE):
            piece = inside[begin : begin + _PIECE + 1]
            at = np.flatnonzero(piece[:-1] == 0xFF)
            following = piece[at + 1]
            other = np.flatnonzero((following != 0) & ((following < 0xD0) | (following > 0xD7)))
            if len(other):
                break
        else:
            return None
        first = begin + int(at[other[0]])
        while first + 2 < len(inside) and inside[first + 1] == 0xFF:  # it may be repeated before a marker
            first += 1
        return self.start + first, int(inside[first + 1])

    @property
    def end(self) -> int:
        """Position behind the codes."""
        return len(self.content) if self.marker is None else self.marker[0]

    def fault(self) -> tuple[int, str] | None:
        """Return what its markers say is wrong with it, and where; None if nothing. Decodes nothing."""
        if self.marker is None:
            tail = self.content[-_LEAST_TAIL:]
            if not tail.any() or (tail == 0xFF).all():
                return len(self.content), f"ends in bytes of 0x{int(tail[-1]):02X} and without an end marker"
            return None  # T.81 asks for a marker; without it, nothing here shows that bytes were lost
        at, value = self.marker
        return None if value == _EOI else (at, f"has a marker 0xFF{value:02X}, which does not belong into image data")

    def count_fault(self) -> tuple[int, str] | None:
        """Walk its codes; return what is wrong with their number, and where; None if the last pixel ends the stream.

        Takes about as long as decoding.
        """
        from eldata.raw._kernels import NO_CODE, TOO_SHORT, walk  # numba takes long to load

        tables = np.stack([code.table() for code in self.codes])
        interval = self.restart_interval * len(self.codes)
        state, done, at = walk(self.content[: self.end], self.start, tables, self.samples, interval)
        if state == NO_CODE:
            return at, f"has bits that are not a code, after {done} of {self.samples} pixels"
        if state == TOO_SHORT:
            return at, f"ends after {done} of {self.samples} pixels"
        padded = self.marker is None and not self.content[at:].any()
        if self.end - at > _MOST_SLACK and not padded:
            return at, f"goes on for {self.end - at} bytes behind the last of its {self.samples} pixels"
        return None


def find_stream(content: NDArray[np.uint8]) -> Stream | None:
    """Return the lossless JPEG that a strip or tile holds; None if it begins as something else, another JPEG included.

    Raises
    ------
    ValueError
        If it begins as a JPEG but its header is damaged; the message says how.
    """
    head = content[:MOST_HEADER].tobytes()
    if not head.startswith(SOI):
        return None
    at, lossless, size, interval = len(SOI), False, (0, 0, 0), 0
    tables = b""
    try:
        while True:
            mark, marker, length = struct.unpack_from(">BBH", head, at)
            body = head[at + 4 : at + 2 + length]
            if mark != 0xFF or length < 2 or len(body) != length - 2:
                raise ValueError(f"has a damaged JPEG header at byte {at}")
            if marker in _FRAMES:
                lossless, size = marker == _SOF3, struct.unpack_from(">xHHB", body)
            elif marker == _DHT:
                tables += body
            elif marker == _DRI:
                (interval,) = struct.unpack_from(">H", body)
            at += 2 + length
            if marker == _SOS:
                if not lossless or body[0] != size[2]:  # components in scans of their own: no camera writes that
                    return None
                codes = _codes(tables)
                used = tuple(codes[body[2 + 2 * index] >> 4] for index in range(body[0]))
                return Stream(content, at, size[0] * size[1] * size[2], used, interval)
    except (struct.error, IndexError, KeyError) as error:
        raise ValueError(f"has a damaged JPEG header at byte {at}") from error


def _codes(tables: bytes) -> dict[int, Code]:
    found: dict[int, Code] = {}
    while tables:
        counts = tables[1:17]
        symbols = tables[17 : 17 + sum(counts)]
        room = sum(count << (16 - length) for length, count in enumerate(counts, 1))
        if len(counts) != 16 or not symbols or len(symbols) != sum(counts) or room > 1 << 16 or max(symbols) > 16:
            raise ValueError("has a damaged Huffman code in its JPEG header")
        found[tables[0] & 15] = Code(counts, symbols)
        tables = tables[17 + sum(counts) :]
    return found
