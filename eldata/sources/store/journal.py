"""A file that survives kill -9: what was committed stays, what was not is undone.

HDF5 overwrites its own tables in place while a file grows, and a file that is left in the middle of that cannot be
opened any more. So everything that HDF5 writes goes through :class:`JournaledFile`. Before committed bytes are
overwritten, their old content is appended to a journal beside the file. A commit replaces the journal by an empty one
that states the file's size. Whoever opens the file next writes the journal's bytes back, last first, and cuts the file
to the committed size: it is then what it was at the last commit, wherever the kill struck.

This holds for a process that dies. A computer that loses its power may lose what the operating system had not written
to the disk yet; :func:`eldata.sources.store.verify_store` finds that by the checksum of each frame.
"""

from __future__ import annotations

import io
import os
import struct
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from eldata.base.files import check_posix, is_at, try_lock
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_HEADER = struct.Struct("<8sQ")  # magic, committed size
_RECORD = struct.Struct("<QQ")  # offset and length of the old bytes that follow
_MAGIC = b"eldata-j"


class JournaledFile(io.FileIO):
    """A file for h5py's ``fileobj`` driver; use it through :func:`journaled`.

    After an error it takes no more: HDF5 writes on while it closes a file, and those writes are dropped.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "r+", opener=lambda name, _: os.open(name, os.O_RDWR | os.O_CREAT, 0o666))
        self.path = path
        self.failure: BaseException | None = None
        self._journal_path = path.with_name(_journal_name(path))
        self._committed = 0
        self._journal = -1

    def resume(self) -> None:
        """Undo what another writer did not commit, and begin to write."""
        self._committed = os.fstat(self.fileno()).st_size
        if self._committed:
            self._undo()
        self._start_journal()

    @property
    def is_new(self) -> bool:
        """Whether nothing has been committed yet."""
        return self._committed == 0

    def commit(self) -> None:
        """Keep all that has been written so far. HDF5 must have flushed it."""
        self._check_alive()
        self._start_journal()

    def finish(self, path: Path) -> None:
        """Make sure that the bytes are on the disk, and give the file its name; it needs no journal any more."""
        self._check_alive()
        os.fsync(self.fileno())
        self.path.rename(path)
        self._journal_path.unlink(missing_ok=True)

    def release(self) -> None:
        """Undo what was not committed, and close the file."""
        try:
            if self._journal_path.exists():
                self._undo()
        finally:
            if self._journal >= 0:
                os.close(self._journal)
            self.close()

    def write(self, data: Any) -> int:
        """Write at the position, after the committed bytes there have gone to the journal."""
        position = self.tell()
        with self._unless_failed() as is_alive:
            if is_alive:
                self._keep_old(position, len(data))
                _write_all(self.fileno(), data, position)
        self.seek(position + len(data))
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Set the file's size."""
        size = self.tell() if size is None else size
        with self._unless_failed() as is_alive:
            if is_alive:
                self._keep_old(size, self._committed - size)
                os.ftruncate(self.fileno(), size)
        return size

    # --- the journal --------------------------------------------------------------------------------------------

    def _check_alive(self) -> None:
        if self.failure is not None:
            raise self.failure

    @contextmanager
    def _unless_failed(self) -> Iterator[bool]:
        """Yield whether no write has failed; remember what fails inside."""
        try:
            yield self.failure is None
        except BaseException as error:
            self.failure = error
            raise

    def _start_journal(self) -> None:
        """Replace the journal by an empty one: this is the moment of the commit."""
        size = os.fstat(self.fileno()).st_size
        fresh = self._journal_path.with_name(f"{self._journal_path.name}.new")
        descriptor = os.open(fresh, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        try:
            _write_all(descriptor, memoryview(_HEADER.pack(_MAGIC, size)), 0)
            fresh.replace(self._journal_path)
        except BaseException:  # Ctrl-C too: the descriptor is ours until it has replaced the old one's
            os.close(descriptor)
            raise
        if self._journal >= 0:
            os.close(self._journal)
        self._journal, self._committed = descriptor, size

    def _keep_old(self, offset: int, length: int) -> None:
        length = min(offset + length, self._committed) - offset
        if length > 0:
            old = os.pread(self.fileno(), length, offset)
            record = _RECORD.pack(offset, len(old)) + old
            _write_all(self._journal, memoryview(record), os.fstat(self._journal).st_size)

    def _undo(self) -> None:
        """Bring the file back to its last commit. May itself be killed and run again: the oldest bytes win."""
        try:
            journal = self._journal_path.read_bytes()  # some tables of HDF5's: small
        except FileNotFoundError:
            raise EldataError(
                f"{self.path}: its journal {self._journal_path.name} is not there, so it cannot be resumed; remove it "
                "to start again"
            ) from None
        if len(journal) < _HEADER.size or not journal.startswith(_MAGIC):
            raise EldataError(f"{self._journal_path}: is not a journal of eldata; remove {self.path} to start again")
        _, size = _HEADER.unpack_from(journal)
        records = []
        at = _HEADER.size
        while at + _RECORD.size <= len(journal):
            offset, length = _RECORD.unpack_from(journal, at)
            at += _RECORD.size + length
            if at > len(journal):
                break  # not whole: what it was to protect had not been touched yet
            records.append((offset, memoryview(journal)[at - length : at]))
        for offset, old in reversed(records):
            _write_all(self.fileno(), old, offset)
        os.ftruncate(self.fileno(), size)


def _write_all(descriptor: int, data: memoryview, offset: int) -> None:
    while data:
        count = os.pwrite(descriptor, data, offset)
        data, offset = data[count:], offset + count


@contextmanager
def journaled(path: Path) -> Iterator[JournaledFile]:
    """Open a file for one writer at a time, made if it is not there; what is not committed at the end is undone.

    Raises
    ------
    EldataError
        If another process is writing it, it cannot be written or resumed, or this system has no file locks.
    """
    check_posix("writing a store")
    try:
        with ExitStack() as undo:
            file = undo.enter_context(JournaledFile(path))
            if not (try_lock(path, file.fileno()) and is_at(path, os.fstat(file.fileno()))):
                raise EldataError(f"{path}: another process is writing it; wait for that one")
            file.resume()
            undo.pop_all()
    except OSError as error:
        raise EldataError(f"cannot write {path}: {error.strerror}") from error
    try:
        yield file
    finally:
        with suppress(OSError):  # whoever opens it next undoes the rest
            file.release()


def remove_stale_journal(path: Path) -> None:
    """Remove a journal whose file has been finished and renamed: a kill between these two steps leaves it."""
    if not path.exists():
        path.with_name(_journal_name(path)).unlink(missing_ok=True)


def _journal_name(path: Path) -> str:
    return f"{path.name}.journal"
