"""The directories of a TIFF-based raw file: the one reader of its tags, extents and exposure.

It reads tables and the tags that this package relies on, no pixels, and refuses a file that does not hold what they
declare: LibRaw reads past the end of a cut-off file without a word. What a file may make it read is bounded for the
whole walk: directories may share their entries, and values their bytes, so that a small file can declare work for
hours.
"""

from __future__ import annotations

import io
import math
import struct
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
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
UNCOMPRESSED, JPEG, JPEG_XL = 1, 7, 52546  # compressions; the last of DNG 1.7
TILE_WIDTH, TILE_HEIGHT = 322, 323
STRIPS, TILES = (273, 279), (324, 325)
"""Offsets and byte counts."""
DNG_VERSION, LINEARIZATION = 50706, 50712
ROW_INTERLEAVE, COLUMN_INTERLEAVE = 50975, 52547
ACTIVE_AREA, MASKED_AREAS = 50829, 50830
BLACK_REPEAT, BLACK_LEVEL, BLACK_DELTAS, WHITE_LEVEL = 50713, 50714, (50715, 50716), 50717
CFA_PHOTOMETRIC = 32803
CFA_REPEAT, CFA_PATTERN, CFA_LAYOUT = 33421, 33422, 50711
OPCODE_LISTS = (51008, 51009, 51022)  # of the stored, the linear and the demosaiced image
AS_SHOT_NEUTRAL, AS_SHOT_WHITE_XY = 50728, 50729
COLOUR_MATRICES = ((50721, 50778), (50722, 50779))
"""Each with the tag of its illuminant."""
CALIBRATIONS, ANALOG_BALANCE = (50723, 50724), 50727
SIGNATURES = (50931, 50932)  # of the calibrations, and of the profile that they are for

MAKE, MODEL, UNIQUE_MODEL, ORIENTATION, SOFTWARE, NOISE_PROFILE = 271, 272, 50708, 274, 305, 51041
EXPOSURE_TIME, F_NUMBER, TAKEN, TAKEN_FRACTION = 33434, 33437, 36867, 37521
ISO, SENSITIVITY_TYPE, OUTPUT_SENSITIVITY, EXPOSURE_INDEX, ISO_SPEED = 34855, *range(34864, 34868)
PANASONIC, PANASONIC_ISOS = 1, (55, 23)  # in a Panasonic's first directory
FUJI_IFD, FUJI_WORDS = 0xF000, 0xF006  # the directory of a RAF's pixels; in it, whether packed ones lie in words
FUJI_TAGS = {0xF001: WIDTH, 0xF002: HEIGHT, 0xF003: BITS, 0xF007: STRIPS[0], 0xF008: STRIPS[1]}
"""Tags of a RAF's pixels, and those of TIFF that mean the same."""

MOST_PIXELS = 8
"""That a byte of image data can hold: no lossless code of noise takes less than one bit."""

_LEVELS = {BLACK_LEVEL: "BlackLevel", 50715: "BlackLevelDeltaH", 50716: "BlackLevelDeltaV", WHITE_LEVEL: "WhiteLevel"}

_SUB_IFDS, EXIF_IFD = 330, 34665
# Tags whose values are read, and so must lie inside the file.
_READ = {
    *(SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, TILE_WIDTH, TILE_HEIGHT, SAMPLES, ROWS_PER_STRIP),
    *(SAMPLE_FORMAT, DNG_VERSION, ROW_INTERLEAVE, COLUMN_INTERLEAVE, _SUB_IFDS, EXIF_IFD, ACTIVE_AREA, MASKED_AREAS),
    *(BLACK_REPEAT, BLACK_LEVEL, *BLACK_DELTAS, WHITE_LEVEL, CFA_REPEAT, CFA_PATTERN, CFA_LAYOUT, *OPCODE_LISTS),
    *(AS_SHOT_NEUTRAL, AS_SHOT_WHITE_XY, *COLOUR_MATRICES[0], *COLOUR_MATRICES[1], *CALIBRATIONS),
    *(ANALOG_BALANCE, *SIGNATURES, MAKE, MODEL, UNIQUE_MODEL, EXPOSURE_TIME, F_NUMBER, TAKEN, TAKEN_FRACTION),
    *(ISO, SENSITIVITY_TYPE, OUTPUT_SENSITIVITY, EXPOSURE_INDEX, ISO_SPEED, *PANASONIC_ISOS, *STRIPS, *TILES),
    *(ORIENTATION, SOFTWARE, NOISE_PROFILE, FUJI_IFD, FUJI_WORDS, *FUJI_TAGS),
}

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
ASCII, SHORT = 2, 3
_FRACTIONS, _FLOATS = (5, 10), (11, 12)
_CODES = {1: "B", 3: "H", 4: "I", 5: "I", 6: "b", 7: "B", 8: "h", 9: "i", 10: "i", 11: "f", 12: "d", 13: "I"}
# Of all directories together; a file with more is damaged, or made to keep a reader busy. Cameras write some hundred
# entries. The values are counted for the tags above: two for each strip or tile, of which 150 megapixels in rows or in
# tiles of 128 x 128 pixels have 20,000.
_MOST = {"directories": 64, "entries": 1 << 12, "values": 1 << 17}
_MOST_REPEATED = 64  # rows or columns of BlackLevel's pattern: cameras write up to 8
_MOST_MASKED = 8  # areas of masked pixels: cameras write up to 4
# How many numbers these tags of a mosaic hold: readers take them apart.
_COUNTS = {
    WIDTH: (1,),
    HEIGHT: (1,),
    ACTIVE_AREA: (4,),
    BLACK_REPEAT: (2, 1),
    CFA_REPEAT: (2,),
    MASKED_AREAS: range(4, 4 * _MOST_MASKED + 1, 4),  # four for each
}

Order = Literal["<", ">"]
Numbers = tuple[int | Fraction, ...]


@dataclass(frozen=True, slots=True)
class Directory:
    """One IFD: the values of the tags that are relied on, exactly.

    Attributes
    ----------
    values
        Numbers by tag; not of tags that state none (0/0). Of a list of opcodes their ids.
    order
        Of its bytes, as struct and numpy name it.
    entries
        Of every tag, relied on or not: where its entry stands in the file, and the type of its values.
    starts
        Where it, and the values that it has elsewhere in the file, begin.
    texts
        Texts by tag.
    """

    values: dict[int, Numbers]
    order: Order = "<"
    entries: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    starts: tuple[int, ...] = ()
    texts: Mapping[int, str] = field(default_factory=dict)

    def number(self, tag: int, default: int) -> int:
        """First number of a tag; ``default`` if it is missing."""
        values = self.values.get(tag)
        return int(values[0]) if values else default

    def corner(self) -> tuple[int, int]:
        """Row and column at which its active area begins."""
        top, left = self.values.get(ACTIVE_AREA, (0, 0))[:2]
        return int(top), int(left)

    @property
    def compression(self) -> int:
        """How its data are compressed; 1: they are not."""
        return self.number(COMPRESSION, UNCOMPRESSED)

    @property
    def black_repeat(self) -> tuple[int, int]:
        """Rows and columns after which its BlackLevel repeats; some write one number, with one level."""
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
        """Offset and byte count of each strip, or of each tile."""
        offsets, counts = (map(int, self.values.get(tag, ())) for tag in tags)
        return tuple(zip(offsets, counts, strict=False))

    @property
    def held(self) -> int:
        """Bytes of all its strips or tiles."""
        return sum(count for _, count in self.extents)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) in pixels that it declares; 0 for one that it does not."""
        return self.number(HEIGHT, 0), self.number(WIDTH, 0)

    @property
    def pixels(self) -> int:
        """Number of pixels that it declares."""
        return math.prod(self.shape)


def read_directories(path: Path) -> tuple[Directory, ...]:
    """Read every directory of a TIFF-based file: the chain, sub-IFDs and EXIF; none of another file.

    Raises
    ------
    RawFileError
        If a directory, a relied-on value, or the raw image's data lies beyond the end of the file, or that data is too
        little for its pixels.
    """
    with path.open("rb") as file:
        directories = TiffReader(path, file).walk() if file.read(4) in MAGIC else ()
    check_images(path, directories)
    return directories


def is_dng(directories: Sequence[Directory]) -> bool:
    """Whether a file of these directories is a DNG."""
    return any(DNG_VERSION in directory.values for directory in directories)


def main_mosaics(directories: Sequence[Directory]) -> tuple[Directory, ...]:
    """Directories of the largest mosaics, in order: one, or several of a pixel shift; no proxies."""
    mosaics = [directory for directory in directories if directory.is_mosaic]
    most = max((directory.pixels for directory in mosaics), default=0)
    largest = [directory for directory in mosaics if directory.pixels == most]
    return tuple([directory for directory in largest if not directory.number(SUBFILE, 0)] or largest)


def check_images(path: Path, directories: Sequence[Directory]) -> None:
    """Refuse a file that does not hold its raw image; raises like :func:`read_directories`."""
    of_dng = is_dng(directories)
    # The raw image alone where it is marked as such: some cameras declare previews that they do not write.
    images = [directory for directory in directories if directory.is_mosaic]
    for mosaic in images:
        _check_mosaic(path, mosaic, of_dng)
    end = 0
    for extent in (extent for directory in images or directories for extent in directory.extents):
        if min(extent) < 0:
            raise RawFileError(path, f"damaged: it declares {extent[1]} bytes of image data at byte {extent[0]}")
        end = max(end, sum(extent))
    require(path, path.stat().st_size, end)


def _check_mosaic(path: Path, mosaic: Directory, of_dng: bool) -> None:
    """Refuse a mosaic with missing or impossible numbers in tags that are relied on, or with too little data."""
    for tag, counts in _COUNTS.items():
        values = mosaic.values.get(tag)
        if values is not None and (len(values) not in counts or min(values, default=0) < 0):
            shown = ", ".join(map(str, values[:5]))
            raise RawFileError(path, f"damaged: expected {counts[0]} numbers from 0 on as its tag {tag}; found {shown}")
    repeats = mosaic.values.get(BLACK_REPEAT, (1, 1))
    if not 1 <= min(repeats) <= max(repeats) <= _MOST_REPEATED:
        raise RawFileError(path, f"damaged: its BlackLevel repeats every {repeats} pixels, not 1 to {_MOST_REPEATED}")
    # JPEG XL is refused by name; a DNG's uncompressed data are held against its rows (eldata.raw.container).
    elsewhere = (JPEG_XL, UNCOMPRESSED) if of_dng else (JPEG_XL,)
    if mosaic.held * MOST_PIXELS < mosaic.pixels and mosaic.compression not in elsewhere:
        raise RawFileError(path, f"truncated: its image data, {mosaic.held} bytes, cannot hold {mosaic.pixels} pixels")


def require(path: Path, size: int, end: int) -> None:
    """Raise a RawFileError if the file, of this size, declares data beyond its end."""
    if end > size:
        raise RawFileError(
            path, f"truncated: it declares data up to byte {end} but has {size} bytes; copy or download it again"
        )


class TiffReader:
    """Reads the directories of one open TIFF file, which may be a part of another, within bounds for all of them."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._path, self._file = path, file
        self._size = file.seek(0, io.SEEK_END)
        self._left = dict(_MOST)
        file.seek(0)
        head = file.read(8)
        self._order: Order = ">" if head[:1] == b"M" else "<"
        self._first = struct.unpack(self._order + "I", head[4:])[0] if len(head) == 8 else 0
        file.seek(0)

    def walk(self) -> tuple[Directory, ...]:
        """Read every directory, in LibRaw's order: those within one before those behind it, each as listed."""
        waiting, seen = [self._first], {0}
        directories: list[Directory] = []
        while waiting:
            at = waiting.pop()
            if at in seen:
                continue
            seen.add(at)
            directory, following = self._read(at)
            directories.append(directory)
            within = [int(place) for tag in (_SUB_IFDS, EXIF_IFD) for place in directory.values.get(tag, ())]
            waiting += [following, *reversed(within)]
        return tuple(directories)

    def read_first(self, tag: int = EXIF_IFD) -> tuple[Directory, Directory]:
        """Read the first directory and one that it names, that of EXIF or another; empty ones where there are none."""
        first = self._read(self._first)[0] if self._first else Directory({})
        at = first.number(tag, 0)
        return first, self._read(at)[0] if at else Directory({})

    def _require(self, end: int) -> None:
        """Refuse the file if it is shorter than ``end`` bytes."""
        require(self._path, self._size, end)

    def _count_down(self, what: str, count: int) -> None:
        """Count things that were read, such as directories, and refuse a file with far too many."""
        self._left[what] -= count
        if self._left[what] < 0:
            raise RawFileError(
                self._path, f"damaged, or made to keep a reader busy: its directories declare far too many {what}"
            )

    def _read(self, at: int) -> tuple[Directory, int]:
        """Read the directory at a place, and where the next one is."""
        if at < 0:
            raise RawFileError(self._path, f"damaged: it declares a directory at byte {at}")
        self._count_down("directories", 1)
        self._require(at + 2)
        self._file.seek(at)
        count = struct.unpack(self._order + "H", self._file.read(2))[0]
        self._count_down("entries", count)
        self._require(at + 2 + 12 * count)
        table = self._file.read(12 * count + 4)
        values: dict[int, Numbers] = {}
        texts: dict[int, str] = {}
        entries: dict[int, tuple[int, int]] = {}
        starts = [at]
        for index, (tag, kind, number, offset) in enumerate(
            struct.iter_unpack(self._order + "HHII", table[: 12 * count])
        ):
            entries[tag] = at + 2 + 12 * index, kind
            length = _SIZES.get(kind, 1) * number
            if length > 4:
                starts.append(offset)
            if tag not in _READ:
                continue
            if length > 4:
                self._require(offset + length - (kind == ASCII))  # some writers leave out a text's last zero
            if tag in OPCODE_LISTS:
                values[tag] = tuple(self._read_opcodes(range(offset, offset + length))) if length > 4 else ()
            elif kind == ASCII or kind in _CODES:
                self._count_down("values", number)
                data = self._read_at(offset, length) if length > 4 else table[12 * index + 8 : 12 * index + 8 + length]
                if kind == ASCII:
                    texts[tag] = _decode_text(data)
                elif (numbers := _unpack_numbers(self._order, kind, data)) is not None:
                    values[tag] = numbers
                elif tag in _LEVELS:  # LibRaw takes such a level for 0
                    raise RawFileError(
                        self._path, f"damaged: its {_LEVELS[tag]} is not a number (0 for its denominator, or NaN)"
                    )
        # The pointer to the next directory may be missing at the very end of a file.
        following = struct.unpack(self._order + "I", table[-4:])[0] if len(table) == 12 * count + 4 else 0
        return Directory(values, self._order, entries, tuple(starts), texts), following

    def _read_at(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(length)

    def _read_opcodes(self, place: range) -> Iterator[int]:
        """Read the ids of a list of opcodes, whose byte order is always big-endian."""
        at = place.start + 4
        for _ in range(int.from_bytes(self._read_at(place.start, 4), "big")):
            if at + 16 > place.stop:
                raise RawFileError(
                    self._path, f"damaged: its list of opcodes holds more of them than its {len(place)} bytes"
                )
            self._count_down("values", 1)
            opcode, _, _, length = struct.unpack(">4I", self._read_at(at, 16))
            yield opcode
            at += 16 + length


def _decode_text(data: bytes) -> str:
    """Decode text up to its first zero byte, as UTF-8 or else Latin-1."""
    text = data.partition(b"\0")[0]
    try:
        return text.decode().strip()
    except UnicodeDecodeError:
        return text.decode("latin-1").strip()


@lru_cache(maxsize=128)  # most are the same in all files of a camera
def _unpack_numbers(order: str, kind: int, data: bytes) -> Numbers | None:
    """Unpack an entry's values; ``None`` if one is a fraction over 0, which says "not known", or not finite."""
    code = _CODES[kind]
    flat = struct.unpack(f"{order}{len(data) // struct.calcsize('=' + code)}{code}", data)
    if kind in _FRACTIONS:
        return tuple(map(Fraction, flat[::2], flat[1::2])) if all(flat[1::2]) else None
    if kind in _FLOATS:
        return tuple(map(Fraction, flat)) if all(map(math.isfinite, flat)) else None
    return flat


def round_fraction(value: Fraction, largest: int) -> Fraction:
    """Round a value to a fraction whose numerator and denominator are at most ``largest``.

    The value itself if its parts fit. Else, from 1 / ``largest`` to ``largest``, it is off by less than one part in
    ``largest`` - 1; below that it is off by less than 1 / ``largest``.

    Raises
    ------
    ValueError
        If the value, without its sign, is above ``largest``.
    """
    if abs(value) > largest:
        raise ValueError(f"{value} is beyond {largest}")
    return value.limit_denominator(largest if abs(value) <= 1 else int(largest / abs(value)))
