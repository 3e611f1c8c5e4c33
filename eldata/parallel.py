"""Units of work spread over processes, results in order, with a progress bar on a terminal."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, TypeVar

from tqdm import tqdm

from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

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
    if jobs < 1:
        raise ArgumentError(f"jobs must be 1 or more; found {jobs}")
    with tqdm(total=len(units), desc=label, unit=unit, disable=None, leave=False) as bar:
        results = _in_processes(work, units, jobs) if jobs > 1 and len(units) > 1 else map(work, units)
        for result in results:
            bar.update()
            yield result


def _in_processes(work: Callable[[Unit], Result], units: Sequence[Unit], jobs: int) -> Iterator[Result]:
    pool = ProcessPoolExecutor(
        min(jobs, len(units)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_leave_ctrl_c_to_parent,
    )
    waiting: deque[tuple[Unit, Future[Result]]] = deque()
    try:
        for unit in units:
            waiting.append((unit, pool.submit(work, unit)))
            if len(waiting) > 4 * jobs:  # enough to keep every worker busy, few enough to hold in memory
                yield waiting.popleft()[1].result()
        while waiting:
            yield waiting[0][1].result()
            waiting.popleft()
    except BrokenProcessPool as error:
        raise EldataError(
            f"a worker process died, probably for lack of memory, at or soon after {waiting[0][0] if waiting else ''}; "
            "try fewer jobs (--jobs)"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _leave_ctrl_c_to_parent() -> None:
    # Ctrl-C reaches the whole process group; the parent ends the pool and says so once.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
