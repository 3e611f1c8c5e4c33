"""What a raw file states of its camera and exposure, exactly. What it does not state is ``None``: nothing is guessed.

LibRaw's figures are not taken, because LibRaw makes some up: 1 s at f/1 from an APEX value of 0, an ISO from its own
table of models, float32 for a fraction, the rounded step of a CRW for its time. Asking it would also decode the pixels.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from typing import TYPE_CHECKING, Any, BinaryIO

from eldata.errors import RawFileError
from eldata.raw.bounded import BoundedFile
from eldata.raw.ciff import read_crw_header
from eldata.raw.containers import exif_blocks
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from pathlib import Path

Tags = dict[str, Any]

_FIRST_YEAR = 1990  # no camera wrote raw files before: such a time is that of a clock that was never set
_SENSITIVITIES = {  # by EXIF's SensitivityType, which says which of them the ISO repeats
    Fraction(2): "RecommendedExposureIndex",
    Fraction(1): "Tag 0x8831",  # StandardOutputSensitivity, which exifread has no name for
    Fraction(3): "ISOSpeed",
}
_ISO_BEYOND_16_BITS = 65535  # what EXIF 2.3 puts in 16 bits where the speed is stated elsewhere


def header_of(path: Path, tags: Tags) -> RawHeader:
    """Return camera, exposure and time as the file, whose EXIF tags these are, states them.

    Raises
    ------
    RawFileError
        If the file is a CRW whose records are damaged.
    """
    crw = read_crw_header(path)
    if crw is not None:
        return replace(crw, taken=_of_a_set_clock(crw.taken))
    make, model = _text(tags, "Image Make"), _text(tags, "Image Model")
    if not make and not model:
        model = _text(tags, "Image Tag 0xC614")  # a DNG's UniqueCameraModel
    exposure = Exposure(_iso(tags), _fraction(tags, "ExposureTime"), _fraction(tags, "FNumber"))
    return RawHeader(path, make, model, exposure, _taken(tags))


def exif_tags(path: Path) -> Tags:
    """Return exifread's tags, named by the IFD that they stand in; empty where the file has no EXIF.

    Raises
    ------
    RawFileError
        If EXIF or what contains it is damaged.
    """
    tags: Tags = {}
    for ifd, block in exif_blocks(path):
        found = _read(path, block)
        if ifd is None:
            tags |= found
        else:
            tags |= {f"{ifd} {name.removeprefix('Image ')}": tag for name, tag in found.items()}
    if _text(tags, "Image Make").upper().startswith("NIKON") and _iso(tags) is None:
        for _, block in exif_blocks(path):  # the first Nikons state it in their own tags alone
            tags |= _read(path, block, details=True)
    return tags


def _read(path: Path, block: BinaryIO, *, details: bool = False) -> Tags:
    import exifread

    source: Any = BoundedFile(path, block)  # all of a file that exifread asks for
    try:
        return exifread.process_file(source, details=details, extract_thumbnail=False)
    except RawFileError:
        raise
    except Exception as error:  # exifread raises many kinds on damaged EXIF
        raise RawFileError(path, f"its EXIF cannot be read ({error}); is the file whole?") from error


def _text(tags: Tags, name: str) -> str:
    values = getattr(tags.get(name), "values", "")
    return values.partition("\0")[0].strip() if isinstance(values, str) else ""


def _taken(tags: Tags) -> datetime | None:
    """Return DateTimeOriginal with its SubSecTime; ``None`` if the file has none, or a clock that was never set."""
    for ifd in ("EXIF", "Image"):
        try:
            taken = datetime.strptime(_text(tags, f"{ifd} DateTimeOriginal"), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 # as stated
        except ValueError:
            continue
        digits = _text(tags, f"{ifd} SubSecTimeOriginal")
        fraction = digits[:6].ljust(6, "0") if digits.isascii() and digits.isdecimal() else "0"
        return _of_a_set_clock(taken.replace(microsecond=int(fraction)))
    return None


def _of_a_set_clock(taken: datetime | None) -> datetime | None:
    return taken if taken is not None and taken.year >= _FIRST_YEAR else None


def _iso(tags: Tags) -> Fraction | None:
    stated = _fraction(tags, "ISOSpeedRatings")
    if stated is not None and stated != _ISO_BEYOND_16_BITS:
        return stated
    first = _SENSITIVITIES.get(_fraction(tags, "SensitivityType") or Fraction(0))
    for name in (first, *_SENSITIVITIES.values()):
        iso = None if name is None else _fraction(tags, name)
        if iso is not None:
            return iso
    if "Image Tag 0x0001" in tags:  # IFD0 of a Panasonic (PanasonicRawVersion): its own two tags of the ISO
        iso = _positive_tag(tags, "Image Tag 0x0037") or _positive_tag(tags, "Image Tag 0x0017")
        if iso != _ISO_BEYOND_16_BITS:
            return iso
    return _positive_tag(tags, "MakerNote ISOSetting", at=-1)  # Nikon's


def _fraction(tags: Tags, name: str) -> Fraction | None:
    """Return a tag's first value, from the EXIF IFD or else from IFD0, if it is a positive number."""
    return _positive_tag(tags, f"EXIF {name}") or _positive_tag(tags, f"Image {name}")


def _positive_tag(tags: Tags, name: str, at: int = 0) -> Fraction | None:
    values = getattr(tags.get(name), "values", None)
    return _positive(values[at]) if values else None


def _positive(value: Any) -> Fraction | None:
    """Return one of exifread's numbers as a fraction, if it is a positive one."""
    numerator, denominator = getattr(value, "num", value), getattr(value, "den", 1)
    if isinstance(numerator, int) and isinstance(denominator, int) and numerator * denominator > 0:
        return Fraction(numerator, denominator)
    return None
