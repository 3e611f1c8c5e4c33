"""What a raw file states of its camera and exposure, exactly. What it does not state is ``None``: nothing is guessed.

LibRaw's figures are not taken, because LibRaw makes some up: 1 s at f/1 from an APEX value of 0, an ISO from its own
table of models, float32 for a fraction. Asking it would also decode the pixels.

TIFF-based files are read where they stand (:mod:`eldata.raw.tiff` checks their extents). Around the others is a
container: Fujifilm's RAF (a JPEG with the EXIF), Canon's CR3 (an ISO base media file, ISO/IEC 14496-12, whose boxes
CMT1 and CMT2 are TIFF files of IFD0 and of the EXIF IFD), Minolta's MRW (its TTW block is a TIFF file).
"""

from __future__ import annotations

import io
import logging
import struct
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, BinaryIO

from eldata.errors import RawFileError
from eldata.raw import tiff
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Tags = dict[str, Any]

_FIRST_YEAR = 1990  # no camera wrote raw files before: such a time is that of a clock that was never set
_SENSITIVITIES = {  # by EXIF's SensitivityType, which says which of them the ISO repeats
    Fraction(2): "RecommendedExposureIndex",
    Fraction(1): "Tag 0x8831",  # StandardOutputSensitivity, which exifread has no name for
    Fraction(3): "ISOSpeed",
}
# TIFF files that call themselves something else: Olympus and OM System (ORF), Panasonic and Leica (RW2, RWL, RAW).
_TIFF_LIKE = (*tiff.MAGIC, b"IIRO", b"IIRS", b"MMOR", b"IIU\0")
_RAF = b"FUJIFILMCCD-RAW"
_RAF_EXTENTS = 84  # offset and length of the JPEG, the CFA header and the CFA data, big-endian
_MRW = b"\0MRM"
_CR3 = b"ftypcrx "  # after the four bytes of the first box's size
_CANON_UUID = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
_CMT = {b"CMT1": "Image", b"CMT2": "EXIF"}

_MOST_BOXES = 1000  # or blocks, of one level; a file with more is damaged, or made to keep a reader busy
_LARGEST_BLOCK = 1 << 24  # of one block of EXIF: cameras write some kilobytes, a RAF's JPEG some megabytes

# exifread reads number by number: 1,400 times in a real file of many tags, 9,000 times with a Canon's own. What is
# allowed here takes half a second; a directory of 65,535 entries that share their values asks for 65 million reads.
_MOST_READS = 1 << 18
_MOST_BYTES = 1 << 26
_ISO_BEYOND_16_BITS = 65535  # what EXIF 2.3 puts in 16 bits where the speed is stated elsewhere


@dataclass(frozen=True)
class RawContainer:
    """What the container of a raw file states; each of its tables is parsed once.

    Attributes
    ----------
    path
        The file.
    directories
        Of a TIFF-based file, in LibRaw's order; none of another.
    """

    path: Path
    directories: tuple[tiff.Directory, ...]

    @cached_property
    def tags(self) -> Tags:
        """Its EXIF (:func:`exif_tags`)."""
        return exif_tags(self.path)

    @cached_property
    def header(self) -> RawHeader:
        """Camera, exposure and time (:func:`header_of`)."""
        return header_of(self.path, self.tags)


def header_of(path: Path, tags: Tags) -> RawHeader:
    """Return camera, exposure and time as the file, whose EXIF tags these are, states them."""
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

    if not exifread.logger.handlers:  # or Python prints what it says, without the file's name
        exifread.logger.addHandler(logging.NullHandler())
    source: Any = _BoundedFile(path, block)  # all of a file that exifread asks for
    try:
        return exifread.process_file(source, details=details, extract_thumbnail=False)
    except RawFileError:
        raise
    except Exception as error:  # exifread raises many kinds on damaged EXIF
        raise RawFileError(path, f"its EXIF cannot be read ({error}); is the file whole?") from error


def _text(tags: Tags, name: str) -> str:
    values = getattr(tags.get(name), "values", "")
    if isinstance(values, bytes):  # exifread leaves what is no UTF-8
        values = values.decode("latin-1")
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
        return taken.replace(microsecond=int(fraction)) if taken.year >= _FIRST_YEAR else None
    return None


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


class _BoundedFile:
    """What exifread needs of a file opened for reading: it gives up where a file keeps its reader busy."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file
        self._reads, self._bytes = _MOST_READS, _MOST_BYTES
        self.seek, self.tell = file.seek, file.tell

    def read(self, size: int = -1) -> bytes:
        """Return that many bytes, or what is left.

        Raises
        ------
        RawFileError
            If too much has been read, in pieces or bytes.
        """
        content = self._file.read(size)
        self._reads -= 1
        self._bytes -= len(content)
        if self._reads < 0 or self._bytes < 0:
            raise RawFileError(self._path, "damaged, or made to keep a reader busy: its EXIF declares far too much")
        return content


# --- where it stands --------------------------------------------------------------------------------------------------


def exif_blocks(path: Path) -> Iterator[tuple[str | None, BinaryIO]]:
    """Yield each TIFF or JPEG file that holds EXIF, open while it is looked at.

    Yields
    ------
    ifd, file
        ``ifd``: what its first directory is, ``"Image"`` or ``"EXIF"``; ``None`` for a file whose directories say so
        themselves. Nothing for a container that has no EXIF.

    Raises
    ------
    RawFileError
        If the container is damaged before its EXIF.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(108)
        if head.startswith(_TIFF_LIKE):
            yield None, file
        elif head.startswith(_RAF) and len(head) == 108:
            yield None, _block(path, file, *struct.unpack_from(">II", head, _RAF_EXTENTS))
        elif head.startswith(_MRW):
            for kind, start, end in _mrw_blocks(path, file, size):
                if kind == b"\0TTW":
                    yield None, _block(path, file, start, end - start)
        elif head[4:12] == _CR3:
            for kind, start, end in _canon_boxes(path, file, size):
                if kind in _CMT:
                    yield _CMT[kind], _block(path, file, start, end - start)


def check_container(path: Path) -> None:
    """Raise a RawFileError if a RAF or a CR3 lacks data that it declares."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(108)
        if head.startswith(_RAF) and len(head) == 108:
            end = max(sum(struct.unpack_from(">II", head, at)) for at in (_RAF_EXTENTS, 92, 100))
            tiff.require(path, size, end)
        elif head[4:12] == _CR3:
            for kind, _, _ in _boxes(path, file, 0, size):
                if kind == b"mdat":  # the pixels, which come last
                    break


def _block(path: Path, file: BinaryIO, offset: int, length: int) -> io.BytesIO:
    if length > _LARGEST_BLOCK:
        raise RawFileError(path, f"damaged: it declares {length} bytes of EXIF, and no camera writes {_LARGEST_BLOCK}")
    file.seek(offset)
    return io.BytesIO(file.read(length))


def _canon_boxes(path: Path, file: BinaryIO, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the boxes of Canon's own box inside a CR3's ``moov``."""
    for kind, start, end in _boxes(path, file, 0, size):
        if kind != b"moov":
            continue
        for inner, inner_start, inner_end in _boxes(path, file, start, end):
            file.seek(inner_start)
            if inner == b"uuid" and file.read(16) == _CANON_UUID:
                yield from _boxes(path, file, inner_start + 16, inner_end)
        return


def _boxes(path: Path, file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield type, begin and end of the content of each box of a part of an ISO base media file."""
    whole = path.stat().st_size
    for _ in range(_MOST_BOXES):
        if start + 8 > end:  # what is left cannot be a box
            return
        file.seek(start)
        head = file.read(16)
        size, kind = struct.unpack_from(">I4s", head)
        content = start + 8
        if size == 1 and len(head) == 16:
            size = struct.unpack_from(">Q", head, 8)[0]
            content = start + 16
        elif size == 0:  # to the end
            size = end - start
        if start + size < content:
            raise RawFileError(path, f"damaged: its box at byte {start} declares {size} bytes, less than its own head")
        tiff.require(path, whole, start + size)
        if start + size > end:
            raise RawFileError(path, f"damaged: its box at byte {start} reaches beyond the box that it stands in")
        yield kind, content, start + size
        start += size
    raise RawFileError(path, f"damaged: it declares more than {_MOST_BOXES} boxes")


def _mrw_blocks(path: Path, file: BinaryIO, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, begin and end of each block of an MRW's header."""
    file.seek(4)
    end = 8 + struct.unpack(">I", file.read(4).ljust(4, b"\0"))[0]
    tiff.require(path, size, end)
    at = 8
    for _ in range(_MOST_BOXES):
        if at + 8 > end:
            return
        file.seek(at)
        name, length = struct.unpack(">4sI", file.read(8))
        if at + 8 + length > end:
            raise RawFileError(path, f"damaged: its block at byte {at} reaches beyond its header of {end} bytes")
        yield name, at + 8, at + 8 + length
        at += 8 + length
    raise RawFileError(path, f"damaged: it declares more than {_MOST_BOXES} blocks")
