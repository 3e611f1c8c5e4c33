"""Archives as strangers make them: sound ones of every kind, and seeded damage to them."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import random
import struct
import tarfile
import warnings
import zipfile
import zlib
from typing import TYPE_CHECKING

from tests.download.helpers import noise, sevenzipped, tarred, zipped

if TYPE_CHECKING:
    from collections.abc import Callable

FILES = {f"Sony/short/0000{number}_00_0.1s.ARW": noise(700 + number, number) for number in range(3)}
LONG = {f"Sony/{'deep/' * 30}{'n' * 120}.ARW": b"x" * 600, "Sony/a": b"a" * 50}
EXTREMES = (0, 1, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)


def tar_of(files: dict[str, bytes], form: int, more: dict[str, str] | None = None) -> bytes:
    """A tar file in one of the three formats, with more pax records for each member."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=form) as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            info.pax_headers = more or {}
            archive.addfile(info, io.BytesIO(content))
    return buffer.getvalue()


def header(name: str, size: int, kind: bytes = tarfile.REGTYPE) -> bytes:
    """One block with a valid checksum, whatever it states; a size below 0 too."""
    info = tarfile.TarInfo(name)
    info.type, info.size = kind, max(size, 0)
    block = bytearray(info.tobuf(tarfile.GNU_FORMAT)[:512])
    if size < 0:
        block[124:136] = b"\xff" + size.to_bytes(11, "big", signed=True)
    return sealed(block)


def sealed(block: bytes | bytearray) -> bytes:
    """A header block with its checksum made right."""
    blank = bytes(block[:148]) + b" " * 8 + bytes(block[156:512])
    return blank[:148] + f"{sum(blank):06o}\0 ".encode() + blank[156:]


def sparse(name: str, *, real_size: int, pieces: int = 1) -> bytes:
    """A member in GNU's old sparse format."""
    block = bytearray(header(name, 512, tarfile.GNUTYPE_SPARSE))
    for index in range(min(pieces, 4)):
        block[386 + 24 * index : 410 + 24 * index] = f"{index * 1024:011o}\0{512:011o}\0".encode()
    block[483:495] = b"\x80" + real_size.to_bytes(11, "big")
    return sealed(block) + b"x" * 512 + bytes(1024)


SOUND: dict[str, Callable[[], bytes]] = {
    "zip": lambda: zipped(FILES),
    "zip-stored": lambda: zipped(FILES, zipfile.ZIP_STORED),
    "ustar": lambda: tar_of(FILES, tarfile.USTAR_FORMAT),
    "gnu": lambda: tar_of(LONG, tarfile.GNU_FORMAT),
    "pax": lambda: tar_of(LONG, tarfile.PAX_FORMAT, {"comment": "no", "mtime": "1.5"}),
    "sparse": lambda: sparse("Sony/a", real_size=4096),
    "pax-sparse": lambda: tar_of(FILES, tarfile.PAX_FORMAT, {"GNU.sparse.map": "0,1", "GNU.sparse.size": "9"}),
    "tar.gz": lambda: tarred(FILES),
    "tar.bz2": lambda: tarred(FILES, "w:bz2"),
    "tar.xz": lambda: tarred(FILES, "w:xz"),
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


OUTER: dict[str, tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]] = {
    "tar.gz": (gzip.decompress, gzip.compress),
    "tar.bz2": (bz2.decompress, bz2.compress),
    "tar.xz": (lzma.decompress, lzma.compress),
}


def damaged_archive(kind: str, content: bytes, seed: int) -> bytes:
    """Sound content with one to four seeded changes; half the time with the checksums of headers made right again."""
    rng = random.Random(seed)  # noqa: S311 # to be repeated
    outer = OUTER.get(kind) if rng.random() < 0.5 else None
    if outer is not None:
        content = outer[0](content)
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        data = _changed(rng, data, kind)
    if rng.random() < 0.5:
        data = _repaired(kind, data)
    return outer[1](bytes(data)) if outer is not None else bytes(data)


def _place(rng: random.Random, data: bytearray, kind: str) -> int:
    """A place to change: headers more often than pixels."""
    if kind.startswith("zip") and rng.random() < 0.7:
        marks = [at for mark in (b"PK\1\2", b"PK\5\6", b"PK\3\4") if (at := data.find(mark)) >= 0]
        return min(rng.choice(marks or [0]) + rng.randrange(50), len(data) - 1)
    if kind.startswith("7z") and rng.random() < 0.7:
        at = 32 + int.from_bytes(data[12:20], "little") if rng.random() < 0.7 else 0
        return min(at + rng.randrange(80), len(data) - 1)
    if rng.random() < 0.7:
        return min(512 * rng.randrange(len(data) // 512 + 1) + rng.randrange(160), len(data) - 1)
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
    if kind.startswith("zip"):
        return data
    if kind.startswith("7z"):
        if len(data) < 32:
            return data
        offset, size = struct.unpack_from("<QQ", data, 12)
        header_crc = zlib.crc32(data[32 + offset : 32 + offset + size]) if offset < len(data) else 0
        struct.pack_into("<L", data, 28, header_crc)
        struct.pack_into("<L", data, 8, zlib.crc32(data[12:32]))
        return data
    for at in range(0, len(data) - 511, 512):
        if data[at + 257 : at + 262] == b"ustar":
            data[at : at + 512] = sealed(data[at : at + 512])
    return data


# --- made to harm -----------------------------------------------------------------------------------------------------

END = bytes(1024)


def _pax(name: str, records: bytes) -> bytes:
    padded = records + bytes(-len(records) % 512)
    return header("pax", len(records), tarfile.XHDTYPE) + padded + header(name, 1) + b"x" + bytes(511) + END


def _record(text: bytes) -> bytes:
    length = len(text) + 2
    while len(str(length)) + 1 + len(text) + 1 != length:
        length += 1
    return str(length).encode() + b" " + text + b"\n"


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
    "a name of 255 characters that are 510 bytes": lambda: tarred({"Sony/" + "\u00e4" * 250: b"x"}),
    "a path of 60,000 characters": lambda: tarred({"n/" * 30_000 + "a": b"x"}),
    "a sparse member of an exabyte": lambda: sparse("Sony/a", real_size=2**60, pieces=4),
    "a pax sparse map that is not numbers": lambda: _pax(
        "a", _record(b"GNU.sparse.map=x,y") + _record(b"GNU.sparse.size=z")
    ),
    "a million pax records": lambda: _pax("a", _record(b"comment=x") * 1_000_000),
    "a pax header without an end": lambda: _pax("a", b"9" * 900_000),
    "a pax size without an end": lambda: _pax("a", _record(b"size=" + b"9" * 9000)),
    "a pax record of length 0": lambda: _pax("a", b"0 a=b\n"),
    "ten thousand headers about one member": lambda: header("././@LongLink", 2, b"L") * 10_000,
    "ten thousand long names": lambda: (header("././@LongLink", 2, b"L") + b"a\0" + bytes(510)) * 10_000 + END,
    "a header of a gigabyte": lambda: gzip.compress(header("x", 2**30, b"L") + bytes(2**20)),
    "a member of less than nothing": lambda: header("a", -512) + END,
    "a long name of less than nothing": lambda: header("././@LongLink", -1024, b"L") + END,
    "a member of a zettabyte": lambda: header("a", 2**70) + END,
    "a gigabyte of zeros": lambda: lzma.compress(header("a", 2**30) + bytes(2**28), preset=0),
    "a zip64 size of exabytes": lambda: _zip64(2**62),
    "a zip64 size beyond 64 bits": lambda: _zip64(2**64 - 1),
    "members over each other": _overlapping,
    "a 7z header of a trillion files": lambda: _seven_zip(b"\x01\x05" + _number(2**40) + b"\0\0"),
    "a 7z header of billions of streams": lambda: _seven_zip(b"\x01\x04\x06\x00" + _number(2**31) + b"\x0a\x01"),
    "a 7z header within headers": lambda: _seven_zip(
        b"\x17\x06\x00\x01\x09\x10\x00\x07\x0b\x01\x00\x01\x00\x0c\x10\x00\x00"
    ),
}
