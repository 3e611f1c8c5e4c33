"""What grows with the number of frames: opening, first batch, memory.

Each opening is timed in a process of its own that has imported everything before. Writing 100,000 frames takes minutes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.harness import Row, Spread
from benchmarks.many_frames import write_small_store

if TYPE_CHECKING:
    from benchmarks.data import Files

_FEW, _MANY = 1000, 100_000

_OPEN = """
import json, sys, time
import torch
from pathlib import Path
import eldata.datasets._preloaded
from eldata import PackedStore
from eldata.datasets import training_loader

def private_mb(process):
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) * 1024 / 1e6

def main():
    path, workers = sys.argv[1], int(sys.argv[2])
    before, start = private_mb("self"), time.perf_counter()
    loader = training_loader(PackedStore(path, crop=16), 4, num_workers=workers)
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
    if cores == 1:
        return []
    with tempfile.TemporaryDirectory(prefix="scale-", dir=files.data.parent) as name:
        folder = Path(name)
        for count in (_FEW, _MANY):
            write_small_store(folder / f"store-{count}", count)
        return openings(folder, min(rounds, 3))


def openings(folder: Path, rounds: int) -> list[Row]:
    """Return seconds and memory of opening many frames, against few."""
    (folder / "opening.py").write_text(_OPEN)
    rows = []
    for workers in (0, 2):
        found: dict[int, list[list[float]]] = {_FEW: [], _MANY: []}
        for _ in range(rounds):
            for count, each in found.items():
                each.append(_opened(folder, count, workers))
        few, many = (list(zip(*found[count], strict=True)) for count in (_FEW, _MANY))
        case = f"store of {_MANY}, {workers} workers"
        against = f"store of {_FEW}"
        # The least of the rounds: the machine is shared.
        ours, theirs = (Spread.of([1000 * value for value in one[0]]) for one in (many, few))
        rows.append(Row(f"{case}: first batch", ours, against, theirs, ours.low / theirs.low, "x the time"))
        rows += [
            Row(f"{case}: {whose}", Spread.of(many[place]), against, Spread.of(few[place]), min(many[place]), " MB")
            for place, whose in ((1, "memory of the parent"), (2, "memory of a worker"))
            if place == 1 or workers
        ]
    return rows


def _opened(folder: Path, count: int, workers: int) -> list[float]:
    command = [sys.executable, str(folder / "opening.py"), str(folder / f"store-{count}"), str(workers)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: list[float] = json.loads(done.stdout)
    return found
