"""One session per folder: a lock that the operating system releases when the last of its processes ends."""

from __future__ import annotations

import json
import os
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capture.capture_errors import TetherError
from eldata.base.fields import TextFile
from eldata.base.files import check_posix, try_lock

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NAME: Final = ".session.lock"
WAIT_S: Final = 3.0
_STEP_S: Final = 0.05
_LARGEST_PROCESS: Final = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Lock:
    """A lock that is held: its file descriptor, to be inherited by gphoto2."""

    descriptor: int

    def note(self, gphoto2: int) -> None:
        """Write down which gphoto2 is at work, for whoever finds the lock held."""
        text = json.dumps({"session": os.getpid(), "gphoto2": gphoto2}).encode()
        with suppress(OSError):  # a full disk must not stop what is only information
            os.pwrite(self.descriptor, text.ljust(64), 0)


@contextmanager
def locked(folder: Path) -> Iterator[Lock]:
    """Hold the folder's lock.

    A gphoto2 that a killed session left behind holds it too, until its download is done, so that no
    file appears behind the back of the next session.

    Raises
    ------
    TetherError
        If another session keeps it for some seconds.
    EldataError
        If this system, or the folder's disk, has no file locks.
    """
    check_posix("tethered capture")
    try:
        descriptor = os.open(folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise TetherError(f"{folder}: cannot be written to ({error.strerror})") from error
    try:
        deadline = time.monotonic() + WAIT_S
        while not try_lock(folder, descriptor):
            if time.monotonic() > deadline:
                raise TetherError(f"{folder}: {_holder(descriptor)}")
            time.sleep(_STEP_S)
        lock = Lock(descriptor)
        lock.note(0)
        yield lock
    finally:
        os.close(descriptor)


def _holder(descriptor: int) -> str:
    try:
        said = TextFile(NAME, TetherError, content=os.pread(descriptor, 64, 0)).json()
        session, gphoto2 = said.whole("session", at_most=_LARGEST_PROCESS), said.whole("gphoto2")
    except TetherError:
        return "another session is at work in this folder; end it first"
    if _alive(session):
        return f"another session is at work in this folder (process {session}); end it first, or take another folder"
    return (
        f"a gphoto2 that an earlier session started is still at work (process {gphoto2}): wait until the camera is "
        f"done, or end it with: kill {gphoto2}"
    )


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
