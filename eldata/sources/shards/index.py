"""What a folder of shards holds: the index, and the facts beside each sample's pixels.

::

    index.json              format, version, written_by, dataset, tile, overlap, seed, levels; of each shard its
                            name, bytes, sha256, and of each of its samples [bytes, crc32]; written last: without it
                            there is nothing
    shard-000000.tar        samples one after the other, three members each, named as WebDataset names them:
      000000042.json          the record, the exposure ratio, both sensors and exposures, the place in the frame; with
                              sensor_more where a sensor states fractions, or a light that is not D65
      000000042.input.npy     (H, W) uint16, the noisy mosaic in DN
      000000042.target.npy    (H, W) uint16, the reference's

The key is the number of the sample in the order of frames and places, whatever shard it came into. Sizes and checksums
in the index let a reader begin at any sample, and know that what it got is what was written.
"""

from __future__ import annotations

import json
import re
import struct
import tarfile
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.fields import TextFile
from eldata.errors import ArgumentError, FileError
from eldata.raw.cfa import packed_shape
from eldata.raw.levels import FRAME_LEVELS, FrameLevels
from eldata.records import PairRecord
from eldata.sources.store.format import exact, exposure_data, exposure_of, more_of_sensor, sensor_data, sensor_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.records import Exposure, Sensor


FORMAT = "eldata-shards"
VERSION = 1
INDEX = "index.json"
KEY_DIGITS = 9
_MOST_SAMPLE_BYTES = 1 << 30  # two frames of 250 megapixels

_SHARD_NAME = re.compile(r"shard-\d{6}\.tar", re.ASCII)


class ShardError(FileError):
    """A shard or the index of shards cannot be used."""


@dataclass(frozen=True, slots=True, eq=False)
class Shard:
    """One tar file: its name, size and ``sha256:<hex>``; of each sample its bytes (int64) and CRC-32 (uint32)."""

    name: str
    bytes: int
    sha256: str
    sample_bytes: NDArray[np.int64]
    crc32: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.sample_bytes)

    @property
    def starts(self) -> NDArray[np.int64]:
        """Where each sample starts, and where the last one ends."""
        return np.concatenate([[0], np.cumsum(self.sample_bytes)])


@dataclass(frozen=True, slots=True, eq=False)
class ShardIndex:
    """What the shards of a folder hold, in their order.

    ``tile`` is the side of the samples in packed pixels, ``None`` where they are whole frames; ``overlap`` that of
    neighbours. ``levels``: those that frames are normalised with unless others are asked for.
    """

    dataset: str
    tile: int | None
    overlap: int
    seed: int
    shards: tuple[Shard, ...]
    levels: FrameLevels = "metadata"

    def __len__(self) -> int:
        return sum(map(len, self.shards))


@dataclass(frozen=True, slots=True)
class Side:
    """One frame of a sample: sensor and exposure as its file states them; size and CFA are those of the sample."""

    sensor: Sensor
    exposure: Exposure


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of a sample without its pixels.

    ``ratio`` is the files' exposure ratio, ``top`` and ``left`` the place in the mosaic.
    """

    record: PairRecord
    ratio: Fraction
    top: int
    left: int
    input: Side
    target: Side


# --- the index ----------------------------------------------------------------------------------------------------


def index_text(index: ShardIndex, written_by: str) -> str:
    """Return the index as JSON, one line per shard."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "written_by": written_by,
        "dataset": index.dataset,
        "tile": index.tile,
        "overlap": index.overlap,
        "seed": index.seed,
        "levels": index.levels,
        "samples": len(index),
    }
    shards = [
        {
            "name": shard.name,
            "bytes": shard.bytes,
            "sha256": shard.sha256,
            "samples": [list(pair) for pair in zip(shard.sample_bytes.tolist(), shard.crc32.tolist(), strict=True)],
        }
        for shard in index.shards
    ]
    lines = ",\n".join(json.dumps(shard, separators=(",", ":")) for shard in shards)
    return json.dumps(head, ensure_ascii=False, indent=1).removesuffix("\n}") + f',\n "shards": [\n{lines}\n]}}\n'


def parse_index(place: str, content: bytes) -> ShardIndex:
    """Return the index that a file holds.

    Raises
    ------
    ShardError
        If it is not one of shards that :func:`index_text` made, or of a newer version.
    """
    data = TextFile(place, ShardError, "expected a whole index, as eldata shard writes it", content).json().data
    if data.get("format") != FORMAT:
        raise ShardError(place, "is not an index of eldata's shards; eldata shard writes them")
    version = data.get("version")
    if not isinstance(version, int) or version > VERSION:
        raise ShardError(
            place,
            f"is of version {version}, written by {data.get('written_by')}; this eldata reads up to version {VERSION}: "
            "install a newer one",
        )
    try:
        shards = tuple(map(_shard, data["shards"]))
        tile = data["tile"] if data["tile"] is None else int(data["tile"])
        overlap, seed = int(data["overlap"]), int(data["seed"])
        index = ShardIndex(str(data["dataset"]), tile, overlap, seed, shards, _levels(data))
        listed = int(data["samples"])
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise ShardError(place, f"is damaged ({error}); copy it again") from error
    if len(index) != listed or not listed:
        raise ShardError(place, f"is damaged: expected {listed} samples, found {len(index)}; copy it again")
    return index


def _levels(data: Mapping[str, Any]) -> FrameLevels:
    found = data["levels"]
    if found not in FRAME_LEVELS:
        raise ValueError(f"levels {found!r}")
    return found  # type: ignore[no-any-return] # one of them


def _shard(data: Mapping[str, Any]) -> Shard:
    name = data["name"]
    if not isinstance(name, str) or not _SHARD_NAME.fullmatch(name):
        raise ValueError(f"shard name {name!r}")  # or it could lead anywhere
    pairs = np.array(data["samples"], dtype=np.int64).reshape(-1, 2)
    shard = Shard(name, int(data["bytes"]), str(data["sha256"]), pairs[:, 0], pairs[:, 1].astype(np.uint32))
    if (pairs < 0).any() or (pairs[:, 1] >= 1 << 32).any() or not 0 <= pairs[:, 0].sum() <= shard.bytes:
        raise ValueError(f"sizes of {name}")
    if pairs[:, 0].max(initial=0) > _MOST_SAMPLE_BYTES:
        raise ValueError(f"a sample of {pairs[:, 0].max()} bytes in {name}")
    return shard


# --- the facts of a sample ----------------------------------------------------------------------------------------


def facts_text(facts: Facts) -> str:
    """Return a sample's facts as JSON; fractions as text, so that they stay exact."""
    fields = asdict(facts.record).items()
    record = {name: str(value) if isinstance(value, Fraction) else value for name, value in fields}
    shift = record.pop("measured_shift_px")
    record |= {} if shift is None else {"measured_shift_px": list(map(str, shift))}
    sides = {name: _side_data(side) for name, side in (("input", facts.input), ("target", facts.target))}
    data = {"record": record, "ratio": str(facts.ratio), "top": facts.top, "left": facts.left, **sides}
    return json.dumps(data, ensure_ascii=False, sort_keys=True)


def parse_facts(content: bytes) -> Facts:
    """Return a sample's facts: the inverse of :func:`facts_text`.

    Raises
    ------
    ValueError, LookupError, TypeError, ArithmeticError
        If they are not what :func:`facts_text` makes.
    """
    data = TextFile("the facts", ArgumentError, content=content).json().data
    record = data["record"]
    iso, exposure_s = (exact(record[name]) for name in ("iso", "exposure_s"))
    texts = {name: record[name] for name in ("path", "reference", "camera", "scene", "split")}
    if not all(isinstance(text, str) for text in [*texts.values(), *record["flags"]]):
        raise TypeError("a text field of the record is not text")
    nominal, ratio = exact(record["ratio"]), exact(data["ratio"])
    if not nominal or not ratio:
        raise ValueError("there is no ratio")
    measured, flags = exact(record["measured_ratio"]), tuple(record["flags"])
    pair = PairRecord(**texts, iso=iso, exposure_s=exposure_s, ratio=nominal, flags=flags, measured_ratio=measured)
    if "measured_shift_px" in record:
        down, right = map(Fraction, record["measured_shift_px"])
        pair = replace(pair, measured_shift_px=(down, right))
    sides = {name: _side(data[name]) for name in ("input", "target")}
    return Facts(pair, ratio, int(data["top"]), int(data["left"]), **sides)


def _side_data(side: Side) -> dict[str, Any]:
    more = more_of_sensor(side.sensor)
    data = {"sensor": sensor_data(side.sensor), "exposure": exposure_data(side.exposure)}
    return data | {"sensor_more": more} if more else data


def _side(data: Mapping[str, Any]) -> Side:
    sensor = sensor_of(data["sensor"], data.get("sensor_more", {}))
    if not np.isfinite(np.array([*sensor.black_level_dn, sensor.white_level_dn], dtype=np.float64)).all():
        raise ValueError("a level is not finite")
    return Side(sensor, exposure_of(data["exposure"]))


def key_of(number: int) -> str:
    """Return a sample's key: its number with leading zeros."""
    return f"{number:0{KEY_DIGITS}d}"


def member_names(key: str) -> Sequence[str]:
    """Return the names of a sample's members, in their order."""
    return f"{key}.json", f"{key}.input.npy", f"{key}.target.npy"


# --- one sample as bytes of a tar file, and back; nothing but plain files of the three known names comes back ---------

# Only tar's headers are taken from :mod:`tarfile`, whose reader follows links, and nothing from WebDataset, whose
# decoders run pickles: here a member that is not expected is an error, and no member is ever run.

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
