"""Writing DNG files that LibRaw and exiftool read back equal in every field.

tifffile writes the TIFF; the DNG and EXIF tags are set here (Adobe DNG specification 1.6, EXIF 2.32). EXIF
stands in an EXIF IFD of its own, where cameras put it: LibRaw ignores an ISO that stands in IFD0.
"""

from __future__ import annotations

import io
import math
import struct
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from eldata.base.files import atomic_write
from eldata.errors import ArgumentError, check_choice
from eldata.raw.colour import neutral_of, private_data
from eldata.raw.damage import mosaic_fault
from eldata.raw.levels import packed_black_level_dn
from eldata.raw.tiff import AS_SHOT_NEUTRAL, COLOUR_MATRICES, PRIVATE_DATA, RATIONAL, SRATIONAL, nearest_fraction
from eldata.records import exact_fraction

if TYPE_CHECKING:
    from collections.abc import Iterable
    from datetime import datetime
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import Exposure, Sensor

Compression = Literal["none", "lossless-jpeg"]
Entry = tuple[int, str, int, object, bool]  # as tifffile's extratags: code, type, count, value, on every page

_COMPRESSION_JPEG = 7
_PHOTOMETRIC_CFA = 32803
_EXIF_IFD = 34665
_EXIF_IFD_PLACEHOLDER = 34664  # an unassigned tag that sorts to the same place
_LEAST_SIDE = 22
_LARGEST_DN = 65535


def _fraction(value: Fraction | float | None, name: str) -> Fraction | None:
    try:
        return value if value is None or isinstance(value, Fraction) else exact_fraction(value)
    except ValueError as error:
        raise ArgumentError(f"{name} = {value}: expected a finite number") from error


def _rational(value: Fraction, name: str) -> tuple[int, int]:
    if not 1 <= value * RATIONAL <= RATIONAL**2:
        raise ArgumentError(f"{name} = {value}: expected a number from 1 / (2^32 - 1) to 2^32 - 1, as EXIF holds")
    nearest = nearest_fraction(value, RATIONAL)
    return nearest.numerator, nearest.denominator


def _parts(values: Iterable[Fraction]) -> tuple[int, ...]:
    return tuple(part for value in values for part in (value.numerator, value.denominator))


def _exif_entries(exposure: Exposure, taken: datetime | None) -> list[tuple[int, int, int, bytes]]:
    """Return EXIF entries (tag, type, count, value bytes), sorted by tag."""
    entries: list[tuple[int, int, int, bytes]] = []
    stated = {name: _fraction(getattr(exposure, name), name) for name in ("exposure_s", "f_number", "iso")}
    for tag, name in ((33434, "exposure_s"), (33437, "f_number")):
        if (value := stated[name]) is not None:
            entries.append((tag, 5, 1, struct.pack("<II", *_rational(value, name))))
    if (speed := stated["iso"]) is not None:
        if speed.denominator != 1 or not 0 < speed <= RATIONAL:
            raise ArgumentError(f"iso = {speed} is not a positive whole number of 32 bits")
        iso = int(speed)
        entries.append((34855, 3, 1, struct.pack("<H", min(iso, 65535))))
        # ISOSpeedRatings has 16 bits; beyond them EXIF 2.3 states the speed as RecommendedExposureIndex.
        entries.append((34864, 3, 1, struct.pack("<H", 2)))
        entries.append((34866, 4, 1, struct.pack("<I", iso)))
    entries.append((36864, 7, 4, b"0232"))
    if taken is not None:
        entries.append((36867, 2, 20, taken.strftime("%Y:%m:%d %H:%M:%S").encode() + b"\0"))
        digits = f"{taken.microsecond:06d}"
        parts = (digits[:3] if digits.endswith("000") else digits).encode() + b"\0"
        entries.append((37521, 2, len(parts), parts))
    return sorted(entries)


def _ifd_bytes(entries: list[tuple[int, int, int, bytes]], offset: int) -> bytes:
    """Return a little-endian IFD that will stand at ``offset``, its long values right behind it."""
    values_at = offset + 2 + 12 * len(entries) + 4
    table, values = struct.pack("<H", len(entries)), b""
    for tag, kind, count, value in entries:
        table += struct.pack("<HHI", tag, kind, count)
        if len(value) <= 4:
            table += value.ljust(4, b"\0")
        else:
            table += struct.pack("<I", values_at + len(values))
            values += value
    return table + struct.pack("<I", 0) + values


def _check_sensor(sensor: Sensor) -> None:
    """Refuse what the format, or LibRaw when it reads the file, cannot hold."""
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
    if sensor.white_balance is not None and not all(map(math.isfinite, sensor.white_balance)):
        raise ArgumentError(f"white_balance {sensor.white_balance}: expected finite multipliers")
    numbers = () if sensor.xyz_to_camera is None else [value for row in sensor.xyz_to_camera for value in row]
    if not all(abs(value) <= SRATIONAL for value in numbers):
        raise ArgumentError(f"xyz_to_camera {sensor.xyz_to_camera}: expected finite numbers of up to 31 bits")
    if not 0 <= sensor.matrix_illuminant < 1 << 16:
        raise ArgumentError(f"matrix_illuminant {sensor.matrix_illuminant}: expected a whole number of 16 bits")
    for name, text in (("make", sensor.make), ("model", sensor.model)):
        if "\0" in text or text != text.strip():
            raise ArgumentError(f"{name} {text!r}: expected text without spaces at its ends or a zero in it")


def _black_tag(sensor: Sensor) -> Entry:
    black = [nearest_fraction(exact_fraction(sensor.black_level_dn[index]), RATIONAL) for index in _sites(sensor)]
    if all(level.denominator == 1 for level in black):
        return (50714, "I", len(black), tuple(map(int, black)), True)
    return (50714, "2I", len(black), _parts(black), True)


def _sites(sensor: Sensor) -> list[int]:
    return [index for row in sensor.cfa for index in row]


def _colour_tags(sensor: Sensor) -> list[Entry]:
    tags: list[Entry] = []
    if sensor.xyz_to_camera is not None:
        matrix = [nearest_fraction(exact_fraction(value), SRATIONAL) for row in sensor.xyz_to_camera for value in row]
        of_matrix, of_illuminant = COLOUR_MATRICES[0]
        tags.append((of_matrix, "2i", 9, _parts(matrix), True))
        if sensor.matrix_illuminant:  # 0 is what stands for a tag that is not there
            tags.append((of_illuminant, "H", 1, sensor.matrix_illuminant, True))
    if sensor.white_balance is not None:
        red, green, blue, second_green = map(exact_fraction, sensor.white_balance)
        balance = red, green, blue, second_green
        tags.append((AS_SHOT_NEUTRAL, "2I", 3, _parts(neutral_of(balance)), True))
        private = private_data(balance)
        if private:
            tags.append((PRIVATE_DATA, "B", len(private), private, True))
    return tags


def _sensor_tags(sensor: Sensor) -> list[Entry]:
    rows, columns = len(sensor.cfa), len(sensor.cfa[0])
    # A DNG's CFAPattern names colours: red 0, green 1, blue 2; which green is which follows from the place.
    colours = bytes({3: 1}.get(index, index) for index in _sites(sensor))
    tags: list[Entry] = [
        (33421, "H", 2, (rows, columns), True),
        (33422, "B", rows * columns, colours, True),
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),
        (50707, "B", 4, bytes((1, 1, 0, 0)), True),
        (50713, "H", 2, (rows, columns), True),
        _black_tag(sensor),
        (50717, "I", 1, int(sensor.white_level_dn), True),
    ]
    for code, text in (
        (271, sensor.make),
        (272, sensor.model),
        (50708, f"{sensor.make} {sensor.model}".strip()),
    ):
        if text:
            tags.append((code, "s", 0, text.encode(), True))
    return tags + _colour_tags(sensor)


def write_dng(
    path: Path | str,
    mosaic: NDArray[np.uint16],
    sensor: Sensor,
    exposure: Exposure,
    *,
    compression: Compression = "none",
    taken: datetime | None = None,
) -> None:
    """Write a mosaic as a DNG, whole or not at all.

    :func:`eldata.raw.read_raw` gives back the same mosaic, sensor and exposure (a sensor without a matrix gets that of
    LibRaw's table if LibRaw knows the model). Numbers are written as the fractions that they stand for
    (:func:`eldata.records.exact_fraction`). One that the fields of TIFF, two whole numbers of 32 bits, cannot hold
    becomes the nearest that they can (:func:`eldata.raw.tiff.nearest_fraction`), off by less than one part in four
    billion (of matrices, which have signs, two billion); but white balance is kept exactly, and so are greens that
    differ, for which a DNG has no field: see :mod:`eldata.raw.colour`.

    Parameters
    ----------
    path
        The file; its folder must exist.
    mosaic
        (H, W) uint16 in DN, H and W as the sensor record says.
    sensor
        Bayer or X-Trans. Black levels from 0 to 65535, fractions too; a whole white level.
    exposure
        Fields that are ``None`` are left out of the file; a float is the decimal that it prints as. ISO must be a whole
        number.
    compression
        ``"none"``, or ``"lossless-jpeg"`` (smaller on disk, several times slower to decode).
    taken
        When, by the camera's clock; to the microsecond.

    Raises
    ------
    ArgumentError
        If a field does not fit the format: it is zero, negative, infinite or too large; the message names file and
        field.
    EldataError
        If the file cannot be written.
    """
    check_choice("compression", compression, get_args(Compression))
    try:
        content = encode_dng(mosaic, sensor, exposure, compression, taken)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    with atomic_write(path) as file:
        file.write(content.getbuffer())


def encode_dng(
    mosaic: NDArray[np.uint16],
    sensor: Sensor,
    exposure: Exposure,
    compression: Compression = "none",
    taken: datetime | None = None,
) -> io.BytesIO:
    """Return the bytes of the file that :func:`write_dng` writes of the same; raises :class:`ArgumentError` like it."""
    import imagecodecs
    import tifffile

    if mosaic.dtype != np.uint16 or mosaic.shape != (sensor.height, sensor.width):
        raise ArgumentError(
            f"expected a uint16 mosaic of {sensor.height} x {sensor.width} pixels as the sensor record says; found "
            f"{mosaic.dtype} {mosaic.shape}"
        )
    _check_sensor(sensor)
    fault = mosaic_fault(mosaic, sensor.black_level_dn, sensor.white_level_dn)
    if fault is not None:
        raise ArgumentError(f"{fault}: reading takes that for a damaged file")

    whole = np.ascontiguousarray(mosaic)
    buffer = io.BytesIO()
    with tifffile.TiffWriter(buffer, bigtiff=False, byteorder="<") as tiff:
        write = partial(
            tiff.write,
            shape=mosaic.shape,
            dtype=mosaic.dtype,
            photometric=_PHOTOMETRIC_CFA,
            rowsperstrip=sensor.height,
            metadata=None,
            software="eldata",
            extratags=[*_sensor_tags(sensor), (_EXIF_IFD_PLACEHOLDER, "I", 1, 0, True)],
        )
        if compression == "lossless-jpeg":
            write(iter([bytes(imagecodecs.ljpeg_encode(whole, bitspersample=16))]), compression=_COMPRESSION_JPEG)
        else:
            write(whole)
    _append_exif(buffer, exposure, taken)
    return buffer


def _append_exif(buffer: io.BytesIO, exposure: Exposure, taken: datetime | None) -> None:
    """Append an EXIF IFD and turn the placeholder into its pointer: tifffile reserves that tag for itself."""
    import tifffile

    end = buffer.seek(0, io.SEEK_END)
    offset = end + end % 2
    buffer.write(b"\0" * (end % 2))
    buffer.write(_ifd_bytes(_exif_entries(exposure, taken), offset))
    buffer.seek(0)
    with tifffile.TiffFile(buffer) as tiff:
        entry = tiff.pages.first.tags[_EXIF_IFD_PLACEHOLDER].offset
    buffer.seek(entry)
    buffer.write(struct.pack("<HHII", _EXIF_IFD, 4, 1, offset))
