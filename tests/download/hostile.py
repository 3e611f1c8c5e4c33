"""Archives as strangers make them: sound ones of every kind, and seeded damage to them."""

from __future__ import annotations

import io
import random
import struct
import warnings
import zipfile
import zlib
from typing import TYPE_CHECKING

from tests.download.helpers import noise, sevenzipped, zipped

if TYPE_CHECKING:
    from collections.abc import Callable

FILES = {f"Sony/short/0000{number}_00_0.1s.ARW": noise(700 + number, number) for number in range(3)}
EXTREMES = (0, 1, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)


SOUND: dict[str, Callable[[], bytes]] = {
    "zip": lambda: zipped(FILES),
    "zip-stored": lambda: zipped(FILES, zipfile.ZIP_STORED),
    "7z": lambda: sevenzipped(FILES),
    "7z-plain": lambda: plain_sevenzip(FILES),
}


def plain_sevenzip(files: dict[str, bytes]) -> bytes:
    """A 7z archive whose header is not packed."""
    import py7zr

    buffer = io.BytesIO()
    with py7zr.SevenZipFile(buffer, "w") as archive:
        archive.set_encoded_header_mode(False)
        for name, content in files.items():
            archive.writestr(content, name)
    return buffer.getvalue()


# --- damage -----------------------------------------------------------------------------------------------------------


def damaged_archive(kind: str, content: bytes, seed: int) -> bytes:
    """Sound content with one to four seeded changes; half the time with the checksums of headers made right again."""
    rng = random.Random(seed)  # noqa: S311 # to be repeated
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        data = _changed(rng, data, kind)
    return bytes(_repaired(kind, data) if rng.random() < 0.5 else data)


def _place(rng: random.Random, data: bytearray, kind: str) -> int:
    """A place to change: headers more often than pixels."""
    if kind.startswith("zip") and rng.random() < 0.7:
        marks = [at for mark in (b"PK\1\2", b"PK\5\6", b"PK\3\4") if (at := data.find(mark)) >= 0]
        return min(rng.choice(marks or [0]) + rng.randrange(50), len(data) - 1)
    if kind.startswith("7z") and rng.random() < 0.7:
        at = 32 + int.from_bytes(data[12:20], "little") if rng.random() < 0.7 else 0
        return min(at + rng.randrange(80), len(data) - 1)
    return rng.randrange(len(data))


def _changed(rng: random.Random, data: bytearray, kind: str) -> bytearray:
    if not data:
        return data
    at = _place(rng, data, kind)
    match rng.randrange(8):
        case 0:
            data[at] ^= 1 << rng.randrange(8)
        case 1:
            data[at] = rng.randrange(256)
        case 2:
            del data[at:]
        case 3:
            data[at : at + 8] = struct.pack("<Q", rng.choice(EXTREMES))
        case 4:
            data[at : at + 4] = struct.pack("<L", rng.choice(EXTREMES) & 0xFFFFFFFF)
        case 5:
            data[at : at + rng.randrange(700)] = b""
        case 6:
            other = rng.randrange(len(data))
            data[at:at] = data[other : other + rng.randrange(1200)]
        case 7:
            count = rng.randrange(1, 40)
            data[at : at + count] = rng.choice((bytes(count), b"\xff" * count, b"7" * count, rng.randbytes(count)))
    return data


def _repaired(kind: str, data: bytearray) -> bytearray:
    """Data whose headers pass their checksums, so that what they say is believed."""
    if kind.startswith("zip") or len(data) < 32:
        return data
    offset, size = struct.unpack_from("<QQ", data, 12)
    header_crc = zlib.crc32(data[32 + offset : 32 + offset + size]) if offset < len(data) else 0
    struct.pack_into("<L", data, 28, header_crc)
    struct.pack_into("<L", data, 8, zlib.crc32(data[12:32]))
    return data


# --- made to harm -----------------------------------------------------------------------------------------------------


def _seven_zip(body: bytes) -> bytes:
    start = struct.pack("<QQL", 0, len(body), zlib.crc32(body))
    return b"7z\xbc\xaf\x27\x1c\x00\x04" + struct.pack("<L", zlib.crc32(start)) + start + body


def _number(value: int) -> bytes:
    return b"\xff" + struct.pack("<Q", value)


def _zip64(size: int) -> bytes:
    """A zip archive whose one member states a size in its zip64 field."""
    data = bytearray(zipped({"a": b"x" * 100}, zipfile.ZIP_STORED))
    at = data.index(b"PK\1\2")
    extra = struct.pack("<HHQQ", 1, 16, size, size)
    struct.pack_into("<LL", data, at + 20, 0xFFFFFFFF, 0xFFFFFFFF)
    struct.pack_into("<H", data, at + 30, len(extra))
    data[at + 47 : at + 47] = extra
    end = data.index(b"PK\5\6")
    struct.pack_into("<L", data, end + 12, end - at)
    return bytes(data)


def _overlapping() -> bytes:
    """Members that all begin at the first one's place."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = bytearray(zipped({f"m{number:03}": bytes(100_000) for number in range(300)}))
    at = data.index(b"PK\1\2")
    while (at := data.find(b"PK\1\2", at)) >= 0:
        struct.pack_into("<L", data, at + 42, 0)
        at += 46
    return bytes(data)


HOSTILE: dict[str, Callable[[], bytes]] = {
    "a name of 300 characters": lambda: zipped({"Sony/" + "n" * 300: b"x"}),
    "a name of 255 characters that are 510 bytes": lambda: zipped({"Sony/" + "\u00e4" * 250: b"x"}),
    "a path of 60,000 characters": lambda: zipped({"n/" * 30_000 + "a": b"x"}),
    "a zip64 size of exabytes": lambda: _zip64(2**62),
    "a zip64 size beyond 64 bits": lambda: _zip64(2**64 - 1),
    "members over each other": _overlapping,
    "a 7z header of a trillion files": lambda: _seven_zip(b"\x01\x05" + _number(2**40) + b"\0\0"),
    "a 7z header of billions of streams": lambda: _seven_zip(b"\x01\x04\x06\x00" + _number(2**31) + b"\x0a\x01"),
    "a 7z header within headers": lambda: _seven_zip(
        b"\x17\x06\x00\x01\x09\x10\x00\x07\x0b\x01\x00\x01\x00\x0c\x10\x00\x00"
    ),
}
