"""JPEG XL streams of a DNG's strips and tiles (ISO/IEC 18181-1, codestream; -2, container): header and pixels.

The header is read here, before anything is decoded, for what imagecodecs does not tell: size, the bits that the stream
counts in, which are not always the directory's BitsPerSample, and whether its colours were transformed, which loses.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple

from eldata.errors import RawFileError

if TYPE_CHECKING:
    from pathlib import Path
    from typing import IO

    from numpy.typing import NDArray

    from eldata.raw.tiff import Directory

_MOST_HEADER = 1 << 16  # bytes that a header, behind the boxes of a container, is looked for in
_CODESTREAM, _CONTAINER = b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n"
_FIELD = 64  # bytes: headers without a preview take up to 30
# Of width over height, by number.
_RATIOS = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))
# Each of four choices: what is added to how many bits.
_SIDE = ((1, 9), (1, 13), (1, 18), (1, 30))
_SAMPLE = ((8, 0), (10, 0), (12, 0), (1, 6))


class Header(NamedTuple):
    """What a stream says of its image: (H, W) in pixels, bits of a sample."""

    shape: tuple[int, int]
    bits: int
    is_transformed: bool
    """Whether it has the colours of human vision, XYB: such a stream is lossy; others may be lossless."""


def read_first_header(path: Path, mosaic: Directory) -> Header:
    """Return the header of a mosaic's first strip or tile; :func:`read_stream_header` says what it raises."""
    with path.open("rb") as file:
        return read_stream_header(path, file, *next(iter(mosaic.extents), (0, 0)))


def read_stream_header(path: Path, file: IO[bytes], offset: int, count: int) -> Header:
    """Return the header of a strip or tile of a file.

    Raises
    ------
    RawFileError
        If it is damaged, or not of a mosaic.
    """
    file.seek(offset)
    try:
        return parse_header(file.read(min(count, _MOST_HEADER)))
    except ValueError as error:
        what = f"its image data, from byte {offset} of the file on: {error}"
        raise RawFileError(path, f"damaged, or no mosaic in JPEG XL: {what}; copy or download it again") from error


def parse_header(content: bytes) -> Header:
    """Return the header of a stream, bare or in a container, from its first bytes.

    Raises
    ------
    ValueError
        If it is none, or one of another kind of image than a mosaic; it says which.
    """
    bits = _Bits(_codestream(content))
    shape = _size(bits)
    if bits.take(1):  # all that follows is as for a picture on a screen
        return Header(shape, 8, True)
    if bits.take(1):
        bits.take(3)  # orientation, which is not applied
        if bits.take(1):
            _size(bits)  # on a screen
        if bits.take(1) or bits.take(1):
            raise ValueError("has a preview, or several images")
    if bits.take(1):
        raise ValueError("holds floating-point numbers")
    count = bits.choose(_SAMPLE)
    bits.take(1)  # whether 16 bits are enough to decode it
    if bits.take(2):
        raise ValueError("has more channels than one")
    return Header(shape, count, bool(bits.take(1)))


def decode_stream(content: bytes) -> NDArray[Any]:
    """Return the pixels of a stream whose header was read and agreed to: its own numbers, not scaled, not turned.

    Raises
    ------
    ValueError
        If it is damaged.
    """
    import imagecodecs

    try:  # one thread, as LibRaw has
        pixels: NDArray[Any] = imagecodecs.jpegxl_decode(content, index=0, keeporientation=True, numthreads=1)
    except RuntimeError as error:
        raise ValueError(f"does not decode ({error})") from error
    return pixels


def can_decode() -> bool:
    """Whether this machine's imagecodecs has JPEG XL, as the wheels of PyPI do."""
    import imagecodecs

    return bool(imagecodecs.JPEGXL.available)


def _codestream(content: bytes) -> bytes:
    """Return the beginning of the codestream."""
    if content.startswith(_CODESTREAM):
        return content[2 : 2 + _FIELD]
    at = len(_CONTAINER) if content.startswith(_CONTAINER) else len(content)
    while at + 16 <= len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        start = at + 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", content, start)
            start += 8
        if kind in (b"jxlc", b"jxlp"):
            start += 4 if kind == b"jxlp" else 0  # its number among the parts
            if content.startswith(_CODESTREAM, start):
                return content[start + 2 : start + 2 + _FIELD]
            break
        if size < start - at:  # 0: it is the last one
            break
        at += size
    raise ValueError("does not begin as a JPEG XL")


class _Bits:
    """Numbers of a header, each from the lowest bit on."""

    def __init__(self, content: bytes) -> None:
        self.left, self.count = int.from_bytes(content, "little"), 8 * len(content)

    def take(self, bits: int) -> int:
        self.count -= bits
        if self.count < 0:
            raise ValueError("breaks off within its header")
        value = self.left & ((1 << bits) - 1)
        self.left >>= bits
        return value

    def choose(self, choices: tuple[tuple[int, int], ...]) -> int:
        base, bits = choices[self.take(2)]
        return base + self.take(bits)


def _size(bits: _Bits) -> tuple[int, int]:
    small = bool(bits.take(1))  # in eights

    def side() -> int:
        return 8 * (1 + bits.take(5)) if small else bits.choose(_SIDE)

    height, ratio = side(), bits.take(3)
    if not ratio:
        return height, side()
    across, down = _RATIOS[ratio - 1]
    return height, height * across // down
