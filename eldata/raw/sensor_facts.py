"""What a raw file states beside its CFA and exposure: levels, white balance, matrix, what of it should be known.

A DNG's own figures to the last digit, from the file; those of other formats as LibRaw has them
(:mod:`eldata.raw.reading` says which and why).

A remark is a sentence that says what was, or was not, done with a file that is read rightly. It is not a problem:
``read_raw`` gives them with the frame, and ``eldata verify`` says each once.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError, RawFileError, UnusableRawError
from eldata.raw.colour import neutral_of_white, white_balance_of
from eldata.raw.tiff import (
    ACTIVE_AREA,
    BITS,
    BLACK_DELTAS,
    BLACK_LEVEL,
    MASKED_AREAS,
    OPCODE_LISTS,
    WHITE_LEVEL,
    read_directories,
)
from eldata.records import D65, exact_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import rawpy
    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows
    from eldata.raw.tiff import Directory
    from eldata.records import Matrix3

AS_SHOT_NEUTRAL, AS_SHOT_WHITE_XY, PRIVATE_DATA = 50728, 50729, 50740
COLOUR_MATRICES = ((50721, 50778), (50722, 50779))
"""Each with the tag of its illuminant."""
_THIRD_MATRIX = 52531
_CALIBRATIONS, _ANALOG_BALANCE = (50723, 50724), 50727
_SIGNATURES = ("Image Tag 0xC6F3", "Image Tag 0xC6F4")  # of the calibrations, and of the profile that they are for

_SONY, _LOSSY_JPEG = 32767, 34892
_LEAST_APART_DN = 0.5  # between masked pixels and the stated level, to be remarked on
# By number, DNG specification 1.7.1, chapter 7.
_OPCODES = (
    *("WarpRectilinear", "WarpFisheye", "FixVignetteRadial", "FixBadPixelsConstant", "FixBadPixelsList"),
    *("TrimBounds", "MapTable", "MapPolynomial", "GainMap", "DeltaPerRow", "DeltaPerColumn", "ScalePerRow"),
    *("ScalePerColumn", "WarpRectilinear2"),
)
_NOT_APPLIED = (
    "the mosaic is what the sensor gave, as stored",
    "the mosaic keeps what they would correct, such as lens shading",
    "they are for a demosaiced image",
)

# Daylight, flash, D55, D75, D50, as EXIF numbers sources of light.
_DAYLIGHT = (1, 4, 20, 22, 23)


def dng_white_level(mosaic: Directory) -> float:
    """Return a DNG's WhiteLevel; where it states none, by the specification the largest number."""
    largest = (1 << mosaic.number(BITS, 16)) - 1
    return exact_number(next(iter(mosaic.values.get(WHITE_LEVEL, ())), Fraction(largest)))


def dng_mean_levels(mosaic: Directory) -> tuple[float, float]:
    """Return the mean black level and the white level that a DNG states, DN."""
    black = mosaic.values.get(BLACK_LEVEL) or (Fraction(0),)
    return float(sum(black) / len(black)), dng_white_level(mosaic)


def dng_black_levels(path: Path, mosaic: Directory, raw: rawpy.RawPy, cfa: CfaRows) -> tuple[float, ...] | None:
    """Return the black level of each channel of the visible area's CFA that a DNG states; None if it states none.

    BlackLevel is a pattern that counts from the active area's first pixel (DNG specification 1.7.1, chapter 5).

    Raises
    ------
    UnusableRawError
        If the pattern does not fit the CFA: it repeats otherwise, or has several levels for sites of one channel.
    """
    if not any(mosaic.values.get(tag) for tag in (BLACK_LEVEL, *BLACK_DELTAS)):  # deltas of 0: others are refused
        return None
    rows, columns = mosaic.black_repeat
    pattern = mosaic.values.get(BLACK_LEVEL) or (Fraction(0),) * (rows * columns)
    period = len(cfa)
    if len(set(pattern)) > 1 and (period % rows or period % columns):
        raise UnusableRawError(
            path,
            f"its BlackLevel repeats every {rows} x {columns} pixels (BlackLevelRepeatDim), and its colour filter "
            f"array every {period} x {period}",
            "one level per channel is needed",
        )
    top, left = map(int, mosaic.values.get(ACTIVE_AREA, (0, 0))[:2])
    down, right = raw.sizes.top_margin - top, raw.sizes.left_margin - left  # LibRaw's area may start a pixel off it
    levels: dict[int, set[Fraction]] = {}
    for y, x in product(range(period), repeat=2):
        levels.setdefault(cfa[y][x], set()).add(pattern[(y + down) % rows * columns + (x + right) % columns])
    if any(len(found) > 1 for found in levels.values()):
        raise UnusableRawError(
            path, "its BlackLevel differs between sites of one colour", "one level per channel is needed"
        )
    return tuple(exact_number(levels[channel].pop()) for channel in sorted(levels))


def channel_whites(raw: rawpy.RawPy, index_of: Sequence[int]) -> tuple[float, ...] | None:
    """Return LibRaw's white level per channel of the CFA, given LibRaw's indices of them; None if it has none."""
    levels = raw.camera_white_level_per_channel
    if levels is None or not all(levels[index] > 0 for index in index_of):
        return None
    return tuple(float(levels[index]) for index in index_of)


def as_shot_multipliers(
    path: Path, raw: rawpy.RawPy, directories: Sequence[Directory], tags: Mapping[str, Any]
) -> tuple[float, float, float, float] | None:
    """Return the multipliers of R, G1, B, G2 as shot, G1 = 1; None if they are not known.

    LibRaw is asked for what the file does not state.

    Raises
    ------
    RawFileError
        If what eldata wrote into the file's DNGPrivateData is damaged.
    """
    neutral = directories[0].values.get(AS_SHOT_NEUTRAL, ()) if directories else ()
    if len(neutral) == 3 and all(value > 0 for value in neutral):
        try:
            exact = white_balance_of((neutral[0], neutral[1], neutral[2]), _private_data(tags))
        except ArgumentError as error:
            raise RawFileError(path, f"the white balance in its DNGPrivateData is damaged: {error}") from error
        red, green, blue, second_green = map(exact_number, exact)
        return red, green, blue, second_green
    white = _neutral_of_white(directories[0], tags) if directories else None
    red, green, blue, second_green = raw.camera_whitebalance if white is None else (*1 / white, 0)
    if not (red > 0 and green > 0 and blue > 0):
        return None
    # LibRaw keeps float32: six decimals give back the number that the file states.
    values = (red, green, blue, second_green if second_green > 0 else green)
    return tuple(round(float(value) / float(green), 6) for value in values)  # type: ignore[return-value] # of four


def _neutral_of_white(stated: Directory, tags: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """Return the camera's response to a DNG's AsShotWhiteXY, in R, G, B; None if its tags do not say it."""

    def numbers(tag: int, otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
        values = np.array([float(value) for value in stated.values.get(tag, ())])
        return values.reshape(otherwise.shape) if values.size == otherwise.size else otherwise

    white = numbers(AS_SHOT_WHITE_XY, np.zeros(2))
    of_profile = len({str(tags.get(signature)) for signature in _SIGNATURES}) == 1
    lights = [
        (_illuminant(stated.values.get(illuminant, ())), matrix, numbers(calibration if of_profile else 0, np.eye(3)))
        for (tag, illuminant), calibration in zip(COLOUR_MATRICES, _CALIBRATIONS, strict=True)
        if (matrix := numbers(tag, np.zeros((3, 3)))).any()
    ]
    if not white[1] > 0 or not lights or _THIRD_MATRIX in stated.entries:
        return None
    neutral = numbers(_ANALOG_BALANCE, np.ones(3)) * neutral_of_white(white[0], white[1], lights)
    return neutral if (neutral > 0).all() else None


def _private_data(tags: Mapping[str, Any]) -> bytes:
    tag = tags.get(f"Image Tag 0x{PRIVATE_DATA:X}")  # exifread leaves out the values of a long one, which is not ours
    values = [] if tag is None else tag.values
    ours = isinstance(values, list) and all(isinstance(value, int) and 0 <= value < 256 for value in values)
    return bytes(values) if ours else b""


def camera_matrix(raw: rawpy.RawPy, directories: Sequence[Directory]) -> tuple[Matrix3 | None, int]:
    """Return the matrix from XYZ to the camera's colours, and the light that it is for; None if it is not known.

    Of a DNG's two matrices that for D65, else the first for another daylight, else the second: LibRaw's order.
    """
    stated = directories[0].values if directories else {}
    found = [
        (_illuminant(stated.get(illuminant, ())), stated[matrix])
        for matrix, illuminant in COLOUR_MATRICES
        if len(stated.get(matrix, ())) == 9
    ]
    if found:
        preferred = [one for one in found if one[0] == D65] or [one for one in found if one[0] in _DAYLIGHT]
        illuminant, values = (preferred or found[-1:])[0]
        numbers = [exact_number(value) for value in values]
    else:
        illuminant = D65  # LibRaw's table
        numbers = [round(float(value), 6) for row in raw.rgb_xyz_matrix[:3] for value in row]
    if not np.any(numbers):
        return None, D65
    return (_three(numbers[:3]), _three(numbers[3:6]), _three(numbers[6:])), illuminant


def _illuminant(stated: Sequence[Fraction]) -> int:
    """Return the number of a source of light; 0, "unknown", if none of 16 bits is stated."""
    return int(stated[0]) if stated and 0 <= stated[0] < 1 << 16 else 0


def _three(numbers: Sequence[float]) -> tuple[float, float, float]:
    first, second, third = numbers
    return first, second, third


def lossy_compression(path: Path) -> str | None:
    """Return what loses data in a raw file, in words, or ``None`` if nothing known does.

    Known are Sony's compressed ARW 2 (one byte per pixel: 11 of 14 bits by a curve, differences within 16 pixels) and
    the lossy JPEG of DNG. Nikon's lossy NEF says so in its maker notes alone, Canon's CRAW in a container that is not
    TIFF: the gaps that such compression leaves between the values show it
    (:func:`eldata.calibration.checks.mean_step`).

    Raises
    ------
    RawFileError
        If the file is truncated or damaged.
    """
    for directory in read_directories(path):
        if not directory.is_mosaic:
            continue
        held = sum(count for _, count in directory.extents)
        if directory.compression == _SONY and held == directory.pixels:
            return "Sony's lossy compression (choose uncompressed raw in the camera)"
        if directory.compression == _LOSSY_JPEG:
            return "a DNG's lossy JPEG compression (convert from the original without it)"
    return None


# --- remarks ----------------------------------------------------------------------------------------------------------


def opcode_remarks(mosaic: Directory) -> tuple[str, ...]:
    """Return what there is to say of a mosaic's lists of opcodes."""
    remarks = []
    for number, (tag, meaning) in enumerate(zip(OPCODE_LISTS, _NOT_APPLIED, strict=True), 1):
        codes = map(int, mosaic.values.get(tag, ()))
        names = dict.fromkeys(_OPCODES[code - 1] if 0 < code <= len(_OPCODES) else "unknown" for code in codes)
        if names:
            remarks.append(f"its OpcodeList{number} ({', '.join(names)}) is not applied: {meaning}")
    return tuple(remarks)


def masked_remarks(mosaic: Directory, stored: NDArray[np.uint16], black_dn: Sequence[float]) -> tuple[str, ...]:
    """Return what there is to say of masked pixels, which no light reaches: if their mean is not the stated black.

    ``stored``: all pixels, (H, W) in DN.
    """
    areas = list(map(int, mosaic.values.get(MASKED_AREAS, ())))
    corners = zip(*[iter(areas)] * 4, strict=True)
    values = np.concatenate([stored[:0, 0], *(stored[y:below, x:beside].ravel() for y, x, below, beside in corners)])
    level = float(np.mean(black_dn))
    mean = float(values.mean()) if values.size else level
    if abs(mean - level) < _LEAST_APART_DN:
        return ()
    remark = (
        f"its masked pixels (MaskedAreas) have a mean of {mean:.1f} DN, but its BlackLevel says {level:.1f} DN, which "
        "is taken, as the DNG specification has it"
    )
    return (remark,)
