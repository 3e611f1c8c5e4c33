"""Processes that do work for this one, a call at a time each, and end with it, however it ends.

One is started when it is first needed (a quarter of a second) and used again. It imports what a call needs, by name;
the user's script only if the call brings something that is defined there. Requests and answers are pickles that go
through its standard streams, so nothing is left behind if both sides are killed; arrays are not copied on their way.

A process says what it is about to do that may end it (:func:`announced`). If it then dies, the call is made again in a
new one; what is announced when that dies too is known to be fatal, and meets an error when the call is made once more.
So a file whose decoder crashes costs its process and an error, not the call that reads other files as well.

Why this is no library's: docs/architecture.md.
"""

from __future__ import annotations

import atexit
import copy
import errno
import io
import os
import pickle
import signal
import socket
import sys
import threading
import traceback
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from typing import IO, TYPE_CHECKING, Any, Final, TypeVar

from eldata.base.files import current_folder
from eldata.base.stopping import SIGNALS, Stopped, ending_of, exit_code, tell_again
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

Result = TypeVar("Result")

_GRACE_S: Final = 5.0  # for work to unwind, and for a process whose streams are closed to end


class LostError(EldataError):
    """A process ended in the middle of a call.

    Attributes
    ----------
    code
        Its exit code, minus the signal if one ended it.
    at
        What it had announced; empty if nothing, ``None`` if it had not even begun.
    """

    def __init__(self, code: int, at: str | None) -> None:
        super().__init__(code, at)
        self.code, self.at = code, at


def portable(error: Exception) -> Exception:
    """Return an error that another process can make again, with its traceback, which does not travel, as a note."""
    error.add_note(f"on {socket.gethostname()}, process {os.getpid()}:\n{''.join(traceback.format_exception(error))}")
    try:
        copy.copy(error)
    except Exception:  # noqa: BLE001 # its class may do anything
        return EldataError(f"unexpected {type(error).__name__}: {error}")
    return error


# --- the parent's side ------------------------------------------------------------------------------------------------


class Processes:
    """As many processes as calls are made at a time, by whatever threads.

    Parameters
    ----------
    instead
        What to do where the system refuses to start one, for the message.
    environment
        Variables that they have beside those of this process.
    """

    def __init__(self, instead: str, environment: Mapping[str, str] | None = None) -> None:
        self._instead, self._environment = instead, environment or {}
        self._all: set[_Process] = set()
        self._idle: list[_Process] = []  # append and pop are atomic
        self._has_ended = False
        self._lock = threading.Lock()
        _POOLS.append(self)

    def run(self, call: Callable[[], Result]) -> Result:
        """Return what a call returns in a process.

        Parameters
        ----------
        call
            Can be pickled, and found by name there. So can what it returns or raises.

        Raises
        ------
        LostError
            If its process died.
        EldataError
            If no process can be started.
        Exception
            Whatever the call raises.
        """
        content = pickle.dumps(call)
        fatal: dict[str, int] = {}
        suspects: set[str] = set()
        while True:
            process = self._idle.pop() if self._idle and not suspects else self._started()
            try:
                is_spent, returned, value = process.ask((current_folder(), fatal, content))
            except LostError as lost:
                self._all.discard(process)
                if self._has_ended or lost.at == "":
                    raise
                if lost.at is None and process.is_new:
                    raise EldataError(
                        f"worker processes die as soon as they start ({ending_of(lost.code)}); lack of memory? "
                        f"{self._instead}"
                    ) from None
                if lost.at is not None:
                    if lost.at in suspects or lost.code == -signal.SIGALRM:  # nobody else took its time
                        fatal[lost.at] = lost.code
                    suspects.add(lost.at)
                continue
            except BaseException:  # Ctrl-C: it may yet answer, and nobody waits for that
                self._all.discard(process)
                raise
            self._idle.append(process)
            if is_spent:
                self.end_idle()
            if returned:
                return value  # type: ignore[no-any-return]
            raise value

    def _started(self) -> _Process:
        with self._lock:
            if self._has_ended:
                raise LostError(0, "")
            try:
                process = _Process(os.environ | self._environment)
            except OSError as error:
                more = "let more files be open at a time (ulimit -n); " if error.errno == errno.EMFILE else ""
                raise EldataError(
                    f"a worker process cannot be started ({error.strerror or error}): {more}{self._instead}"
                ) from error
            self._all.add(process)
        return process

    def end_idle(self) -> None:
        """End the processes that have nothing to do."""
        ending, self._idle = self._idle, []
        for process in ending:
            process.dismiss()  # all before the first is waited for
        for process in ending:
            self._all.discard(process)
            process.end()

    def end(self) -> None:
        """End all processes, for good: also in the middle of work, which unwinds."""
        with self._lock:
            self._has_ended = True
        _POOLS.remove(self)
        self.end_idle()
        working = list(self._all)
        for process in working:
            process.terminate()
        for process in working:
            process.end()
        self._all.clear()

    def forget(self) -> None:
        """Let go of the processes, in a fork: they are its parent's."""
        for process in self._all:
            process.forget()
        self._idle.clear()
        self._all.clear()


class _Process:
    """One process, seen from its parent."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        import subprocess

        if _Here.imports_script:
            raise ArgumentError(
                f"worker processes run {_Here.script[1]} again from its first line, and would come back to where they "
                'are started: put that under if __name__ == "__main__":, or work without processes (workers=1)'
            )
        main = sys.modules.get("__main__")
        script = getattr(getattr(main, "__spec__", None), "name", None), getattr(main, "__file__", None)
        inherited, self._lifeline = os.pipe() if sys.platform == "linux" else (-1, -1)
        start = (
            f"import sys; sys.path[:] = {sys.path!r}; from eldata.base.processes import serve; "
            f"serve({inherited}, {sys.argv!r}, {script!r})"
        )
        flags = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined] # noqa: SLF001 # as multiprocessing does
        try:
            self._process = subprocess.Popen(  # noqa: S603 # this interpreter
                [sys.executable, *flags, "-c", start],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
                pass_fds=() if inherited < 0 else (inherited,),
                start_new_session=True,  # Ctrl-C and the end of a terminal are the parent's to answer
            )
        except OSError:
            self._cut()
            raise
        finally:
            if inherited >= 0:
                os.close(inherited)
        self._to: Any = self._process.stdin
        self._from: Any = self._process.stdout
        self.terminate = self._process.terminate
        self.is_new = True

    def ask(self, request: tuple[str | None, dict[str, int], bytes]) -> tuple[bool, bool, Any]:
        """Return what :func:`_answer` does of a request."""
        at: str | None = None
        try:
            pickle.dump(request, self._to)
            self._to.flush()
            while isinstance(answer := _load(self._from), str):
                at = answer
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):  # it, or we, have closed the streams
            raise LostError(self.end(), at) from None
        except BaseException:
            self._process.kill()
            self.end()
            raise
        self.is_new = False
        return answer  # type: ignore[no-any-return]

    def dismiss(self) -> None:
        """Let it end when it has nothing to do."""
        with suppress(OSError):  # it did not take all that was sent
            self._to.close()

    def end(self) -> int:
        """Close the streams; return the exit code, minus the signal if one ended it, once it has ended."""
        from subprocess import TimeoutExpired

        self.dismiss()
        try:
            code = self._process.wait(_GRACE_S)
        except TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        self._from.close()
        self._cut()
        return code

    def forget(self) -> None:
        """Close the streams as they are; its end would be looked for otherwise."""
        for stream in (self._to, self._from):
            stream.raw.close()
        self._cut()
        self._process.returncode = 0

    def _cut(self) -> None:
        """Close the pipe whose end the kernel tells the process of, which dies of that."""
        lifeline, self._lifeline = self._lifeline, -1
        if lifeline >= 0:
            os.close(lifeline)


def _load(answers: Any) -> Any:
    """Return what :func:`_tell` sent; arrays in memory of their own, which may be written to."""
    content, sizes = pickle.load(answers)  # noqa: S301 # a process of ours
    memory: list[Any] = []
    for size in sizes:
        import numpy as np

        memory.append(np.empty(size, np.uint8))
        if answers.readinto(memory[-1]) < size:
            raise EOFError
    return pickle.loads(content, buffers=memory)  # noqa: S301 # a process of ours


_POOLS: list[Processes] = []


@atexit.register
def _end_all() -> None:
    while _POOLS:
        _POOLS[-1].end()


def _forget_all() -> None:
    for pool in _POOLS:
        pool.forget()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)


# --- the process's side -----------------------------------------------------------------------------------------------


class _Here:
    """What this process is to another one, if it works for one."""

    parent: IO[bytes] | None = None
    is_busy = is_told = is_spent = imports_script = False
    fatal: Mapping[str, int]
    script: tuple[str | None, str | None]


def serves() -> bool:
    """Return whether this process works for another one, which notices its death."""
    return _Here.parent is not None


def earlier_end(work: str) -> int | None:
    """Return the exit code of the processes that died of some announced work; ``None`` if none did."""
    return _Here.fatal.get(work)


@contextmanager
def announced(work: str) -> Iterator[None]:
    """Tell the parent of work that may end this process: its name, the same whenever the call is made."""
    _tell(work)
    try:
        yield
    finally:
        _tell("")


def _tell(answer: Any) -> None:
    """Send an announcement or an answer; the memory of arrays goes behind it."""
    if _Here.parent is None:
        return
    arrays: list[pickle.PickleBuffer] = []
    content = pickle.dumps(answer, protocol=5, buffer_callback=arrays.append)
    memory = [array.raw() for array in arrays]
    pickle.dump((content, [part.nbytes for part in memory]), _Here.parent)
    for part in memory:
        _Here.parent.write(part)
    _Here.parent.flush()


def end_after_this() -> None:
    """Let this process end when it has answered: its memory is not what it was."""
    _Here.is_spent = True


class _Call(pickle.Unpickler):
    """What the user's script defines is looked for in its second run, as multiprocessing does."""

    def find_class(self, module: str, name: str) -> Any:
        if module == "__main__" and "__mp_main__" not in sys.modules:
            from multiprocessing import spawn

            its_name, path = _Here.script
            _Here.imports_script = True
            if its_name is not None:
                spawn._fixup_main_from_name(its_name)  # type: ignore[attr-defined] # noqa: SLF001 # nothing public does
            elif path is not None:
                spawn._fixup_main_from_path(path)  # type: ignore[attr-defined] # noqa: SLF001 # the same
            _Here.imports_script = False
        return super().find_class(module, name)


def serve(lifeline: int, argv: list[str], script: tuple[str | None, str | None]) -> None:
    """Answer the requests that come through standard input until it is closed."""
    sys.argv[:] = argv
    _Here.script = script
    requests, _Here.parent = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what is printed is not an answer
    sys.unraisablehook = _lost
    for number in SIGNALS:
        signal.signal(number, _end if number == signal.SIGTERM else signal.SIG_IGN)
    if sys.platform == "linux":
        _hang_on(lifeline)
    waiting: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests, waiting), daemon=True).start()
    while (request := waiting.get()) is not None:
        _Here.is_busy = True
        _tell("")
        try:
            answer = _answer(*request)
        except Stopped:
            _Here.is_told = True
        if _Here.is_told:  # a library may have made another error of it, or none
            os._exit(exit_code(signal.SIGTERM))
        _Here.is_busy = False
        try:
            _tell(answer)
        except (TypeError, AttributeError, pickle.PicklingError) as error:
            _tell((False, False, EldataError(f"what a worker returns cannot be sent: {error}")))


def _hang_on(lifeline: int) -> None:
    """Have the kernel end this process with its parent: :func:`_listen` cannot while a library keeps Python's lock.

    Nothing is ever written to the pipe, and only the parent holds its other end.
    """
    import fcntl

    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)


def _listen(requests: IO[bytes], waiting: SimpleQueue[Any]) -> None:
    """Pass requests on; end the process with its parent, even in the middle of some work."""
    with suppress(EOFError, pickle.UnpicklingError):
        while True:
            waiting.put(pickle.load(requests))  # noqa: S301 # the parent's own
    waiting.put(None)
    if _Here.is_busy:
        os._exit(exit_code(signal.SIGTERM))


def _end(number: int, _: object) -> None:
    if not _Here.is_busy:
        os._exit(exit_code(number))
    if not _Here.is_told:  # else it unwinds already
        _Here.is_told = True
        raise Stopped(number)


def _lost(unraisable: Any) -> None:
    """Tell this process to end once more where a library's callback dropped that; show what else was dropped."""
    if not isinstance(unraisable.exc_value, Stopped):
        sys.__unraisablehook__(unraisable)
    elif _Here.is_busy:
        _Here.is_told = False
        tell_again(unraisable.exc_value.number)


def _answer(folder: str | None, fatal: Mapping[str, int], content: bytes) -> tuple[bool, bool, Any]:
    """Make a call; return whether the process ends now, and whether it returned, with what it returned or raised."""
    _Here.fatal = fatal
    try:
        if folder is not None:
            os.chdir(folder)
        value = _Call(io.BytesIO(content)).load()()
    except Exception as error:  # noqa: BLE001 # whatever it is, it is the caller's
        return _Here.is_spent, False, portable(error)
    return _Here.is_spent, True, value
