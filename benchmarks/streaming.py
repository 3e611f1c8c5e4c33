"""Crop pairs streamed from shards, beside random crops of the store that they come from; the page cache is warm."""

from __future__ import annotations

import io
import tarfile
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.harness import Row, in_turn
from eldata import StreamedPairs
from eldata.datasets import PackedStore
from eldata.datasets.loading import training_loader
from eldata.datasets.ranks import Rank
from eldata.raw.levels import pack_normalised
from eldata.sources.shards import verify_shards, write_shards
from eldata.sources.shards.index import parse_facts
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray
    from torch.utils.data import DataLoader

    from benchmarks.data import Files
    from eldata.sources.shards.index import Side

_TILE, _BATCH, _BUFFER = 512, 4, 16


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="streaming-", dir=files.data.parent) as name:
        folder = Path(name)
        source = source_of_dataset("eld-demo", root=files.data, manifest=files.manifest)
        build_store(source, folder / "store.h5", workers=cores)
        rows = _writing(folder, rounds)
        streamed = StreamedPairs(str(folder / "shards"), augment=False, shuffle_buffer=_BUFFER)
        each = len(streamed) // len(PackedStore(folder / "store.h5"))
        pairs = PackedStore(folder / "store.h5", crop=_TILE, augment=False, crops_per_frame=each)
        rows += _one_process(folder, streamed, pairs, rounds)
        if cores > 1:
            rows += _loaders(streamed, pairs, rounds)
        return rows


def _writing(folder: Path, rounds: int) -> list[Row]:
    """Time writing and checking; the shards of the last round stay."""
    shards = folder / "shards"

    def write() -> None:
        if shards.exists():
            for path in shards.iterdir():
                path.unlink()
        write_shards(folder / "store.h5", shards, tile=_TILE, samples_per_shard=8)

    write()
    count = len(StreamedPairs(str(shards)))
    content = [path.read_bytes() for path in sorted(shards.glob("*.tar"))]

    def copy() -> None:
        for number, whole in enumerate(content):
            (folder / f"copy-{number}").write_bytes(whole)

    ways: dict[str, Callable[[], object]] = {
        "writing shards": write,
        "writing the same bytes": copy,
        "verify_shards": lambda: verify_shards(str(shards)),
    }
    timings = in_turn(min(rounds, 3), ways, dict.fromkeys(ways, count))
    case = "a sample of 512"
    return [
        timings.cost(f"{case}: writing", "writing shards", "writing the same bytes"),
        timings.cost(f"{case}: checking all", "verify_shards", "writing the same bytes"),
    ]


def _one_process(folder: Path, streamed: StreamedPairs, pairs: PackedStore, rounds: int) -> list[Row]:
    count = len(streamed)
    paths = sorted((folder / "shards").glob("*.tar"))
    _check_equal(streamed, paths)
    pixels = np.ones((2, 4, _TILE, _TILE), np.uint16)
    ways: dict[str, Callable[[], object]] = {
        "shards": partial(_exhaust, streamed),
        "store": lambda: [len(pairs[index]) for index in range(count)],
        "tarfile + numpy": lambda: _exhaust(_plain(paths)),
        "memcpy": lambda: [len(pixels.copy()) for _ in range(count)],
    }
    timings = in_turn(rounds, ways, dict.fromkeys(ways, count))
    case = "a crop pair of 512, one process"
    return [
        timings.faster(case, "shards", "store"),
        timings.faster(case, "shards", "tarfile + numpy", values="bit-identical"),
        timings.cost(case, "shards", "memcpy"),
    ]


def _loaders(streamed: StreamedPairs, pairs: PackedStore, rounds: int) -> list[Row]:
    loaders: dict[str, DataLoader[Any]] = {
        "shards": training_loader(streamed, _BATCH, workers=2),
        "store": training_loader(pairs, _BATCH, workers=2),
    }
    ways: dict[str, Callable[[], object]] = {name: partial(_exhaust, loader) for name, loader in loaders.items()}
    units = {name: _BATCH * len(loader) for name, loader in loaders.items()}
    return [in_turn(rounds, ways, units).faster("a crop pair of 512, 2 workers", "shards", "store")]


def _exhaust(items: Any) -> None:
    for item in items:
        del item


def _plain(paths: list[Path], side: int = 2 * _TILE) -> Iterator[dict[str, Any]]:
    """Yield what the shards hold by tarfile and numpy, unchecked and in order, with our kernel: the same work."""
    for path in paths:
        with tarfile.open(path) as archive:
            contents: list[bytes] = []
            for info in archive:
                file = archive.extractfile(info)
                assert file is not None
                contents.append(file.read())
                if len(contents) == 3:
                    facts = parse_facts(contents[0])
                    yield {
                        "path": facts.record.path,
                        "input": _packed(facts.input, contents[1], side, float(facts.ratio)),
                        "target": _packed(facts.target, contents[2], side, 1.0),
                    }
                    contents = []


def _packed(frame: Side, content: bytes, side: int, gain: float) -> NDArray[np.float32]:
    mosaic = np.load(io.BytesIO(content), allow_pickle=False)
    sensor = frame.sensor
    return pack_normalised(mosaic[:side, :side], sensor.cfa, sensor.black_level_dn, 16383.0, gain=gain)


def _check_equal(streamed: StreamedPairs, paths: list[Path]) -> None:
    """Hold each streamed crop against its tile, which has one packed pixel more a side."""
    whole = 2 * _TILE + 2
    for ours, theirs in zip(streamed.for_evaluation(1, Rank()), _plain(paths, whole), strict=True):
        assert ours["path"] == theirs["path"]
        assert any(
            np.array_equal(ours["target"], theirs["target"][:, y : y + _TILE, x : x + _TILE])
            and np.array_equal(ours["input"], theirs["input"][:, y : y + _TILE, x : x + _TILE])
            for y in range(2)
            for x in range(2)
        )
