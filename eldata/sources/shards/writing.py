"""Writing shards from a store: the same bytes whenever it is done, each shard whole or not there."""

from __future__ import annotations

import hashlib
import json
import re
import zlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from eldata.base.fields import TextFile
from eldata.base.files import atomic_write, write_text
from eldata.datasets.packed_store import PackedStore
from eldata.datasets.stored_clean import stored_mosaic
from eldata.errors import ArgumentError, EldataError
from eldata.raw.reading import exposure_ratio
from eldata.sources.shards.layout import FORMAT, INDEX, VERSION, Facts, Shard, ShardIndex, Side, index_text, key_of
from eldata.sources.shards.members import END, to_bytes
from eldata.sources.shards.tiles import grid, whole
from eldata.sources.store.read import PixelReader, open_store

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from eldata.records import PairRecord
    from eldata.sources.shards.tiles import Tile
    from eldata.sources.store.layout import StoredFrame

# What was begun, so that only the same work goes on in the folder; gone when the index is there.
BEGUN = ".begun.json"
_LEFT_OVER = re.compile(r"\.(shard-\d{6}\.tar|index\.json|\.begun\.json)\.[0-9a-f]{16}\.part")
_MOST_SHARDS = 10**6


@dataclass(frozen=True, slots=True)
class ShardReport:
    """What was written: samples and shards in all, ``resumed`` shards of them before; bytes of the shards."""

    folder: Path
    samples: int
    shards: int
    resumed: int
    bytes: int


@dataclass(frozen=True, slots=True)
class _Planned:
    """One sample to write."""

    number: int
    record: PairRecord
    noisy: StoredFrame
    reference: StoredFrame
    tile: Tile


def write_shards(
    store: Path | str,
    folder: Path | str,
    *,
    tile: int | None = 512,
    overlap: int = 0,
    samples_per_shard: int = 64,
    seed: int = 0,
    cameras: Collection[str] | None = None,
    splits: Collection[str] | None = None,
    subset: str | None = None,
    exclude_flags: Collection[str] = (),
) -> ShardReport:
    """Write a store's pairs as shards.

    The samples are shuffled over all shards here, once, so that a reader's buffer need not be large. Whatever ends the
    work (an error, a full disk, Ctrl-C, kill -9) leaves whole shards, and the same call goes on; the index comes last.

    Parameters
    ----------
    store
        A store of pairs, from ``eldata pack``.
    folder
        A local folder, new or empty, or one in which the same work was begun.
    tile, overlap
        Side of the samples and what neighbours share, in packed pixels (:func:`eldata.sources.shards.tiles.grid`); tile
        ``None`` writes whole frames.
    samples_per_shard
        The last shard has the rest.
    seed
        Of the order.
    cameras, splits, subset, exclude_flags
        Which of the store's pairs, as in :class:`~eldata.datasets.packed_store.PackedStore`.

    Raises
    ------
    StoreError
        If the store cannot be read.
    DatasetError
        If it holds no pairs, or a frame is smaller than a tile.
    ArgumentError
        If an argument is out of its range, or the folder was begun with others.
    EldataError
        If the folder holds finished shards or other files, or cannot be written.
    """
    if samples_per_shard < 1 or seed < 0:
        raise ArgumentError(
            f"samples_per_shard must be 1 or more and seed 0 or more; found {samples_per_shard}, {seed}"
        )
    folder = Path(folder)
    pairs = PackedStore(
        store, crop=None, augment=False, cameras=cameras, splits=splits, subset=subset, exclude_flags=exclude_flags
    )
    planned = list(_planned(pairs, tile, overlap))
    order = np.random.default_rng(np.random.SeedSequence(seed)).permutation(len(planned)).tolist()
    parts = [order[start : start + samples_per_shard] for start in range(0, len(order), samples_per_shard)]
    if len(parts) > _MOST_SHARDS:
        raise ArgumentError(f"{len(parts)} shards are more than {_MOST_SHARDS}; take more samples per shard")
    options = {"tile": tile, "overlap": overlap, "samples_per_shard": samples_per_shard, "seed": seed}
    _begin(folder, options | {"samples": _digest(planned)})
    reader = PixelReader(Path(store))
    shards, resumed = [], 0
    with tqdm(total=len(planned), desc="writing shards", unit="sample", disable=None, leave=False) as bar:
        for number, part in enumerate(parts):
            path = folder / f"shard-{number:06d}.tar"
            samples = partial(_contents, reader, pairs.root, [planned[place] for place in part])
            shard = _found(path, samples()) if path.exists() else None
            resumed += shard is not None
            shards.append(shard or _written(path, samples()))
            bar.update(len(part))
    index = ShardIndex(pairs.name, tile, overlap, seed, tuple(shards))
    write_text(folder / INDEX, index_text(index, _version()))
    (folder / BEGUN).unlink()
    return ShardReport(folder, len(index), len(shards), resumed, sum(shard.bytes for shard in shards))


def _planned(pairs: PackedStore, tile: int | None, overlap: int) -> Iterator[_Planned]:
    """Yield the samples in the order of pairs and places, which numbers them."""
    frames = {frame.path: frame for frame in open_store(pairs.root).frames}
    number = 0
    for record in pairs.records:
        noisy, reference = frames[record.path], frames[record.reference]
        name = str(pairs.root / record.path)
        for place in whole(noisy.sensor) if tile is None else grid(name, noisy.sensor, tile, overlap):
            yield _Planned(number, record, noisy, reference, place)
            number += 1


def _digest(planned: Sequence[_Planned]) -> str:
    """Return a digest of what decides the samples' bytes."""
    found = hashlib.sha256()
    for sample in planned:
        noisy, reference = sample.noisy, sample.reference
        sides = [(f.sha256, repr(f.sensor), repr(f.exposure)) for f in (noisy, reference)]
        found.update(repr((sample.number, sample.record, sample.tile, sides)).encode())
    return f"sha256:{found.hexdigest()}"


def _begin(folder: Path, options: dict[str, Any]) -> None:
    """Make the folder, or make sure that the same work was begun in it; remove what a killed writer left."""
    wanted = {"format": FORMAT, "version": VERSION, "written_by": _version(), **options}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = sorted(path.name for path in folder.iterdir())
        for name in there:
            if _LEFT_OVER.fullmatch(name):
                (folder / name).unlink()
        there = [name for name in there if not _LEFT_OVER.fullmatch(name)]
    except OSError as error:
        raise EldataError(f"cannot write into {folder}: {error.strerror or error}") from error
    begun = TextFile(folder / BEGUN, EldataError, "remove the folder to start anew").json() if BEGUN in there else None
    if INDEX in there:
        raise EldataError(f"{folder}: holds finished shards already; remove it, or name another folder")
    if begun is None:
        if there:
            raise EldataError(f"{folder}: holds other files, such as {there[0]}; name a new folder")
        write_text(folder / BEGUN, json.dumps(wanted, indent=1) + "\n")
        return
    for name, value in wanted.items():
        if begun.data.get(name) != value:
            found = begun.data.get(name)
            raise ArgumentError(
                f"{folder}: was begun with another {name.replace('_', ' ')}: expected {value}, found {found}; give the "
                "same store and options as then, or remove the folder to start anew"
            )


def _contents(reader: PixelReader, root: Path, samples: Sequence[_Planned]) -> Iterator[bytes]:
    return (_content(reader, root, sample) for sample in samples)


def _content(reader: PixelReader, root: Path, sample: _Planned) -> bytes:
    headers = [frame.header(root) for frame in (sample.reference, sample.noisy)]
    frames = sample.noisy, sample.reference
    sides = [Side(sample.tile.sensor(frame.sensor), frame.exposure) for frame in frames]
    facts = Facts(sample.record, exposure_ratio(*headers), sample.tile.top, sample.tile.left, *sides)
    mosaics = [stored_mosaic(reader, frame)[sample.tile.slices] for frame in frames]
    return to_bytes(key_of(sample.number), facts, mosaics[0], mosaics[1])


class _Tally:
    """Sizes and checksums of the samples of a shard as they pass by."""

    def __init__(self) -> None:
        self._sizes: list[int] = []
        self._crc32: list[int] = []
        self._sha256 = hashlib.sha256()

    def add(self, content: bytes) -> None:
        self._sizes.append(len(content))
        self._crc32.append(zlib.crc32(content))
        self._sha256.update(content)

    def shard(self, name: str) -> Shard:
        self._sha256.update(END)
        sizes, sums = np.array(self._sizes, dtype=np.int64), np.array(self._crc32, dtype=np.uint32)
        return Shard(name, sum(self._sizes) + len(END), f"sha256:{self._sha256.hexdigest()}", sizes, sums)


def _written(path: Path, samples: Iterator[bytes]) -> Shard:
    """Write a shard, one sample in memory at a time."""
    tally = _Tally()
    with atomic_write(path) as file:
        for content in samples:
            file.write(content)
            tally.add(content)
        file.write(END)
    return tally.shard(path.name)


def _found(path: Path, samples: Iterator[bytes]) -> Shard | None:
    """Return a shard that was written before, if it holds these samples, byte by byte."""
    tally = _Tally()
    try:
        with path.open("rb") as file:
            for content in samples:
                if file.read(len(content)) != content:
                    return None
                tally.add(content)
            return tally.shard(path.name) if file.read() == END else None
    except OSError as error:
        raise EldataError(f"cannot read {path}: {error.strerror or error}") from error


def _version() -> str:
    from eldata import __version__

    return f"eldata {__version__}"
