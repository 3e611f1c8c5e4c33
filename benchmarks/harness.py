"""Timing several ways of the same work in turn, in a child process that keeps to some of the CPUs.

This module imports nothing that starts threads or reads thread settings: a child imports it before it is pinned.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from benchmarks.data import Files

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and range over the rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        return cls(statistics.median(values), min(values), max(values))

    def __str__(self) -> str:
        digits = max(0, 2 - len(str(int(self.median))))
        return f"{self.median:.{digits}f} [{self.low:.{digits}f}-{self.high:.{digits}f}]"


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison.

    ``figure`` is what counts: ``"x faster"`` is the other's time over ours, ``"x the time"`` ours over the other's,
    both the median of the rounds' ratios. ``expected`` is its least value where more is better, else its greatest;
    ``None`` where nothing is expected. ``values`` says how equal the results are, as asserted in the same process.
    """

    case: str
    ours: Spread
    against: str
    theirs: Spread
    figure: float
    unit: Literal["x faster", "x the time", " MB"]
    expected: float | None = None
    values: str = ""

    @property
    def verdict(self) -> str:
        """The expectation and whether it is met, as text."""
        if self.expected is None:
            return ""
        more_is_better = self.unit == "x faster"
        met = self.figure >= self.expected if more_is_better else self.figure <= self.expected
        return f"{'>=' if more_is_better else '<='} {self.expected:g}{self.unit}: {'met' if met else 'MISSED'}"


@dataclass(frozen=True, slots=True)
class Timings:
    """Milliseconds of each way, round by round."""

    by_way: Mapping[str, Sequence[float]]

    def faster(self, case: str, ours: str, than: str, *, at_least: float | None = None, values: str = "") -> Row:
        """Return the row that says how many times faster ``ours`` is."""
        figure = self._ratio(than, ours)
        return Row(case, self._spread(ours), than, self._spread(than), figure, "x faster", at_least, values)

    def cost(self, case: str, ours: str, floor: str, *, at_most: float | None = None) -> Row:
        """Return the row that says how many times the floor's time ``ours`` takes."""
        figure = self._ratio(ours, floor)
        return Row(case, self._spread(ours), floor, self._spread(floor), figure, "x the time", at_most)

    def _spread(self, way: str) -> Spread:
        return Spread.of(self.by_way[way])

    def _ratio(self, above: str, below: str) -> float:
        pairs = zip(self.by_way[above], self.by_way[below], strict=True)
        return statistics.median(a / b for a, b in pairs)


def in_turn(rounds: int, ways: Mapping[str, Callable[[], object]], units: Mapping[str, int] | None = None) -> Timings:
    """Time each way once a round, after one round of warm-up; freeing the result is part of the time.

    Every second round goes backwards: what a way leaves behind in the allocator and the caches changes the time of the
    next one. ``units`` divides the time of a way that does several units of work in one call.
    """
    units = units or {}
    by_way: dict[str, list[float]] = {way: [] for way in ways}
    for number in range(rounds + 1):
        for way in list(ways) if number % 2 == 0 else reversed(list(ways)):
            start = time.perf_counter()
            ways[way]()
            elapsed = time.perf_counter() - start
            if number > 0:
                by_way[way].append(1000 * elapsed / units.get(way, 1))
    return Timings(by_way)


def peak_growth_mb(work: Callable[[], object]) -> float:
    """Return by how much this process's resident memory rises above its present size during a call, in 10^6 bytes."""
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    before = _status_bytes("VmRSS")
    work()
    return (_status_bytes("VmHWM") - before) / 1e6


def _status_bytes(field: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) * 1024
    raise RuntimeError(f"this kernel does not state {field}")


# --- children -------------------------------------------------------------------------------------------------


def measure(name: str, files: Files, rounds: int, cores: int) -> list[Row]:
    """Return the rows of one benchmark, run by a new process on the first ``cores`` of the CPUs that this one has."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, initializer=_pin, initargs=(cores,)) as pool:
        return pool.submit(_run, name, files, rounds, cores).result()


def _pin(cores: int) -> None:
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, str(cores)))
    import torch

    torch.set_num_threads(cores)


def _run(name: str, files: Files, rounds: int, cores: int) -> list[Row]:
    rows: list[Row] = import_module(f"benchmarks.{name}").run(files, rounds, cores)
    return rows
