"""PNG files as DRV and predictions have them: up to 16 bits per sample. The one PNG reader of this package.

imagecodecs (libpng) reads 16-bit RGB, which Pillow does not. Samples come as the file has them, in the order R, G, B,
without gamma or colour management; OpenCV, which the DRV code uses, returns the same samples as B, G, R.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.errors import FileError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 26
_END = b"\0\0\0\0IEND\xaeB`\x82"
_COLOURS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What a PNG says of itself: size in pixels, bits per sample, and ``grey``, ``RGB``, ``palette`` or with alpha."""

    width: int
    height: int
    bit_depth: int
    colour: str

    def __str__(self) -> str:
        return f"{self.bit_depth}-bit {self.colour}"


def read_png_header(path: Path) -> PngHeader:
    """Read a PNG's header without decoding its pixels.

    Raises
    ------
    FileError
        If the file cannot be read, is not a PNG, or does not end like one: it is truncated.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
            size = file.seek(0, 2)
            file.seek(max(0, size - len(_END)))
            tail = file.read()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    if size == 0:
        raise FileError(path, "is empty (0 bytes): copy or download it again")
    if not head.startswith(_SIGNATURE) or len(head) < _HEADER_BYTES:
        raise FileError(path, "is not a PNG file")
    if tail != _END:
        raise FileError(path, f"does not end as a PNG does ({size} bytes): truncated? copy or download it again")
    width, height, bit_depth, colour = struct.unpack_from(">IIBB", head, 16)
    return PngHeader(width, height, bit_depth, _COLOURS.get(colour, f"colour type {colour}"))


def decode_png(content: bytes) -> NDArray[Any]:
    """Decode a PNG file's bytes: (H, W) or (H, W, channels), uint8 or uint16. Raises what imagecodecs raises."""
    import imagecodecs

    array: NDArray[Any] = imagecodecs.png_decode(content)
    return array


def rgb_frame(path: Path) -> NDArray[np.float32]:
    """Read a 16-bit RGB PNG as a frame, (3, h, w) float32: its samples / 65535. Raises like :func:`read_rgb16`."""
    import numpy as np

    pixels = np.ascontiguousarray(read_rgb16(path).transpose(2, 0, 1)).astype(np.float32)
    pixels /= np.float32(65535)
    return pixels


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
    try:
        array: NDArray[np.uint16] = decode_png(path.read_bytes())
    except (OSError, RuntimeError, ValueError) as error:  # imagecodecs' errors are RuntimeErrors
        raise FileError(path, f"cannot be decoded ({error}); copy or download it again") from error
    return array
