"""Worker processes that end with their parent, however it ends.

Parent and workers hold the two ends of a pair of sockets. The parent's end is closed by :meth:`Lifeline.cut`, or by the
system if the parent is killed; a thread of each worker waits for that. A worker without work then ends at once. In one
that works, :class:`~eldata.base.stopping.Stopped` is raised, so that a half-written file is removed; if a long call
into C does not let that happen within five seconds, it ends nevertheless.

A library that keeps the interpreter's lock for long could keep that thread from running. On Linux the kernel therefore
kills workers whose parent is gone; :class:`Lifeline` says when that is safe.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.queues import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from eldata.base.stopping import SIGNALS, Stopped, exit_code, held

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

Result = TypeVar("Result")

_GRACE_S = 5.0  # for a unit to unwind
_START_S = 15.0  # for a worker that starts to notice: it imports first
_LOOK_S = 1.0  # how often a worker looks for its parent, should another process have inherited the parent's end


# --- the parent's side ------------------------------------------------------------------------------------------------


class Lifeline:
    """The parent's end, cut when no worker is wanted any more, and the ``context`` of the pool that starts them.

    A worker that the kernel is to kill with its parent is in fact killed with the *thread* that started it, so the
    kernel is asked only where that is the main thread.
    """

    def __init__(self) -> None:
        if sys.platform != "win32":
            with held(), _blocked():
                # Of multiprocessing, it ignores Ctrl-C and SIGTERM and would die of SIGHUP, with many words. Its start
                # also ends the blocking, and would do so while a worker starts.
                resource_tracker.ensure_running()
        self._ours, self._theirs = socket.socketpair()
        self.context = _Spawning()

    @property
    def arguments(self) -> tuple[Any, ...]:
        """What :func:`begin` takes, to be sent to each worker as it starts."""
        return self._theirs, _InMainThread()

    def cut(self) -> None:
        """End the workers, and wait for that."""
        self._theirs.close()
        with self._ours, suppress(OSError):  # they may be gone already
            self._ours.shutdown(socket.SHUT_WR)
            self._ours.settimeout(_GRACE_S + _START_S)
            self._ours.recv(1)  # nothing, once each of them has closed its end
        for worker in self.context.workers:
            if worker.pid is not None:  # the system may have refused to start it
                worker.kill()


class _InMainThread:
    """Arrives at a worker as whether the parent's main thread has started it."""

    def __reduce__(self) -> tuple[type[bool], tuple[bool]]:
        return bool, (threading.current_thread() is threading.main_thread(),)


class _Worker(SpawnProcess):
    """A process in which signals wait until :func:`begin` has said what they do."""

    def start(self) -> None:
        with held(), _blocked():  # or nobody would know of a process that was half started
            super().start()


class _Spawning(SpawnContext):
    """The context of a process pool, which knows its workers."""

    def __init__(self) -> None:
        self.workers: list[_Worker] = []

    def Process(self, *arguments: Any, **options: Any) -> _Worker:  # type: ignore[override] # noqa: N802 # so called there
        worker = _Worker(*arguments, **options)
        self.workers.append(worker)
        return worker


@contextmanager
def _blocked() -> Iterator[None]:
    """Block the signals of a stop in this thread, and from the first instruction on in processes started inside."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# --- the worker's side ------------------------------------------------------------------------------------------------


class _Worked:
    """What this worker does at the moment."""

    busy = False
    told = False


def begin(lifeline: socket.socket, by_main_thread: bool) -> None:  # as a pool passes it
    """Begin a worker's life: from here on it ends with its parent. Ctrl-C and its like are the parent's to answer."""
    parent = multiprocessing.parent_process()
    watched: list[Any] = [lifeline]
    for number in SIGNALS:
        signal.signal(number, _end if number == signal.SIGTERM else signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        # Written to when the signal comes, where its handler may have to wait for a call into C to return.
        told, telling = socket.socketpair()
        telling.setblocking(False)
        signal.set_wakeup_fd(telling.detach(), warn_on_full_buffer=False)
        watched.append(told)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    if by_main_thread and sys.platform == "linux":
        _die_with_parent()
    threading.Thread(target=_watch, args=(watched, parent and parent.pid), daemon=True).start()


def interruptible(unit: Callable[[], Result]) -> Result:
    """Return what a unit of work returns, unless the worker is told to end meanwhile."""
    _Worked.busy = True
    try:
        result = unit()
    except Stopped as stopped:
        os._exit(exit_code(stopped.number))
    finally:
        _Worked.busy = False
    if _Worked.told:  # a library made another error of it, or none
        os._exit(exit_code(signal.SIGTERM))
    return result


def _end(number: int, frame: FrameType | None) -> None:
    if _Worked.told or _sends(frame):
        return  # it unwinds already; or half a result would make the parent wait for the other half: asked again soon
    if not _Worked.busy:
        os._exit(exit_code(number))
    _Worked.told = True
    raise Stopped(number)


def _sends(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code is SimpleQueue.put.__code__:
            return True
        frame = frame.f_back
    return False


def _watch(watched: list[Any], parent: int | None) -> None:
    # An orphan gets another parent. (Windows never says so; there the lifeline has to do.)
    while not connection.wait(watched, _LOOK_S) and (sys.platform == "win32" or os.getppid() == parent):
        pass
    end = time.monotonic() + _GRACE_S
    while hasattr(signal, "pthread_kill") and time.monotonic() < end:
        # To the thread that works, and that may wait for something: this one would take the signal of os.kill.
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
        time.sleep(0.05)
    os._exit(exit_code(signal.SIGTERM))


def _die_with_parent() -> None:
    import ctypes

    with suppress(OSError, AttributeError):  # without it the thread has to do
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
