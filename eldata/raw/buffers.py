"""Sensor buffers without a header, as camera apps, drivers and boards save them, to :class:`~eldata.records.RawFrame`.

Such a file is pixels alone: what a raw file would state has to be said. Its size is what can be checked.

mipi
    As MIPI CSI-2 sends pixels (and Android's RAW10 and RAW12, V4L2's pRAA and pRCC hold them). 10 bits: four pixels in
    five bytes, the upper 8 bits of each, then a byte of their lower 2 bits, the first pixel's lowest. 12 bits: two
    pixels in three bytes, then a byte of their lower 4 bits, likewise. Each row begins with a byte of its own.
le16
    A pixel is a number of two bytes, the lower one first, in its lowest bits.

Rows may be padded: ``stride`` is the number of bytes from one row to the next.
"""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from eldata.errors import ArgumentError, RawFileError, check_choice
from eldata.raw.cfa import packed_area, packing_sites
from eldata.raw.damage import mosaic_fault
from eldata.records import Exposure, RawFrame, Sensor, exact_fraction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import Cfa

Packing = Literal["mipi", "le16"]

# Pixels that are packed together, and bytes that they take, by bits.
_MIPI_GROUPS = {10: (4, 5), 12: (2, 3)}
_LE16_BITS = (10, 12, 14, 16)


def read_buffer(
    path: Path | str,
    shape: tuple[int, int],
    *,
    cfa: Cfa,
    black: float | Sequence[float],
    white: float,
    bits: int = 10,
    packing: Packing = "mipi",
    iso: Fraction | float | None = None,
    exposure_s: Fraction | float | None = None,
    stride: int | None = None,
) -> RawFrame:
    """Read a sensor's buffer that was saved without a header (see the module's text).

    Parameters
    ----------
    path
        The file: one frame and nothing else.
    shape
        (H, W) in pixels. Packed rows are whole groups of pixels: W is a multiple of 4 for 10 bits, of 2 for 12.
    cfa
        Of its first pixels, as :attr:`eldata.records.Sensor.cfa` has it: ``bayer_cfa("RGGB", block=2)``.
    black
        Black level in DN: one, or one for each of the CFA's channels (R, G1, B, G2; of X-Trans R, G, B).
    white
        White level in DN, at most 2^bits - 1.
    bits
        10 or 12; ``"le16"`` takes 14 and 16 too.
    packing
        ``"mipi"`` or ``"le16"``.
    iso, exposure_s
        Of the exposure, the time in seconds, if known; a float is the decimal number that it prints as.
    stride
        Bytes from one row to the next; by default rows follow each other. The last row's padding may be missing.

    Returns
    -------
    RawFrame
        ``mosaic`` is (H, W) uint16 in DN. The camera's name, white balance and matrix are not known;
        ``dataclasses.replace(frame.sensor, ...)`` adds them.

    Raises
    ------
    ArgumentError
        If an argument is invalid, or they do not go together.
    RawFileError
        If the file cannot be read, has another size, values beyond ``bits``, or damage that shows
        (:mod:`eldata.raw.damage`). The message names the file, what was expected, what was found and what to do.
    """
    path = Path(path)
    height, width = _sides(shape)
    row_bytes = _row_bytes(width, bits, packing)
    if stride is not None and not stride >= row_bytes:
        raise ArgumentError(
            f"stride must be a whole number of at least {row_bytes} bytes, a row of {width} pixels of {bits} bits "
            f"({packing}); found {stride!r}"
        )
    sensor = _sensor((height, width), cfa, black, white, bits)
    exposure = Exposure(_positive("iso", iso), _positive("exposure_s", exposure_s))
    content = _content(path, height, row_bytes, stride, f"{height} x {width} pixels of {bits} bits ({packing})")
    rows = np.lib.stride_tricks.as_strided(content, (height, row_bytes), (stride or row_bytes, 1), writeable=False)
    mosaic = _unpacked(rows, bits, packing)
    highest = int(mosaic.max())
    if highest >= 1 << bits:
        raise RawFileError(
            path,
            f"holds {highest} DN, and {bits} bits hold at most {(1 << bits) - 1}: give the bits that it has; values "
            "that stand in the upper bits, or with the upper byte first, have to be moved first",
        )
    fault = mosaic_fault(mosaic, sensor.black_level_dn, sensor.white_level_dn)
    if fault is not None:
        raise RawFileError(path, f"damaged, or its shape, packing or black level are others: {fault}")
    return RawFrame(path, mosaic, sensor, exposure)


def _sides(shape: Sequence[Any]) -> tuple[int, int]:
    sides = tuple(shape)
    if len(sides) != 2 or not all(isinstance(side, (int, np.integer)) and side > 0 for side in sides):
        raise ArgumentError(f"shape must be (H, W), two whole numbers above 0; found {shape!r}")
    return int(sides[0]), int(sides[1])


def _row_bytes(width: int, bits: int, packing: Packing) -> int:
    check_choice("packing", packing, get_args(Packing))
    if packing == "le16":
        check_choice("bits", bits, _LE16_BITS)
        return 2 * width
    check_choice("bits", bits, _MIPI_GROUPS)
    pixels, size = _MIPI_GROUPS[bits]
    if width % pixels:
        raise ArgumentError(
            f"packed rows of {bits} bits hold whole groups of {pixels} pixels, and {width} is not a multiple of "
            f"{pixels}: give the width with its padding, and crop the mosaic"
        )
    return width // pixels * size


def _sensor(shape: tuple[int, int], cfa: Cfa, black: float | Sequence[float], white: float, bits: int) -> Sensor:
    packed_area(shape, cfa)  # refuses a mosaic below one period
    count = packing_sites(cfa).levels
    given: Any = black
    levels: tuple[float, ...] = (given,) * count if np.ndim(given) == 0 else tuple(given)
    if len(levels) != count:
        raise ArgumentError(f"black must be one level, or {count} for this CFA; found {black!r}")
    if not all(_is_number(level) and level >= 0 for level in levels):
        raise ArgumentError(f"black must be of numbers from 0 on, in DN; found {black!r}")
    if not (_is_number(white) and max(levels) < white < 1 << bits):
        raise ArgumentError(
            f"white must lie above the black level ({max(levels):g} DN) and be at most {(1 << bits) - 1}, the most "
            f"that {bits} bits hold; found {white!r}"
        )
    rows = tuple(tuple(int(index) for index in row) for row in cfa)
    return Sensor("", "", rows, tuple(map(float, levels)), float(white), *shape)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value)


def _positive(name: str, value: Fraction | float | None) -> Fraction | None:
    if value is None:
        return None
    if not (isinstance(value, Fraction) or _is_number(value)) or not value > 0:
        raise ArgumentError(f"{name} must be a number above 0, or None if it is not known; found {value!r}")
    return exact_fraction(value) if isinstance(value, (float, np.floating)) else Fraction(value)


def _content(path: Path, height: int, row_bytes: int, stride: int | None, what: str) -> NDArray[np.uint8]:
    """Return the file's bytes, once its size is the one that it should have."""
    whole = (stride or row_bytes) * height
    least = whole if stride is None else stride * (height - 1) + row_bytes
    try:
        found = path.stat().st_size
        if found in (least, whole):
            content = np.fromfile(path, np.uint8)
            found = len(content)  # it may have changed
    except OSError as error:
        raise RawFileError(path, f"cannot be read: {error.strerror}") from error
    if found not in (least, whole):
        rows = f"{height} rows of {row_bytes} bytes" if stride is None else f"{height} rows {stride} bytes apart"
        expected = f"{whole} bytes" if least == whole else f"{whole} bytes, or {least} without the last padding,"
        hint = "is it whole, and are shape, bits and packing right?"
        if stride is None and found > whole and found % height == 0:
            hint = f"its rows may be padded: then give stride={found // height}"
        elif found < least:
            hint = "is it whole? Or shape, bits, packing or stride are others"
        raise RawFileError(path, f"expected {expected} for {what} in {rows}; found {found} bytes; {hint}")
    return content


def _unpacked(rows: NDArray[np.uint8], bits: int, packing: Packing) -> NDArray[np.uint16]:
    """Return pixels (H, W) of rows of bytes."""
    if packing == "le16":
        return np.ascontiguousarray(rows).view("<u2").astype(np.uint16)
    pixels, size = _MIPI_GROUPS[bits]
    groups = rows.reshape(len(rows), -1, size)
    lower = bits - 8
    mosaic = np.empty((len(rows), groups.shape[1], pixels), np.uint16)
    for place in range(pixels):
        upper = groups[:, :, place].astype(np.uint16) << lower
        mosaic[:, :, place] = upper | (groups[:, :, -1] >> (lower * place)) & ((1 << lower) - 1)
    return mosaic.reshape(len(rows), -1)
