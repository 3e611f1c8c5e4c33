"""The references and pairs of the published ELD evaluation a second time, in plain numpy float64, rawpy and exifread.

It shares no code with the package, on purpose: nothing of ``eldata`` may be imported here.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import exifread
import numpy as np
import rawpy
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]

WHITE_DN = 16383.0
REFERENCE_NUMBERS = np.array([1, 6, 11, 16])


@dataclass(frozen=True)
class Frame:
    """One decoded file: mosaic in DN, 2x2 pattern of channel indices, black level per channel."""

    mosaic: Floats
    pattern: NDArray[np.int64]
    black: Floats


@dataclass(frozen=True)
class Pair:
    path: str
    reference: str
    camera: str
    scene: str
    iso: float
    factor: int


def decode(path: Path) -> Frame:
    with rawpy.imread(str(path)) as raw:
        assert raw.raw_pattern is not None
        return Frame(
            raw.raw_image_visible.astype(np.float64),
            raw.raw_pattern.astype(np.int64),
            np.array(raw.black_level_per_channel, dtype=np.float64),
        )


def pack(mosaic: Floats, pattern: NDArray[np.int64]) -> Floats:
    """R, G1, B, G2, each at its own site of the 2x2 cell."""
    channels = []
    for index in range(4):
        ((row,), (column,)) = np.where(pattern == index)
        channels.append(mosaic[row::2, column::2])
    return np.stack(channels)


def unpack(packed: NDArray[Any], pattern: NDArray[np.int64]) -> NDArray[Any]:
    _, height, width = packed.shape
    mosaic = np.empty((2 * height, 2 * width), packed.dtype)
    for index in range(4):
        ((row,), (column,)) = np.where(pattern == index)
        mosaic[row::2, column::2] = packed[index]
    return mosaic


def reference(path: Path) -> Floats:
    """Packed, black subtracted, divided by 16383 - black, clipped to [0, 1]."""
    frame = decode(path)
    black = frame.black[:, None, None]
    return np.clip((pack(frame.mosaic, frame.pattern) - black) / (WHITE_DN - black), 0, 1)


def iso_and_seconds(path: Path) -> tuple[Fraction, Fraction]:
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=False)
    seconds = tags["EXIF ExposureTime"].values[0]
    return Fraction(tags["EXIF ISOSpeedRatings"].values[0]), Fraction(seconds.num, seconds.den)


def pairs(folder: Path) -> list[Pair]:
    """The pairs of factors 100 and 200, from the file names and the EXIF alone."""
    found = []
    for path in sorted(folder.glob("*/scene-*/IMG_*.dng")):
        number = int(path.stem.removeprefix("IMG_"))
        if number in REFERENCE_NUMBERS:
            continue
        nearest = int(REFERENCE_NUMBERS[np.argmin(np.abs(number - REFERENCE_NUMBERS))])
        partner = path.with_name(f"IMG_{nearest:04d}.dng")
        (iso, seconds), (reference_iso, reference_seconds) = iso_and_seconds(path), iso_and_seconds(partner)
        factor = round(reference_iso * reference_seconds / (iso * seconds))
        if factor in (100, 200):
            names = [item.relative_to(folder).as_posix() for item in (path, partner)]
            found.append(Pair(names[0], names[1], path.parts[-3], path.parts[-2], float(iso), factor))
    return found
