"""Units of work spread over processes, threads or any executor, results in order.

An executor is a :class:`concurrent.futures.Executor` of the caller: a pool of the standard library, or Dask's
(``client.get_executor()``), whose workers may be on other machines. It is never shut down here. A bounded number of
units is in flight: four for each worker if the executor says how many it has, so that none waits for work and results
do not pile up; else 64.

A unit whose worker died is run once more, alone: if it ends that one too it is a failure that names it, and costs no
other unit.
"""

from __future__ import annotations

import copy
import os
import socket
import sys
import traceback
import uuid
from collections import deque
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from tqdm import tqdm

from eldata.base.processes import TERMINATED, Ended, Processes
from eldata.errors import ArgumentError, EldataError, FileError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from pathlib import Path

Unit = TypeVar("Unit")
Result = TypeVar("Result")

_PER_WORKER = 4  # units in flight: enough to keep every worker busy, few enough to hold in memory
_UNSTATED_WORKERS = 16  # assumed for an executor that does not say how many it has
_MOST_LARGE = 16  # large results in flight, however many the workers: they are held in memory here


class UnseenFileError(FileError):
    """The machine that is to work on a file cannot see it."""


@dataclass(frozen=True, slots=True)
class Failed(Generic[Unit]):
    """A unit without a result: what it raised, or why its worker was lost."""

    unit: Unit
    error: Exception

    @property
    def reason(self) -> str:
        """What went wrong, as a sentence."""
        if isinstance(self.error, EldataError):
            return str(self.error)
        if isinstance(self.error, OSError):
            return f"{self.error.filename}: {self.error.strerror}" if self.error.filename else str(self.error)
        return f"unexpected {type(self.error).__name__}: {self.error}"


@dataclass(frozen=True, slots=True)
class Workers:
    """Where units of work run: in this process, in processes or threads of our own, or on the caller's executor.

    Made once, at the edge (a command line, a public function), and passed on whole.

    Attributes
    ----------
    jobs
        How many units run at a time, in worker processes (:meth:`run`, :meth:`attempt`) or threads
        (:meth:`read_ahead`); 1 works in this process.
    executor
        Runs the units instead, if given; ``jobs`` is then ignored. It is never shut down here.

    Raises
    ------
    ArgumentError
        If ``jobs`` is not positive.
    """

    jobs: int = 1
    executor: Executor | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ArgumentError(f"workers must be 1 or more; found {self.jobs}")

    @classmethod
    def of(cls, given: Workers | Executor | int) -> Workers:
        """Return what a public function's ``workers`` means: a number of processes, an executor, or this itself."""
        if isinstance(given, Workers):
            return given
        if isinstance(given, int):
            return cls(given)
        if callable(getattr(given, "submit", None)):
            return cls(executor=given)
        raise ArgumentError(f"workers must be a whole number or an executor; found {given!r}")

    @property
    def threads_within(self) -> int | None:
        """How many threads a unit's own work may use: one if units run side by side, else ``None``: all CPUs."""
        return None if self.jobs == 1 and self.executor is None else 1

    @contextmanager
    def sharing(self) -> Iterator[Workers]:
        """Yield workers whose processes are started once for all that is run in the block."""
        if self.executor is not None or self.jobs == 1:
            yield self
        else:
            with Processes(self.jobs) as processes:
                yield Workers(self.jobs, processes)

    def run(
        self, work: Callable[[Unit], Result], units: Sequence[Unit], *, label: str = "", unit: str = "file"
    ) -> Iterator[Result]:
        """Yield ``work(unit)`` for each unit, in the units' order; the first failure ends it.

        Parameters
        ----------
        work
            A function of a module's top level: worker processes are spawned, not forked, and import it by name.
        units
            Picklable and small: paths, not pixels.
        label, unit
            What the progress bar on stderr says. It shows on a terminal only.

        Raises
        ------
        EldataError
        What a unit of work raised, in its turn; or that no worker can be started.
        """
        return _results(self.attempt(work, units, label=label, unit=unit))

    def attempt(
        self, work: Callable[[Unit], Result], units: Sequence[Unit], *, label: str = "", unit: str = "file"
    ) -> Generator[Result | Failed[Unit], None, None]:
        """Yield ``work(unit)`` or, where that failed, :class:`Failed`, for each unit, in the units' order.

        Parameters and errors are those of :meth:`run`, except that a unit that fails, or that ends its worker twice,
        does not end the others.
        """
        with tqdm(total=len(units), desc=label, unit=unit, disable=None, leave=False) as bar:
            for outcome in _outcomes(work, units, self):
                if isinstance(outcome, Failed) and isinstance(outcome.error, ImportError):
                    raise outcome.error  # no unit is to blame, and none would succeed
                bar.update()
                yield outcome

    def read_ahead(self, work: Callable[[Unit], Result], units: Iterable[Unit]) -> Iterator[Result]:
        """Yield ``work(unit)`` for each unit, in the units' order, computed by threads that run ahead.

        For work that releases the GIL, as decoding does, and whose results are too large to send between processes. At
        most ``jobs`` + 1 results are in memory; 1 works in the calling thread. An executor takes the threads' place,
        with at most two results per worker and one more in memory, and never more than 17.

        Raises
        ------
        EldataError
            Like :meth:`run`, if there is an executor. Errors that ``work`` raises come through as they are, in their
            unit's turn.
        """
        if self.executor is not None:
            yield from _results(_in_order(work, units, self.executor, per_worker=2, most=_MOST_LARGE))
        elif self.jobs == 1:
            yield from map(work, units)
        else:
            pool = ThreadPoolExecutor(self.jobs)
            try:
                yield from _results(_in_order(work, units, pool, per_worker=1))
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


IN_THIS_PROCESS = Workers()
"""The default of functions that are handed workers."""

AnyWorkers = Workers | Executor | int
"""What a public function takes as ``workers``: how many processes, an executor, or :class:`Workers`."""


def require_files(*paths: Path) -> None:
    """Raise :class:`UnseenFileError` unless this machine sees every file: for the first line of a unit's work.

    The machine that starts the work has seen them; a worker on another machine may not.
    """
    for path in paths:
        try:
            os.stat(path)  # noqa: PTH116 # its error says why not, where is_file() is silent
        except OSError as error:
            raise UnseenFileError(
                path,
                f"{error.strerror} on {socket.gethostname()}; every machine that takes part must see the same files "
                "under the same paths",
            ) from error


def slots_of(executor: Executor) -> int:
    """Return how many units an executor runs at a time, as the standard library's and Dask's say; else a guess."""
    client: Any = getattr(executor, "_client", None)
    if hasattr(client, "nthreads"):
        return sum(client.nthreads().values()) or _UNSTATED_WORKERS  # workers may come later
    return getattr(executor, "_max_workers", _UNSTATED_WORKERS)


# --- one unit, where it runs ------------------------------------------------------------------------------------------


def _call(work: Callable[[Unit], Result], unit: Unit) -> Callable[[], list[Result | Failed[Unit]]]:
    """Return a unit's work for another worker: its outcome comes in a list, to be taken out of it.

    A thread holds on to what it returned until it runs again, some time after the result is there, and an outcome may
    be large.
    """
    # Dask takes equal calls for the same one, and answers with the result that it already has.
    return partial(_run_elsewhere, work, unit, os.getpid(), uuid.uuid4().hex)


def _run_elsewhere(work: Callable[[Unit], Result], unit: Unit, caller: int, _: str) -> list[Result | Failed[Unit]]:
    try:
        outcome = _run_unit(work, unit)
    except Ended:
        os._exit(TERMINATED)  # else it would be this unit's result, and the next one's turn
    if isinstance(outcome, Failed) and os.getpid() != caller:
        outcome = Failed(unit, _portable(outcome.error))
    return [outcome]


def _run_unit(work: Callable[[Unit], Result], unit: Unit) -> Result | Failed[Unit]:
    """Return a unit's result, or its error as a value: what an executor itself raises can then be told from it."""
    try:
        return work(unit)
    except Exception as error:  # noqa: BLE001 # whatever it is, it is the unit's
        return Failed(unit, error)


def _portable(error: Exception) -> Exception:
    """Return an error that another process can make again, with its traceback, which does not travel, as a note."""
    error.add_note(f"on {socket.gethostname()}, process {os.getpid()}:\n{''.join(traceback.format_exception(error))}")
    try:
        copy.copy(error)
    except Exception:  # noqa: BLE001 # its class may do anything
        return EldataError(f"unexpected {type(error).__name__}: {error}")
    return error


def _results(outcomes: Generator[Result | Failed[Any], None, None]) -> Iterator[Result]:
    """Yield results; the first failure is raised and ends the others."""
    with closing(outcomes):
        for outcome in outcomes:
            if isinstance(outcome, Failed):
                raise outcome.error
            yield outcome
            del outcome  # it may be large


# --- all units --------------------------------------------------------------------------------------------------------


def _outcomes(
    work: Callable[[Unit], Result], units: Sequence[Unit], workers: Workers
) -> Iterator[Result | Failed[Unit]]:
    if workers.executor is not None:
        yield from _in_order(work, units, workers.executor, per_worker=_PER_WORKER)
    elif workers.jobs > 1 and len(units) > 1:
        with Processes(min(workers.jobs, len(units))) as processes:
            yield from _in_order(work, units, processes, per_worker=_PER_WORKER)
    else:
        for unit in units:
            yield _run_unit(work, unit)


def _in_order(
    work: Callable[[Unit], Result],
    units: Iterable[Unit],
    executor: Executor,
    *,
    per_worker: int,
    most: int = sys.maxsize,
) -> Generator[Result | Failed[Unit], None, None]:
    left = iter(units)
    waiting: deque[tuple[Unit, Future[Any]]] = deque()
    window = asked = 0
    try:
        while True:
            if asked == 0:  # now and then: a cluster may grow, or shrink
                window = asked = min(per_worker * slots_of(executor), most) + 1
            asked -= 1
            for unit in islice(left, max(0, window - len(waiting))):
                waiting.append((unit, _submit(executor, _call(work, unit))))
            if not waiting:
                return
            unit, future = waiting[0]
            error = _error_of(future)
            if _is_loss(executor, error):
                # Only a unit that runs alone shows whether it was the one that ended the worker.
                wait([other for _, other in waiting])
                if isinstance(executor, Processes):
                    executor.check()
                future = _submit(executor, _call(work, unit))
                waiting[0] = unit, future
                error = _error_of(future)
            if error is None:
                found = future.result().pop()
            elif _is_loss(executor, error):
                found = Failed(unit, EldataError(_loss(executor, _unit_name(unit))))
            else:
                raise _unrunnable(unit, error) from error
            waiting.popleft()
            del future  # and with it the result, which may be large
            yield found
            del found
    finally:
        for _, future in waiting:
            future.cancel()


def _submit(executor: Executor, call: Callable[[], Any]) -> Future[Any]:
    try:
        return executor.submit(call)
    except EldataError:  # a process of our own cannot be started
        raise
    except BrokenExecutor as error:
        broken: Future[Any] = Future()
        broken.set_exception(error)  # broken by an earlier unit, which is reported first
        return broken
    except Exception as error:  # each executor has its own, for a shutdown or a lost cluster
        raise ArgumentError(f"the executor takes no work: {error}") from error


def _error_of(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _is_loss(executor: Executor, error: BaseException | None) -> bool:
    """Return whether a future's error means that the unit's worker was lost, and the unit may be run again."""
    if isinstance(executor, Processes):
        return isinstance(error, BrokenProcessPool)
    # Dask runs a lost worker's units again by itself; this is its error for one that lost several workers. It blames
    # every unit on the worker, the innocent ones too.
    return type(error).__name__ == "KilledWorker"


def _loss(executor: Executor, name: str) -> str:
    """Return the sentence about a unit that was lost twice."""
    if isinstance(executor, Processes):
        return (
            f"{name}: a worker process died at it twice, the second time with nothing else beside it: a decoder that "
            "crashes, or lack of memory? Try fewer --jobs"
        )
    return (
        f"{name}: the workers that ran it died again and again, in the end with nothing else beside it; lack of "
        "memory? their logs may tell"
    )


def _unit_name(unit: object) -> str:
    """Return what messages call a unit: its path, if it has one."""
    return str(getattr(unit, "path", unit))


def _unrunnable(unit: object, error: BaseException) -> EldataError:
    """Return what is wrong if not the unit's work failed, but the attempt to run it."""
    name = _unit_name(unit)
    if isinstance(error, CancelledError):
        return EldataError(f"the work on {name} was cancelled; was the executor shut down, or its scheduler restarted?")
    if isinstance(error, BrokenExecutor):
        return EldataError(
            f"the executor broke at or soon after {name}: a worker died; lack of memory? make a new executor, with "
            "fewer workers"
        )
    return EldataError(
        f"the executor cannot run the work on {name}: {type(error).__name__}: {error}; is the same version of eldata "
        "installed on every worker (with Dask, on the scheduler too)?"
    )
