"""Units of work spread over processes, threads or any executor, results in order.

An executor is a :class:`concurrent.futures.Executor` of the caller: a pool of the standard library, or Dask's
(``client.get_executor()``), whose workers may be on other machines. It is never shut down here. A bounded number of
units is in flight, so that no worker waits and results do not pile up.

A unit whose worker died is run once more, alone: if it ends that one too it is a failure that names it, and costs no
other unit. Processes end with this one, however it ends.
"""

from __future__ import annotations

import atexit
import copy
import os
import signal
import socket
import sys
import threading
import time
import traceback
import uuid
from collections import deque
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing import current_process, get_context, parent_process, resource_tracker
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from tqdm import tqdm

from eldata.errors import ArgumentError, EldataError, FileError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from multiprocessing.process import BaseProcess
    from pathlib import Path

Unit = TypeVar("Unit")
Result = TypeVar("Result")

_PER_WORKER = 4  # units in flight: enough to keep every worker busy, few enough to hold in memory
_UNSTATED_WORKERS = 16  # assumed for an executor that does not say how many it has
_MOST_LARGE = 16  # large results in flight, however many the workers: they are held in memory here
_MOST_PROCESSES = 61  # of a pool on Windows, which cannot wait for more
_GRACE_S = 5.0  # for work that is ended in its middle to unwind
_TERMINATED = 128 + signal.SIGTERM
_DIED_AGAIN = (
    "worker processes died at it again and again, in the end with it alone: a decoder that crashes, or lack of memory? "
    "Try fewer --jobs"
)
_NOT_RUN = (
    "was it shut down, did a worker die (lack of memory?), and is the same version of eldata installed on every worker?"
)
_AT_WORK = threading.Event()  # of a worker process of our own


@dataclass(frozen=True, slots=True)
class Failed(Generic[Unit]):
    """A unit without a result: the error that it raised, or why its worker was lost."""

    unit: Unit
    error: Exception

    @property
    def reason(self) -> str:
        """The error as a sentence."""
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
    executor: futures.Executor | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ArgumentError(f"workers must be 1 or more; found {self.jobs}")

    @classmethod
    def of(cls, workers: Workers | futures.Executor | int) -> Workers:
        """Convert a public function's ``workers``: a number of processes, an executor, or workers already."""
        if isinstance(workers, Workers):
            return workers
        if isinstance(workers, int):
            return cls(workers)
        if callable(getattr(workers, "submit", None)):
            return cls(executor=workers)
        raise ArgumentError(f"workers must be a whole number or an executor; found {workers!r}")

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
            Text of the progress bar on stderr. It shows on a terminal only.

        Raises
        ------
        EldataError
            What a unit of work raised, in its turn; or that no worker can be started.
        """
        return _raise_failures(self.attempt(work, units, label=label, unit=unit))

    def attempt(
        self, work: Callable[[Unit], Result], units: Sequence[Unit], *, label: str = "", unit: str = "file"
    ) -> Generator[Result | Failed[Unit], None, None]:
        """Yield ``work(unit)`` or, where that failed, :class:`Failed`, for each unit, in the units' order.

        Parameters and errors are those of :meth:`run`, except that a unit that fails, or that ends its worker twice,
        does not end the others.
        """
        with tqdm(total=len(units), desc=label, unit=unit, disable=None, leave=False) as bar:
            for outcome in self._run_units(work, units):
                if isinstance(outcome, Failed) and isinstance(outcome.error, ImportError):
                    raise outcome.error  # no unit is to blame, and none would succeed
                bar.update()
                yield outcome

    def _run_units(
        self, work: Callable[[Unit], Result], units: Sequence[Unit]
    ) -> Generator[Result | Failed[Unit], None, None]:
        """Yield each unit's result or failure, in the units' order, from the executor, processes or this thread."""
        if self.executor is not None:
            yield from _in_order(work, units, self.executor, _PER_WORKER * count_workers(self.executor) + 1)
        elif self.jobs > 1 and len(units) > 1:
            with Processes(min(self.jobs, len(units))) as processes:
                yield from _in_order(work, units, processes, _PER_WORKER * count_workers(processes) + 1)
        else:
            for unit in units:
                yield _run_unit(work, unit)

    def read_ahead(self, work: Callable[[Unit], Result], units: Iterable[Unit]) -> Iterator[Result]:
        """Yield ``work(unit)`` for each unit, in the units' order, computed by threads that run ahead.

        For work that releases the GIL, as decoding does, and whose results are too large to send between processes. At
        most ``jobs`` + 1 results are in memory; 1 works in the calling thread. With an executor, which replaces the
        threads, there is one result per worker and one more, never more than 17.

        Raises
        ------
        EldataError
            Like :meth:`run`, if there is an executor. Errors that ``work`` raises come through as they are, in their
            unit's turn.
        """
        if self.executor is not None:
            in_flight = min(count_workers(self.executor), _MOST_LARGE) + 1
            yield from _raise_failures(_in_order(work, units, self.executor, in_flight))
        elif self.jobs == 1:
            yield from map(work, units)
        else:
            pool = futures.ThreadPoolExecutor(self.jobs)
            try:
                yield from _raise_failures(_in_order(work, units, pool, self.jobs + 1))
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


IN_THIS_PROCESS = Workers()
"""The default of functions that are handed workers."""

AnyWorkers = Workers | futures.Executor | int
"""What a public function takes as ``workers``: how many processes, an executor, or :class:`Workers`."""


def require_files(*paths: Path) -> None:
    """Check that this machine can see the files; call it first in a worker.

    Raises
    ------
    FileError
        If it cannot see one: the machine that starts the work has seen them, a worker on another machine may not.
    """
    for path in paths:
        try:
            os.stat(path)  # noqa: PTH116 # its error says why not, where is_file() is silent
        except OSError as error:
            raise FileError(
                path,
                f"{error.strerror} on {socket.gethostname()}; every machine that takes part must see the same files "
                "under the same paths",
            ) from error


def count_workers(executor: futures.Executor) -> int:
    """Count the units that an executor runs at a time, as the standard library's and Dask's say; else guess."""
    client: Any = getattr(executor, "_client", None)
    if hasattr(client, "nthreads"):
        return sum(client.nthreads().values()) or _UNSTATED_WORKERS  # workers may come later
    return getattr(executor, "_max_workers", _UNSTATED_WORKERS)


# --- one unit, where it runs ------------------------------------------------------------------------------------------


def _submit(executor: futures.Executor, work: Callable[[Unit], Result], unit: Unit) -> futures.Future[Any]:
    """Submit a unit to an executor; if that is broken, its error is the future's."""
    # Dask takes equal calls for the same one, and answers with the result that it already has: hence the UUID.
    call = partial(_run_elsewhere, work, unit, os.getpid(), uuid.uuid4().hex)
    try:
        return executor.submit(call)
    except futures.BrokenExecutor as error:
        broken: futures.Future[Any] = futures.Future()
        broken.set_exception(error)  # broken by an earlier unit, which is reported first
        return broken


def _run_elsewhere(work: Callable[[Unit], Result], unit: Unit, caller: int, _: str) -> list[Result | Failed[Unit]]:
    """Run a unit in another thread or process; return its outcome in a list, which the caller empties.

    A thread holds on to what it returned until it runs again, and an outcome may be large.
    """
    try:
        _AT_WORK.set()
        outcome = _run_unit(work, unit)
        _AT_WORK.clear()
    except SystemExit:  # this process was told to end: it would be this unit's result, and the next one's turn
        if os.getpid() == caller:
            raise
        os._exit(_TERMINATED)
    if isinstance(outcome, Failed) and os.getpid() != caller:
        outcome = Failed(unit, _to_portable_error(outcome.error))
    return [outcome]


def _run_unit(work: Callable[[Unit], Result], unit: Unit) -> Result | Failed[Unit]:
    """Run a unit; return its error as a value, to distinguish it from an executor's own errors."""
    try:
        return work(unit)
    except Exception as error:  # noqa: BLE001 # whatever it is, it is the unit's
        return Failed(unit, error)


def _to_portable_error(error: Exception) -> Exception:
    """Make an error that another process can make again, with its traceback, which does not travel, as a note."""
    error.add_note(f"on {socket.gethostname()}, process {os.getpid()}:\n{''.join(traceback.format_exception(error))}")
    try:
        copy.copy(error)
    except Exception:  # noqa: BLE001 # its class may do anything
        return EldataError(f"unexpected {type(error).__name__}: {error}")
    return error


# --- all units --------------------------------------------------------------------------------------------------------


def _raise_failures(outcomes: Generator[Result | Failed[Any], None, None]) -> Iterator[Result]:
    """Yield results; the first failure is raised and ends the others."""
    with closing(outcomes):
        for outcome in outcomes:
            if isinstance(outcome, Failed):
                raise outcome.error
            yield outcome
            del outcome  # it may be large


def _in_order(
    work: Callable[[Unit], Result], units: Iterable[Unit], executor: futures.Executor, in_flight: int
) -> Generator[Result | Failed[Unit], None, None]:
    """Yield the outcomes of units on an executor; ``in_flight`` of them are submitted at a time."""
    left = iter(units)
    waiting: deque[tuple[Unit, futures.Future[Any]]] = deque()
    try:
        while True:
            for unit in islice(left, in_flight - len(waiting)):
                waiting.append((unit, _submit(executor, work, unit)))
            if not waiting:
                return
            unit, future = waiting[0]
            error = _await_error(future)
            if _is_loss(executor, error):
                # Only a unit that runs alone shows whether it was the one that ended the worker.
                futures.wait([other for _, other in waiting])
                if isinstance(executor, Processes):
                    executor.check()
                future = _submit(executor, work, unit)
                waiting[0] = unit, future
                error = _await_error(future)
            name = getattr(unit, "path", unit)
            if error is None:
                outcome = future.result().pop()
            elif _is_loss(executor, error):
                outcome = Failed(unit, EldataError(f"{name}: {_DIED_AGAIN}"))
            else:
                reason = f"the executor cannot run the work on {name}: {type(error).__name__}: {error}"
                raise EldataError(f"{reason}; {_NOT_RUN}") from error
            waiting.popleft()
            del future  # and with it the result, which may be large
            yield outcome
            del outcome
    finally:
        for _, future in waiting:
            future.cancel()


def _await_error(future: futures.Future[Any]) -> BaseException | None:
    """Wait for a future and take its error, or its cancellation; ``None`` if it has a result."""
    try:
        return future.exception()
    except futures.CancelledError as error:
        return error


def _is_loss(executor: futures.Executor, error: BaseException | None) -> bool:
    """Tell whether a future's error means that the unit's worker was lost, and the unit may be run again."""
    if isinstance(executor, Processes):
        return isinstance(error, BrokenProcessPool)
    # Dask runs a lost worker's units again by itself; this is its error for one that lost several workers. It blames
    # every unit on the worker, the innocent ones too.
    return type(error).__name__ == "KilledWorker"


# --- processes of our own ---------------------------------------------------------------------------------------------


def require_main_guard() -> None:
    """End a worker that runs the main script again because that has no main guard, with a message."""
    if getattr(current_process(), "_inheriting", False):  # as Python's own check asks
        sys.stderr.write('put work under if __name__ == "__main__": each worker process runs the script again\n')
        sys.stderr.flush()
        os._exit(1)


class Processes(futures.Executor):
    """A pool of spawned processes that is made anew if one of them dies, and that ends with this process."""

    def __init__(self, count: int) -> None:
        require_main_guard()
        self._max_workers = min(count, _MOST_PROCESSES)
        self._pool = self._new_pool()

    def _new_pool(self) -> futures.ProcessPoolExecutor:
        """Make a pool of worker processes, each a fresh interpreter."""
        return futures.ProcessPoolExecutor(self._max_workers, mp_context=get_context("spawn"), initializer=_begin)

    def submit(self, call: Callable[[], Any], /) -> futures.Future[Any]:  # type: ignore[override] # all that is used
        """Start a call, and the process for it."""
        with _ctrl_c_blocked():
            try:
                return self._pool.submit(call)
            except BrokenProcessPool:
                self._end()
                self._pool = self._new_pool()
                return self._pool.submit(call)

    def check(self) -> None:
        """Raise :class:`EldataError` if processes die before they are given any work."""
        if self.submit(os.getpid).exception() is not None:
            raise EldataError(
                "worker processes die as soon as they start: lack of memory, or a script without "
                'if __name__ == "__main__":? One job (--jobs 1, workers=1) needs none'
            )

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is None:
            self._pool.shutdown()
        else:  # an error, Ctrl-C, or a consumer that has enough
            self._end()

    def _end(self) -> None:
        """End the processes, also in the middle of work, which unwinds; those that do not are killed."""
        processes: list[BaseProcess] = list((self._pool._processes or {}).values())  # noqa: SLF001 # public from Python 3.14 on
        manager = getattr(self._pool, "_executor_manager_thread", None)
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        deadline = time.monotonic() + _GRACE_S
        try:
            for process in processes:
                process.join(max(0.0, deadline - time.monotonic()))
        finally:
            for process in processes:
                process.kill()
            # It closes the pipe by which the interpreter's end wakes it, and must not do both at a time.
            if manager is not None:
                manager.join(_GRACE_S)


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Shield the processes that are started in the block from a terminal's Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # else the first process starts it, and it lets Ctrl-C through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Begin a worker: Ctrl-C is its parent's to answer, SIGTERM unwinds its work, and it ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _unwind)
    atexit.register(os._exit, 0)  # all is sent by then, and taking modules apart takes a quarter of a second
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _unwind(number: int, _: object) -> None:
    """Handle SIGTERM in a worker, once: unwind its unit, or end at once if there is none."""
    signal.signal(number, signal.SIG_IGN)  # it comes twice: from the parent, and to its group
    if not _AT_WORK.is_set():  # the library would print what is raised
        os._exit(_TERMINATED)
    raise SystemExit(_TERMINATED)


def _end_with_parent() -> None:
    """Wait in a thread for the parent process to end, then end this process at once."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(_TERMINATED)
