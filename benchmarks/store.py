"""Random 512 x 512 crop pairs from a store, beside the routes of ``store_routes``; the page cache is warm."""

from __future__ import annotations

import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from torch.utils.data import DataLoader

from benchmarks.harness import Row, Spread, in_turn
from benchmarks.store_routes import CROP, Lmdb, Memmap, MemmapInDn, SameValues
from eldata.datasets import PackedStore, normalise_batch
from eldata.parallel import read_ahead
from eldata.raw import read_raw
from eldata.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from benchmarks.data import Files
    from eldata.store.layout import Compression

_COUNT, _BATCH = 48, 4
_COMPRESSIONS: tuple[Compression, ...] = ("none", "lz4", "zstd")


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="store-", dir=files.data.parent) as folder:
        rows = _packing(files, Path(folder), rounds, cores)
        ways = dict(_ways(files, Path(folder)))
        rows += _one_process(ways, files, rounds)
        rows += _memory(Path(folder))
        if cores > 1:
            rows += _loaders(ways, rounds)
        return rows


def _packing(files: Files, folder: Path, rounds: int, cores: int) -> list[Row]:
    """Time packing; the stores of its last round stay."""
    source = source_of_dataset("eld-demo", root=files.data, manifest=files.manifest)
    paths = [source.folder / path for path, _ in source.files]

    def pack(compression: Compression) -> None:
        path = folder / f"{compression}.h5"
        path.unlink(missing_ok=True)
        build_store(source, path, compression=compression, jobs=cores)

    def decode() -> None:
        for frame in read_ahead(read_raw, paths, threads=cores):
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
    yield "store, in DN", store("none").in_dn()
    frames = [[read_raw(pairs.root / path) for path in (r.path, r.reference)] for r in pairs.records]
    yield "memmap x 1/white", Memmap(folder, frames, _COUNT)
    yield "memmap, in DN", MemmapInDn(folder, frames, _COUNT)
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
        timings.faster(f"{case}, in DN", "store, in DN", "memmap, in DN", values="bit-identical"),
        *(timings.faster(f"{case}: {way}", way, "memmap x 1/white") for way in _OTHERS),
        *(timings.faster(f"{case}: {way}", way, "LMDB of fixed patches", at_least=1.5) for way in _OTHERS),
    ]


def _memory(folder: Path) -> list[Row]:
    """Measure all that a fresh process has in memory, libraries included, before and after it reads."""
    rows = []
    for name in _COMPRESSIONS:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            before, after = pool.submit(_peaks_mb, folder / f"{name}.h5").result()
        spreads = Spread.of([after]), Spread.of([before])
        rows.append(Row(f"a worker's memory, {name}", spreads[0], "libraries alone", spreads[1], after, " MB", 600))
    return rows


def _peaks_mb(store: Path) -> tuple[float, float]:
    before = _peak_mb()
    pairs = PackedStore(store, crop=CROP, crops_per_frame=20)
    for index in range(len(pairs)):
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
    names = ("store", "store, lz4", "store, in DN", "memmap x 1/white", "LMDB of fixed patches")
    loaders: dict[str, DataLoader[Any]] = {
        name: DataLoader(
            datasets[name],
            batch_size=_BATCH,
            num_workers=2,
            persistent_workers=True,
            multiprocessing_context="fork",  # h5py's and lmdb's handles of the others cannot be pickled
        )
        for name in names
    }

    def epoch(name: str) -> None:
        for batch in loaders[name]:
            del batch

    def converted() -> None:
        for batch in loaders["store, in DN"]:
            normalise_batch(batch)

    ways: dict[str, Callable[[], object]] = {name: partial(epoch, name) for name in names}
    ways["store, in DN, converted here"] = converted
    timings = in_turn(rounds, ways, dict.fromkeys(ways, _COUNT))
    case = "a crop pair, DataLoader, 2 workers"
    return [
        timings.faster(case, "store", "memmap x 1/white", at_least=0.7),
        timings.faster(case, "store", "LMDB of fixed patches", at_least=1.5),
        timings.faster(f"{case}: lz4", "store, lz4", "memmap x 1/white"),
        timings.faster(f"{case}: in DN", "store, in DN", "store"),
        timings.faster(
            f"{case}: in DN, converted here", "store, in DN, converted here", "store", values="bit-identical"
        ),
    ]


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
    in_dn = normalise_batch(datasets["store, in DN"][1])
    assert np.array_equal(in_dn["input"], datasets["store"][1]["input"])
