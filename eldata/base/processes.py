"""A pool of spawned processes that ends with this one, however it ends: the library's, and what it leaves open.

The library's own workers wait for ever if their parent is killed, get Ctrl-C of a terminal beside it, and are all lost
if one of them dies.
"""

from __future__ import annotations

import atexit
import errno
import os
import signal
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process, resource_tracker
from typing import TYPE_CHECKING, Any

from eldata.base.arguments import require_main_guard
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.process import BaseProcess

TERMINATED = 128 + signal.SIGTERM
"""The exit code of a worker that was told to end."""

_MOST_PROCESSES = 61  # of a pool on Windows, which cannot wait for more
_GRACE_S = 5.0  # for work that is ended in its middle to unwind
_ONE_JOB = "one job (--jobs 1, workers=1) needs none"


@contextmanager
def hold_signals() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of a block: a library in C loses what is raised where it calls Python."""
    held: list[int] = []
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # no other is sent any
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        handlers = {number: handler for number, handler in handlers.items() if handler is not None}
    try:
        for number in handlers:
            signal.signal(number, lambda number, _: held.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in held[:1]:
            signal.raise_signal(number)


class Ended(SystemExit):  # quiet, where nothing catches it
    """A worker was told to end; its work unwinds."""


class Processes(Executor):
    """A pool of spawned processes that is made anew if one of them dies, and that ends with this process.

    Raises
    ------
    ArgumentError
        If they would come back to where they are started: the script has no main guard.
    """

    def __init__(self, count: int) -> None:
        require_main_guard()
        self._max_workers = min(count, _MOST_PROCESSES)
        with _starting():
            self._pool = self._new_pool()

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._max_workers, mp_context=get_context("spawn"), initializer=_begin)

    def submit(self, call: Callable[[], Any], /) -> Future[Any]:  # type: ignore[override] # all that is used
        """Start a call.

        Raises
        ------
        EldataError
            If the system starts no process.
        """
        with _starting():
            try:
                return self._pool.submit(call)
            except BrokenProcessPool:
                self._end()
                self._pool = self._new_pool()
                return self._pool.submit(call)

    def check(self) -> None:
        """Raise :class:`EldataError` if processes die before they are given any work."""
        if self.submit(os.getpid).exception() is not None:
            raise EldataError(f"worker processes die as soon as they start; lack of memory? {_ONE_JOB}")

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
def _starting() -> Iterator[None]:
    """Let Ctrl-C of a terminal, which goes to all processes, pass by those that are started in the block.

    Raises
    ------
    EldataError
        If the system starts none.
    """
    masked = hasattr(signal, "pthread_sigmask")  # not on Windows
    try:
        if masked:
            resource_tracker.ensure_running()  # else the first process starts it, and it lets Ctrl-C through again
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            if masked:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
    except OSError as error:
        more = "let more files be open at a time (ulimit -n); " if error.errno == errno.EMFILE else ""
        raise EldataError(
            f"a worker process cannot be started ({error.strerror or error}): {more}{_ONE_JOB}"
        ) from error


def _begin() -> None:
    """Begin a worker: Ctrl-C is its parent's to answer, SIGTERM unwinds its work, and it ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _unwind)
    atexit.register(os._exit, 0)  # all is sent by then, and taking modules apart takes a quarter of a second
    threading.Thread(target=_end_with_parent, daemon=True).start()
    parent = parent_process()
    if sys.platform == "linux" and parent is not None:
        import fcntl

        # The thread cannot while a library keeps Python's lock. The kernel can: it tells of the pipe's other end, which
        # the parent holds open and never writes to again.
        pipe = parent.sentinel
        signal.signal(signal.SIGIO, signal.SIG_DFL)
        fcntl.fcntl(pipe, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)


def _unwind(number: int, _: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # it comes twice: from the parent, and to its group
    raise Ended(TERMINATED)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(TERMINATED)
