"""Writing DNG files that LibRaw and exifread read back equal in every field.

tifffile writes the TIFF; the DNG and EXIF tags are set here (Adobe DNG specification 1.6, EXIF 2.32). EXIF
stands in an EXIF IFD of its own, where cameras put it: LibRaw ignores an ISO that stands in IFD0.
"""

from __future__ import annotations

import io
import struct
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from eldata.base.files import atomic_write
from eldata.errors import ArgumentError, check_choice
from eldata.raw.cfa import packed_black_level_dn
from eldata.raw.damage import mosaic_fault

if TYPE_CHECKING:
    from datetime import datetime
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import Exposure, Sensor

Compression = Literal["none", "lossless-jpeg"]
Entry = tuple[int, str, int, object, bool]  # as tifffile's extratags: code, type, count, value, on every page

_MAX_LONG = 2**32 - 1
_COMPRESSION_JPEG = 7
_PHOTOMETRIC_CFA = 32803
_EXIF_IFD = 34665
_EXIF_IFD_PLACEHOLDER = 34664  # an unassigned tag that sorts to the same place
_ILLUMINANT_D65 = 21
_LEAST_SIDE = 22


def _rational(value: Fraction, name: str) -> tuple[int, int]:
    if value <= 0 or value.numerator > _MAX_LONG or value.denominator > _MAX_LONG:
        raise ArgumentError(f"{name} = {value} does not fit an EXIF fraction (positive, 32 bits each part)")
    return value.numerator, value.denominator


def _decimal(value: float) -> Fraction:
    """Return the decimal number that a float was written as: 2.1 becomes 21/10."""
    return Fraction(repr(float(value)))


def _exif_entries(exposure: Exposure, taken: datetime | None) -> list[tuple[int, int, int, bytes]]:
    """Return EXIF entries (tag, type, count, value bytes), sorted by tag."""
    entries: list[tuple[int, int, int, bytes]] = []
    if exposure.exposure_s is not None:
        entries.append((33434, 5, 1, struct.pack("<II", *_rational(exposure.exposure_s, "exposure_s"))))
    if exposure.f_number is not None:
        entries.append((33437, 5, 1, struct.pack("<II", *_rational(exposure.f_number, "f_number"))))
    if exposure.iso is not None:
        if exposure.iso.denominator != 1 or not 0 < exposure.iso <= _MAX_LONG:
            raise ArgumentError(f"iso = {exposure.iso} is not a positive whole number of 32 bits")
        iso = int(exposure.iso)
        entries.append((34855, 3, 1, struct.pack("<H", min(iso, 65535))))
        # ISOSpeedRatings has 16 bits; beyond them EXIF 2.3 states the speed as RecommendedExposureIndex.
        entries.append((34864, 3, 1, struct.pack("<H", 2)))
        entries.append((34866, 4, 1, struct.pack("<I", iso)))
    entries.append((36864, 7, 4, b"0232"))
    if taken is not None:
        entries.append((36867, 2, 20, taken.strftime("%Y:%m:%d %H:%M:%S\0").encode()))
        entries.append((37521, 2, 4, f"{taken.microsecond // 1000:03d}\0".encode()))
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
    channels = packed_black_level_dn(sensor.cfa, sensor.black_level_dn)  # refuses CFA and number of levels
    if len(sensor.black_level_dn) == 3 and len(set(sensor.black_level_dn)) > 1:
        raise ArgumentError(f"black_level_dn {sensor.black_level_dn}: LibRaw keeps one level for X-Trans")
    for name, level in (("black_level_dn", channels), ("white_level_dn", sensor.white_level_dn)):
        levels = np.atleast_1d(level)
        if not (np.all(levels == np.rint(levels)) and np.all((levels >= 0) & (levels <= 65535))):
            raise ArgumentError(f"{name} {level}: expected whole numbers from 0 to 65535; LibRaw keeps no other levels")
    if not sensor.white_level_dn > max(sensor.black_level_dn):
        raise ArgumentError(
            f"white_level_dn {sensor.white_level_dn} must lie above black_level_dn {sensor.black_level_dn}"
        )
    if min(sensor.height, sensor.width) < _LEAST_SIDE:
        raise ArgumentError(
            f"{sensor.height} x {sensor.width} pixels: LibRaw reads no raw image under {_LEAST_SIDE} pixels per side"
        )
    if sensor.white_balance is not None and not all(0 < value < np.inf for value in sensor.white_balance):
        raise ArgumentError(f"white_balance {sensor.white_balance}: expected positive multipliers")
    if sensor.xyz_to_camera is not None and not np.all(np.isfinite(sensor.xyz_to_camera)):
        raise ArgumentError(f"xyz_to_camera {sensor.xyz_to_camera}: expected finite numbers")
    for text in (sensor.make, sensor.model):
        if not text.isascii() or text != text.strip():
            raise ArgumentError(f"{text!r}: expected ASCII text without spaces at its ends")


def _sensor_tags(sensor: Sensor) -> list[Entry]:
    rows, columns = len(sensor.cfa), len(sensor.cfa[0])
    # A DNG's CFAPattern names colours: red 0, green 1, blue 2; which green is which follows from the place.
    colours = bytes({3: 1}.get(index, index) for row in sensor.cfa for index in row)
    black = [int(sensor.black_level_dn[index]) for row in sensor.cfa for index in row]
    tags: list[Entry] = [
        (33421, "H", 2, (rows, columns), True),
        (33422, "B", rows * columns, colours, True),
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),
        (50707, "B", 4, bytes((1, 1, 0, 0)), True),
        (50713, "H", 2, (rows, columns), True),
        (50714, "I", len(black), tuple(black), True),
        (50717, "I", 1, int(sensor.white_level_dn), True),
    ]
    for code, text in (
        (271, sensor.make),
        (272, sensor.model),
        (50708, f"{sensor.make} {sensor.model}".strip()),
    ):
        if text:
            tags.append((code, "s", 0, text, True))
    if sensor.xyz_to_camera is not None:
        matrix = [_decimal(round(value, 6)) for row in sensor.xyz_to_camera for value in row]
        tags.append((50721, "2i", 9, tuple(n for f in matrix for n in (f.numerator, f.denominator)), True))
        tags.append((50778, "H", 1, _ILLUMINANT_D65, True))
    if sensor.white_balance is not None:
        red, green, blue, second_green = sensor.white_balance
        if green != second_green:
            raise ArgumentError(f"white_balance {sensor.white_balance}: a DNG holds one multiplier for both greens")
        neutral = [_decimal(green) / _decimal(value) for value in (red, green, blue)]
        parts = [n for f in neutral for n in _rational(f, "white_balance")]
        tags.append((50728, "2I", 3, tuple(parts), True))
    return tags


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

    :func:`eldata.raw.read_raw` gives back the same mosaic, sensor and exposure (matrix and white balance to six
    decimals; a sensor without a matrix gets that of LibRaw's table if LibRaw knows the model).

    Parameters
    ----------
    path
        The file; its folder must exist.
    mosaic
        (H, W) uint16 in DN, H and W as the sensor record says.
    sensor
        Bayer or X-Trans. LibRaw keeps whole black levels only, so a fraction of a DN is refused.
    exposure
        Fields that are ``None`` are left out of the file. ISO must be a whole number.
    compression
        ``"none"``, or ``"lossless-jpeg"`` (smaller on disk, several times slower to decode).
    taken
        When, by the camera's clock; kept to the millisecond.

    Raises
    ------
    ArgumentError
        If a field does not fit the format.
    EldataError
        If the file cannot be written.
    """
    import imagecodecs
    import tifffile

    check_choice("compression", compression, get_args(Compression))
    _check_sensor(sensor)
    if mosaic.dtype != np.uint16 or mosaic.shape != (sensor.height, sensor.width):
        raise ArgumentError(
            f"expected a uint16 mosaic of {sensor.height} x {sensor.width} pixels as the sensor record says; "
            f"found {mosaic.dtype} {mosaic.shape}"
        )
    fault = mosaic_fault(mosaic, sensor.black_level_dn, sensor.white_level_dn)
    if fault is not None:
        raise ArgumentError(f"{fault}: reading takes that for a damaged file")

    whole = np.ascontiguousarray(mosaic)
    buffer = io.BytesIO()
    with tifffile.TiffWriter(buffer, bigtiff=False, byteorder="<") as tiff:
        write = partial(
            tiff.write,
            shape=mosaic.shape,
            dtype=np.uint16,
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
    with atomic_write(path) as file:
        file.write(buffer.getbuffer())


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
