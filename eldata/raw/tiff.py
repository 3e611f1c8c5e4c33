"""The directories of a TIFF-based raw file, and whether the file holds what they declare.

exifread and LibRaw read past the end of a cut-off file without a word; this walker does not. It reads tables and the
few tags that this package relies on, no pixels. What a file may make it read is bounded for the whole walk: directories
may share their entries, and values their bytes, so that a small file can declare work for hours.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from fractions import Fraction
from typing import IO, TYPE_CHECKING, Literal

from eldata.errors import RawFileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

RATIONAL = 2**32 - 1
"""The largest part of a RATIONAL."""
SRATIONAL = 2**31 - 1
"""The largest part, without its sign, of an SRATIONAL."""

MAGIC = (b"II*\0", b"MM\0*")
COLOURS = "RGBCMYW"  # of a DNG's CFAPattern, by number

SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
SAMPLES, ROWS_PER_STRIP, SAMPLE_FORMAT = 277, 278, 339
UNCOMPRESSED, JPEG_XL = 1, 52546  # compressions; the latter of DNG 1.7
TILE_WIDTH, TILE_HEIGHT = 322, 323
STRIPS, TILES = (273, 279), (324, 325)
"""Offsets and byte counts."""
DNG_VERSION = 50706
ROW_INTERLEAVE, COLUMN_INTERLEAVE = 50975, 52547
ACTIVE_AREA, MASKED_AREAS = 50829, 50830
BLACK_REPEAT, BLACK_LEVEL, BLACK_DELTAS, WHITE_LEVEL = 50713, 50714, (50715, 50716), 50717
CFA_PHOTOMETRIC = 32803
CFA_REPEAT, CFA_PATTERN, CFA_LAYOUT = 33421, 33422, 50711
OPCODE_LISTS = (51008, 51009, 51022)  # of the stored, the linear and the demosaiced image

MOST_PIXELS = 8
"""That a byte of image data can hold: no lossless code of noise takes less than one bit."""

_LEVELS = {BLACK_LEVEL: "BlackLevel", BLACK_DELTAS[0]: "BlackLevelDeltaH", BLACK_DELTAS[1]: "BlackLevelDeltaV"}
_LEVELS |= {WHITE_LEVEL: "WhiteLevel"}

_SUB_IFDS, _EXIF_IFD = 330, 34665
# Tags whose values must lie inside the file: those above, and what reading.py takes from EXIF and DNG tags.
_EXIF = {33434, 33437, 34855, 34864, 34865, 34866, 34867}
_READ = _EXIF | {
    *(SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, TILE_WIDTH, TILE_HEIGHT),
    *(SAMPLES, ROWS_PER_STRIP, SAMPLE_FORMAT, DNG_VERSION, ROW_INTERLEAVE, COLUMN_INTERLEAVE),
    *(271, 272, _SUB_IFDS, _EXIF_IFD, ACTIVE_AREA, MASKED_AREAS, BLACK_REPEAT, BLACK_LEVEL, *BLACK_DELTAS),
    *(WHITE_LEVEL, *range(50721, 50725), *range(50727, 50730), 50778, 50779, CFA_REPEAT, CFA_PATTERN, CFA_LAYOUT),
    *OPCODE_LISTS,
    *STRIPS,
    *TILES,
}

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
SHORT = 3
_CODES = {1: "B", 3: "H", 4: "I", 5: "II", 6: "b", 7: "B", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d", 13: "I"}
# Of all directories together; a file with more is damaged, or made to keep a reader busy. Cameras write some hundred
# entries. The values are those of the tags above: two for each strip or tile, of which 150 megapixels in rows or in
# tiles of 128 x 128 pixels have 20,000.
_MOST_DIRECTORIES = 64
_MOST_ENTRIES = 1 << 12
_MOST_VALUES = 1 << 17
_MOST_REPEATED = 64  # rows or columns of BlackLevel's pattern: those of cameras have up to 8
_MOST_MASKED = 8  # areas of masked pixels: those of cameras have up to 4
# How many numbers these tags of a mosaic hold: readers take them apart.
_COUNTS = {
    WIDTH: (1,),
    HEIGHT: (1,),
    ACTIVE_AREA: (4,),
    BLACK_REPEAT: (2, 1),
    CFA_REPEAT: (2,),
    MASKED_AREAS: range(4, 4 * _MOST_MASKED + 1, 4),  # four for each
}

Numbers = tuple[Fraction, ...]


@dataclass(frozen=True, slots=True)
class Directory:
    """The numbers of one IFD's relied-on tags, by tag, exactly; not of those that state none (0/0).

    Of a list of opcodes their ids.
    """

    values: dict[int, Numbers]
    order: Literal["<", ">"] = "<"
    """Of its bytes, as struct and numpy name it."""
    entries: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    """Of every tag that it has, relied on or not: where its entry stands in the file, and the type of its values."""
    starts: tuple[int, ...] = ()
    """Where it, and the values that it has elsewhere in the file, begin."""

    def number(self, tag: int, default: int) -> int:
        """Return the first number of a tag; ``default`` if it is not there."""
        return int(next(iter(self.values.get(tag, ())), default))

    @property
    def compression(self) -> int:
        """How its data are compressed; 1: they are not."""
        return self.number(COMPRESSION, 1)

    @property
    def black_repeat(self) -> tuple[int, int]:
        """Rows and columns after which its BlackLevel repeats; some write one number, beside one level."""
        repeat = self.values.get(BLACK_REPEAT, ())
        return (int(repeat[0]), int(repeat[1])) if len(repeat) == 2 else (1, 1)

    @property
    def is_mosaic(self) -> bool:
        """Whether this directory describes a CFA image."""
        return CFA_PHOTOMETRIC in self.values.get(PHOTOMETRIC, ())

    @property
    def cfa_letters(self) -> tuple[str, ...] | None:
        """One period of its colour filter array by row; None if it states none, or one that does not fit its size.

        It begins at the active area's first pixel, as LibRaw has it too.
        """
        rows, columns = map(int, self.values.get(CFA_REPEAT, (2, 2)))
        numbers = self.values.get(CFA_PATTERN, ())
        if not numbers or len(numbers) != rows * columns or not all(0 <= number < len(COLOURS) for number in numbers):
            return None
        letters = "".join(COLOURS[int(number)] for number in numbers)
        return tuple(letters[columns * y : columns * (y + 1)] for y in range(rows))

    @property
    def extents(self) -> tuple[tuple[int, int], ...]:
        """Offset and byte count of each strip or tile."""
        return self.extents_of(STRIPS) + self.extents_of(TILES)

    def extents_of(self, tags: tuple[int, int]) -> tuple[tuple[int, int], ...]:
        """Return offset and byte count of each strip, or of each tile."""
        offsets, counts = (map(int, self.values.get(tag, ())) for tag in tags)
        return tuple(zip(offsets, counts, strict=False))

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) in pixels that it declares; 0 for one that it does not."""
        return self.number(HEIGHT, 0), self.number(WIDTH, 0)

    @property
    def pixels(self) -> int:
        """Number of pixels that it declares."""
        return math.prod(self.shape)


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
        order: Literal["<", ">"] = "<" if head[:2] == b"II" else ">"
        budget = _Budget(path, {"directories": _MOST_DIRECTORIES, "entries": _MOST_ENTRIES, "values": _MOST_VALUES})
        waiting = [struct.unpack(order + "I", head[4:])[0]]
        seen: set[int] = set()
        found: list[Directory] = []
        while waiting:
            at = waiting.pop()
            if at == 0 or at in seen:
                continue
            if at < 0:
                raise RawFileError(path, f"damaged: it declares a directory at byte {at}")
            seen.add(at)
            budget.spend("directories", 1)
            directory, following = _read_directory(path, file, size, order, at, budget)
            found.append(directory)
            # In LibRaw's order: those within a directory before those behind it, each as listed.
            within = (int(place) for tag in (_SUB_IFDS, _EXIF_IFD) for place in directory.values.get(tag, ()))
            waiting += reversed([*within, following])
    for directory in found:
        _check_mosaic(path, directory, is_dng(found))
    # The raw image alone where it is marked as such: some cameras declare previews that they do not write.
    images = [directory for directory in found if directory.is_mosaic] or found
    for extent in (extent for directory in images for extent in directory.extents if min(extent) < 0):
        raise RawFileError(path, f"damaged: it declares {extent[1]} bytes of image data at byte {extent[0]}")
    require(path, size, max((sum(extent) for directory in images for extent in directory.extents), default=0))
    return tuple(found)


def is_dng(directories: Sequence[Directory]) -> bool:
    """Return whether a file of these directories is a DNG."""
    return any(DNG_VERSION in directory.values for directory in directories)


def main_mosaics(directories: Sequence[Directory]) -> tuple[Directory, ...]:
    """Return the directories of the largest mosaics, in order: one, but of a pixel shift; no proxies."""
    mosaics = [directory for directory in directories if directory.is_mosaic]
    most = max((directory.pixels for directory in mosaics), default=0)
    largest = [directory for directory in mosaics if directory.pixels == most]
    return tuple([directory for directory in largest if not directory.number(SUBFILE, 0)] or largest)


@dataclass(frozen=True, slots=True)
class _Budget:
    """What may still be read of a file."""

    path: Path
    left: dict[str, int]

    def spend(self, what: str, count: int) -> None:
        self.left[what] -= count
        if self.left[what] < 0:
            raise RawFileError(
                self.path, f"damaged, or made to keep a reader busy: its directories declare far too many {what}"
            )


def _check_mosaic(path: Path, directory: Directory, of_dng: bool) -> None:
    """Refuse a mosaic of which numbers that are relied on are missing or impossible, or that has too little data."""
    if not directory.is_mosaic:
        return
    for tag, counts in _COUNTS.items():
        values = directory.values.get(tag)
        if values is not None and (len(values) not in counts or min(values, default=0) < 0):
            shown = ", ".join(map(str, values[:5]))
            raise RawFileError(path, f"damaged: expected {counts[0]} numbers from 0 on as its tag {tag}; found {shown}")
    repeat = directory.values.get(BLACK_REPEAT, (1, 1))
    if not 1 <= min(repeat) <= max(repeat) <= _MOST_REPEATED:
        raise RawFileError(
            path,
            f"damaged: its BlackLevel repeats every {' x '.join(map(str, repeat))} pixels; expected 1 to "
            f"{_MOST_REPEATED} either way",
        )
    held = sum(count for _, count in directory.extents)
    # JPEG XL is refused by name; what a DNG states of uncompressed data is held against its rows (eldata.raw.strips).
    elsewhere = (JPEG_XL, UNCOMPRESSED) if of_dng else (JPEG_XL,)
    if held * MOST_PIXELS < directory.pixels and directory.compression not in elsewhere:
        raise RawFileError(path, f"truncated: its image data, {held} bytes, cannot hold {directory.pixels} pixels")


def _read_directory(
    path: Path, file: IO[bytes], size: int, order: Literal["<", ">"], at: int, budget: _Budget
) -> tuple[Directory, int]:
    require(path, size, at + 2)
    file.seek(at)
    count = struct.unpack(order + "H", file.read(2))[0]
    budget.spend("entries", count)
    require(path, size, at + 2 + 12 * count)
    table = file.read(12 * count + 4)
    values: dict[int, Numbers] = {}
    entries: dict[int, tuple[int, int]] = {}
    starts = [at]
    for index in range(count):
        entry = table[12 * index : 12 * index + 12]
        tag, kind, number = struct.unpack(order + "HHI", entry[:8])
        entries[tag] = at + 2 + 12 * index, kind
        length = _SIZES.get(kind, 1) * number
        data = entry[8:12]
        offset = struct.unpack(order + "I", data)[0]
        if length > 4:
            starts.append(offset)
        if tag not in _READ:
            continue
        if length > 4:
            require(path, size, offset + length)
        if tag in OPCODE_LISTS:
            values[tag] = tuple(_opcodes(path, file, range(offset, offset + length), budget)) if length > 4 else ()
            continue
        code = _CODES.get(kind)
        if code is None:
            continue
        budget.spend("values", number)
        if length > 4:
            file.seek(offset)
            data = file.read(length)
        numbers = _numbers(order, code, number, data)
        if numbers is not None:
            values[tag] = numbers
        elif tag in _LEVELS:  # LibRaw takes such a level for 0
            raise RawFileError(path, f"damaged: its {_LEVELS[tag]} is not a number (0 for its denominator, or NaN)")
    # The pointer to the next directory may be missing at the very end of a file.
    following = struct.unpack(order + "I", table[-4:])[0] if len(table) == 12 * count + 4 else 0
    return Directory(values, order, entries, tuple(starts)), following


def _opcodes(path: Path, file: IO[bytes], place: range, budget: _Budget) -> Iterator[Fraction]:
    """Yield the ids of a list of opcodes, whose byte order is always big-endian."""
    file.seek(place.start)
    at = place.start + 4
    for _ in range(int.from_bytes(file.read(4), "big")):
        if at + 16 > place.stop:
            raise RawFileError(path, f"damaged: its list of opcodes holds more of them than its {len(place)} bytes")
        budget.spend("values", 1)
        file.seek(at)
        opcode, _, _, length = struct.unpack(">4I", file.read(16))
        yield Fraction(opcode)
        at += 16 + length


def _numbers(order: str, code: str, number: int, data: bytes) -> Numbers | None:
    """Return an entry's values; ``None`` if one is a fraction over 0, which says "not known", or not finite."""
    flat = struct.unpack_from(f"{order}{number * len(code)}{code[0]}", data)
    if not all(map(math.isfinite, flat)):
        return None
    if len(code) == 1:
        return tuple(map(Fraction, flat))
    if not all(flat[1::2]):
        return None
    return tuple(Fraction(numerator, denominator) for numerator, denominator in zip(flat[::2], flat[1::2], strict=True))


def require(path: Path, size: int, end: int) -> None:
    """Raise a RawFileError if the file, of this size, declares data beyond its end."""
    if end > size:
        raise RawFileError(
            path, f"truncated: it declares data up to byte {end} but has {size} bytes; copy or download it again"
        )


def nearest_fraction(value: Fraction, largest: int) -> Fraction:
    """Return the fraction nearest to a value whose numerator and denominator are at most ``largest``.

    The value itself if its parts fit. Else, from 1 / ``largest`` to ``largest``, it is off by less than one part in
    ``largest`` - 1; below that it is off by less than 1 / ``largest``.

    Raises
    ------
    ValueError
        If the value, without its sign, is above ``largest``.
    """
    size = abs(value)
    if size > largest:
        raise ValueError(f"{value} is beyond {largest}")
    denominator = largest if size <= 1 else int(largest / size)
    candidates = [size.limit_denominator(denominator)]
    if size > 1:  # the one denominator more at which the numerator is still near enough to count
        candidates.append(Fraction(largest, denominator + 1))
    best = min(candidates, key=lambda candidate: abs(candidate - size))
    return best if value >= 0 else -best
