"""Changes that know nothing of a format: what a disk, a cable or an unfinished copy does to a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    Change = Callable[[bytes, Random, bytes], bytes]

# Where signs, sizes and counts tip over.
EDGES = (0, 1, 2, 3, 7, 127, 128, 255, 256, 4096, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
PAGE = 4096


def part(size: int, random: Random, longest: int = 1 << 16) -> tuple[int, int]:
    """A part of a file of this size, seldom a long one, as start and stop."""
    start = random.randrange(size) if size else 0
    return start, min(size, start + min(longest, 1 << random.randrange(17)))


def flipped(data: bytes, random: Random, other: bytes) -> bytes:
    """Some bits flipped, mostly one."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 8, 64))):
        if changed:
            changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def overwritten(data: bytes, random: Random, other: bytes) -> bytes:
    """Some bytes replaced by random ones."""
    start, stop = part(len(data), random, 64)
    return data[:start] + random.randbytes(stop - start) + data[stop:]


def number(data: bytes, random: Random, other: bytes) -> bytes:
    """A number of 1, 2, 4 or 8 bytes, in either byte order, replaced by one at an edge."""
    width = random.choice((1, 2, 4, 8))
    at = random.randrange(max(1, len(data) - width + 1))
    value = random.choice((random.choice(EDGES), random.choice(EDGES), random.getrandbits(8 * width), len(data)))
    new = (value % (1 << 8 * width)).to_bytes(width, random.choice(("little", "big")))
    return data[:at] + new + data[at + width :]


def head_number(data: bytes, random: Random, other: bytes) -> bytes:
    """The same, in the first 512 bytes, where headers are."""
    return number(data[:512], random, other) + data[512:]


def zeroed(data: bytes, random: Random, other: bytes) -> bytes:
    """A run of zeros."""
    start, stop = part(len(data), random)
    return data[:start] + bytes(stop - start) + data[stop:]


def truncated(data: bytes, random: Random, other: bytes) -> bytes:
    """Cut short, as often close to either end as anywhere."""
    near = min(len(data), 1 << random.randrange(1, 12))
    return data[: random.choice((random.randrange(len(data) + 1), near, len(data) - near))]


def grown(data: bytes, random: Random, other: bytes) -> bytes:
    """Something appended or put in between."""
    at = random.choice((len(data), random.randrange(len(data) + 1)))
    count = 1 << random.randrange(13)
    return data[:at] + random.choice((random.randbytes(count), bytes(count), data[:count])) + data[at:]


def removed(data: bytes, random: Random, other: bytes) -> bytes:
    """A part left out."""
    start, stop = part(len(data), random)
    return data[:start] + data[stop:]


def moved(data: bytes, random: Random, other: bytes) -> bytes:
    """A part copied over another place of the file."""
    start, stop = part(len(data), random)
    at = random.randrange(len(data) + 1)
    return data[:at] + data[start:stop] + data[at + (stop - start) :]


def spliced(data: bytes, random: Random, other: bytes) -> bytes:
    """The start of one file and the end of another, or a part of another in its place."""
    at = random.randrange(len(data) + 1)
    if random.random() < 0.5:
        return data[:at] + other[min(at, len(other)) :]
    start, stop = part(len(other), random)
    return data[:at] + other[start:stop] + data[at + (stop - start) :]


CHANGES: tuple[Change, ...] = (
    *(flipped, overwritten, number, head_number, zeroed, truncated, grown, removed, moved, spliced),
)


def hole(data: bytes, random: Random, start: int, stop: int) -> bytes:
    """At least a page of zeros inside ``start`` to ``stop``: what a preallocated download or a lost page leaves."""
    room = stop - start - PAGE
    length = PAGE + (random.randrange(room + 1) if random.random() < 0.5 else 0)
    at = start + random.randrange(stop - start - length + 1)
    aligned = -(-at // PAGE) * PAGE
    if random.random() < 0.5 and aligned + length <= stop:
        at = aligned
    return data[:at] + bytes(length) + data[at + length :]


def tail(data: bytes, random: Random, start: int, stop: int) -> bytes:
    """Zeros from somewhere inside ``start`` to ``stop``, at least a page before that end, to the end of the file."""
    at = start + random.randrange(stop - start - PAGE + 1)
    return data[:at] + bytes(len(data) - at)
