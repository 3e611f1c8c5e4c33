"""What grows with the number of frames: opening, first batch, memory; and shards from a web server that is far away.

Each opening is timed in a process of its own that has imported everything before. Writing 100,000 frames takes minutes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.harness import Row, Spread
from benchmarks.many_frames import write_small_shards, write_small_store
from eldata import StreamedPairs
from eldata.datasets import training_loader
from tests.sources.shards.server import serving

if TYPE_CHECKING:
    from benchmarks.data import Files

_FEW, _MANY = 1000, 100_000
_LATENCY_S, _BYTES_PER_S = 0.05, 20e6

_OPEN = """
import json, sys, time
import torch
from pathlib import Path
import eldata.datasets._preloaded
from eldata import PackedStore, StreamedPairs
from eldata.datasets import training_loader

def private_mb(process):
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) * 1024 / 1e6

def main():
    kind, path, workers = sys.argv[1], sys.argv[2], int(sys.argv[3])
    before, start = private_mb("self"), time.perf_counter()
    dataset = PackedStore(path, crop=16) if kind == "store" else StreamedPairs(path, crop=16)
    loader = training_loader(dataset, 4, workers=workers)
    batches = iter(loader)
    next(batches)
    seconds = time.perf_counter() - start
    own = private_mb("self") - before
    each = [private_mb(process.pid) for process in batches._workers] if workers else [0.0]
    print(json.dumps([seconds, own, max(each)]))

if __name__ == "__main__":
    main()
"""


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="scale-", dir=files.data.parent) as name:
        folder = Path(name)
        if cores == 1:
            return from_afar(write_small_shards(folder / "shards", 20 * _FEW), min(rounds, 3))
        for count in (_FEW, _MANY):
            write_small_store(folder / f"store-{count}", count)
            write_small_shards(folder / f"shards-{count}", count)
        return openings(folder, min(rounds, 3))


def openings(folder: Path, rounds: int) -> list[Row]:
    """Return seconds and memory of opening many frames, against few."""
    (folder / "opening.py").write_text(_OPEN)
    rows = []
    for kind in ("store", "shards"):
        for workers in (0, 2):
            found: dict[int, list[list[float]]] = {_FEW: [], _MANY: []}
            for _ in range(rounds):
                for count, each in found.items():
                    each.append(_opened(folder, kind, count, workers))
            few, many = (list(zip(*found[count], strict=True)) for count in (_FEW, _MANY))
            case = f"{kind} of {_MANY}, {workers} workers"
            against = f"{kind} of {_FEW}"
            # The least of the rounds: the machine is shared.
            ours, theirs = (Spread.of([1000 * value for value in one[0]]) for one in (many, few))
            rows.append(Row(f"{case}: first batch", ours, against, theirs, ours.low / theirs.low, "x the time"))
            rows += [
                Row(f"{case}: {whose}", Spread.of(many[place]), against, Spread.of(few[place]), min(many[place]), " MB")
                for place, whose in ((1, "memory of the parent"), (2, "memory of a worker"))
                if place == 1 or workers
            ]
    return rows


def _opened(folder: Path, kind: str, count: int, workers: int) -> list[float]:
    command = [sys.executable, str(folder / "opening.py"), kind, str(folder / f"{kind}-{count}"), str(workers)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: list[float] = json.loads(done.stdout)
    return found


def from_afar(shards: Path, rounds: int) -> list[Row]:
    """Return milliseconds a sample from a server with latency and little bandwidth, against the bandwidth's floor."""
    rows = []
    size = sum(path.stat().st_size for path in shards.glob("*.tar"))
    samples = len(StreamedPairs(str(shards)))
    floor = 1000 * size / samples / _BYTES_PER_S
    for workers in (0, 2, 4):
        times = []
        for _ in range(rounds):
            with serving(shards) as site:
                dataset: Any = StreamedPairs(site.address, crop=16)
                loader = training_loader(dataset, 16, workers=workers)
                site.latency_s, site.bytes_per_s = _LATENCY_S, _BYTES_PER_S
                batches = iter(loader)
                next(batches)
                start = time.perf_counter()
                count = sum(16 for _ in batches)
                times.append(1000 * (time.perf_counter() - start) / count)
        case = f"a sample of {size / samples / 1e3:.0f} kB over HTTP, {1000 * _LATENCY_S:.0f} ms, {workers} workers"
        each = Spread.of([floor])
        against = f"{_BYTES_PER_S / 1e6:.0f} MB/s, one connection"
        rows.append(Row(case, Spread.of(times), against, each, min(times) / floor, "x the time"))
    return rows
