"""What a raw file says of its camera and exposure: EXIF by exifread, and what of LibRaw's figures stands in for it."""

from __future__ import annotations

import io
import struct
from datetime import datetime
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import RawFileError
from eldata.raw.tiff import MAGIC, require
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from pathlib import Path

    import rawpy

Tags = dict[str, Any]

_RAF_MAGIC = b"FUJIFILMCCD-RAW"


def check_raf(path: Path) -> None:
    """Raise a RawFileError if a RAF lacks data that it declares."""
    with path.open("rb") as file:
        head = file.read(108)
    if head.startswith(_RAF_MAGIC) and len(head) == 108:
        # Offset and length of the JPEG, the CFA header and the CFA data, big-endian.
        end = max(sum(struct.unpack_from(">II", head, at)) for at in (84, 92, 100))
        require(path, path.stat().st_size, end)


def exif_tags(path: Path) -> Tags:
    """Return exifread's tags; empty where the container is one that exifread does not know."""
    import exifread

    with path.open("rb") as file:
        head = file.read(92)
        if head.startswith(_RAF_MAGIC) and len(head) == 92:
            # A RAF embeds a JPEG with the EXIF.
            offset, length = struct.unpack_from(">II", head, 84)
            file.seek(offset)
            source: Any = io.BytesIO(file.read(length))
        elif head.startswith(MAGIC):
            source = file
        else:
            return {}
        try:
            return exifread.process_file(source, details=False, extract_thumbnail=False)
        except Exception as error:  # exifread raises many kinds on damaged EXIF
            raise RawFileError(path, f"its EXIF cannot be read ({error}); is the file whole?") from error


def header_of(path: Path, raw: rawpy.RawPy, tags: Tags) -> RawHeader:
    """Return camera, exposure and time from a file's tags, or else from LibRaw."""
    return RawHeader(path, _ascii(tags, "Image Make"), _ascii(tags, "Image Model"), _exposure(tags, raw), _taken(tags))


def _ascii(tags: Tags, name: str) -> str:
    tag = tags.get(name)
    return "" if tag is None else str(tag.values).strip("\0 ")


def _taken(tags: Tags) -> datetime | None:
    """Return DateTimeOriginal with its SubSecTime; ``None`` if the file has none, or a clock that was never set."""
    for ifd in ("EXIF", "Image"):
        try:
            taken = datetime.strptime(_ascii(tags, f"{ifd} DateTimeOriginal"), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 # as stated
        except ValueError:
            continue
        digits = _ascii(tags, f"{ifd} SubSecTimeOriginal")
        fraction = digits[:6].ljust(6, "0") if digits.isascii() and digits.isdecimal() else "0"
        return taken.replace(microsecond=int(fraction))
    return None


def _exposure(tags: Tags, raw: rawpy.RawPy) -> Exposure:
    iso = _fraction(tags, "ISOSpeedRatings")
    if iso is None or iso == 65535:  # 16 bits: EXIF 2.3 states higher speeds elsewhere
        for name in ("RecommendedExposureIndex", "StandardOutputSensitivity", "ISOSpeed"):
            iso = _fraction(tags, name) or iso
    exposure_s, f_number = _fraction(tags, "ExposureTime"), _fraction(tags, "FNumber")
    if iso is None or exposure_s is None:  # asked only then: rawpy decodes the pixels to answer
        iso = iso or simplest_fraction(raw.other.iso_speed)
        exposure_s = exposure_s or simplest_fraction(raw.other.shutter_speed)
        f_number = f_number or simplest_fraction(raw.other.aperture)
    return Exposure(iso, exposure_s, f_number)


def _fraction(tags: Tags, name: str) -> Fraction | None:
    """Return a tag's first value, from the EXIF IFD or else from IFD0, if it is a positive number."""
    for ifd in ("EXIF", "Image"):
        tag = tags.get(f"{ifd} {name}")
        if tag is None or not tag.values:
            continue
        value = positive(tag.values[0])
        if value is not None:
            return value
    return None


def positive(value: Any) -> Fraction | None:
    """Return one of exifread's numbers as a fraction, if it is a positive one."""
    numerator, denominator = getattr(value, "num", value), getattr(value, "den", 1)
    if isinstance(numerator, int) and isinstance(denominator, int) and denominator and numerator > 0:
        return Fraction(numerator, denominator)
    return None


def simplest_fraction(value: float) -> Fraction | None:
    """Return the fraction of the smallest denominator (by powers of ten) that rounds to a float32."""
    if not (np.isfinite(value) and value > 0):
        return None
    for digits in range(1, 10):
        fraction = Fraction(value).limit_denominator(10**digits)
        if np.float32(float(fraction)) == np.float32(value):
            return fraction
    return Fraction(value)
