"""Reading the samples of shards, each checked as it is read, and checking all of a folder, wherever it is."""

from __future__ import annotations

import hashlib
import zlib
from contextlib import closing
from typing import TYPE_CHECKING, Any

from eldata.errors import DatasetError
from eldata.sources.shards.index import ShardError, key_of
from eldata.sources.shards.members import END, MemberError, StoredSample, from_bytes
from eldata.sources.shards.remote import Folder, Forward

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping, Sequence

    from eldata.sources.shards.index import Shard, ShardIndex


def read_samples(
    folder: Folder, index: ShardIndex, shard_number: int, numbers: Sequence[int]
) -> Generator[StoredSample]:
    """Yield samples of a shard by their rising places in it, one in memory at a time; those between are passed over.

    Raises
    ------
    ShardError
        If the shard is missing, truncated or damaged, or holds anything but samples; the message says where.
    """
    shard = index.shards[shard_number]
    with closing(Forward(folder, shard.name)) as file:
        for _, sample in _each(file, shard, numbers):
            yield sample


def _each(file: Forward, shard: Shard, numbers: Sequence[int]) -> Iterator[tuple[bytes, StoredSample]]:
    """Yield samples of an open shard, and the bytes that they are."""
    starts = shard.starts.tolist()
    for number in numbers:
        file.go_to(starts[number])
        where = f"sample {number} (bytes {starts[number]} to {starts[number + 1]})"
        content = file.read(int(shard.sample_bytes[number]))
        yield content, _checked_sample(file.place, where, content, int(shard.crc32[number]))


def _checked_sample(place: str, where: str, content: bytes, crc32: int) -> StoredSample:
    """Return the sample that bytes of a shard are, if their checksum is that of the index.

    Raises
    ------
    ShardError
        If it is not, or they are not a sample.
    """
    if zlib.crc32(content) != crc32:
        # What it holds instead often says more than that it differs.
        problem = "its checksum is not that of the index"
        try:
            problem = f"{problem}, although it reads as sample {key_of(from_bytes(content).number)}"
        except MemberError as error:
            problem = f"{problem}: {error}"
        raise ShardError(place, f"{where} is damaged or of other shards: {problem}; copy it again")
    try:
        return from_bytes(content)
    except MemberError as error:
        raise ShardError(place, f"{where} is not a sample: {error}") from error


def verify_shards(address: str, *, storage_options: Mapping[str, Any] | None = None) -> list[str]:
    """Read all shards and return what is wrong with them, one line per shard; nothing if all is well.

    Raises
    ------
    ShardError
        If there is no index, or none that can be read.
    ArgumentError
        If fsspec cannot open the address.
    """
    folder = Folder(str(address), storage_options or {})
    index = folder.read_index()
    problems = []
    numbers: set[int] = set()
    for shard in index.shards:
        try:
            numbers |= _checked(folder, shard)
        except (ShardError, DatasetError) as error:
            problems.append(str(error))
    if not problems and numbers != set(range(len(index))):
        problems.append(f"{folder.address}: its {len(index)} samples are not numbered from 0, each once")
    return problems


def _checked(folder: Folder, shard: Shard) -> set[int]:
    """Return the numbers of a shard's samples."""
    digest = hashlib.sha256()
    numbers = set()
    with closing(Forward(folder, shard.name)) as file:
        for content, sample in _each(file, shard, range(len(shard))):
            digest.update(content)
            numbers.add(sample.number)
        end = file.read_rest(len(END))
        if end != END:
            raise ShardError(file.place, f"does not end after its {len(shard)} samples; copy it again")
        digest.update(end)
        if f"sha256:{digest.hexdigest()}" != shard.sha256:
            raise ShardError(file.place, f"expected {shard.sha256}, found sha256:{digest.hexdigest()}; copy it again")
    return numbers
