"""Changes to what files are made of that is not TIFF: JPEG, boxes, heaps, PNG, zip, tar, 7z, numpy, HDF5."""

from __future__ import annotations

import io
import re
import struct
import zlib
from typing import TYPE_CHECKING

from tests.fuzz.bytewise import EDGES, flipped

if TYPE_CHECKING:
    from random import Random


def _put(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def _edge(random: Random, width: int, order: str) -> bytes:
    value = random.choice((random.choice(EDGES), random.getrandbits(8 * width)))
    return (value % (1 << 8 * width)).to_bytes(width, "little" if order == "<" else "big")


# --- raws ---------------------------------------------------------------------------------------------------------


def jpeg(data: bytes, random: Random, other: bytes) -> bytes:
    """A segment's length or content: precision, size, components, Huffman table, predictor."""
    marks = [found.start() for found in re.finditer(rb"\xff[\xc0-\xcf\xda-\xdd\xe0-\xe2]..", data, re.DOTALL)]
    if not marks:
        return data
    at = random.choice(marks[:12])
    length = struct.unpack_from(">H", data, at + 2)[0]
    if random.random() < 0.3:
        return _put(data, at + 2, _edge(random, 2, ">"))
    place = at + 4 + random.randrange(max(1, min(length, 40)))
    return _put(data, place, _edge(random, random.choice((1, 2)), ">"))[: len(data)]


def jpeg_end(data: bytes, random: Random, other: bytes) -> bytes:
    """The mark of the end put into the middle, or a restart."""
    start = data.find(b"\xff\xda")
    if start < 0 or start + 16 > len(data):
        return data
    return _put(data, random.randrange(start + 14, len(data)), random.choice((b"\xff\xd9", b"\xff\xd0", b"\xff\xff")))[
        : len(data)
    ]


def boxes(data: bytes, random: Random, other: bytes) -> bytes:
    """A box of an ISO container (CR3): its size, its name, or its first bytes."""
    names = rb"(?:ftyp|moov|uuid|CMT[1-4]|CNCV|CTBO|trak|mdia|minf|stbl|stsd|stsz|co64|CRAW|CMP1|mdat|PRVW|THMB|free)"
    places = [found.start() for found in re.finditer(names, data)]
    if not places:
        return data
    at = random.choice(places)
    which = random.randrange(4)
    if which == 0:
        return _put(data, max(0, at - 4), _edge(random, 4, ">"))
    if which == 1:
        return _put(data, at, data[(name := random.choice(places)) : name + 4])
    if which == 2:  # a size of 64 bits
        return _put(data, max(0, at - 4), struct.pack(">I", 1) + data[at : at + 4] + _edge(random, 8, ">"))[: len(data)]
    return _put(data, at + 4 + random.randrange(64), _edge(random, 4, ">"))[: len(data)]


def heap(data: bytes, random: Random, other: bytes) -> bytes:
    """A record of a CIFF heap (CRW): the table's place, the number of records, a type, a length, an offset."""
    if len(data) < 40 or data[6:10] != b"HEAP":
        return data
    table = len(data) - 4 - struct.unpack("<I", data[-4:])[0]
    places = [len(data) - 4, 2]
    start = struct.unpack_from("<I", data, 2)[0] + struct.unpack("<I", data[-4:])[0]
    if 0 < start < len(data) - 2:
        places += [start, *(start + 2 + 10 * number + part for number in range(12) for part in (0, 2, 6))]
    at = random.choice([place for place in (*places, table) if 0 <= place <= len(data) - 4])
    return _put(data, at, _edge(random, random.choice((2, 4)), "<"))[: len(data)]


def raf(data: bytes, random: Random, other: bytes) -> bytes:
    """An offset or length of a RAF's header, or a record of its own directory."""
    if not data.startswith(b"FUJIFILM") or len(data) < 120:
        return data
    at = random.choice((84, 88, 92, 96, 100, 104, 108, 112))
    if random.random() < 0.4:
        start = struct.unpack_from(">I", data, 92)[0]
        at = start + random.randrange(64)
    return _put(data, at, _edge(random, random.choice((2, 4)), ">"))[: len(data)]


# --- pictures and arrays --------------------------------------------------------------------------------------------


def png(data: bytes, random: Random, other: bytes) -> bytes:
    """A chunk's content with its checksum mended: size, depth, colour type, interlace; or chunks out of order."""
    if not data.startswith(b"\x89PNG"):
        return data
    chunks, at = [], 8
    while at + 12 <= len(data):
        length = struct.unpack_from(">I", data, at)[0]
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    if not chunks:
        return data
    index = random.randrange(len(chunks)) if random.random() < 0.3 else 0
    name, content = chunks[index]
    which = random.randrange(5)
    if which < 3 and content:
        place = random.randrange(min(len(content), 13))
        content = _put(content, place, _edge(random, random.choice((1, 4)), ">"))[: len(content)]
        chunks[index] = (name, content)
    elif which == 3:
        chunks.insert(index, random.choice(chunks))
    else:
        random.shuffle(chunks)
    return data[:8] + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks
    )


def png_bomb(data: bytes, random: Random, other: bytes) -> bytes:
    """A PNG of 30,000 x 30,000 pixels in some kilobytes."""
    side = random.choice((3000, 30000, 100000))
    depth, kind = random.choice(((16, 0), (16, 2), (8, 2), (8, 6), (1, 0)))
    head = struct.pack(">IIBBBBB", side, side, depth, kind, 0, 0, 0)
    body = zlib.compress(bytes(random.choice((1 << 10, 1 << 22))))
    chunks = ((b"IHDR", head), (b"IDAT", body), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks
    )


_DESCRIPTIONS = (
    *("<f4", ">f4", "<f8", "|O", "<U9999999", "|S0", "<f2", "|b1", "<c16", "<M8[s]", "|V8", "<u2", "f4,f4"),
    *("<f16", "x"),
)
_SHAPES = ("(4, 30, 32)", "()", "(0,)", "(-1,)", "(1073741824, 4)", "(2305843009213693952, 8)", "(4.0, 2)", "(True,)")
_HEADERS = ("{", "[]", "{'descr': '<f4'}", "{'shape': (1,)}", "(" * 900, "__import__('os')", "9" * 300, "{**{}}")


def npy(data: bytes, random: Random, other: bytes) -> bytes:
    """A numpy header: type, order, shape, its own length and version."""
    at = data.find(b"\x93NUMPY")
    if at < 0 or at + 10 > len(data):
        return data
    which = random.randrange(6)
    if which == 0:
        return _put(data, at + 6, bytes((random.choice((0, 1, 2, 3, 4, 255)), random.choice((0, 1)))))
    if which == 1:
        return _put(data, at + 8, _edge(random, 2, "<"))
    size = struct.unpack_from("<H", data, at + 8)[0]
    header = data[at + 10 : at + 10 + size].decode("latin1")
    if which == 2:
        header = re.sub(r"'descr': '[^']*'", f"'descr': '{random.choice(_DESCRIPTIONS)}'", header)
    elif which == 3:
        header = re.sub(r"\([^)]*\)", random.choice(_SHAPES), header)
    elif which == 4:
        header = random.choice(_HEADERS)
    else:
        header = flipped(header.encode("latin1"), random, other).decode("latin1")
    header = header.rstrip()[: size - 1].ljust(size - 1) + "\n" if len(header) <= size + 8 else header + "\n"
    return data[: at + 8] + struct.pack("<H", len(header) % 65536) + header.encode("latin1") + data[at + 10 + size :]


def hdf5(data: bytes, random: Random, other: bytes) -> bytes:
    """HDF5 made anew: declared beyond reason, in another file, in another place, of another kind."""
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        which = random.randrange(9)
        name = random.choice(("prediction", "a", "a\x1b[2J", "p" * 300))
        if which == 0:
            shape = random.choice(((4, 30, 32), (1 << 15, 1 << 15), (4, 1 << 15, 1 << 14), (1 << 40,)))
            file.create_dataset(name, shape, "f4", chunks=(1,) * (len(shape) - 1) + (32,), compression="gzip")
        elif which == 1:
            target = random.choice(("/etc/passwd", "../other.h5", "/dev/zero", "input.h5", "."))
            file[name] = h5py.ExternalLink(target, "/prediction")
        elif which == 2:
            file[name] = h5py.SoftLink(random.choice((f"/{name}", "/", "/x/y", ".")))
        elif which == 3:
            target = random.choice(("/etc/passwd", "/dev/zero", "../secret", "/proc/self/environ"))
            file.create_dataset(name, (60, 64), "u2", external=[(target, 0, 7680)])
        elif which == 4:
            layout = h5py.VirtualLayout((60, 64), "f4")
            layout[:] = h5py.VirtualSource(random.choice(("/etc/passwd", "../o.h5", ".")), "prediction", (60, 64))
            file.create_virtual_dataset(name, layout)
        elif which == 5:
            kind = random.choice((h5py.string_dtype(), h5py.vlen_dtype("f4"), h5py.ref_dtype, "S9", "V8", "i8", "?"))
            file.create_dataset(name, (2, 2), kind)
        elif which == 6:
            file.create_group(name).create_group("b")
        elif which == 7:
            file.create_dataset(name, (), "f4", fillvalue=float("nan"))
        else:
            file.create_dataset(name, random.choice(((0,), (60, 64), (0, 64))), random.choice(("f4", "u2", "f2")))
    return buffer.getvalue()


# --- archives -------------------------------------------------------------------------------------------------------


def zip_record(data: bytes, random: Random, other: bytes) -> bytes:
    """A field of a local header, of the central directory, of its end: sizes, offsets, methods, flags, names."""
    places = [found.start() for found in re.finditer(rb"PK(?:\x01\x02|\x03\x04|\x05\x06|\x06\x06|\x06\x07)", data)]
    if not places:
        return data
    at = random.choice(places)
    return _put(data, at + 4 + random.randrange(60), _edge(random, random.choice((1, 2, 4)), "<"))[: len(data)]


_NAMES = (
    *(b"../../outside", b"/etc/outside", b"a/../b", b"C:\\x", b"\x1b[2J", b"\xe2\x80\xaeexe", b"\xff\xfe"),
    *(b"a\0b", b"", b"n" * 90, b"CON", b"a/" * 40, b".", b"Sony/long/00001_00_10s.ARW"),
)


def named(data: bytes, random: Random, other: bytes) -> bytes:
    """A member's name replaced by a hostile one of the same length."""
    places = [found.span() for found in re.finditer(rb"Sony/(?:long|short)/[\w.]+ARW", data)]
    if not places:
        return data
    start, stop = random.choice(places)
    new = random.choice(_NAMES)
    return (
        data[:start]
        + (new * (1 + (stop - start) // max(1, len(new))))[: stop - start].ljust(stop - start, b"x")
        + (data[stop:])
    )


_TAR_FIELDS = ((0, 100), (100, 8), (108, 8), (116, 8), (124, 12), (136, 12), (156, 1), (157, 100), (257, 8), (345, 155))
_OCTAL = (b"7" * 11, b"-1", b"\x80" + b"\0" * 10 + b"\x7f", b"\xff" * 11, b"999", b"", b"0x1", b"0" * 12, b" " * 11)
_PAX = (
    *("GNU.sparse.major=1", "GNU.sparse.map=1,x", "GNU.sparse.size=x", "GNU.sparse.map=0,9,9"),
    *("GNU.sparse.realsize=-1", "size=x", "size=-5", "size=99999999999999999999", "path=../x"),
    *("path=" + "n" * 5000, "path=\x1b[2J", "mtime=nan", "linkpath=/etc/passwd", "hdrcharset=BINARY", "="),
    *("GNU.sparse.name=", "GNU.sparse.numblocks=2", "uid=x"),
)


def tar_record(data: bytes, random: Random, other: bytes) -> bytes:
    """A field of a tar header with its checksum mended, or a header of pax before a member."""
    heads = [at for at in range(0, len(data) - 511, 512) if data[at + 257 : at + 262] == b"ustar"]
    if not heads:
        return data
    at = random.choice(heads)
    if random.random() < 0.4:
        return data[:at] + _pax(random) + data[at:]
    block = bytearray(data[at : at + 512])
    start, width = random.choice(_TAR_FIELDS)
    if width == 1:
        new = random.choice(b"\x000123456789gxLKSDMNV").to_bytes(1, "big")
    elif start in (100, 108, 116, 124, 136):
        new = random.choice(_OCTAL)
    else:
        new = random.choice(_NAMES)
    block[start : start + width] = new[:width].ljust(width, b"\0")
    return data[:at] + _summed(block) + data[at + 512 :]


def _summed(block: bytearray) -> bytes:
    block[148:156] = b" " * 8
    block[148:156] = f"{sum(block):06o}\0 ".encode()
    return bytes(block)


def _pax(random: Random) -> bytes:
    lines = b""
    for _ in range(random.choice((1, 1, 2, 4))):
        text = f" {random.choice(_PAX)}\n".encode()
        length = len(text) + 1
        while len(str(length)) + len(text) != length:
            length += 1
        if random.random() < 0.15:
            length = random.choice((0, 5, length + 9, 10**9))
        lines += str(length).encode() + text
    block = bytearray(512)
    block[:7] = b"PaxHead"
    block[100:108] = b"0000644\0"
    block[124:136] = f"{len(lines):011o}\0".encode()
    block[156:157] = random.choice((b"x", b"x", b"x", b"g"))
    block[257:265] = b"ustar\x0000"
    return _summed(block) + lines + bytes(-len(lines) % 512)


def sevenzip(data: bytes, random: Random, other: bytes) -> bytes:
    """A byte of a 7z archive's headers, with both checksums mended."""
    if not data.startswith(b"7z\xbc\xaf") or len(data) < 32:
        return data
    offset, size = struct.unpack_from("<QQ", data, 12)
    start = 32 + offset
    if random.random() < 0.2:
        head = _put(data[12:32], random.choice((0, 8)), _edge(random, 8, "<"))[:20]
        return data[:8] + struct.pack("<I", zlib.crc32(head)) + head + data[32:]
    if not start + size <= len(data) or not size:
        return data
    block = data[start : start + size]
    for _ in range(random.choice((1, 1, 2, 4))):
        block = _put(block, random.randrange(len(block)), _edge(random, 1, "<"))
    head = data[12:28] + struct.pack("<I", zlib.crc32(block))
    return data[:8] + struct.pack("<I", zlib.crc32(head)) + head + data[32:start] + block + data[start + size :]
