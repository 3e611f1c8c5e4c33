"""Canon's CRW: camera, exposure and time from its heap of records (CIFF), which has no EXIF.

A heap ends with the offset of its table, whose entries name a record's type, length and place; some records are heaps
themselves. What the fields mean is exiftool's knowledge of them (lib/Image/ExifTool/CanonRaw.pm and Canon.pm).
"""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from fractions import Fraction
from typing import TYPE_CHECKING, BinaryIO

from eldata.errors import RawFileError
from eldata.raw.tiff import require
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = b"HEAPCCDR"  # after the byte order and the length of the head
_MAKE_MODEL, _TIME, _BASE_ISO, _SHOT_INFO, _PROPERTIES = 0x080A, 0x180E, 0x101C, 0x102A, 0x300A
_IN_ENTRY, _PLACE, _KIND, _HEAPS = 0x4000, 0xC000, 0x3800, (0x2800, 0x3000)
_MOST_DEPTH, _MOST_RECORDS, _MOST_BYTES = 8, 1000, 4096
_DECIMALS = 6


def read_crw_header(path: Path) -> RawHeader | None:
    """Return what a CRW says of its camera and exposure; ``None`` for another file.

    Canon states the time and the aperture as powers of two (APEX: 2 to the minus 7/3 s), which are not fractions unless
    the power is whole: those are given to six significant digits. The ISO likewise, where it is not written out; such
    a one is given if it is whole.

    Raises
    ------
    RawFileError
        If its heap is cut off or damaged.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(26)
        if head[6:14] != MAGIC:
            return None
        order = {b"II": "<", b"MM": ">"}.get(head[:2])
        if order is None:
            raise RawFileError(path, f"damaged: a CRW begins with II or MM, and it with {head[:2]!r}")
        records = _Heap(path, file, order).records(struct.unpack_from(order + "I", head, 2)[0], size)
    make, model, *_ = (*records.get(_MAKE_MODEL, b"").decode("ascii", "replace").split("\0"), "", "")
    info = records.get(_SHOT_INFO, b"")
    shot = struct.unpack_from(f"{order}{len(info) // 2}h", info)
    seconds = _number(records.get(_TIME), order + "I")
    return RawHeader(
        path,
        make.strip(),
        model.strip(),
        Exposure(_iso(_number(records.get(_BASE_ISO), order + "H"), shot), _exposure_s(shot), _f_number(shot)),
        # Counted as if the camera's clock, which knows no zone, were on UTC.
        datetime.fromtimestamp(seconds, UTC).replace(tzinfo=None) if seconds else None,
    )


class _Heap:
    """Walks a file's heaps, and gives up on one that is made to keep it busy."""

    def __init__(self, path: Path, file: BinaryIO, order: str) -> None:
        self.path, self.file, self.order, self.left = path, file, order, _MOST_RECORDS

    def records(self, start: int, end: int, depth: int = 0) -> dict[int, bytes]:
        """Return the relied-on records of the heap in these bytes of the file, by type."""
        require(self.path, self.path.stat().st_size, max(start + 6, end))
        if depth > _MOST_DEPTH or end < start + 6:
            raise self._damaged(start)
        table = start + self._unpack(end - 4, "I")[0]
        if not start <= table <= end - 6:
            raise self._damaged(start)
        count = self._unpack(table, "H")[0]
        self.left -= count
        if self.left < 0 or table + 2 + 10 * count > end:
            raise self._damaged(start)
        found: dict[int, bytes] = {}
        kinds = set()
        for at in range(table + 2, table + 2 + 10 * count, 10):
            word, length, offset = self._unpack(at, "HII")
            kind = word & ~_PLACE
            kinds.add(kind)
            if word & _PLACE == _IN_ENTRY:
                place, length = at + 2, 8
            else:
                place = start + offset
            if word & _KIND in _HEAPS:
                if place + length > end:
                    raise self._damaged(place)
                found |= self.records(place, place + length, depth + 1)
            elif kind in (_MAKE_MODEL, _TIME, _BASE_ISO, _SHOT_INFO):
                if place + length > end or length > _MOST_BYTES:
                    raise self._damaged(place)
                self.file.seek(place)
                found[kind] = self.file.read(length)
        if depth == 0 and _PROPERTIES not in kinds:  # what stands at the end of a file that was cut off
            raise self._damaged(table)
        return found

    def _unpack(self, at: int, code: str) -> tuple[int, ...]:
        self.file.seek(at)
        return struct.unpack(self.order + code, self.file.read(struct.calcsize(self.order + code)))

    def _damaged(self, at: int) -> RawFileError:
        return RawFileError(self.path, f"damaged: its heap of records does not hold together at byte {at}")


def _number(data: bytes | None, code: str) -> int:
    return int(struct.unpack_from(code, data)[0]) if data and len(data) >= struct.calcsize(code) else 0


def _iso(base: int, shot: tuple[int, ...]) -> Fraction | None:
    if len(shot) <= 2 or shot[2] <= 0:
        return Fraction(base) if base else None
    steps = Fraction(shot[1] + shot[2], 32) - 5  # ISO 100 is 5; the camera's own choice of ISO is a step of its own
    return 100 * _power(steps) if steps.denominator == 1 else None


def _exposure_s(shot: tuple[int, ...]) -> Fraction | None:
    if len(shot) <= 22:
        return None
    if abs(shot[22]) < 1000:
        return _power(-_steps(shot[22]))
    return Fraction(shot[24], 10) if len(shot) > 24 and shot[24] > 0 else None  # held open by hand


def _f_number(shot: tuple[int, ...]) -> Fraction | None:
    return _power(_steps(shot[21]) / 2) if len(shot) > 21 and 0 < shot[21] < 1000 else None


def _steps(code: int) -> Fraction:
    """Return Canon's code in steps of APEX: 32nds, in which 12 and 20 stand for thirds."""
    whole, part = divmod(abs(code), 32)
    steps = whole + {12: Fraction(1, 3), 20: Fraction(2, 3)}.get(part, Fraction(part, 32))
    return steps if code >= 0 else -steps


def _power(steps: Fraction) -> Fraction:
    if steps.denominator == 1:
        return Fraction(2) ** int(steps)
    return Fraction(f"{2.0 ** float(steps):.{_DECIMALS - 1}e}")
