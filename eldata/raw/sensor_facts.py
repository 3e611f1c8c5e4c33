"""What a raw file states of its sensor beside the CFA: levels, white balance, colour matrix.

A DNG's own figures to the last digit, from the file; those of other formats as LibRaw has them
(:mod:`eldata.raw.reading` says which and why).
"""

from __future__ import annotations

from fractions import Fraction
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.isolation import guarded_file
from eldata.errors import ArgumentError, RawFileError
from eldata.raw.neutrals import white_balance_of
from eldata.raw.tiff import (
    BITS,
    NOISE_PROFILE,
    WHITE_LEVEL,
    image_directories,
    read_directories,
)
from eldata.records import D65, exact_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import rawpy

    from eldata.raw.tiff import Directory
    from eldata.records import Matrix3

AS_SHOT_NEUTRAL, PRIVATE_DATA = 50728, 50740
COLOUR_MATRICES = ((50721, 50778), (50722, 50779))
"""Each with the tag of its illuminant."""

# Daylight, flash, D55, D75, D50, as EXIF numbers sources of light.
_DAYLIGHT = (1, 4, 20, 22, 23)


def dng_white_level(mosaic: Directory) -> float:
    """Return a DNG's WhiteLevel; where it states none, by the specification 1 of floats, else the largest number."""
    largest = 1 if mosaic.is_float else (1 << mosaic.number(BITS, 16)) - 1
    return exact_number(next(iter(mosaic.values.get(WHITE_LEVEL, ())), Fraction(largest)))


def dng_noise_profile(path: Path) -> tuple[float, ...] | None:
    """Return the numbers of a DNG's NoiseProfile as they stand; None if the file has none.

    By the DNG specification (1.3 and later) S and O of the variance ``S x + O`` of linear values x, 0 at black and 1 at
    white: one pair for all colour planes, or one for each in their order.

    Raises
    ------
    RawFileError
        If a directory of the file is damaged.
    """
    directories = guarded_file(read_directories, path, RawFileError)
    largest = max((one.shape for one in directories if one.is_mosaic), key=prod, default=(0, 0))
    # It stands beside the mosaic, not a proxy of it, or in IFD0.
    places = (*image_directories(directories, largest), *directories)
    stated = (one.values[NOISE_PROFILE] for one in places if NOISE_PROFILE in one.values)
    return next((tuple(map(float, numbers)) for numbers in stated), None)


def channel_whites(raw: rawpy.RawPy, index_of: Sequence[int]) -> tuple[float, ...] | None:
    """Return LibRaw's white level per channel of the CFA, given LibRaw's indices of them; None if it has none."""
    levels = raw.camera_white_level_per_channel
    if levels is None or not all(levels[index] > 0 for index in index_of):
        return None
    return tuple(float(levels[index]) for index in index_of)


def as_shot_multipliers(
    path: Path, raw: rawpy.RawPy | None, directories: Sequence[Directory], tags: Mapping[str, Any]
) -> tuple[float, float, float, float] | None:
    """Return the multipliers of R, G1, B, G2 as shot, G1 = 1; None if they are not known.

    LibRaw is asked, where it is given, for what the file does not state.

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
    if raw is None:
        return None
    red, green, blue, second_green = raw.camera_whitebalance
    if not (red > 0 and green > 0 and blue > 0):
        return None
    # LibRaw keeps float32: six decimals give back the number that the file states.
    values = (red, green, blue, second_green if second_green > 0 else green)
    return tuple(round(float(value) / float(green), 6) for value in values)  # type: ignore[return-value] # of four


def _private_data(tags: Mapping[str, Any]) -> bytes:
    tag = tags.get(f"Image Tag 0x{PRIVATE_DATA:X}")  # exifread leaves out the values of a long one, which is not ours
    values = [] if tag is None else tag.values
    ours = isinstance(values, list) and all(isinstance(value, int) and 0 <= value < 256 for value in values)
    return bytes(values) if ours else b""


def camera_matrix(raw: rawpy.RawPy | None, directories: Sequence[Directory]) -> tuple[Matrix3 | None, int]:
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
        numbers = [] if raw is None else [round(float(value), 6) for row in raw.rgb_xyz_matrix[:3] for value in row]
    if not np.any(numbers):
        return None, D65
    return (_three(numbers[:3]), _three(numbers[3:6]), _three(numbers[6:])), illuminant


def _illuminant(stated: Sequence[Fraction]) -> int:
    """Return the number of a source of light; 0, "unknown", if none of 16 bits is stated."""
    return int(stated[0]) if stated and 0 <= stated[0] < 1 << 16 else 0


def _three(numbers: Sequence[float]) -> tuple[float, float, float]:
    first, second, third = numbers
    return first, second, third
