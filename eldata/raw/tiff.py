"""The directories of a TIFF-based raw file, and whether the file holds what they declare.

exifread and LibRaw read past the end of a cut-off file without a word; this walker does not. It reads tables and the
few tags that this package relies on, no pixels.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from typing import IO, TYPE_CHECKING

from eldata.errors import RawFileError

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = (b"II*\0", b"MM\0*")

WIDTH, HEIGHT, COMPRESSION, PHOTOMETRIC = 256, 257, 259, 262
ACTIVE_AREA = 50829
BLACK_REPEAT, BLACK_LEVEL, BLACK_DELTAS = 50713, 50714, (50715, 50716)
CFA_PHOTOMETRIC = 32803

_SUB_IFDS, _EXIF_IFD = 330, 34665
_DATA = ((273, 279), (324, 325))  # strips, tiles: offsets and byte counts
# Tags whose values must lie inside the file: those above, and what reading.py takes from EXIF and DNG tags.
_EXIF = {33434, 33437, 34855, 34864, 34865, 34866, 34867}
_READ = _EXIF | {
    *(WIDTH, HEIGHT, COMPRESSION, PHOTOMETRIC),
    *(271, 272, _SUB_IFDS, _EXIF_IFD, ACTIVE_AREA, BLACK_REPEAT, BLACK_LEVEL, *BLACK_DELTAS),
    *(50717, 50721, 50722, 50728, 50778, 50779),
    *(tag for pair in _DATA for tag in pair),
}

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_CODES = {1: "B", 3: "H", 4: "I", 5: "II", 6: "b", 8: "h", 9: "i", 10: "ii", 13: "I"}
_MOST_DIRECTORIES = 64  # a file with more is damaged, or made to keep a reader busy
_MOST_VALUES = 1 << 20

Numbers = tuple[Fraction, ...]


@dataclass(frozen=True, slots=True)
class Directory:
    """The integer and fraction values of one IFD's relied-on tags, by tag."""

    values: dict[int, Numbers]

    @property
    def is_mosaic(self) -> bool:
        """Whether this directory describes a CFA image."""
        return CFA_PHOTOMETRIC in self.values.get(PHOTOMETRIC, ())

    @property
    def extents(self) -> tuple[tuple[int, int], ...]:
        """Offset and byte count of each strip or tile."""
        return tuple(
            (int(offset), int(count))
            for offsets, counts in _DATA
            for offset, count in zip(self.values.get(offsets, ()), self.values.get(counts, ()), strict=False)
        )

    @property
    def pixels(self) -> int:
        """Number of pixels that it declares."""
        width, height = (next(iter(self.values.get(tag, ())), 0) for tag in (WIDTH, HEIGHT))
        return int(width * height)


def read_directories(path: Path) -> tuple[Directory, ...]:
    """Return every directory of a TIFF-based file: the chain, sub-IFDs and EXIF; none for another file.

    Raises
    ------
    RawFileError
        If a directory, a relied-on value, or the raw image's data lies beyond the end of the file, or that data is too
        little for its pixels.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(8)
        if head[:4] not in MAGIC or len(head) < 8:
            return ()
        order = "<" if head[:2] == b"II" else ">"
        waiting = [struct.unpack(order + "I", head[4:])[0]]
        seen: set[int] = set()
        found: list[Directory] = []
        while waiting:
            at = waiting.pop()
            if at == 0 or at in seen:
                continue
            seen.add(at)
            if len(seen) > _MOST_DIRECTORIES:
                raise RawFileError(path, f"damaged: it declares more than {_MOST_DIRECTORIES} directories")
            directory, following = _read_directory(path, file, size, order, at)
            found.append(directory)
            waiting.append(following)
            for tag in (_SUB_IFDS, _EXIF_IFD):
                waiting += map(int, directory.values.get(tag, ()))
    # The raw image alone where it is marked as such: some cameras declare previews that they do not write.
    images = [directory for directory in found if directory.is_mosaic] or found
    require(path, size, max((sum(extent) for directory in images for extent in directory.extents), default=0))
    for directory in found:
        held = sum(count for _, count in directory.extents)
        # No lossless code takes less than one bit per pixel.
        if directory.is_mosaic and held * 8 < directory.pixels:
            raise RawFileError(path, f"truncated: its image data, {held} bytes, cannot hold {directory.pixels} pixels")
    return tuple(found)


def _read_directory(path: Path, file: IO[bytes], size: int, order: str, at: int) -> tuple[Directory, int]:
    require(path, size, at + 2)
    file.seek(at)
    count = struct.unpack(order + "H", file.read(2))[0]
    require(path, size, at + 2 + 12 * count)
    table = file.read(12 * count + 4)
    values: dict[int, Numbers] = {}
    for index in range(count):
        entry = table[12 * index : 12 * index + 12]
        tag, kind, number = struct.unpack(order + "HHI", entry[:8])
        if tag not in _READ:
            continue
        length = _SIZES.get(kind, 1) * number
        data = entry[8:12]
        if length > 4:
            offset = struct.unpack(order + "I", data)[0]
            require(path, size, offset + length)
            if kind not in _CODES or number > _MOST_VALUES:
                continue
            file.seek(offset)
            data = file.read(length)
        if kind in _CODES:
            values[tag] = _numbers(order, _CODES[kind], number, data)
    # The pointer to the next directory may be missing at the very end of a file.
    following = struct.unpack(order + "I", table[-4:])[0] if len(table) == 12 * count + 4 else 0
    return Directory(values), following


def _numbers(order: str, code: str, number: int, data: bytes) -> Numbers:
    flat = struct.unpack_from(f"{order}{number * len(code)}{code[0]}", data)
    if len(code) == 1:
        return tuple(map(Fraction, flat))
    pairs = zip(flat[::2], flat[1::2], strict=True)
    return tuple(Fraction(numerator, denominator) if denominator else Fraction(0) for numerator, denominator in pairs)


def require(path: Path, size: int, end: int) -> None:
    """Raise a RawFileError if the file, of this size, declares data beyond its end."""
    if end > size:
        raise RawFileError(
            path, f"truncated: it declares data up to byte {end} but has {size} bytes; copy or download it again"
        )
