"""Writing shards from a store: the same bytes whenever it is done, each shard whole or not there."""

from __future__ import annotations

import hashlib
import re
import zlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from tqdm import tqdm

from eldata.base.fields import TextFile
from eldata.base.files import atomic_write, write_json, write_text
from eldata.base.keywords import keywords
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.manifest.pairs import RENAMED, Choice
from eldata.sources.pairs import checked_ratio
from eldata.sources.shards.index import FORMAT, INDEX, VERSION, Facts, Shard, ShardIndex, Side, index_text, key_of
from eldata.sources.shards.members import END, to_bytes
from eldata.sources.shards.tiles import grid, whole
from eldata.sources.store.read import StoreFrames

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from fractions import Fraction

    from eldata.records import PairRecord, Sensor
    from eldata.sources.frames import Frame
    from eldata.sources.shards.tiles import Tile

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
    ratio: Fraction
    sides: tuple[Frame, Frame]
    sha256: tuple[str, str]
    tile: Tile

    @property
    def sensors(self) -> list[Sensor]:
        """Of the noisy frame and its reference."""
        return [frame.sensor for frame in self.sides if frame.sensor is not None]


def write_shards(
    store: Path | str,
    folder: Path | str,
    *,
    tile: int | None = 512,
    overlap: int = 0,
    samples_per_shard: int = 64,
    seed: int = 0,
    **choice: Unpack[Choice],
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
    choice
        Which of the store's pairs.

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
    (chosen,) = keywords("write_shards", choice, Choice, renamed=RENAMED)
    source = StoreFrames(store)
    planned = list(_planned(source, source.pairs(chosen), tile, overlap))
    order = np.random.default_rng(np.random.SeedSequence(seed)).permutation(len(planned)).tolist()
    parts = [order[start : start + samples_per_shard] for start in range(0, len(order), samples_per_shard)]
    if len(parts) > _MOST_SHARDS:
        raise ArgumentError(f"{len(parts)} shards are more than {_MOST_SHARDS}; take more samples per shard")
    options = {"tile": tile, "overlap": overlap, "samples_per_shard": samples_per_shard, "seed": seed}
    _begin(folder, options | {"samples": _digest(planned)})
    shards, resumed = [], 0
    with tqdm(total=len(planned), desc="writing shards", unit="sample", disable=None, leave=False) as bar:
        for number, part in enumerate(parts):
            path = folder / f"shard-{number:06d}.tar"
            samples = partial(_contents, [planned[place] for place in part])
            shard = _found(path, samples()) if path.exists() else None
            resumed += shard is not None
            shards.append(shard or _written(path, samples()))
            bar.update(len(part))
    index = ShardIndex(source.store.dataset, tile, overlap, seed, tuple(shards))
    write_text(folder / INDEX, index_text(index, _version()))
    (folder / BEGUN).unlink()
    return ShardReport(folder, len(index), len(shards), resumed, sum(shard.bytes for shard in shards))


def _planned(source: StoreFrames, pairs: Sequence[PairRecord], tile: int | None, overlap: int) -> Iterator[_Planned]:
    """Yield the samples in the order of pairs and places, which numbers them."""
    digests = {frame.path: frame.sha256 for frame in source.store.frames}
    number = 0
    for record in pairs:
        noisy, reference = source.frame(record.path), source.frame(record.reference)
        ratio = checked_ratio(record, reference, noisy)
        sums = digests[record.path], digests[record.reference]
        sensor = noisy.sensor
        if sensor is None:
            raise DatasetError(f"{noisy.name}: is not a raw file; shards hold mosaics in DN")
        for place in whole(sensor) if tile is None else grid(noisy.name, sensor, tile, overlap):
            yield _Planned(number, record, ratio, (noisy, reference), sums, place)
            number += 1


def _digest(planned: Sequence[_Planned]) -> str:
    """Return a digest of what decides the samples' bytes."""
    found = hashlib.sha256()
    for sample in planned:
        sides = [
            (digest, repr(sensor), repr(frame.exposure))
            for digest, sensor, frame in zip(sample.sha256, sample.sensors, sample.sides, strict=True)
        ]
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
        write_json(folder / BEGUN, wanted, indent=1)
        return
    for name, value in wanted.items():
        if begun.data.get(name) != value:
            found = begun.data.get(name)
            raise ArgumentError(
                f"{folder}: was begun with another {name.replace('_', ' ')}: expected {value}, found {found}; give the "
                "same store and options as then, or remove the folder to start anew"
            )


def _contents(samples: Sequence[_Planned]) -> Iterator[bytes]:
    return map(_content, samples)


def _content(sample: _Planned) -> bytes:
    tile = sample.tile
    sides = [
        Side(tile.sensor(sensor), frame.exposure) for sensor, frame in zip(sample.sensors, sample.sides, strict=True)
    ]
    facts = Facts(sample.record, sample.ratio, tile.top, tile.left, *sides)
    noisy, reference = (frame.mosaic[tile.slices] for frame in sample.sides)
    return to_bytes(key_of(sample.number), facts, noisy, reference)


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
