"""Strips and tiles of a DNG's mosaic that LibRaw does not decode, or wrongly: floating-point numbers, JPEG XL.

LibRaw makes integers of floats, scaled by the frame's own maximum, without negative values. Here they stay what the
file holds: DN on the scale of its own black and white level. Of 16 bits, 24 bits (one of sign, 7 of exponent, 16 of
fraction) or 32 bits, which float32 holds exactly; uncompressed or in Deflate, with the predictors of TIFF and DNG.

JPEG XL (DNG 1.7) is read of whole numbers: libjxl gives back other halves below 0.00006 than it was given.

Everything that a file declares is held against its bytes before memory is taken for it.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.errors import RawFileError, UnusableRawError
from eldata.raw.jpeg_xl import can_decode, decode_stream, read_first_header, read_stream_header
from eldata.raw.sensor_facts import scaled_bits
from eldata.raw.tiff import (
    BITS,
    COMPRESSION,
    LINEARIZATION,
    PLANAR,
    PREDICTOR,
    ROWS_PER_STRIP,
    TILE_HEIGHT,
    TILE_WIDTH,
    require,
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
_MOST_BITS = 16  # of whole numbers
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


def check_jpeg_xl(path: Path, mosaic: Directory) -> None:
    """Refuse whole numbers in JPEG XL that cannot be read.

    Raises
    ------
    UnusableRawError
        If it has several samples of each pixel, a LinearizationTable of another type than the specification's, or this
        machine has no decoder.
    """
    if mosaic.samples != 1:
        raise UnusableRawError(
            path, f"has {mosaic.samples} samples of each pixel in JPEG XL; expected 1", "write it again with one"
        )
    if LINEARIZATION in mosaic.tags and mosaic.linearization is None:
        raise UnusableRawError(path, "has a LinearizationTable that is not of SHORTs", "write it again as SHORTs")
    if not can_decode():
        todo = "install imagecodecs as PyPI's wheels have it, or convert the file to lossless JPEG"
        raise UnusableRawError(
            path, "is a DNG with JPEG XL compression, which this imagecodecs was built without", todo
        )


def read_stored(path: Path, mosaic: Directory) -> NDArray[Any]:
    """Return the pixels that a directory describes, (H, W) in DN: float32 as they are stored, or uint16 of JPEG XL.

    Those of JPEG XL went through the file's LinearizationTable, if it has one. Of several samples it is the first. The
    directory is one that :func:`check_floats` or :func:`check_jpeg_xl` lets pass.

    Raises
    ------
    UnusableRawError
        If they are not all finite, or JPEG XL has fewer bits than its white level is meant for.
    RawFileError
        If they are damaged.
    """
    layout = _Layout(path, mosaic)
    height, width = mosaic.shape
    pixels = np.empty((height, width), np.uint16 if mosaic.is_jpeg_xl else np.float32)
    with path.open("rb") as file:
        for (top, left), (offset, count) in zip(layout.places, mosaic.extents, strict=False):
            rows = layout.height if layout.is_tiled else min(layout.height, height - top)
            place = pixels[top : top + rows, left : left + layout.width]
            place[...] = layout.decode(file, offset, count, rows, place.shape)[: place.shape[0], : place.shape[1]]
    if mosaic.is_jpeg_xl:
        return _linear(path, mosaic, pixels)
    bad = ~np.isfinite(pixels)
    if bad.any():
        row, column = divmod(int(bad.argmax()), width)
        found = f"{int(bad.sum())} of its pixels are not finite numbers, the first in row {row}, column {column}"
        raise UnusableRawError(path, found, "write it again without them")
    return pixels


def _linear(path: Path, mosaic: Directory, pixels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return samples of JPEG XL as DN."""
    bits = scaled_bits(path, mosaic)
    if bits:
        most = (1 << bits) - 1  # odd, so that nothing is half-way
        pixels = np.rint(np.arange(1 << bits) * (((1 << 16) - 1) / most)).astype(np.uint16)[pixels]
    place = mosaic.linearization
    if not place:
        return pixels
    require(path, path.stat().st_size, place.stop)
    table = np.fromfile(path, f"{mosaic.order}u2", len(place) // 2, offset=place.start).astype(np.uint16)
    return table[np.minimum(pixels, len(table) - 1)]  # beyond its end its last number stands, by the specification


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
        self.compression, self.predictor = mosaic.compression, mosaic.number(PREDICTOR, 1)
        self.bytes = mosaic.number(BITS, 32) // 8
        self.header = read_first_header(path, mosaic) if mosaic.is_jpeg_xl else None
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

    def decode(
        self, file: IO[bytes], offset: int, count: int, rows: int, least: tuple[int, ...]
    ) -> NDArray[np.float32 | np.uint16]:
        """Return the first samples of a strip or tile, (rows, columns); of JPEG XL ``least`` (H, W) or more."""
        if self.header is not None:
            return self._from_jpeg_xl(file, offset, count, ((least[0], rows), (least[1], self.width)))
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
        import imagecodecs

        with suppress(RuntimeError):  # its bytes, its checksum, or more than that size
            found = imagecodecs.zlib_decode(content, out=size)
            if len(found) == size:
                return bytes(found)
        raise self._damaged(offset, f"it does not decompress to just the {size} bytes of its pixels")

    def _from_jpeg_xl(
        self, file: IO[bytes], offset: int, count: int, sides: tuple[tuple[int, int], ...]
    ) -> NDArray[np.uint16]:
        """Return what a stream holds, whose sides are each one of two; its header is held against them first."""
        header = read_stream_header(self.path, file, offset, count)
        if any(found not in known for found, known in zip(header.shape, sides, strict=True)):
            expected = " x ".join(str(known[1]) for known in sides)
            raise self._damaged(offset, f"it holds {header.shape} pixels; expected {expected}")
        if self.header is None or header.bits != self.header.bits or header.bits > _MOST_BITS:
            raise self._damaged(
                offset, f"it has samples of {header.bits} bits; expected those of the first, at most 16"
            )
        file.seek(offset)
        try:
            pixels = decode_stream(file.read(count))
        except ValueError as error:
            raise self._damaged(offset, str(error)) from error
        if pixels.shape != header.shape:
            raise self._damaged(offset, f"it decodes to {pixels.shape}; expected {header.shape}")
        return pixels

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
