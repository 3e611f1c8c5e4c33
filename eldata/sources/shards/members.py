"""One sample as bytes of a tar file, and back; nothing but plain files of the three known names comes back.

Only tar's headers are taken from :mod:`tarfile`, whose reader follows links, and nothing from WebDataset, whose
decoders run pickles: here a member that is not expected is an error, and no member is ever run.
"""

from __future__ import annotations

import re
import struct
import tarfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.raw.cfa import packed_shape
from eldata.sources.shards.index import KEY_DIGITS, Facts, facts_text, member_names, parse_facts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from eldata.records import Sensor

BLOCK = tarfile.BLOCKSIZE
# Two blocks of zeros end an archive; no padding to a "record" of 10 KiB, which is for tapes.
END = bytes(2 * BLOCK)

_KEY = re.compile(rf"(\d{{{KEY_DIGITS}}})\.json", re.ASCII)
_PIXELS = np.dtype("<u2")


class MemberError(ValueError):
    """A sample's bytes are not what was written."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredSample:
    """One sample of a shard: its number, facts, and both mosaics (H, W) uint16 in DN, views of the bytes read."""

    number: int
    facts: Facts
    input_dn: NDArray[np.uint16]
    target_dn: NDArray[np.uint16]


def to_bytes(key: str, facts: Facts, input_dn: NDArray[np.uint16], target_dn: NDArray[np.uint16]) -> bytes:
    """Return a sample's part of a tar file: the same bytes for the same sample, whoever writes it and when."""
    contents = facts_text(facts).encode(), _npy(input_dn), _npy(target_dn)
    return b"".join(
        part
        for name, content in zip(member_names(key), contents, strict=True)
        for part in (_header(name, len(content)), content, bytes(-len(content) % BLOCK))
    )


def from_bytes(content: bytes) -> StoredSample:
    """Return the sample that a part of a tar file is.

    Raises
    ------
    MemberError
        If it is anything else; the message names the member.
    """
    members = list(_members(content))
    if len(members) != 3:
        raise MemberError(f"a sample has 3 members; found {len(members)}")
    found = _KEY.fullmatch(members[0][0])
    expected = member_names(found[1]) if found else member_names("KEY")
    for (name, _), wanted in zip(members, expected, strict=True):
        if name != wanted:
            raise MemberError(f"member {name!r} does not belong in a shard: expected {wanted}")
    try:
        facts = parse_facts(bytes(members[0][1]))
        _check_sides(facts)
    except (ValueError, LookupError, TypeError, ArithmeticError, AttributeError, RecursionError) as error:
        raise MemberError(f"member {members[0][0]} does not hold a sample's facts ({error})") from error
    sensors = facts.input.sensor, facts.target.sensor
    mosaics = [_mosaic(name, body, sensor) for (name, body), sensor in zip(members[1:], sensors, strict=True)]
    return StoredSample(int(members[0][0].partition(".")[0]), facts, mosaics[0], mosaics[1])


def _header(name: str, size: int) -> bytes:
    info = tarfile.TarInfo(name)  # no time, no owner
    info.size = size
    return info.tobuf(tarfile.USTAR_FORMAT)


def _members(content: bytes) -> Iterator[tuple[str, memoryview]]:
    view = memoryview(content)
    at = 0
    while at < len(view):
        try:
            info = tarfile.TarInfo.frombuf(bytes(view[at : at + BLOCK]), "utf-8", "surrogateescape")
        except tarfile.HeaderError as error:
            raise MemberError(f"byte {at} of the sample is not a tar header ({error})") from error
        if info.type not in (tarfile.REGTYPE, tarfile.AREGTYPE):
            raise MemberError(f"member {info.name!r} is a link, folder or device; a shard holds plain files only")
        end = at + BLOCK + info.size
        if info.size < 0 or end > len(view):
            raise MemberError(f"member {info.name!r} says that it has {info.size} bytes, more than its sample")
        yield info.name, view[at + BLOCK : end]
        at = end + -info.size % BLOCK


def _npy_header(shape: tuple[int, ...]) -> bytes:
    """Return how a .npy file (version 1.0) of uint16 begins; the pixels start at a multiple of 64 bytes."""
    text = f"{{'descr': '<u2', 'fortran_order': False, 'shape': {shape}, }}"
    padded = text + " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded.encode()


def _npy(mosaic: NDArray[np.uint16]) -> bytes:
    return _npy_header(mosaic.shape) + np.ascontiguousarray(mosaic, dtype=_PIXELS).tobytes()


def _mosaic(name: str, body: memoryview, sensor: Sensor) -> NDArray[np.uint16]:
    """Return the array of a .npy file as a view of its bytes.

    Its beginning is compared, not parsed: an array of another kind, such as one of objects, which is a pickle, is not
    even looked at.
    """
    shape = sensor.height, sensor.width
    header = _npy_header(shape)
    if body[: len(header)] != header or len(body) != len(header) + shape[0] * shape[1] * _PIXELS.itemsize:
        raise MemberError(f"member {name}: expected {shape} pixels of uint16 in the .npy format, found something else")
    return np.frombuffer(body, _PIXELS, offset=len(header)).reshape(shape).astype(np.uint16, copy=False)


def _check_sides(facts: Facts) -> None:
    first, second = facts.input.sensor, facts.target.sensor
    shape = first.height, first.width
    if shape != (second.height, second.width) or first.cfa != second.cfa:
        raise ValueError("input and target differ in size or CFA")
    if not all(isinstance(side, int) for side in shape) or min(packed_shape(shape, first.cfa)) < 1:
        raise ValueError(f"size {shape}")
    channels = 1 + max(max(row) for row in first.cfa)
    if any(len(sensor.black_level_dn) != channels for sensor in (first, second)):
        raise ValueError(f"expected {channels} black levels")
