"""Random 512 x 512 crop pairs from a store, beside the routes of ``store_routes``; the page cache is warm."""

from __future__ import annotations

import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from torch.utils.data import DataLoader

from benchmarks.harness import Row, Spread, in_turn
from benchmarks.store_routes import CROP, Lmdb, Memmap, SameValues
from eldata.base.workers import Workers
from eldata.datasets import PackedStore
from eldata.raw import read_raw
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from benchmarks.data import Files
    from eldata.records import Role
    from eldata.sources.store import Source
    from eldata.sources.store.read import Compression

_COUNT, _BATCH = 48, 4
_RGB_SIZE, _RGB_FRAMES = (918, 1374), 10
_COMPRESSIONS: tuple[Compression, ...] = ("none", "lz4", "zstd")


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="store-", dir=files.data.parent) as folder:
        rows = _packing(files, Path(folder), rounds, cores)
        ways = dict(_ways(files, Path(folder)))
        rows += _one_process(ways, files, rounds)
        rows += _clips(Path(folder), rounds)
        rows += _memory(files, Path(folder))
        if cores > 1:
            rows += _loaders(ways, rounds)
            rows += _noise(ways, Path(folder), rounds)
        return rows


def _packing(files: Files, folder: Path, rounds: int, cores: int) -> list[Row]:
    """Time packing; the stores of its last round stay."""
    source = source_of_dataset("eld-demo", root=files.data, manifest=files.manifest)
    paths = [source.folder / path for path, _ in source.files]

    def pack(compression: Compression) -> None:
        path = folder / f"{compression}.h5"
        path.unlink(missing_ok=True)
        build_store(source, path, compression=compression, workers=cores)

    def decode() -> None:
        for frame in Workers(cores).read_ahead(read_raw, paths):
            del frame

    ways: dict[str, Callable[[], object]] = {
        "decoding alone": decode,
        **{name: partial(pack, name) for name in _COMPRESSIONS},
    }
    timings = in_turn(min(rounds, 3), ways, dict.fromkeys(ways, len(paths)))
    pixels = sum(frame.mosaic.nbytes for frame in map(read_raw, paths[:1])) * len(paths)
    return [
        timings.cost(f"packing a frame, {name} ({pixels / (folder / f'{name}.h5').stat().st_size:.2f}:1)", name, other)
        for name in _COMPRESSIONS
        for other in ["decoding alone"]
    ]


def _ways(files: Files, folder: Path) -> Iterator[tuple[str, Any]]:
    """Yield each way as a dataset of as many crop pairs."""
    pairs = files.dataset()

    def store(compression: Compression, *, augment: bool = False) -> PackedStore:
        path = folder / f"{compression}.h5"
        return PackedStore(path, crop=CROP, augment=augment, crops_per_frame=_COUNT // len(pairs), ratios=(100, 200))

    yield "store", store("none")
    yield "store, lz4", store("lz4")
    yield "store, zstd", store("zstd")
    yield "store, turned", store("none", augment=True)
    frames = [[read_raw(pairs.root / path) for path in (r.path, r.reference)] for r in pairs.records]
    yield "memmap x 1/white", Memmap(folder, frames, _COUNT)
    ratios = [sample["ratio"] for sample in store("none")][: len(pairs)]
    mapped, contiguous = [], []
    with h5py.File(folder / "contiguous.h5", "w") as file:
        for number, pair in enumerate(frames):
            for side, frame in enumerate(pair):
                frame.mosaic.tofile(folder / f"{number}-{side}.mosaic")
                file[f"{number}-{side}"] = frame.mosaic
    opened = h5py.File(folder / "contiguous.h5", "r")
    for number, pair in enumerate(frames):
        names = [f"{number}-{side}" for side in range(2)]
        mapped.append([np.memmap(folder / f"{n}.mosaic", np.uint16, "r", shape=pair[0].mosaic.shape) for n in names])
        contiguous.append([opened[name] for name in names])
    yield "memmap, same values", SameValues(mapped, frames, ratios, _COUNT)
    yield "h5py contiguous, same values", SameValues(contiguous, frames, ratios, _COUNT)
    yield "LMDB of fixed patches", Lmdb(folder, frames, _COUNT)


def _one_process(datasets: Mapping[str, Any], files: Files, rounds: int) -> list[Row]:
    pairs = files.dataset()
    _check_equal(datasets, pairs)
    ways: dict[str, Callable[[], object]] = {name: partial(_every, dataset) for name, dataset in datasets.items()}
    ways["raw decode"] = lambda: pairs[0]
    bytes_of_a_pair = np.ones((2, 4, CROP, CROP), np.uint16)
    ways["memcpy"] = lambda: [len(bytes_of_a_pair.copy()) for _ in range(_COUNT)]
    timings = in_turn(rounds, ways, {way: _COUNT for way in ways if way != "raw decode"})
    case = "a crop pair, one process"
    return [
        timings.faster(case, "store", "memmap x 1/white", at_least=0.7),
        timings.faster(case, "store", "memmap, same values", at_least=0.7, values="bit-identical"),
        timings.faster(case, "store", "h5py contiguous, same values", values="bit-identical"),
        timings.faster(case, "store", "LMDB of fixed patches", at_least=1.5),
        timings.faster(case, "store", "raw decode", at_least=80, values="bit-identical"),
        timings.cost(case, "store", "memcpy"),
        timings.cost(f"{case}: store, turned", "store, turned", "store"),
        *(timings.faster(f"{case}: {way}", way, "memmap x 1/white") for way in _OTHERS),
        *(timings.faster(f"{case}: {way}", way, "LMDB of fixed patches", at_least=1.5) for way in _OTHERS),
    ]


def _clips(folder: Path, rounds: int) -> list[Row]:
    """Windows of preprocessed clips: from the store, and decoded from the PNG files."""
    import imagecodecs

    from eldata.datasets import DRVDataset
    from eldata.datasets.packed import PackedClips

    rgb = np.random.default_rng(0).gamma(4.0, 3000.0, (_RGB_FRAMES + 1, *_RGB_SIZE, 3)).clip(0, 65535).astype(np.uint16)
    drv = folder / "DRV"
    for number, frame in enumerate(rgb):
        name = f"VBM4D_rawRGB/0007/{number:04d}.png" if number else "long/0007/half0001.png"
        (drv / name).parent.mkdir(parents=True, exist_ok=True)
        (drv / name).write_bytes(imagecodecs.png_encode(frame, level=1))
    build_store(source_of_dataset("drv", root=folder, ids=["0007"]), folder / "clips.h5")
    top, left, side = 100, 200, CROP
    stored = PackedClips(folder / "clips.h5", crop=side, augment=False)
    files = DRVDataset(drv, ids=["0007"], region=(top, left, side, side))
    for ours, theirs in zip(PackedClips(folder / "clips.h5", crop=None, augment=False), files, strict=True):
        part = ours["input"][..., top : top + side, left : left + side]
        if not np.array_equal(part, theirs["input"]):
            raise RuntimeError("the store's windows are not those of the files")
    ways: dict[str, Callable[[], object]] = {
        "store": lambda: [len(stored[index]) for index in range(len(stored))],
        "PNG files": lambda: [len(files[index]) for index in range(len(files))],
    }
    timings = in_turn(min(rounds, 3), ways, dict.fromkeys(ways, len(files)))
    return [timings.faster("a window of 5 RGB frames, one process", "store", "PNG files", values="bit-identical")]


def _memory(files: Files, folder: Path) -> list[Row]:
    """Measure all that a fresh process has in memory, libraries included, before and after it reads."""
    small = folder / "small.h5"
    source = source_of_dataset("eld-demo", root=files.data, manifest=files.manifest)
    build_store(replace(source, files=_first_pair(source)), small)
    rows = []
    for name in _COMPRESSIONS:
        before, after = _in_fresh_process(folder / f"{name}.h5")
        spreads = Spread.of([after]), Spread.of([before])
        rows.append(Row(f"a worker's memory, {name}", spreads[0], "libraries alone", spreads[1], after, " MB", 600))
    spreads = Spread.of([_in_fresh_process(folder / "none.h5")[1]]), Spread.of([_in_fresh_process(small)[1]])
    growth = spreads[0].median - spreads[1].median
    return [*rows, Row("a worker's memory, 16 frames", spreads[0], "2 frames", spreads[1], growth, " MB", 20)]


def _first_pair(source: Source) -> tuple[tuple[str, Role], ...]:
    """Return the files of the first pair."""
    reference, noisy = (next(file for file in source.files if file[1] == role) for role in ("reference", "noisy"))
    return reference, noisy


def _in_fresh_process(store: Path) -> tuple[float, float]:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_peaks_mb, store).result()


def _peaks_mb(store: Path) -> tuple[float, float]:
    before = _peak_mb()
    pairs = PackedStore(store, crop=CROP, crops_per_frame=240)
    for index in range(0, len(pairs), len(pairs) // 240):
        pairs[index]
    return before, _peak_mb()


def _peak_mb() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1024 / 1e6


def _every(dataset: Any) -> None:
    for index in range(_COUNT):
        dataset[index]


_OTHERS = ("store, lz4", "store, zstd", "store, turned")


def _loaders(datasets: Mapping[str, Any], rounds: int) -> list[Row]:
    names = ("store", "store, lz4", "store, turned", "memmap x 1/white", "LMDB of fixed patches")
    rows = []
    for workers in (2, 4):
        loaders = {name: _loader(datasets[name], workers) for name in names}
        ways: dict[str, Callable[[], object]] = {name: partial(_epoch, loaders[name]) for name in names}
        ways["store, each copied"] = partial(_epoch, loaders["store"], _copied)
        ways["LMDB, each copied"] = partial(_epoch, loaders["LMDB of fixed patches"], _copied)
        timings = in_turn(rounds, ways, dict.fromkeys(ways, _COUNT))
        case = f"a crop pair, DataLoader, {workers} workers"
        lmdb = "LMDB of fixed patches"
        rows += [
            timings.faster(case, "store", "memmap x 1/white", at_least=0.7),
            timings.faster(case, "store", lmdb, at_least=1.5),
            timings.faster(f"{case}, each copied", "store, each copied", "LMDB, each copied", at_least=1.5),
            timings.faster(f"{case}: turned", "store, turned", lmdb, at_least=1.5),
            timings.faster(f"{case}: lz4", "store, lz4", "memmap x 1/white"),
            timings.faster(f"{case}: lz4", "store, lz4", lmdb, at_least=1.5),
        ]
    return rows


def _noise(datasets: Mapping[str, Any], folder: Path, rounds: int) -> list[Row]:
    """Clean crops with the full noise model, made by the workers or in the main process."""
    from benchmarks.store_noise import CleanCrops, LmdbWithNoise
    from eldata.datasets import CleanFrames, SyntheticPairs

    source = CleanFrames(folder / "none.h5")
    profile = "SonyA7S2"
    ours = SyntheticPairs(source, profile, crop=CROP, augment=False, crops_per_frame=-(-_COUNT // len(source)))
    ours.set_epoch(0)  # each round reads the same items
    published = LmdbWithNoise(datasets["LMDB of fixed patches"])
    clean = CleanCrops(source, _COUNT)
    rows = []
    for workers in (0, 2, 4):
        loaders = {"store": ours, "LMDB, plain numpy noise": published, "store, noise here": clean}
        made = {name: _loader(dataset, workers) for name, dataset in loaders.items()}
        ways: dict[str, Callable[[], object]] = {name: partial(_epoch, loader) for name, loader in made.items()}
        ways["store, noise here"] = partial(_epoch, made["store, noise here"], clean.noisy)
        units = {"store": len(ours), "LMDB, plain numpy noise": len(published), "store, noise here": len(clean)}
        timings = in_turn(min(rounds, 5), ways, units)
        case = f"a noisy pair, DataLoader, {workers} workers" if workers else "a noisy pair, DataLoader, one process"
        rows += [
            timings.faster(case, "store", "LMDB, plain numpy noise", at_least=3),
            timings.faster(f"{case}: noise in the main process", "store, noise here", "store"),
        ]
    return rows


def _loader(dataset: Any, workers: int) -> DataLoader[Any]:
    if workers == 0:
        return DataLoader(dataset, batch_size=_BATCH)
    return DataLoader(
        dataset,
        batch_size=_BATCH,
        num_workers=workers,
        persistent_workers=True,
        multiprocessing_context="fork",  # h5py's and lmdb's handles of the others cannot be pickled
    )


def _epoch(loader: DataLoader[Any], work: Callable[[Any], object] | None = None) -> None:
    for batch in loader:
        if work is not None:
            work(batch)
        del batch


def _copied(batch: Mapping[str, Any]) -> None:
    """Read every byte once, as sending a batch to a device does; the memory is there already."""
    for side in ("input", "target"):
        np.copyto(_DEVICE[: len(batch[side])], batch[side].numpy())


_DEVICE = np.ones((_BATCH, 4, CROP, CROP), np.float32)


def _check_equal(datasets: Mapping[str, Any], pairs: Any) -> None:
    """Hold the store's crops against the raw route's frames, and against those of the routes with its values."""
    wanted = pairs[1]
    for name in ("store", "store, lz4", "store, zstd"):
        crop = datasets[name][1]
        first = np.argwhere(wanted["target"][0].numpy() == crop["target"][0, 0, 0].item())
        assert any(
            np.array_equal(wanted["target"][:, y : y + CROP, x : x + CROP], crop["target"])
            and np.array_equal(wanted["input"][:, y : y + CROP, x : x + CROP], crop["input"])
            for y, x in first
        )
    pair, top, left = datasets["memmap, same values"].places[1]
    assert pair == 1
    for name in ("memmap, same values", "h5py contiguous, same values"):
        for side in ("input", "target"):
            part = wanted[side][:, top : top + CROP, left : left + CROP]
            assert np.array_equal(datasets[name][1][side], part)
