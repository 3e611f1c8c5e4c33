"""Units of work spread over processes or threads, results in order."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections import deque
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from tqdm import tqdm

from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

Unit = TypeVar("Unit")
Result = TypeVar("Result")


def run_units(
    work: Callable[[Unit], Result],
    units: Sequence[Unit],
    *,
    jobs: int = 1,
    label: str = "",
    unit: str = "file",
) -> Iterator[Result]:
    """Yield ``work(unit)`` for each unit, in the units' order.

    Parameters
    ----------
    work
        A function of a module's top level: worker processes are spawned, not forked, and import it by name.
    units
        Picklable and small: paths, not pixels.
    jobs
        Number of worker processes; 1 works in this process.
    label, unit
        What the progress bar on stderr says. It shows on a terminal only.

    Raises
    ------
    ArgumentError
        If ``jobs`` is not positive.
    EldataError
        If a worker process dies. Errors that ``work`` raises come through as they are.
    """
    check_jobs(jobs)
    with tqdm(total=len(units), desc=label, unit=unit, disable=None, leave=False) as bar:
        results = _in_processes(work, units, jobs) if jobs > 1 and len(units) > 1 else map(work, units)
        for result in results:
            bar.update()
            yield result


def read_ahead(work: Callable[[Unit], Result], units: Iterable[Unit], *, threads: int) -> Iterator[Result]:
    """Yield ``work(unit)`` for each unit, in the units' order, computed by threads that run ahead.

    For work that releases the GIL, as decoding does, and whose results are too large to send between processes. At most
    ``threads`` + 1 results are in memory; 1 works in the calling thread.

    Raises
    ------
    ArgumentError
        If ``threads`` is not positive. Errors that ``work`` raises come through as they are, in their unit's turn.
    """
    check_jobs(threads)
    if threads == 1:
        yield from map(work, units)
        return
    pool = ThreadPoolExecutor(threads)
    waiting: deque[Future[Result]] = deque()
    try:
        for unit in units:
            waiting.append(pool.submit(work, unit))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def check_jobs(jobs: int) -> None:
    """Raise :class:`ArgumentError` unless ``jobs`` is at least 1."""
    if jobs < 1:
        raise ArgumentError(f"jobs must be 1 or more; found {jobs}")


def _in_processes(work: Callable[[Unit], Result], units: Sequence[Unit], jobs: int) -> Iterator[Result]:
    pool = ProcessPoolExecutor(min(jobs, len(units)), mp_context=multiprocessing.get_context("spawn"))
    waiting: deque[tuple[Unit, Future[Result]]] = deque()
    try:
        for unit in units:
            with _workers_without_ctrl_c():  # each submission may start a process
                waiting.append((unit, pool.submit(work, unit)))
            if len(waiting) > 4 * jobs:  # enough to keep every worker busy, few enough to hold in memory
                yield waiting[0][1].result()
                waiting.popleft()
        while waiting:
            yield waiting[0][1].result()
            waiting.popleft()
    except BrokenProcessPool as error:
        unit = waiting[0][0]
        raise EldataError(
            f"a worker process died at or soon after {getattr(unit, 'path', unit)}; lack of memory? try fewer --jobs. "
            "(A script that uses jobs > 1 needs the guard if __name__ == '__main__'.)"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _workers_without_ctrl_c() -> Iterator[None]:
    """Let processes that start meanwhile ignore Ctrl-C from their first instruction on.

    It reaches the whole process group; the parent ends the pool and says so once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signals
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
