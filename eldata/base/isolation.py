"""Work on a stranger's file in a process that may die of it: a decoder that crashes, hangs or eats memory is one error.

Where isolation is on (:func:`isolation`, ``--isolate``), :func:`guarded` calls a function with limits on time and
memory in a process of :mod:`eldata.base.processes`: in this one, if it is one, as workers are; else in a helper. A
helper knows numpy and the decoder, not torch; there are as many as threads that ask at a time.

Arrays come from a helper as they are: 24 MB take 9 ms.

This contains accidents, not attackers: such a process has all rights of its user.
"""

from __future__ import annotations

import os
import signal
import threading
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from eldata.base.files import check_posix, file_problem
from eldata.base.processes import LostError, Processes, announced, earlier_end, end_after_this, serves
from eldata.base.stopping import ending_of
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from eldata.errors import FileError

Result = TypeVar("Result")

VARIABLE = "ELDATA_ISOLATE"
"""The environment variable that holds the setting, so that processes started from here have it too: 1 is on."""

_CAN_ISOLATE = hasattr(os, "register_at_fork")  # a POSIX system
# No threads that it does not use; and one frame's memory is used again for the next (by glibc), where new pages cost
# more than sending the pixels does.
_HELPERS = Processes(
    "--no-isolate (eldata.isolation(False)) decodes in this one",
    {
        "OPENBLAS_NUM_THREADS": "1",
        "MALLOC_MMAP_THRESHOLD_": str(1 << 30),
        "MALLOC_TRIM_THRESHOLD_": str(1 << 30),
    },
)


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
        Of data, beside what its process had before (RLIMIT_DATA, which counts what is used and not, as RLIMIT_AS does,
        what is merely reserved). 2 GiB hold a raw of 150 megapixels four times over. macOS does not enforce it.
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
            _HELPERS.end_idle()


def guarded(work: Callable[..., Result], *arguments: object, limits: Limits = LIMITS) -> Result:
    """Return ``work(*arguments)``: from a guarded process where isolation is on, else directly.

    Parameters
    ----------
    work
        A function of a module's top level, found there by name. Its result can be pickled.
    arguments
        Picklable.
    limits
        For this call. Without isolation there are none.

    Raises
    ------
    GuardError
        If the process crashed, took too long or needed too much memory.
    Exception
        Whatever ``work`` raises. With isolation a ``MemoryError`` becomes a ``GuardError``.
    """
    if not isolating():
        return work(*arguments)
    if serves():
        return _guarded_here(work, arguments, limits)
    check_posix("decoding in a process of its own")
    try:
        return _HELPERS.run(partial(_guarded_here, work, arguments, limits))
    except LostError as lost:
        raise GuardError(_reason(lost.code, limits)) from None


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
        result: Result = guarded(_read_file, work, path, error, limits=limits)
    except GuardError as how:
        raise error(path, f"{how}; is the file whole, and what it says it is?") from None
    except MemoryError as lack:
        reason = "needs more memory than there is; is the file whole, and what it says it is?"
        raise error(path, reason) from lack
    return result


def _read_file(work: Callable[[Path], Result], path: Path, error: type[FileError]) -> Result:
    try:
        return work(path)
    except OSError as cause:
        if cause.errno is None:  # not the system's: a library that does not load, say
            raise
        raise error(path, f"cannot be read: {cause.strerror or cause}") from cause


# --- where it is done -------------------------------------------------------------------------------------------------

_ONE_AT_A_TIME = threading.RLock()  # the limits are the process's
_limited = False


def _guarded_here(work: Callable[..., Result], arguments: tuple[object, ...], limits: Limits) -> Result:
    with _ONE_AT_A_TIME:
        if _limited:  # the work has guarded work within
            return work(*arguments)
        name = " ".join(map(_name_of, (work, *arguments)))
        code = earlier_end(name)
        if code is not None:
            raise GuardError(_reason(code, limits))
        with announced(name), _in_limits(limits):
            try:
                return work(*arguments)
            except MemoryError:
                end_after_this()
                size = limits.memory_bytes / (1 << 30)
                raise GuardError(f"its decoder needed more than {size:g} GiB of memory") from None


def _name_of(part: object) -> str:
    """Return what tells a function or its argument from others, in every process."""
    plain = str(part) if isinstance(part, (str, int, os.PathLike)) else type(part).__qualname__
    return getattr(part, "__qualname__", plain)


def _reason(code: int, limits: Limits) -> str:
    if code == -signal.SIGALRM:
        return f"its decoder took more than {limits.seconds:g} s"
    return f"its decoder crashed ({ending_of(code)})"


@contextmanager
def _in_limits(limits: Limits) -> Iterator[None]:
    """Limit the time and the memory of this process, and keep what libraries print to themselves."""
    import resource

    global _limited  # noqa: PLW0603 # as the limits are
    with ExitStack() as undo:
        shown = os.dup(2)
        undo.callback(os.close, shown)
        nothing = os.open(os.devnull, os.O_WRONLY)
        undo.callback(os.close, nothing)
        os.dup2(nothing, 2)
        undo.callback(os.dup2, shown, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        undo.callback(resource.setrlimit, resource.RLIMIT_DATA, resource.getrlimit(resource.RLIMIT_DATA))
        limit_memory(_data_bytes() + limits.memory_bytes)
        # The kernel ends the process, whoever holds Python's lock, and whether or not the parent lives.
        signal.setitimer(signal.ITIMER_REAL, limits.seconds)
        undo.callback(signal.setitimer, signal.ITIMER_REAL, 0)
        _limited = True
        try:
            yield
        finally:
            _limited = False


def _data_bytes() -> int:
    """Return how much RLIMIT_DATA counts now; 0 where that cannot be told, nor is it limited."""
    try:
        with open("/proc/self/statm", "rb") as file:  # noqa: PTH123 # for each frame
            return int(file.read().split()[5]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


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
