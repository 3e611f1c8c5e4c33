"""Strips and tiles of a DNG's mosaic that LibRaw cannot be asked for: floating-point samples, integers in Deflate.

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
    HEIGHT,
    LINEARIZATION,
    PLANAR,
    PREDICTOR,
    ROWS_PER_STRIP,
    SAMPLE_FORMAT,
    TILE_HEIGHT,
    TILE_WIDTH,
)

if TYPE_CHECKING:
    from pathlib import Path
    from typing import IO

    from numpy.typing import NDArray

    from eldata.raw.tiff import Directory

_FLOAT = 3
_UNCOMPRESSED, _DEFLATE = 1, (8, 32946)
# By how many samples of a row they reach back; those of floats mix the bytes of a row, then.
_DIFFERENCES, _OF_FLOATS = {1: 0, 2: 1, 34892: 2, 34893: 4}, {3: 1, 34894: 2, 34895: 4}
_BITS = {False: (8, 16), True: (16, 24, 32)}
_DENSEST = 1032  # bytes that one byte of Deflate can stand for, at most
_AGAIN = "copy or download it again"


def is_float(mosaic: Directory) -> bool:
    """Return whether the samples of a mosaic are floating-point numbers."""
    return mosaic.number(SAMPLE_FORMAT, 1) == _FLOAT


def is_own(mosaic: Directory) -> bool:
    """Return whether LibRaw cannot be asked for the pixels of a mosaic."""
    return is_float(mosaic) or mosaic.number(COMPRESSION, _UNCOMPRESSED) in _DEFLATE


def read_pixels(path: Path, mosaic: Directory) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Return the pixels that a directory describes, (H, W), as they are stored; of several samples the first.

    Returns
    -------
    ndarray
        uint16, or float32 of floating-point samples: DN.

    Raises
    ------
    RawFileError
        If they are of a kind that is not supported, which the message names, or are damaged.
    """
    layout = _Layout(path, mosaic)
    height, width = mosaic.shape
    pixels = np.empty((height, width), np.float32 if layout.floats else np.uint16)
    with path.open("rb") as file:
        for (top, left), (offset, count) in zip(layout.places, mosaic.extents, strict=False):
            rows = layout.height if layout.is_tiled else min(layout.height, height - top)
            place = pixels[top : top + rows, left : left + layout.width]
            place[...] = layout.decode(file, offset, count, rows)[: place.shape[0], : place.shape[1]]
    bad = ~np.isfinite(pixels)
    if bad.any():
        row, column = divmod(int(bad.argmax()), width)
        raise RawFileError(
            path,
            f"{int(bad.sum())} of its pixels are not finite numbers, the first in row {row}, column {column}: write it "
            "again without them",
        )
    return pixels


class _Layout:
    """How the samples of a mosaic lie in its strips or tiles."""

    def __init__(self, path: Path, mosaic: Directory) -> None:
        self.path, self.order, self.floats = path, mosaic.order, is_float(mosaic)
        height, width = mosaic.shape
        self.is_tiled = TILE_WIDTH in mosaic.values
        self.height = mosaic.number(TILE_HEIGHT if self.is_tiled else ROWS_PER_STRIP, height)
        self.width = mosaic.number(TILE_WIDTH, width)
        if not self.is_tiled:
            self.height = min(self.height, height)
        self.samples = mosaic.samples if mosaic.number(PLANAR, 1) == 1 else 1
        self.compression, self.predictor = mosaic.number(COMPRESSION, _UNCOMPRESSED), mosaic.number(PREDICTOR, 1)
        bits = set(map(int, mosaic.values.get(BITS, ())))
        kind = "floating-point" if self.floats else "whole"
        if len(bits) != 1 or not bits <= set(_BITS[self.floats]):
            known = ", ".join(map(str, _BITS[self.floats]))
            self._refuse(f"its BitsPerSample is {sorted(bits)}, expected one of {known} for {kind} numbers")
        self.bytes = bits.pop() // 8
        if self.compression not in (_UNCOMPRESSED, *_DEFLATE):
            self._refuse(f"{kind} numbers with compression {self.compression}, expected none or Deflate")
        if self.predictor not in (_DIFFERENCES.keys() | (_OF_FLOATS.keys() if self.floats else ())) or (
            self.floats and _DIFFERENCES.get(self.predictor)
        ):
            self._refuse(f"{kind} numbers with predictor {self.predictor}")
        if LINEARIZATION in mosaic.values:
            self._refuse(f"a LinearizationTable with compression {self.compression}")
        if min(height, width, self.height, self.width, self.samples) < 1:
            raise RawFileError(path, f"damaged: its tag {HEIGHT} or another one of its sizes is 0; {_AGAIN}")
        down, across = -(-height // self.height), -(-width // self.width)
        if down * across > len(mosaic.extents):
            raise RawFileError(
                path, f"damaged: it declares {len(mosaic.extents)} of {down * across} strips or tiles; {_AGAIN}"
            )
        self.places = ((self.height * (i // across), self.width * (i % across)) for i in range(down * across))

    def _refuse(self, what: str) -> None:
        raise UnusableRawError(self.path, f"cannot be decoded: {what}", "write it as uncompressed floats or integers")

    def decode(self, file: IO[bytes], offset: int, count: int, rows: int) -> NDArray[np.generic]:
        """Return the first samples of a strip or tile, (rows, columns)."""
        size = rows * self.width * self.samples * self.bytes
        most = count if self.compression == _UNCOMPRESSED else _DENSEST * count
        if size > most:
            raise self._damaged(offset, f"{count} bytes cannot hold {rows} x {self.width} pixels")
        file.seek(offset)
        content = file.read(count)
        if self.compression != _UNCOMPRESSED:
            content = self._inflated(content, size, offset)
        data = np.frombuffer(content, np.uint8, size).reshape(rows, -1)
        values = self._from_floats(data) if self.predictor in _OF_FLOATS else self._numbers(data, self.order)
        back = _DIFFERENCES.get(self.predictor, 0) * self.samples
        if back:
            values = _summed(values, back)
        return values.reshape(rows, self.width, self.samples)[:, :, 0]

    def _inflated(self, content: bytes, size: int, offset: int) -> bytes:
        decoder = zlib.decompressobj()
        try:
            found = decoder.decompress(content, size)
            decoder.decompress(decoder.unconsumed_tail, 1)  # to the end, where its checksum is
        except zlib.error as error:
            raise self._damaged(offset, f"it does not decompress ({error})") from error
        if len(found) < size:
            raise self._damaged(offset, f"decompresses to {len(found)} of {size} bytes")
        return found

    def _damaged(self, offset: int, what: str) -> RawFileError:
        return RawFileError(self.path, f"damaged: its image data, from byte {offset} of the file on: {what}; {_AGAIN}")

    def _from_floats(self, data: NDArray[np.uint8]) -> NDArray[np.generic]:
        """Undo the floats' predictor: of each row first the uppermost bytes of all samples, last the lowest ones."""
        planes = _summed(data, _OF_FLOATS[self.predictor] * self.samples).reshape(len(data), self.bytes, -1)
        return self._numbers(np.ascontiguousarray(planes.transpose(0, 2, 1)).reshape(len(data), -1), ">")

    def _numbers(self, data: NDArray[np.uint8], order: Literal["<", ">"]) -> NDArray[np.generic]:
        if self.bytes == 3:
            import imagecodecs

            values = imagecodecs.float24_decode(data.tobytes(), byteorder=order)
            return np.asarray(values).reshape(len(data), -1)
        return data.view(f"{order}{'f' if self.floats else 'u'}{self.bytes}").reshape(len(data), -1)


def _summed(values: NDArray[np.generic], back: int) -> NDArray[np.generic]:
    """Return rows whose values are given as differences to those so many places before; they wrap."""
    summed = values.astype(values.dtype.newbyteorder("="))
    for first in range(back):
        summed[:, first::back] = np.cumsum(summed[:, first::back], axis=1, dtype=summed.dtype)
    return summed
