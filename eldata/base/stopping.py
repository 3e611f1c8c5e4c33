"""How a program and its workers end when they are told to: Ctrl-C, SIGTERM, and SIGHUP of a terminal that is closed.

A command line goes through three stages. While it imports and parses, :func:`exit_when_told` ends it on the spot:
there is nothing to tidy. While its work runs, :func:`stoppable` raises :class:`Stopped` in it, which unwinds: files
that are half written are removed, workers end. Afterwards it ends on the spot again. Who asks twice is served at once,
even while the main thread is inside a call into C, for whose return Python's handlers wait: a thread ends the program
then, unless the call keeps the interpreter's lock.

What this module and the entry points import decides how soon the first stage begins: neither ``typing`` nor
``threading``, which would take as long as all the rest.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import time
from contextlib import contextmanager, nullcontext

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType
    from typing import Any, NoReturn

_WORDS = {
    name: words
    for name, words in (("SIGINT", "interrupted"), ("SIGTERM", "terminated"), ("SIGHUP", "ended with its terminal"))
    if hasattr(signal, name)  # Windows has no SIGHUP
}
SIGNALS = tuple(getattr(signal, name) for name in _WORDS)
"""The signals by which people, schedulers and terminals ask a process to end."""

_SAME_EVENT_S = 1.0  # timeout(1) sends SIGTERM twice at once, to its child and to the child's group


class Stopped(KeyboardInterrupt):  # no error, like its base
    """The process was told to end. What handles Ctrl-C handles it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def exit_code(number: int) -> int:
    """Return the exit code of a program that a signal ended, as shells have it: 130, 143, 129."""
    return 128 + number


def what_it_did(number: int) -> str:
    """Return what a signal did, such as ``"interrupted"``."""
    return _WORDS[signal.Signals(number).name]


def exit_when_told(program: str) -> None:
    """End this process at once, with one line, when it is told to from here on: where there is nothing to tidy.

    For programs only, not for what others may import. A signal that is ignored, as under ``nohup``, stays so.
    """

    def leave(number: int, _: FrameType | None) -> None:
        _exit(number, program)

    for its in _ours():
        signal.signal(its, leave)


def _exit(number: int, program: str) -> NoReturn:
    try:
        os.write(2, f"{program}: {what_it_did(number)}\n".encode())
    finally:  # whether or not anybody sees it
        os._exit(exit_code(number))


def _ours() -> Iterator[int]:
    """Yield the signals whose handling is ours to choose: not those that somebody ignores or handles already."""
    for number in SIGNALS if _in_main_thread() else ():
        handler = signal.getsignal(number)
        if handler in (signal.SIG_DFL, signal.default_int_handler) or getattr(handler, "__module__", "") == __name__:
            yield number


def _in_main_thread() -> bool:
    """Whether this is the thread that handles signals, and the only one that may set how."""
    threading = sys.modules.get("threading")  # if nothing has imported it, there is one thread
    return threading is None or threading.current_thread() is threading.main_thread()


class Stopping:
    """Whether this process has been told to end, and by what.

    If it is told again, more than a second later, it ends at once: ``program`` is what it then calls itself. With
    ``None``, where the process is not ours to end, :class:`Stopped` is raised again.
    """

    def __init__(self, program: str | None) -> None:
        self.number: int | None = None
        self._program = program
        self._since = 0.0
        self._again = False
        self._is_watched = False

    def told(self, number: int, _: FrameType | None) -> None:
        """Handle a signal: the first unwinds; a later one is impatience, and ends a program at once."""
        if self.number is None:
            self.number, self._since = number, time.monotonic()
        elif self._again:
            self._again = False
        elif self._is_watched or time.monotonic() - self._since < _SAME_EVENT_S:
            return
        elif self._program is not None:
            _exit(self.number, self._program)
        raise Stopped(self.number)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Have a thread end the program when it is told again: C's own handler of signals writes to it at once."""
        if self._program is None or not hasattr(signal, "pthread_sigmask"):  # Windows has neither masks nor such pipes
            yield
            return
        told, telling = os.pipe()
        os.set_blocking(telling, False)
        before = signal.set_wakeup_fd(telling, warn_on_full_buffer=False)
        _thread.start_new_thread(_watch, (told, self._program))
        self._is_watched = True
        try:
            yield
        finally:
            self._is_watched = False
            signal.set_wakeup_fd(before)
            os.close(telling)  # which ends the thread

    def after(self, before: Any) -> Any:
        """Return what handles a signal once the work is over: of a program what ends it, else what did before."""
        program = self._program
        if program is None:
            return before

        def leave(number: int, _: FrameType | None) -> None:
            if self.number is None or time.monotonic() - self._since > _SAME_EVENT_S:
                _exit(self.number or number, program)

        return leave

    def lost(self, unraisable: Any) -> bool:
        """Raise again what was raised where Python drops exceptions, as in ``__del__``; return whether it was that."""
        if not isinstance(unraisable.exc_value, Stopped):
            return False
        self._again = True
        tell_again(unraisable.exc_value.number)
        return True


def _watch(told: int, program: str) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # they are to interrupt the main thread
    first, since = 0, 0.0
    while numbers := os.read(told, 64):
        for number in filter(SIGNALS.__contains__, numbers):
            if not first:
                first, since = number, time.monotonic()
            elif time.monotonic() - since >= _SAME_EVENT_S:
                _exit(first, program)
    os.close(told)


def ending_of(code: int) -> str:
    """Return an exit code in words, such as ``exit code 3`` or ``SIGSEGV``."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def tell_again(number: int) -> None:
    """Have the main thread handle a signal again, soon: what its handler raised was dropped in somebody's callback."""
    _thread.start_new_thread(_again_soon, (number,))


def _again_soon(number: int) -> None:
    import threading

    time.sleep(0.01)  # or it would be raised in the hook, and dropped again
    if hasattr(signal, "pthread_kill"):  # which wakes it from a system's call, too
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


_current: Stopping | None = None


def raise_if_told() -> None:
    """Raise :class:`Stopped` again if the command that runs has been told to end, and a library made nothing of it.

    For the seams of long work: an import that is interrupted may end in any other error, or in none.
    """
    if _current is not None and _current.number is not None and _in_main_thread():
        raise Stopped(_current.number)


@contextmanager
def stoppable(state: Stopping) -> Iterator[None]:
    """Raise :class:`Stopped` in the block when the process is told to end, and again at its end if that was lost.

    In threads other than the main one, and for signals that somebody else handles or ignores, nothing changes.
    """
    global _current  # noqa: PLW0603 # signals are the process's
    before = {number: signal.getsignal(number) for number in _ours()}
    hook, outer = sys.unraisablehook, _current

    def watching(unraisable: Any) -> None:
        if not state.lost(unraisable):
            hook(unraisable)

    try:
        if before:
            _current = state
            sys.unraisablehook = watching
        for number in before:
            signal.signal(number, state.told)
        with state.watched() if before else nullcontext():
            yield
        if state.number is not None:
            raise Stopped(state.number)
    finally:
        for number, handler in before.items():
            signal.signal(number, state.after(handler))
        sys.unraisablehook = hook
        _current = outer


@contextmanager
def held() -> Iterator[None]:
    """Put off the signals of :data:`SIGNALS` to the end of the block, where half the work would be worse than none.

    For moments such as the start of a process, of which nobody would know if an exception came in between.
    """
    arrived: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        arrived.append(number)

    before: dict[int, Any] = {}
    try:
        for number in SIGNALS if _in_main_thread() else ():
            handler = signal.getsignal(number)
            if callable(handler):
                before[number] = handler
                signal.signal(number, note)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in arrived:
            before[number](number, None)
