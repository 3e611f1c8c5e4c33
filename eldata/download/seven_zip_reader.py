"""7z archives, through py7zr in a process of its own.

A header of a hundred bytes can make py7zr reserve any memory, and most of its decoders are compiled code that meets
strangers' bytes nowhere else: what happens in that process, a crash included, costs one line.
"""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from eldata.base.fields import shown
from eldata.base.isolation import limit_memory
from eldata.base.main_guard import require_main_guard
from eldata.download.readers import (
    BY_HAND,
    CUT_SHORT,
    MOST_MEMBERS,
    Member,
    check_size,
    clean_name,
    damage_named,
    too_many,
)
from eldata.errors import ArchiveError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from multiprocessing.connection import Connection
    from pathlib import Path

    from eldata.download.readers import Kind, Sink

# 7z's largest usual dictionary is 1.5 GiB (-md=1536m); its default is 32 MiB.
_MOST_MEMORY_BYTES = 2 * 2**30
# Without a byte read from the archive or unpacked from it.
_SILENCE_S = 60.0
_BEAT_S = 1.0


class SevenZipReader:
    """Reads 7z archives; py7zr never learns of a folder to write to."""

    def members(self, path: Path, most_bytes: int) -> tuple[Member, ...]:  # noqa: ARG002 # the header has sizes
        """Return every entry of the header."""
        with _messages(path, None) as messages:
            return tuple(Member(*fields) for _, members in messages for fields in members)

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks, after the CRC of each."""
        if not members:
            return
        wanted = {member.name: member for member in members}
        sinks: dict[str, Sink] = {}
        sizes: dict[str, int] = {}
        with _messages(path, [member.stored_name for member in members]) as messages:
            for kind, content in messages:
                if kind == "begin":
                    name = content
                    sinks[name], sizes[name] = receive(wanted[name]), 0
                elif kind == "piece":
                    sizes[name] += len(content)
                    sinks[name].write(content)
                else:  # its CRC was right
                    check_size(path, wanted[name], sizes[name])
                    sinks.pop(name).finish()


@contextmanager
def _messages(path: Path, names: list[str] | None) -> Iterator[Iterator[tuple[str, Any]]]:
    """Yield what a process says about an archive: its members; or, of named members, beginning, pieces and end."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_serve, args=(theirs, os.fspath(path), names), daemon=True)
    with ours, theirs:
        require_main_guard()
        with _interruptions_held():
            process.start()
        try:
            theirs.close()  # or its end would not be seen
            yield _received(path, ours, process)
        finally:
            process.kill()
            process.join()


@contextmanager
def _interruptions_held() -> Iterator[None]:
    """Let a process that begins here not see Ctrl-C: we end it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _received(path: Path, connection: Connection, process: Any) -> Iterator[tuple[str, Any]]:
    while True:
        try:
            if not connection.poll(_SILENCE_S):
                raise ArchiveError(path, f"nothing came out of it for {_SILENCE_S:.0f} s; {BY_HAND}")
            kind, content = connection.recv()
        except (EOFError, ConnectionError) as error:
            process.join()
            how = f"exit code {process.exitcode}"
            raise ArchiveError(path, f"the process that unpacks it ended early ({how}); {CUT_SHORT}") from error
        if kind == "end":
            return
        if kind == "problem":
            raise ArchiveError(path, content)
        if kind != "beat":
            yield kind, content


# --- in the process -------------------------------------------------------------------------------------------------


def _serve(connection: Connection, name: str, names: list[str] | None) -> None:
    """Send what is asked for, and an end or what is wrong."""
    from pathlib import Path

    limit_memory(_MOST_MEMORY_BYTES)
    path = Path(name)
    with suppress(ConnectionError):  # nobody is interested any more
        try:
            with damage_named(path):
                _send_members(connection, path) if names is None else _send_contents(connection, path, names)
        except ArchiveError as error:
            connection.send(("problem", error.reason))
        else:
            connection.send(("end", None))


def _send_members(connection: Connection, path: Path) -> None:
    with _opened(connection, path) as archive:
        if archive.needs_password():
            raise ArchiveError(path, "is encrypted; unpack it by hand")
        infos = archive.list()
        if len(infos) > MOST_MEMBERS:
            raise too_many(path, len(infos))
        connection.send(
            (
                "members",
                [
                    (clean_name(info.filename), info.filename, _kind(info), info.uncompressed, None, info.crc32)
                    for info in infos
                ],
            )
        )


def _send_contents(connection: Connection, path: Path, names: Sequence[str]) -> None:
    import py7zr

    class OneMember(py7zr.io.Py7zIO):
        def __init__(self, name: str) -> None:
            self._name = name
            self._size = 0
            connection.send(("begin", name))

        def write(self, piece: bytes | bytearray) -> int:
            connection.send(("piece", bytes(piece)))
            self._size += len(piece)
            return len(piece)

        def close(self) -> None:  # called if the CRC was right
            connection.send(("whole", self._name))

        def read(self, size: int | None = None) -> bytes:  # noqa: ARG002 # py7zr's interface has it and never calls it
            raise io.UnsupportedOperation("read")

        def seek(self, offset: int, whence: int = 0) -> int:  # noqa: ARG002 # py7zr calls it before it closes, and needs no answer
            return 0

        def flush(self) -> None:
            pass

        def size(self) -> int:
            return self._size

    wanted = {clean_name(name): name for name in names}

    class Members(py7zr.io.WriterFactory):
        def create(self, filename: str) -> py7zr.io.Py7zIO:
            if filename not in wanted:
                raise ValueError(f"member {shown(filename)} was not listed")
            return OneMember(filename)

    with _opened(connection, path) as archive:
        archive.extract(targets=list(names), factory=Members())


@contextmanager
def _opened(connection: Connection, path: Path) -> Iterator[Any]:
    import py7zr

    # An open file, not a path, or py7zr unpacks in threads of its own.
    with _Beating(connection, path) as file:
        try:
            with py7zr.SevenZipFile(file) as archive:
                yield archive
        except py7zr.exceptions.PasswordRequired as error:
            raise ArchiveError(path, "is encrypted; unpack it by hand") from error
        except py7zr.exceptions.UnsupportedCompressionMethodError as error:
            raise ArchiveError(path, f"is packed by a method that py7zr does not know; {BY_HAND}") from error


class _Beating(io.FileIO):
    """A file that shows that something is still reading it."""

    def __init__(self, connection: Connection, path: Path) -> None:
        super().__init__(path)
        self._connection = connection
        self._last = time.monotonic()

    def read(self, size: int | None = -1, /) -> bytes:
        now = time.monotonic()
        if now - self._last > _BEAT_S:
            self._last = now
            self._connection.send(("beat", None))
        return super().read(-1 if size is None else size)


def _kind(info: Any) -> Kind:
    if info.is_symlink:
        return "link"
    if info.is_directory:
        return "folder"
    return "file" if info.is_file else "special"
