"""Checking all shards of a folder, wherever it is."""

from __future__ import annotations

import hashlib
from contextlib import closing
from typing import TYPE_CHECKING, Any

from eldata.errors import DatasetError
from eldata.sources.shards.index import ShardError
from eldata.sources.shards.members import END
from eldata.sources.shards.remote import Folder, Forward
from eldata.sources.shards.samples import checked_sample

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eldata.sources.shards.index import Shard


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
    starts = shard.starts.tolist()
    with closing(Forward(folder, shard.name)) as file:
        for number, size in enumerate(shard.sample_bytes.tolist()):
            content = file.read(size)
            digest.update(content)
            where = f"sample {number} (bytes {starts[number]} to {starts[number + 1]})"
            numbers.add(checked_sample(file.place, where, content, int(shard.crc32[number])).number)
        end = file.read_all()
        if end != END:
            raise ShardError(file.place, f"does not end after its {len(shard)} samples; copy it again")
        digest.update(end)
        if f"sha256:{digest.hexdigest()}" != shard.sha256:
            raise ShardError(file.place, f"expected {shard.sha256}, found sha256:{digest.hexdigest()}; copy it again")
    return numbers
