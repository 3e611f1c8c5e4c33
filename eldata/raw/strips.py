"""Strips and tiles of a floating-point DNG's mosaic.

LibRaw makes integers of floats, scaled by the frame's own maximum, without negative values. Here they stay what the
file holds: DN on the scale of its own black and white level. Of 16 bits, 24 bits (one of sign, 7 of exponent, 16 of
fraction) or 32 bits, which float32 holds exactly; uncompressed or in Deflate, with the predictors of TIFF and DNG.

Everything that a file declares is held against its bytes before memory is taken for it.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Literal

import numpy as np

from eldata.errors import RawFileError, UnusableRawError
from eldata.raw.tiff import (
    BITS,
    COMPRESSION,
    LINEARIZATION,
    PLANAR,
    PREDICTOR,
    ROWS_PER_STRIP,
    TILE_HEIGHT,
    TILE_WIDTH,
)

if TYPE_CHECKING:
    from pathlib import Path
    from typing import IO

    from numpy.typing import NDArray

    from eldata.raw.tiff import Directory

_BITS = (16, 24, 32)
_UNCOMPRESSED, _DEFLATE = 1, 8
# Those that mix the bytes of a row, and by how many samples they reach back; 1 is none.
_PREDICTORS = {1: 0, 3: 1, 34894: 2, 34895: 4}
_DENSEST = 1032  # bytes that one byte of Deflate can stand for, at most
# Of strips and tiles, which may be larger than the image: a file with more is made to keep a reader busy.
_MOST_BESIDE, _LARGE_TILE = 4, 1 << 24
_AGAIN = "copy or download it again"


def check_floats(path: Path, mosaic: Directory) -> None:
    """Refuse floating-point pixels that are stored in a way that is not supported, of which LibRaw says less.

    Raises
    ------
    UnusableRawError
        If they are; it says which way.
    """
    if LINEARIZATION in mosaic.tags:
        raise UnusableRawError(
            path, "its pixels are floating-point numbers with a LinearizationTable", "write it again without one"
        )
    for name, tag, known in (
        ("BitsPerSample", BITS, _BITS),
        ("Compression", COMPRESSION, (_UNCOMPRESSED, _DEFLATE)),
        ("Predictor", PREDICTOR, tuple(_PREDICTORS)),
    ):
        found = mosaic.number(tag, 1)
        if found not in known:
            known_text = ", ".join(map(str, known))
            raise UnusableRawError(
                path,
                f"its floating-point pixels have a {name} of {found}, not one of {known_text}",
                "write it again as uncompressed floats of 32 bits",
            )


def read_floats(path: Path, mosaic: Directory) -> NDArray[np.float32]:
    """Return the pixels that a directory describes, (H, W) in DN as they are stored; of several samples the first.

    The directory is one that :func:`check_floats` lets pass.

    Raises
    ------
    UnusableRawError
        If they are not all finite.
    RawFileError
        If they are damaged.
    """
    layout = _Layout(path, mosaic)
    height, width = mosaic.shape
    pixels = np.empty((height, width), np.float32)
    with path.open("rb") as file:
        for (top, left), (offset, count) in zip(layout.places, mosaic.extents, strict=False):
            rows = layout.height if layout.is_tiled else min(layout.height, height - top)
            place = pixels[top : top + rows, left : left + layout.width]
            place[...] = layout.decode(file, offset, count, rows)[: place.shape[0], : place.shape[1]]
    bad = ~np.isfinite(pixels)
    if bad.any():
        row, column = divmod(int(bad.argmax()), width)
        found = f"{int(bad.sum())} of its pixels are not finite numbers, the first in row {row}, column {column}"
        raise UnusableRawError(path, found, "write it again without them")
    return pixels


class _Layout:
    """How the samples of a mosaic lie in its strips or tiles."""

    def __init__(self, path: Path, mosaic: Directory) -> None:
        self.path, self.order = path, mosaic.order
        height, width = mosaic.shape
        self.is_tiled = TILE_WIDTH in mosaic.values
        self.height = mosaic.number(TILE_HEIGHT if self.is_tiled else ROWS_PER_STRIP, height)
        self.width = mosaic.number(TILE_WIDTH, width)
        if not self.is_tiled:
            self.height = min(self.height, height)
        self.samples = mosaic.samples if mosaic.number(PLANAR, 1) == 1 else 1
        self.compression, self.predictor = mosaic.number(COMPRESSION, _UNCOMPRESSED), mosaic.number(PREDICTOR, 1)
        self.bytes = mosaic.number(BITS, 32) // 8
        if min(height, width, self.height, self.width, self.samples) < 1:
            raise RawFileError(path, f"damaged: one of the sizes that it declares is 0; {_AGAIN}")
        down, across = -(-height // self.height), -(-width // self.width)
        if down * self.height * across * self.width > _MOST_BESIDE * height * width + _LARGE_TILE:
            raise RawFileError(path, f"damaged: its strips or tiles have far more pixels than {height} x {width}")
        if down * across > len(mosaic.extents):
            raise RawFileError(
                path, f"damaged: it declares {len(mosaic.extents)} of {down * across} strips or tiles; {_AGAIN}"
            )
        self.places = ((self.height * (i // across), self.width * (i % across)) for i in range(down * across))

    def decode(self, file: IO[bytes], offset: int, count: int, rows: int) -> NDArray[np.float32]:
        """Return the first samples of a strip or tile, (rows, columns)."""
        size = rows * self.width * self.samples * self.bytes
        if size > count * (1 if self.compression == _UNCOMPRESSED else _DENSEST):
            raise self._damaged(offset, f"{count} bytes cannot hold {rows} x {self.width} pixels")
        file.seek(offset)
        content = file.read(count)
        if self.compression != _UNCOMPRESSED:
            content = self._inflated(content, size, offset)
        data, order = np.frombuffer(content, np.uint8, size).reshape(rows, -1), self.order
        back = _PREDICTORS[self.predictor] * self.samples
        if back:
            data, order = self._unpredicted(data, back), ">"
        return self._numbers(data, order).reshape(rows, self.width, self.samples)[:, :, 0]

    def _inflated(self, content: bytes, size: int, offset: int) -> bytes:
        decoder = zlib.decompressobj()
        try:
            found = decoder.decompress(content, size)
            found += decoder.decompress(decoder.unconsumed_tail, 1)  # to the end, where its checksum is
        except zlib.error as error:
            raise self._damaged(offset, f"it does not decompress ({error})") from error
        if len(found) != size or not decoder.eof:
            raise self._damaged(offset, f"it does not decompress to just the {size} bytes of its pixels")
        return found

    def _damaged(self, offset: int, what: str) -> RawFileError:
        return RawFileError(self.path, f"damaged: its image data, from byte {offset} of the file on: {what}; {_AGAIN}")

    def _unpredicted(self, data: NDArray[np.uint8], back: int) -> NDArray[np.uint8]:
        """Return rows of big-endian samples: stored are differences, first of the uppermost bytes of all samples."""
        summed = np.empty_like(data)
        for first in range(back):
            summed[:, first::back] = np.cumsum(data[:, first::back], axis=1, dtype=np.uint8)  # they wrap
        return summed.reshape(len(data), self.bytes, -1).transpose(0, 2, 1).reshape(data.shape)

    def _numbers(self, data: NDArray[np.uint8], order: Literal["<", ">"]) -> NDArray[np.float32]:
        if self.bytes == 3:
            import imagecodecs

            values: NDArray[np.float32] = imagecodecs.float24_decode(data.tobytes(), byteorder=order)
            return values
        return data.view(f"{order}f{self.bytes}").astype(np.float32)
