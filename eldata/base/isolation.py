"""Work on a stranger's file in a process of its own: a decoder that crashes, hangs or eats memory is one error.

Where isolation is on (:func:`isolation`, ``--isolate``), :func:`guarded` calls a function in a helper process with
limits on time and memory. A helper knows numpy and the decoder, not torch. It starts when it is first needed (a quarter
of a second) and is used again by whichever thread asks next; there are as many as threads that ask at a time. It ends
with its parent, however that ends, and never sees Ctrl-C.

Requests and answers go through a pair of sockets, so nothing is left behind if both are killed. Arrays pass through it
as they are: 24 MB take 4 ms of the parent and 3 ms of the helper, less than shared memory without a name, whose pages
are new each time (9 and 10).

Only a helper that was new can be blamed on a file: where one that has worked before crashes or runs out of memory, the
work is done again in a new one.

This contains accidents, not attackers: a helper has all rights of its user. What it answers is unpickled, but only
records of ours, arrays and plain values are admitted.

Pebble's pool, the one well-kept library with limits on time, was measured first: such an array costs 52 ms of the
parent alone, memory has no limit, and its spawned processes run the user's script again. loky has no limit on either.
"""

from __future__ import annotations

import atexit
import builtins
import io
import os
import pickle
import signal
import socket
import struct
import sys
import threading
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from eldata.base.files import check_posix, current_folder, file_problem
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from eldata.errors import FileError

Result = TypeVar("Result")

VARIABLE = "ELDATA_ISOLATE"
"""The environment variable that holds the setting, so that processes started from here have it too: 1 is on."""

_CAN_ISOLATE = hasattr(os, "register_at_fork")  # a POSIX system
_START_S = 120.0  # for a helper to start: a third of a second on an idle machine
_GRACE_S = 5.0  # after its limit a helper whose parent is gone ends by itself
_LARGE_BYTES = 1 << 16  # smaller arrays are pickled with the rest
_SOCKET_BYTES = 1 << 18
# Of a helper: no threads that it does not use; and one frame's memory is used again for the next (by glibc), where new
# pages cost more than sending the pixels does.
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(1 << 30),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 30),
}


class GuardError(EldataError):
    """Guarded work ended without a result; the message says how, and reads on from a file's name."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What guarded work may use.

    Attributes
    ----------
    seconds
        Of wall time. The largest camera raws decode in five seconds; a loaded machine or a slow disk gets 60.
    memory_bytes
        Of the helper's own data (RLIMIT_DATA, which counts what is used and not, as RLIMIT_AS does, what is merely
        reserved). 2 GiB hold a raw of 150 megapixels four times over. macOS does not enforce it.
    """

    seconds: float = 60.0
    memory_bytes: int = 2 << 30

    def __post_init__(self) -> None:
        if not (self.seconds > 0 and self.memory_bytes > 0):
            raise ArgumentError(f"limits must be positive; found {self}")


LIMITS = Limits()


def isolating() -> bool:
    """Return whether strangers' files are decoded in guarded processes.

    Raises
    ------
    ArgumentError
        If the environment variable holds anything but 0 or 1.
    """
    stated = os.environ.get(VARIABLE, "")
    if stated not in ("", "0", "1"):
        raise ArgumentError(f"{VARIABLE} must be 0 or 1; found {stated!r}")
    return stated == "1"


def set_isolation(on: bool) -> None:
    """Turn isolation on or off for this process and those that it starts from now on.

    Raises
    ------
    EldataError
        If it is to be on and this system is not a POSIX system.
    """
    if on:
        check_posix("decoding in a process of its own")
    os.environ[VARIABLE] = "1" if on else "0"


@contextmanager
def isolation(on: bool | None = True) -> Iterator[None]:
    """Decode the files that are read inside the block in guarded processes; or, with ``False``, in this one.

    ``None`` is the default of the command line: as the environment variable says, else on where the system can.

    It holds for all threads, for workers that eldata starts meanwhile or sends work to, and for a DataLoader's workers
    if they are started inside the block. A file whose decoder crashes, hangs for more than a minute or needs more than
    2 GiB is an error that names it. Set the environment variable ``ELDATA_ISOLATE=1`` to have it on throughout.

    Raises
    ------
    EldataError
        Like :func:`set_isolation`.
    """
    before = os.environ.get(VARIABLE)
    set_isolation((isolating() if before else _CAN_ISOLATE) if on is None else on)
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = before
        if before != "1":
            while _idle:
                _idle.pop().end()


def guarded(work: Callable[..., Result], *arguments: object, limits: Limits = LIMITS) -> Result:
    """Return ``work(*arguments)``: from a guarded process where isolation is on, else directly.

    Parameters
    ----------
    work
        A function of a module's top level, found there by name. Its result consists of records of this package, arrays,
        fractions, dates, paths and plain values.
    arguments
        Picklable.
    limits
        For this call. Without isolation there are none.

    Raises
    ------
    GuardError
        If the process crashed, took too long or needed too much memory.
    Exception
        Whatever ``work`` raises; an error of another library as the built-in error that it derives from. With isolation
        a ``MemoryError`` becomes a ``GuardError``.
    """
    if not isolating():
        return work(*arguments)
    check_posix("decoding in a process of its own")
    request = pickle.dumps((current_folder(), limits, work, arguments))
    with suppress(IndexError, _LostError):  # an earlier file may have left it in a bad state: a new one tells
        return _idle.pop().answer(request, limits)  # type: ignore[no-any-return]
    return _Helper().answer(request, limits)  # type: ignore[no-any-return]


def guarded_file(
    work: Callable[[Path], Result], path: Path, error: type[FileError], *, limits: Limits = LIMITS
) -> Result:
    """Return ``work(path)`` of a stranger's file: from a guarded process where isolation is on.

    Parameters
    ----------
    work
        As of :func:`guarded`.
    path
        Of a regular file, links followed; nothing else is opened.
    error
        What is raised if the file cannot be read, or its work ends without a result.
    limits
        For this file.

    Raises
    ------
    FileError
        ``error``, with the path and the reason.
    Exception
        Whatever ``work`` raises, except a ``MemoryError``.
    """
    problem = file_problem(path)
    if problem is not None:
        raise error(path, problem)
    try:
        return guarded(partial(_read_file, work), path, error, limits=limits)
    except GuardError as how:
        raise error(path, f"{how}; is the file whole, and what it says it is?") from None
    except MemoryError as lack:
        reason = "needs more memory than there is; is the file whole, and what it says it is?"
        raise error(path, reason) from lack


def _read_file(work: Callable[[Path], Result], path: Path, error: type[FileError]) -> Result:
    try:
        return work(path)
    except OSError as cause:
        if cause.errno is None:  # not the system's: a library that does not load, say
            raise
        raise error(path, f"cannot be read: {cause.strerror or cause}") from cause


# --- the parent's side ------------------------------------------------------------------------------------------------


class _LostError(GuardError):
    """The helper crashed or ran out of memory."""


class _Helper:
    """One guarded process, seen from its parent."""

    def __init__(self) -> None:
        import subprocess

        try:
            self._socket, theirs = socket.socketpair()
        except OSError as error:
            raise _unstartable(error) from error
        start = f"import sys; sys.path[:] = {sys.path!r}; from eldata.base.isolation import serve; serve()"
        environment = os.environ | {VARIABLE: "0"} | _ENVIRONMENT
        with theirs:
            theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BYTES)
            try:
                self._process = subprocess.Popen(  # noqa: S603 # this interpreter
                    [sys.executable, "-c", start],
                    stdin=theirs.fileno(),
                    stdout=subprocess.DEVNULL,
                    env=environment,
                    start_new_session=True,  # Ctrl-C goes to the parent alone
                )
            except OSError as error:
                self._socket.close()
                raise _unstartable(error) from error
        _all.add(self)
        try:
            self._socket.settimeout(_START_S)
            _receive(self._socket)
        except TimeoutError:
            self.end()
            raise EldataError(f"the process that is to decode did not start within {_START_S:g} s") from None
        except OSError:
            code = self.end()
            raise EldataError(f"the process that is to decode did not start (exit code {code})") from None
        except BaseException:  # Ctrl-C too: nobody else knows of it yet
            self.end()
            raise

    def answer(self, request: bytes, limits: Limits) -> Any:
        """Return what the work returned, or raise what it raised; then be free for the next."""
        try:
            self._socket.settimeout(limits.seconds)
            _send(self._socket, [request])
            content, *large = _receive(self._socket)
            returned, value = _Answer(io.BytesIO(content), buffers=large).load()
        except TimeoutError:
            self.end()
            raise GuardError(f"its decoder took more than {limits.seconds:g} s") from None
        except OSError:
            raise _LostError(f"its decoder crashed ({_ending(self.end(kill=False))})") from None
        except BaseException:  # an answer to come would be taken for the next one's
            self.end()
            raise
        if isinstance(value, MemoryError) and not returned:
            self.end()
            raise _LostError(f"its decoder needed more than {limits.memory_bytes / (1 << 30):g} GiB of memory")
        _idle.append(self)
        if returned:
            return value
        raise value

    def end(self, *, kill: bool = True) -> int:
        """End the process and return its exit code, minus the signal if one ended it."""
        from subprocess import TimeoutExpired

        _all.discard(self)
        if kill:
            self._process.kill()
        try:
            code = self._process.wait(_START_S)
        except TimeoutExpired:  # it has closed its socket and lives
            self._process.kill()
            code = self._process.wait()
        self._socket.close()
        return code

    def forget(self) -> None:
        """Close the socket, in a fork: the process is its parent's."""
        self._socket.close()
        self._process.returncode = 0  # or its end would be looked for


_all: set[_Helper] = set()
_idle: list[_Helper] = []  # append and pop are atomic


@atexit.register
def _end_all() -> None:
    _idle.clear()
    for helper in list(_all):
        helper.end()


def _forget_all() -> None:
    for helper in list(_all):
        helper.forget()
    _all.clear()
    _idle.clear()


if _CAN_ISOLATE:
    os.register_at_fork(after_in_child=_forget_all)


def _unstartable(error: OSError) -> EldataError:
    return EldataError(
        f"the process that is to decode cannot be started: {error.strerror or error}; --no-isolate "
        "(eldata.isolation(False)) decodes in this one"
    )


def _ending(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


class _Answer(pickle.Unpickler):  # find_class below admits records and arrays alone
    _NUMPY = frozenset(("ndarray", "dtype", "_frombuffer", "_reconstruct", "scalar"))
    _PLAIN = frozenset(("fractions", "datetime", "pathlib"))

    def find_class(self, module: str, name: str) -> Any:
        top = module.partition(".")[0]
        if (top == "numpy" and name in self._NUMPY) or top in (*self._PLAIN, "eldata", "capture", "builtins"):
            found = super().find_class(module, name)
            if top == "numpy" or (isinstance(found, type) and (top != "builtins" or issubclass(found, BaseException))):
                return found
        raise TypeError(f"guarded work answered with {module}.{name}; expected records, arrays and plain values")


# --- what goes between them -------------------------------------------------------------------------------------------


def _send(to: socket.socket, parts: Sequence[bytes | memoryview]) -> None:
    """Send the number of some parts, their sizes, and the parts."""
    to.sendall(struct.pack(f"<{1 + len(parts)}Q", len(parts), *map(len, parts)))
    for part in parts:
        to.sendall(part)


def _receive(sender: socket.socket) -> list[Any]:
    """Return the parts that were sent, the first as bytes, the others as arrays of bytes.

    Raises
    ------
    OSError
        If the other end is closed before the last byte.
    """
    (count,) = struct.unpack("<Q", _filled(bytearray(8), sender))
    first, *others = struct.unpack(f"<{count}Q", _filled(bytearray(8 * count), sender))
    parts: list[Any] = [_filled(bytearray(first), sender)]
    if others:
        import numpy as np

        parts += [_filled(np.empty(size, np.uint8), sender) for size in others]
    return parts


def _filled(buffer: Any, sender: socket.socket) -> Any:
    left = memoryview(buffer)
    while left:
        received = sender.recv_into(left)
        if not received:
            raise ConnectionResetError
        left = left[received:]
    return buffer


# --- the helper's side ------------------------------------------------------------------------------------------------


def serve() -> None:
    """Answer the requests that come through standard input, a socket, until its other end is closed."""
    import resource

    parent = socket.socket(fileno=os.dup(0))
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    _send(parent, [b""])
    os.dup2(nothing, 2)  # libraries that crash say so, and the parent does already
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    requests: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(parent, requests), daemon=True).start()
    while True:
        _send(parent, _answer(requests.get()))


def _listen(parent: socket.socket, requests: SimpleQueue[bytes]) -> None:
    """Pass requests on; end the process with its parent, even in the middle of some work."""
    while True:
        try:
            requests.put(_receive(parent)[0])
        except OSError:
            os._exit(0)


def limit_memory(most_bytes: int) -> None:
    """Let this process have so many bytes of memory and no more: what asks for more gets a ``MemoryError``.

    Without effect on systems that know no such limit (Windows, macOS).
    """
    try:
        import resource
    except ImportError:
        return
    with suppress(ValueError, OSError):  # a lower limit holds already
        resource.setrlimit(resource.RLIMIT_DATA, (most_bytes, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def _answer(request: bytes) -> list[bytes | memoryview]:
    """Do the work; return whether it returned with what it returned or raised, pickled, and the large arrays in it."""
    import resource
    from multiprocessing.reduction import ForkingPickler

    most = resource.getrlimit(resource.RLIMIT_DATA)[1]
    answer: tuple[bool, Any]
    try:
        folder, limits, work, arguments = ForkingPickler.loads(request)  # the parent's own: no stranger's
        limit_memory(limits.memory_bytes)
        # The thread that listens needs Python's lock, which hanging work may hold; this does not.
        signal.setitimer(signal.ITIMER_REAL, limits.seconds + _GRACE_S)
        if folder is not None:
            os.chdir(folder)
        answer = True, work(*arguments)
    except Exception as error:  # noqa: BLE001 # whatever it is, it is the caller's
        answer = False, _transportable(error)
    signal.setitimer(signal.ITIMER_REAL, 0)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    large: list[bytes | memoryview] = []

    def is_pickled(buffer: pickle.PickleBuffer) -> bool:
        content = buffer.raw()
        if content.nbytes >= _LARGE_BYTES:
            large.append(content)
        return content.nbytes < _LARGE_BYTES

    return [pickle.dumps(answer, protocol=5, buffer_callback=is_pickled), *large]


def _transportable(error: Exception) -> Exception:
    """Return an error of ours or a built-in one, with the traceback, which does not travel, as a note."""
    import traceback

    told = "".join(traceback.format_exception(error))
    if type(error).__module__.partition(".")[0] not in ("eldata", "capture", "builtins"):
        base = next(kind for kind in type(error).__mro__ if kind.__module__ == "builtins")
        error = getattr(builtins, base.__name__)(str(error))
    error.add_note(f"in the process that decodes:\n{told}")
    return error
