"""Changes to TIFF-based files (most raws, DNG, TIFF predictions): directories, tags, types, counts, offsets."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tests.fuzz.bytewise import EDGES

if TYPE_CHECKING:
    from random import Random

_SUB_DIRECTORIES = (330, 34665, 34853, 40965)
# Tags that a reader relies on: sizes, places, levels, colours, exposure.
_RELIED_ON = (
    *(254, 256, 257, 258, 259, 262, 271, 272, 273, 274, 277, 278, 279, 284, 322, 323),
    *(324, 325, 330, 513, 514, 33421, 33422, 33434, 33437, 34665, 34853, 34855, 34864, 34866, 36867, 37521),
    *(50706, 50708, 50711, 50712, 50713, 50714, 50715, 50716, 50717, 50718, 50719, 50720, 50721, 50722, 50728, 50778),
    *(50779, 50829, 50830, 51008, 51022, 51041),
)
_TYPES = (*range(14), 16, 17, 18, 255, 65535)


@dataclass(frozen=True)
class Entry:
    """Where one entry of a directory stands in the file."""

    at: int
    tag: int
    kind: int
    count: int


@dataclass(frozen=True)
class Layout:
    """Byte order, entries, places of pointers to next directories, and starts of directories."""

    order: str
    entries: tuple[Entry, ...]
    pointers: tuple[int, ...]
    directories: tuple[int, ...]


def layout(data: bytes, base: int = 0) -> Layout | None:
    """What stands where, as far as it can be followed; nothing if it is no TIFF."""
    head = data[base : base + 4]
    if head[:2] not in (b"II", b"MM") or len(data) < base + 8:
        return None
    order = "<" if head[:2] == b"II" else ">"
    waiting = [int(struct.unpack_from(order + "I", data, base + 4)[0])]
    entries: list[Entry] = []
    pointers = [base + 4]
    seen: list[int] = []
    while waiting and len(seen) < 16:
        offset = waiting.pop()
        at = base + offset
        if offset == 0 or at in seen or at + 2 > len(data):
            continue
        seen.append(at)
        count = struct.unpack_from(order + "H", data, at)[0]
        for number in range(count):
            place = at + 2 + 12 * number
            if place + 12 > len(data):
                break
            tag, kind, values, value = struct.unpack_from(order + "HHII", data, place)
            entries.append(Entry(place, tag, kind, values))
            if tag in _SUB_DIRECTORIES and values == 1:
                waiting.append(value)
            elif tag in _SUB_DIRECTORIES:
                waiting += [
                    int(struct.unpack_from(order + "I", data, base + value + 4 * index)[0])
                    for index in range(min(values, 8))
                    if base + value + 4 * index + 4 <= len(data)
                ]
        following = at + 2 + 12 * count
        if following + 4 <= len(data):
            pointers.append(following)
            waiting.append(struct.unpack_from(order + "I", data, following)[0])
    return Layout(order, tuple(entries), tuple(pointers), tuple(seen))


def field(data: bytes, random: Random, other: bytes) -> bytes:
    """One entry's tag, type, count, or value or offset."""
    found = layout(data)
    if found is None or not found.entries:
        return data
    changed = bytearray(data)
    likely = [entry for entry in found.entries if entry.tag in _RELIED_ON]
    entry = random.choice(likely if likely and random.random() < 0.8 else found.entries)
    wide = (random.choice(EDGES), random.choice(EDGES), len(data), entry.at, random.getrandbits(32))
    which = random.randrange(5)
    if which == 0:
        struct.pack_into(found.order + "H", changed, entry.at, random.choice(_RELIED_ON))
    elif which == 1:
        struct.pack_into(found.order + "H", changed, entry.at + 2, random.choice(_TYPES))
    elif which == 2:
        struct.pack_into(found.order + "I", changed, entry.at + 4, random.choice((*wide, 1021, 1021**2, 1 << 20)))
    else:
        struct.pack_into(found.order + "I", changed, entry.at + 8, random.choice(wide))
    return bytes(changed)


def values(data: bytes, random: Random, other: bytes) -> bytes:
    """The numbers that an entry points to: levels, matrices, fractions of zero, texts."""
    found = layout(data)
    if found is None:
        return data
    far = [entry for entry in found.entries if entry.count * (8 if entry.kind in (5, 10, 12) else 4) > 4]
    if not far:
        return data
    changed = bytearray(data)
    entry = random.choice(far)
    offset = struct.unpack_from(found.order + "I", data, entry.at + 8)[0]
    place = offset + 4 * random.randrange(max(1, min(entry.count, 16) * 2))
    if place + 4 <= len(data):
        struct.pack_into(found.order + "I", changed, place, random.choice((*EDGES, random.getrandbits(32))))
    return bytes(changed)


def text(data: bytes, random: Random, other: bytes) -> bytes:
    """Make, model or another text: escape sequences, bytes of no encoding, no end."""
    found = layout(data)
    texts = [] if found is None else [entry for entry in found.entries if entry.kind == 2 and entry.count > 4]
    if found is None or not texts:
        return data
    entry = random.choice(texts)
    offset = struct.unpack_from(found.order + "I", data, entry.at + 8)[0]
    hostile = random.choice(
        (b"\x1b[2J\x1b]0;x\x07", b"\xe2\x80\xae\xc2\x9b", b"\xff" * 16, b"\0" * 8, b"a\nb\rc", b"=1+1")
    )
    return data[:offset] + hostile[: entry.count] + data[offset + min(entry.count, len(hostile)) :]


def pointer(data: bytes, random: Random, other: bytes) -> bytes:
    """A pointer to a directory: into itself, into another, past the end, anywhere."""
    found = layout(data)
    if found is None:
        return data
    changed = bytearray(data)
    targets = (*found.directories, 0, 8, len(data) - 2, len(data), random.randrange(len(data)), 2**32 - 1)
    struct.pack_into(found.order + "I", changed, random.choice(found.pointers), random.choice(targets))
    return bytes(changed)


def exchanged(data: bytes, random: Random, other: bytes) -> bytes:
    """Two entries exchanged, or one in the place of another."""
    found = layout(data)
    if found is None or len(found.entries) < 2:
        return data
    one, two = random.sample(found.entries, 2)
    changed = bytearray(data)
    changed[one.at : one.at + 12] = data[two.at : two.at + 12]
    if random.random() < 0.5:
        changed[two.at : two.at + 12] = data[one.at : one.at + 12]
    return bytes(changed)


def crowded(data: bytes, random: Random, other: bytes) -> bytes:
    """A first directory of thousands of entries, which share one large value, or are directories themselves."""
    found = layout(data)
    if found is None or not found.entries:
        return data
    order = found.order
    count = random.choice((40, 300, 2000))
    large = random.choice((16, 4096, 1 << 16, 1 << 20))
    tags = random.choice(((50714,), _RELIED_ON, (330,), (273, 279)))
    value_at = len(data) + 2 + 12 * count + 4
    table = struct.pack(order + "H", count) + b"".join(
        struct.pack(order + "HHII", random.choice(tags), random.choice((1, 3, 4, 5)), large, value_at)
        for _ in range(count)
    )
    first = found.directories[0] if found.directories else 0
    changed = bytearray(data)
    struct.pack_into(order + "I", changed, 4, len(data))
    return bytes(changed) + table + struct.pack(order + "I", first) + bytes(min(8 * large, 1 << 20))


CHANGES = (field, field, field, values, values, text, pointer, exchanged)
