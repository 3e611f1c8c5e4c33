"""Items from uncompressed raw files beside the same from a store, LMDB and LibRaw: page cache warm, and dropped."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import imagecodecs
import numpy as np
import rawpy
import tifffile

from benchmarks import published
from benchmarks.harness import Row, in_turn, peak_growth_mb
from benchmarks.store import _copied, _epoch, _every, _loader
from benchmarks.store_routes import CROP, Lmdb
from eldata.datasets import ELDDataset, PackedStore, training_loader
from eldata.raw import read_header, read_raw, write_dng
from eldata.raw.mapped import _map
from eldata.sources.frames import Files as Sources
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from benchmarks.data import Files

_COUNT = 48


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="raw-parts-", dir=files.data.parent) as name:
        root = Path(name) / files.dataset().root.name
        paths = _write_uncompressed(files, root)
        store = Path(name) / "none.h5"
        build_store(source_of_dataset("eld-demo", root=Path(name), manifest=files.manifest), store)
        whole = ELDDataset(root, manifest=files.manifest)
        each: dict[str, Any] = {"crop": CROP, "crops_per_frame": _COUNT // len(whole)}
        make: dict[str, Callable[[], Any]] = {
            "raws": lambda: ELDDataset(root, manifest=files.manifest, **each),
            "store": lambda: PackedStore(store, augment=False, ratios=(100, 200), **each),
        }
        rows = _cold(make, [*paths, store], rounds)
        raws, stored = make["raws"](), make["store"]()
        frames = [[read_raw(root / path) for path in (row.path, row.reference)] for row in whole.records]
        ways: dict[str, Any] = {"raws": raws, "store": stored, "LMDB": Lmdb(Path(name), frames, _COUNT)}
        del frames
        for index in range(0, _COUNT, 7):
            for side in ("input", "target"):
                assert np.array_equal(raws[index][side], stored[index][side])
        rows += _one_process(ways, rounds)
        rows += _whole(files, whole, rounds)
        rows += _files(paths[0], rounds)
        rows += _memory(raws, files)
        rows += _compressed(files, Path(name), rounds)
        return rows + (_loaders(ways, rounds) if cores > 1 else [])


def _write_uncompressed(files: Files, root: Path) -> list[Path]:
    """Write every frame of the set without compression."""
    paths = []
    for path in sorted(files.dataset().root.rglob("*.dng")):
        frame, target = read_raw(path), root / path.relative_to(files.dataset().root)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_dng(target, frame.mosaic, frame.sensor, frame.exposure)
        paths.append(target)
    os.sync()  # only what is on the disk can be dropped from memory
    return paths


def _cold(make: dict[str, Callable[[], Any]], paths: Iterable[Path], rounds: int) -> list[Row]:
    """Read a first epoch without a page of the files in memory; nothing may have them mapped, which keeps pages."""

    def read_first(name: str) -> None:
        _map.cache_clear()
        for path in paths:
            descriptor = os.open(path, os.O_RDONLY)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)
        _every(make[name]())

    timings = in_turn(min(rounds, 3), {name: partial(read_first, name) for name in make}, dict.fromkeys(make, _COUNT))
    return [timings.cost("a crop pair, cold", "raws", "store", at_most=1.3)]


def _one_process(datasets: dict[str, Any], rounds: int) -> list[Row]:
    ways = {name: partial(_every, dataset) for name, dataset in datasets.items()}
    timings = in_turn(rounds, ways, dict.fromkeys(ways, _COUNT))
    return [
        timings.cost("a crop pair", "raws", "store", at_most=1.3),
        timings.faster("a crop pair", "raws", "LMDB"),
    ]


def _whole(files: Files, whole: ELDDataset, rounds: int) -> list[Row]:
    pair = files.first_pair()
    uncompressed = [whole.root / path.relative_to(files.dataset().root) for path in pair]
    ways: dict[str, Callable[[], object]] = {
        "raws": lambda: whole[0],
        "LibRaw, both files": lambda: [published.decode(path) for path in uncompressed],
        "published": lambda: published.item(*uncompressed),
    }
    timings = in_turn(rounds, ways)
    return [
        timings.cost("two whole frames, packed, normalised", "raws", "LibRaw, both files"),
        timings.faster("two whole frames, packed, normalised", "raws", "published", values="bit-identical"),
    ]


def _files(path: Path, rounds: int) -> list[Row]:
    many = 50

    def open_only() -> None:
        for _ in range(many):
            with rawpy.RawPy() as raw:
                raw.open_file(str(path))

    ways: dict[str, Callable[[], object]] = {
        "eldata": lambda: [read_header(path) for _ in range(many)],
        "LibRaw, opened": open_only,
    }
    return [in_turn(rounds, ways, dict.fromkeys(ways, many)).cost("a header", "eldata", "LibRaw, opened")]


def _memory(raws: ELDDataset, files: Files) -> list[Row]:
    from benchmarks.harness import Spread

    decoded = ELDDataset(files.dataset().root, manifest=files.manifest, crop=CROP)
    ours, theirs = (peak_growth_mb(partial(lambda each: [each[n] for n in range(6)], each)) for each in (raws, decoded))
    spreads = Spread.of([ours]), Spread.of([theirs])
    return [Row("six crop pairs", spreads[0], "lossless JPEG", spreads[1], ours, " MB", expected=theirs)]


def _compressed(files: Files, folder: Path, rounds: int) -> list[Row]:
    """Crops of lossless JPEG: of tiles, and of whole frames that are kept, twice as many pairs as there is room for."""
    tiled = folder / "tiled.dng"
    _write_tiles(tiled, read_raw(files.first_pair()[1]).mosaic)
    one = Sources()
    frame = one.frame(str(tiled))
    assert frame.reads_parts
    generator = np.random.default_rng(0)
    corners = [(int(generator.integers(1800)), int(generator.integers(3200))) for _ in range(6)]
    part = {"tiles": lambda: [frame.read(slice(y, y + 1024), slice(x, x + 1024)) for y, x in corners]}
    ways: dict[str, Callable[[], object]] = {**part, "a whole decode": lambda: [published.decode(tiled)] * 6}
    rows = [in_turn(rounds, ways, {"tiles": 6}).cost("a crop of 1024 pixels, tiles of 256", "tiles", "a whole decode")]
    rates: dict[str, float] = {}

    def epoch(way: str, most: int, at_a_time: int | None) -> None:
        dataset = ELDDataset(files.dataset().root, manifest=files.manifest, crop=CROP, crops_per_frame=8)
        dataset.source.kept.most = most
        for _ in training_loader(dataset, 1, num_workers=0, records_at_a_time=at_a_time):
            pass
        kept = dataset.source.kept
        rates[way] = kept.hits / max(1, kept.hits + kept.misses)

    room = 4 * 2 * frame.shape[0] * frame.shape[1]
    orders = {"two pairs at a time": (room, 2), "all mixed": (room, None), "none kept": (0, None)}
    epochs = {way: partial(epoch, way, *options) for way, options in orders.items()}
    timings = in_turn(min(rounds, 2), epochs, dict.fromkeys(epochs, 8 * len(files.dataset())))
    return rows + [
        replace(timings.faster("a crop pair, 4 frames kept", way, "none kept"), values=f"{way}: {rates[way]:.0%} hits")
        for way in list(orders)[:2]
    ]


def _write_tiles(path: Path, mosaic: NDArray[np.uint16], side: int = 256) -> None:
    """Write a DNG as Adobe's converter does, in square tiles of lossless JPEG."""
    height, width = mosaic.shape
    padded = np.pad(mosaic, ((0, -height % side), (0, -width % side)), "edge")
    tiles = (
        bytes(imagecodecs.ljpeg_encode(np.ascontiguousarray(padded[y : y + side, x : x + side]), bitspersample=16))
        for y in range(0, height, side)
        for x in range(0, width, side)
    )
    tags: list[Any] = [(50706, "B", 4, bytes((1, 4, 0, 0)), True), (50707, "B", 4, bytes((1, 1, 0, 0)), True)]
    tags += [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True), (272, "s", 0, "Tiles", True)]
    shape: dict[str, Any] = {"shape": mosaic.shape, "dtype": np.uint16, "tile": (side, side), "compression": 7}
    tifffile.imwrite(path, tiles, photometric=32803, metadata=None, extratags=tags, **shape)


def _loaders(datasets: dict[str, Any], rounds: int) -> list[Row]:
    loaders = {name: _loader(dataset, 2) for name, dataset in datasets.items()}
    ways: dict[str, Callable[[], object]] = {name: partial(_epoch, loader) for name, loader in loaders.items()}
    ways["LMDB, each copied"] = partial(_epoch, loaders["LMDB"], _copied)
    ways["raws, each copied"] = partial(_epoch, loaders["raws"], _copied)
    timings = in_turn(rounds, ways, dict.fromkeys(ways, _COUNT))
    case = "a crop pair, DataLoader, 2 workers"
    return [
        timings.cost(case, "raws", "store", at_most=1.2),
        timings.faster(case, "raws", "LMDB", at_least=5),
        timings.faster(f"{case}, each copied", "raws, each copied", "LMDB, each copied"),
    ]
