"""Samples of a shard, checked as they are read."""

from __future__ import annotations

import zlib
from contextlib import closing
from typing import TYPE_CHECKING

from eldata.sources.shards.index import ShardError, key_of
from eldata.sources.shards.members import MemberError, StoredSample, from_bytes
from eldata.sources.shards.remote import Forward

if TYPE_CHECKING:
    from collections.abc import Generator

    from eldata.sources.shards.index import ShardIndex
    from eldata.sources.shards.remote import Folder
    from eldata.sources.shards.splitting import Run


def read_run(folder: Folder, index: ShardIndex, run: Run) -> Generator[StoredSample]:
    """Yield neighbouring samples of a shard, one in memory at a time.

    Raises
    ------
    ShardError
        If the shard is missing, truncated or damaged, or holds anything but samples; the message says where.
    """
    shard = index.shards[run.shard]
    start = int(shard.starts[run.first])
    with closing(Forward(folder, shard.name, start)) as file:
        for number in range(run.first, run.last):
            size = int(shard.sample_bytes[number])
            where = f"sample {number} (bytes {start} to {start + size})"
            content = file.read(size)
            yield checked_sample(file.place, where, content, int(shard.crc32[number]))
            start += size


def checked_sample(place: str, where: str, content: bytes, crc32: int) -> StoredSample:
    """Return the sample that bytes of a shard are, if their checksum is that of the index.

    Raises
    ------
    ShardError
        If it is not, or they are no sample.
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
