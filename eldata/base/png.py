"""PNG files as DRV and predictions have them: up to 16 bits per sample. The one PNG reader of this package.

The header is looked at first, and only chunks that are pixels are handed on: a kilobyte of compressed text or profile
can stand for megabytes. imagecodecs (libpng) reads 16-bit RGB, which Pillow does not. Samples come as the file has
them, in the order R, G, B, without gamma or colour management; OpenCV, which the DRV code uses, returns the same
samples as B, G, R.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

from eldata.base.files import file_problem
from eldata.base.isolation import GuardError, guarded
from eldata.base.visible import in_line
from eldata.errors import FileError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 26
_END = b"\0\0\0\0IEND\xaeB`\x82"
_COLOURS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}
_CHANNELS = {"grey": (), "grey with alpha": (2,), "RGB with alpha": (4,)}  # the others have three

# What pixels are made of, beside the header; texts, profiles and times are passed over: of 1.5 MB of compressed text
# libpng makes 1.5 GB, in a minute.
_OF_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_HEADER_CHUNK, _WHOLE_HEADER = b"\0\0\0\x0dIHDR", 33
_MOST_PIXELS = 100_000_000  # of a frame that is read without knowing its size: the largest sensors with room for RGB


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What a PNG says of itself: size in pixels, bits per sample, and ``grey``, ``RGB``, ``palette`` or with alpha."""

    width: int
    height: int
    bit_depth: int
    colour: str

    def __str__(self) -> str:
        return f"{self.bit_depth}-bit {self.colour}"

    @property
    def shape(self) -> tuple[int, ...]:
        """That of its pixels: (H, W) or (H, W, channels)."""
        return self.height, self.width, *_CHANNELS.get(self.colour, (3,))

    @property
    def values(self) -> str:
        """The type of its samples when decoded: ``uint8`` or ``uint16``."""
        return "uint16" if self.bit_depth == 16 else "uint8"


def read_png_header(path: Path) -> PngHeader:
    """Read a PNG's header without decoding its pixels.

    Raises
    ------
    FileError
        If the file cannot be read, is not a PNG, or does not end like one: it is truncated.
    """
    problem = file_problem(path)
    if problem is not None:
        raise FileError(path, problem)
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
            size = file.seek(0, 2)
            file.seek(max(0, size - len(_END)))
            tail = file.read()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    if not head.startswith(_SIGNATURE) or len(head) < _HEADER_BYTES:
        raise FileError(path, "is not a PNG file")
    if tail != _END:
        raise FileError(path, f"does not end as a PNG does ({size} bytes): truncated? copy or download it again")
    return _header(head[16:])


def _header(content: bytes | bytearray) -> PngHeader:
    width, height, bit_depth, colour = struct.unpack_from(">IIBB", content)
    return PngHeader(width, height, bit_depth, _COLOURS.get(colour, f"colour type {colour}"))


def read_png(path: Path, check: Callable[[PngHeader], None] | None = None) -> NDArray[Any]:
    """Decode a PNG file: (H, W) or (H, W, channels), uint8 or uint16.

    Parameters
    ----------
    path
        The file.
    check
        Is called with the header before anything is decoded, and raises if that is not what is wanted.

    Raises
    ------
    ValueError
        If it is not a PNG file, is truncated or damaged, or holds more compressed data than its pixels can need.
    OSError, RuntimeError
        If it cannot be read or decoded.
    """
    import imagecodecs

    with path.open("rb") as file:
        content = _pixel_chunks(file, check)
    array: NDArray[Any] = imagecodecs.png_decode(content)
    return array


def _pixel_chunks(file: IO[bytes], check: Callable[[PngHeader], None] | None) -> bytearray:
    """Return a PNG file without the chunks that are not pixels; libpng checks what it is then given."""
    content = bytearray(file.read(_WHOLE_HEADER))
    if content[:16] != _SIGNATURE + _HEADER_CHUNK or len(content) < _WHOLE_HEADER:
        raise ValueError("does not begin as a PNG file")
    header = _header(content[16:])
    if check is not None:
        check(header)
    most, kind = _most_compressed_bytes(header), b""
    while kind != b"IEND":
        head = file.read(8)
        if len(head) < 8:
            raise ValueError("ends without its last chunk: truncated?")
        length, kind = struct.unpack(">I4s", head)
        if kind not in _OF_PIXELS:
            file.seek(length + 4, 1)  # and the checksum
        elif len(content) + length > most:
            raise ValueError(f"more compressed data than {header.width} x {header.height} pixels can need")
        else:
            content += head + file.read(length + 4)
    return content


def _most_compressed_bytes(header: PngHeader) -> int:
    """Return a generous bound: deflate adds a few bytes per 16 kB that do not compress, chunks 12 each."""
    channels = header.shape[2] if len(header.shape) == 3 else 1
    samples = header.height * (header.width * channels * header.bit_depth // 8 + 16)
    return samples + samples // 8 + (1 << 16)


def rgb_frame(path: Path) -> NDArray[np.float32]:
    """Read a 16-bit RGB PNG as a frame, (3, h, w) float32: its samples / 65535. Raises like :func:`read_rgb16`."""
    import numpy as np

    samples = read_rgb16(path).transpose(2, 0, 1)
    pixels = np.empty(samples.shape, np.float32)
    return np.divide(samples, np.float32(65535), out=pixels, dtype=np.float32)


def read_rgb16(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit RGB PNG.

    Returns
    -------
    ndarray
        (H, W, 3) uint16 in the order R, G, B.

    Raises
    ------
    FileError
        If the file cannot be read or decoded, or is not 16-bit RGB.
    """
    header = read_png_header(path)
    if (header.bit_depth, header.colour) != (16, "RGB"):
        raise FileError(path, f"expected a 16-bit RGB PNG, found {header}")
    if header.width * header.height > _MOST_PIXELS:
        found = f"{header.width} x {header.height}"
        raise FileError(path, f"expected up to {_MOST_PIXELS // 1_000_000} megapixels, found {found}; is it damaged?")
    try:
        array: NDArray[np.uint16] = guarded(read_png, path)
    except (OSError, RuntimeError, ValueError, GuardError) as error:  # imagecodecs' errors are RuntimeErrors
        raise FileError(path, f"cannot be decoded ({in_line(str(error))}); copy or download it again") from error
    return array
