"""Writing DNG files that LibRaw and exiftool read back equal in every field.

Adobe DNG specification 1.6, EXIF 2.32. The file's one directory comes first, then the pixels in one strip, then an EXIF
directory of its own, where cameras put it: LibRaw ignores an ISO that stands in the first one.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from eldata.base.files import atomic_write
from eldata.base.numbers import simplest_fraction
from eldata.errors import ArgumentError, check_choice
from eldata.raw import tiff
from eldata.raw.colour import neutral_of
from eldata.raw.damage import mosaic_fault
from eldata.raw.levels import packed_black_level_dn
from eldata.raw.tiff import RATIONAL, SRATIONAL, round_fraction

if TYPE_CHECKING:
    from collections.abc import Iterable
    from datetime import datetime
    from fractions import Fraction
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import Exposure, Sensor


Compression = Literal["none", "lossless-jpeg"]
Entry = tuple[int, str, "bytes | tuple[int, ...]"]
"""Tag, type (as struct names its numbers; ``s``: text, ``x``: undefined) and values, two for each fraction."""

_KINDS = {"B": 1, "s": 2, "H": 3, "I": 4, "2I": 5, "x": 7, "2i": 10}
_LEAST_SIDE = 22
_LARGEST_DN = 65535


def _pack_directory(entries: Iterable[Entry], at: int) -> bytes:
    """Pack a little-endian directory that will stand at ``at``, its long values right behind it."""
    entries = sorted(entries)
    behind = at + 2 + 12 * len(entries) + 4
    table, values = struct.pack("<H", len(entries)), b""
    for tag, kind, numbers in entries:
        data = numbers if isinstance(numbers, bytes) else struct.pack(f"<{len(numbers)}{kind[-1]}", *numbers)
        table += struct.pack("<HHI", tag, _KINDS[kind], len(numbers) // len(kind))
        if len(data) <= 4:
            table += data.ljust(4, b"\0")
        else:
            table += struct.pack("<I", behind + len(values))
            values += data + b"\0" * (len(data) % 2)
    return table + bytes(4) + values


def _text_entry(tag: int, text: str) -> Entry:
    """Make a directory's entry of a text, which ends with a zero byte."""
    return tag, "s", text.encode() + b"\0"


def _split_fractions(values: Iterable[Fraction]) -> tuple[int, ...]:
    """List the numerator and denominator of each fraction in turn, as TIFF stores them."""
    return tuple(part for value in values for part in (value.numerator, value.denominator))


def _exif_entries(exposure: Exposure, taken: datetime | None) -> list[Entry]:
    """Make the EXIF entries of exposure time, f-number, ISO and date; refuse numbers that EXIF cannot hold."""
    entries: list[Entry] = [(36864, "x", b"0232")]
    for tag, name in ((tiff.EXPOSURE_TIME, "exposure_s"), (tiff.F_NUMBER, "f_number")):
        if getattr(exposure, name) is not None:
            value = simplest_fraction(getattr(exposure, name))
            if not 1 <= value * RATIONAL <= RATIONAL**2:
                raise ArgumentError(
                    f"{name} = {value}: expected a number from 1 / (2^32 - 1) to 2^32 - 1, as EXIF holds"
                )
            entries.append((tag, "2I", _split_fractions([round_fraction(value, RATIONAL)])))
    if exposure.iso is not None:
        iso = simplest_fraction(exposure.iso)
        if iso.denominator != 1 or not 0 < iso <= RATIONAL:
            raise ArgumentError(f"iso = {iso} is not a positive whole number of 32 bits")
        # ISOSpeedRatings has 16 bits; beyond them EXIF 2.3 states the speed as RecommendedExposureIndex.
        entries.append((tiff.ISO, "H", (min(int(iso), 65535),)))
        entries += [(tiff.SENSITIVITY_TYPE, "H", (2,)), (tiff.EXPOSURE_INDEX, "I", (int(iso),))]
    if taken is not None:
        digits = f"{taken.microsecond:06d}"
        entries.append(_text_entry(tiff.TAKEN, taken.strftime("%Y:%m:%d %H:%M:%S")))
        entries.append(_text_entry(tiff.TAKEN_FRACTION, digits[:3] if digits.endswith("000") else digits))
    return entries


def _check_sensor(sensor: Sensor) -> None:
    """Refuse a sensor that LibRaw would read from the file as something else."""
    packed_black_level_dn(sensor.cfa, sensor.black_level_dn)  # refuses CFA and number of levels
    white = sensor.white_level_dn
    if not all(0 <= level <= _LARGEST_DN for level in sensor.black_level_dn):
        raise ArgumentError(f"black_level_dn {sensor.black_level_dn}: expected numbers from 0 to {_LARGEST_DN}")
    if not (0 <= white <= _LARGEST_DN and white == int(white)):
        raise ArgumentError(f"white_level_dn {white}: expected a whole number from 0 to {_LARGEST_DN}, as a DNG holds")
    if not white > max(sensor.black_level_dn):
        raise ArgumentError(f"white_level_dn {white} must lie above black_level_dn {sensor.black_level_dn}")
    if min(sensor.height, sensor.width) < _LEAST_SIDE:
        raise ArgumentError(
            f"{sensor.height} x {sensor.width} pixels: LibRaw reads no raw image under {_LEAST_SIDE} pixels per side"
        )
    for name, text in (("make", sensor.make), ("model", sensor.model)):
        if "\0" in text or text != text.strip():
            raise ArgumentError(f"{name} {text!r}: expected text without spaces at its ends or a zero in it")


def _sensor_entries(sensor: Sensor) -> list[Entry]:
    """Make the entries of a sensor: CFA, levels, camera, colour matrix and white balance."""
    sites = [index for row in sensor.cfa for index in row]
    period = len(sensor.cfa), len(sensor.cfa[0])
    black = [round_fraction(simplest_fraction(sensor.black_level_dn[index]), RATIONAL) for index in sites]
    whole = all(level.denominator == 1 for level in black)
    entries: list[Entry] = [
        (tiff.CFA_REPEAT, "H", period),
        # A DNG's CFAPattern names colours: red 0, green 1, blue 2; which green is which follows from the place.
        (tiff.CFA_PATTERN, "B", bytes({3: 1}.get(index, index) for index in sites)),
        (tiff.DNG_VERSION, "B", bytes((1, 4, 0, 0))),
        (50707, "B", bytes((1, 1, 0, 0))),  # DNGBackwardVersion
        (tiff.BLACK_REPEAT, "H", period),
        (tiff.BLACK_LEVEL, "I", tuple(map(int, black))) if whole else (tiff.BLACK_LEVEL, "2I", _split_fractions(black)),
        (tiff.WHITE_LEVEL, "I", (int(sensor.white_level_dn),)),
    ]
    names = {tiff.MAKE: sensor.make, tiff.MODEL: sensor.model}
    # As Adobe names cameras, whose profiles are found by it: no maker twice.
    has_maker = sensor.model.casefold().startswith(tuple(sensor.make.casefold().split()[:1]))
    names[tiff.UNIQUE_MODEL] = sensor.model if has_maker else f"{sensor.make} {sensor.model}".strip()
    entries += [_text_entry(tag, name) for tag, name in names.items() if name]
    if sensor.xyz_to_camera is not None:
        matrix = [round_fraction(simplest_fraction(value), SRATIONAL) for row in sensor.xyz_to_camera for value in row]
        of_matrix, of_illuminant = tiff.COLOUR_MATRICES[0]
        entries.append((of_matrix, "2i", _split_fractions(matrix)))
        if sensor.matrix_illuminant:  # 0 is what stands for a tag that is not there
            entries.append((of_illuminant, "H", (sensor.matrix_illuminant,)))
    if sensor.white_balance is not None:
        neutral = neutral_of(list(map(simplest_fraction, sensor.white_balance)))
        entries.append((tiff.AS_SHOT_NEUTRAL, "2I", _split_fractions(neutral)))
    return entries


def write_dng(
    path: Path | str, mosaic: NDArray[np.uint16], sensor: Sensor, exposure: Exposure, *,
    compression: Compression = "none", taken: datetime | None = None, orientation: int = 1, software: str = "eldata",
) -> None:  # fmt: skip
    """Write a mosaic as a DNG, whole or not at all.

    :func:`eldata.raw.read_raw` gives back the same mosaic, sensor and exposure (for a sensor without a matrix LibRaw's,
    if its table has the model). A float is written as the simple fraction that it is the nearest float to, such as
    21/10. What does not fit TIFF's fields, two whole numbers of 32 bits, is rounded
    (:func:`eldata.raw.tiff.round_fraction`), off by less than one part in four billion (of matrices, which have signs,
    two billion). A DNG has one white balance for both greens: G1's.

    Parameters
    ----------
    path
        The file; its folder must exist.
    mosaic
        (H, W) uint16 in DN, H and W as the sensor record says.
    sensor
        Bayer or X-Trans. Black levels from 0 to 65535, fractions too; a whole white level.
    exposure
        Fields that are ``None`` are left out of the file. ISO must be a whole number.
    compression
        ``"none"``, or ``"lossless-jpeg"`` (smaller on disk, several times slower to decode).
    taken
        When, by the camera's clock; to the microsecond.
    orientation
        EXIF's, 1 to 8: how to turn the picture for viewing.
    software
        What made the pixels.

    Raises
    ------
    ArgumentError
        If a field does not fit the format: it is zero, negative, infinite or too large; the message names file and
        field.
    EldataError
        If the file cannot be written.
    """
    check_choice("compression", compression, get_args(Compression))
    if orientation not in range(1, 9):
        raise ArgumentError(f"{path}: orientation {orientation}: expected EXIF's, 1 to 8")
    made: list[Entry] = [(tiff.ORIENTATION, "H", (orientation,)), _text_entry(tiff.SOFTWARE, software)]
    try:
        content = _encode_dng(mosaic, sensor, exposure, compression, taken, made)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    except (struct.error, ValueError, OverflowError) as error:  # NaN, infinity, or more than 32 bits
        raise ArgumentError(f"{path}: a DNG cannot hold {sensor} and {exposure}: {error}") from error
    with atomic_write(path) as file:
        file.writelines(content)


def _encode_dng(
    mosaic: NDArray[np.uint16], sensor: Sensor, exposure: Exposure, compression: Compression,
    taken: datetime | None, made: list[Entry],
) -> tuple[bytes, bytes | memoryview, bytes]:  # fmt: skip
    """Encode a DNG as three parts to write in order: header and directory, pixels, EXIF."""
    if mosaic.dtype != np.uint16 or mosaic.shape != (sensor.height, sensor.width):
        raise ArgumentError(
            f"expected a uint16 mosaic of {sensor.height} x {sensor.width} pixels as the sensor record says; found "
            f"{mosaic.dtype} {mosaic.shape}"
        )
    _check_sensor(sensor)
    fault = mosaic_fault(mosaic, sensor.black_level_dn, sensor.white_level_dn)
    if fault is not None:
        raise ArgumentError(f"{fault}: reading takes that for a damaged file")
    pixels: bytes | memoryview = np.ascontiguousarray(mosaic, "<u2").data.cast("B")  # a frame's bytes are not copied
    if compression == "lossless-jpeg":
        import imagecodecs

        encoded = bytes(imagecodecs.ljpeg_encode(np.ascontiguousarray(mosaic), bitspersample=16))
        pixels = encoded + b"\0" * (len(encoded) % 2)
    stated = _sensor_entries(sensor)

    def pack_head(exif_at: int, pixels_at: int) -> bytes:
        """Pack the header and the first directory, given the offsets of EXIF and pixels in bytes."""
        image = {tiff.WIDTH: sensor.width, tiff.HEIGHT: sensor.height, tiff.ROWS_PER_STRIP: sensor.height}
        image |= {tiff.STRIPS[0]: pixels_at, tiff.STRIPS[1]: len(pixels), tiff.EXIF_IFD: exif_at}
        short = {tiff.BITS: 16, tiff.COMPRESSION: tiff.JPEG if compression == "lossless-jpeg" else tiff.UNCOMPRESSED}
        short |= {tiff.PHOTOMETRIC: tiff.CFA_PHOTOMETRIC, tiff.SAMPLES: 1}
        entries = [(tag, "I", (value,)) for tag, value in image.items()]
        entries += [(tag, "H", (value,)) for tag, value in short.items()]
        return b"II*\0" + struct.pack("<I", 8) + _pack_directory([*entries, *stated, *made], 8)

    begin = len(pack_head(0, 0))  # which stays as long
    end = begin + len(pixels)
    return pack_head(end, begin), pixels, _pack_directory(_exif_entries(exposure, taken), end)
