"""Writing shards from a store: the same bytes whenever it is done, each shard whole or not there."""

from __future__ import annotations

import hashlib
import zlib
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np
from tqdm import tqdm

from eldata import __version__
from eldata.base.arguments import keywords, spell_keywords
from eldata.base.fields import TextFile
from eldata.base.files import atomic_write, check_same_work, remove_leftovers, sha256_of, write_json, write_text
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.manifest.pairs import Choice, refuse_shifted
from eldata.raw.cfa import cfa_from, packed_area, packing_sites
from eldata.sources.frames import checked_ratio
from eldata.sources.shards.index import (
    END,
    FORMAT,
    INDEX,
    VERSION,
    Facts,
    Shard,
    ShardIndex,
    Side,
    index_text,
    key_of,
    to_bytes,
)
from eldata.sources.store.read import StoreFrames

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from eldata.raw.cfa import CfaRows
    from eldata.records import PairRecord, Sensor
    from eldata.sources.frames import Frame

# What was begun, so that only the same work goes on in the folder; gone soon after the index is there.
BEGUN = ".begun.json"
_MOST_SHARDS = 10**6


@dataclass(frozen=True, slots=True)
class ShardReport:
    """What was written: samples and shards in all, ``resumed`` shards of them before; bytes of the shards."""

    folder: Path
    samples: int
    shards: int
    resumed: int
    bytes: int


class _Planned(NamedTuple):
    """One sample to write: its facts, the noisy frame and its reference, their checksums, and the part of them."""

    facts: Facts
    frames: tuple[Frame, Frame]
    sha256: tuple[str, str]
    tile: Tile

    def content(self, number: int) -> bytes:
        """Return the sample's part of a shard."""
        noisy, reference = (frame.read(*self.tile.slices).copy() for frame in self.frames)
        return to_bytes(key_of(number), self.facts, noisy, reference)


@spell_keywords(Choice)
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
        Side of the samples and what neighbours share, in packed pixels (:func:`grid`); tile
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
    (chosen,) = keywords("write_shards", choice, Choice)
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
            samples = partial(map, lambda place: planned[place].content(place), part)
            shard = _found(path, samples()) if path.exists() else None
            resumed += shard is not None
            shards.append(shard or _written(path, samples()))
            bar.update(len(part))
    index = ShardIndex(source.store.dataset, tile, overlap, seed, tuple(shards), source.levels)
    write_text(folder / INDEX, index_text(index, f"eldata {__version__}"))
    (folder / BEGUN).unlink()
    return ShardReport(folder, len(index), len(shards), resumed, sum(shard.bytes for shard in shards))


def _planned(source: StoreFrames, pairs: Sequence[PairRecord], tile: int | None, overlap: int) -> Iterator[_Planned]:
    """Yield the samples in the order of pairs and places, which numbers them."""
    digests = {frame.path: frame.sha256 for frame in source.store.frames}
    for record in pairs:
        refuse_shifted(record, "shards hold both frames as they lie: load it from files or a store")
        noisy, reference = source.frame(record.path), source.frame(record.reference)
        ratio = checked_ratio(record, reference, noisy)
        sums = digests[record.path], digests[record.reference]
        if noisy.sensor is None or reference.sensor is None:
            raise DatasetError(f"{noisy.name}: is not a raw file; shards hold mosaics in DN")
        for place in whole(noisy.sensor) if tile is None else grid(noisy.name, noisy.sensor, tile, overlap):
            first = Side(place.sensor(noisy.sensor), noisy.exposure)
            second = Side(place.sensor(reference.sensor), reference.exposure)
            facts = Facts(record, ratio, place.top, place.left, first, second)
            yield _Planned(facts, (noisy, reference), sums, place)


def _digest(planned: Sequence[_Planned]) -> str:
    """Return a digest of what decides the samples' bytes."""
    found = hashlib.sha256()
    for sample in planned:
        found.update(repr((sample.facts, sample.sha256)).encode())
    return f"sha256:{found.hexdigest()}"


def _begin(folder: Path, options: dict[str, Any]) -> None:
    """Make the folder, or make sure that the same work was begun in it; remove what a killed writer left."""
    wanted = {"format": FORMAT, "version": VERSION, "written_by": f"eldata {__version__}", **options}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        there = sorted(path.name for path in folder.iterdir())
    except OSError as error:
        raise EldataError(f"cannot write into {folder}: {error.strerror or error}") from error
    begun = TextFile(folder / BEGUN, EldataError, "remove the folder to start again").json() if BEGUN in there else None
    if INDEX in there and begun is None:
        raise EldataError(f"{folder}: holds finished shards already; remove it, or name another folder")
    if begun is None:
        if there:
            raise EldataError(f"{folder}: holds other files, such as {there[0]}; name a new folder")
        write_json(folder / BEGUN, wanted, indent=1)
        return
    check_same_work(folder, begun.data, wanted)


def _tallied(name: str, samples: Iterable[bytes], write: Callable[[bytes], object]) -> Shard:
    """Write the samples of a shard, one in memory at a time; return their sizes and checksums."""
    sizes, sums, digest = [], [], hashlib.sha256()
    for content in samples:
        write(content)
        sizes.append(len(content))
        sums.append(zlib.crc32(content))
        digest.update(content)
    write(END)
    digest.update(END)
    sha256 = f"sha256:{digest.hexdigest()}"
    return Shard(name, sum(sizes) + len(END), sha256, np.array(sizes, np.int64), np.array(sums, np.uint32))


def _written(path: Path, samples: Iterable[bytes]) -> Shard:
    with atomic_write(path) as file:
        return _tallied(path.name, samples, file.write)


def _found(path: Path, samples: Iterable[bytes]) -> Shard | None:
    """Return a shard that was written before, if it holds these samples."""
    shard = _tallied(path.name, samples, len)
    try:
        return shard if sha256_of(path) == shard.sha256 else None
    except OSError as error:
        raise EldataError(f"cannot read {path}: {error.strerror or error}") from error


@dataclass(frozen=True, slots=True)
class Tile:
    """A part of a mosaic, in its pixels, and the CFA that it starts with."""

    top: int
    left: int
    height: int
    width: int
    cfa: CfaRows

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of the tile: ``mosaic[tile.slices]``."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def sensor(self, sensor: Sensor) -> Sensor:
        """Return a frame's sensor as that of the tile."""
        return replace(sensor, cfa=self.cfa, height=self.height, width=self.width)


def whole(sensor: Sensor) -> list[Tile]:
    """Return the one tile that is the whole frame, pixels that packing drops included."""
    return [Tile(0, 0, sensor.height, sensor.width, sensor.cfa)]


def grid(name: str, sensor: Sensor, tile: int, overlap: int) -> list[Tile]:
    """Return the tiles that cover all that packing keeps of a frame, row by row.

    Each has ``tile`` packed pixels a side and one period of the CFA more, so that a crop of the whole side can still be
    turned. They are spread evenly, the last of a row or column ends with the frame: most overlap by more.

    Parameters
    ----------
    name
        Of the frame, for errors.
    sensor
        Size and CFA.
    tile, overlap
        In packed pixels, even for X-Trans.

    Raises
    ------
    ArgumentError
        If a length is out of its range, or odd for X-Trans.
    DatasetError
        If the frame is smaller than a tile.
    """
    period = len(sensor.cfa)
    scale = packing_sites(sensor.cfa).scale
    if tile < 2 or not 0 <= overlap < tile:
        raise ArgumentError(f"tile must be 2 or more and overlap from 0 up to below it; found {tile}, {overlap}")
    side, stride = tile * scale, (tile - overlap) * scale
    if side % period or stride % period:
        raise ArgumentError(f"tile and overlap must be even for X-Trans; found {tile}, {overlap}")
    side += period
    area = packed_area((sensor.height, sensor.width), sensor.cfa)
    if side > min(area.height, area.width):
        raise DatasetError(
            f"{name}: {area.height} x {area.width} pixels are too few for a tile of {side} x {side} (tile={tile}); "
            "take smaller tiles, or whole frames"
        )
    cfa = cfa_from(sensor.cfa, area.top, area.left)
    starts = [_starts(length - side, stride, period) for length in (area.height, area.width)]
    return [Tile(area.top + top, area.left + left, side, side, cfa) for top, left in product(*starts)]


def _starts(last: int, stride: int, period: int) -> list[int]:
    """Return places from 0 to ``last``, spread evenly, at most a stride apart; all are multiples of the period."""
    steps = -(-last // stride)
    return [last // period * step // steps * period for step in range(steps)] + [last]
