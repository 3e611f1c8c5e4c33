"""An unfinished download: the bytes that have arrived, and which file they belong to."""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import IO, TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import check_posix, try_lock, write_json
from eldata.download.sizes import size_text
from eldata.errors import DownloadError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Version:
    """Which file the bytes in a ``.part`` belong to: ``mark`` is the server's ETag or Last-Modified, or empty."""

    address: str
    total_bytes: int
    mark: str


class Partial:
    """An unfinished download: ``<name>.part``, which :func:`opened_partial` opens, and which file it belongs to."""

    def __init__(self, target: Path, file: IO[bytes]) -> None:
        self.path, self._note = _paths(target)
        self._file = file

    @property
    def size_bytes(self) -> int:
        """How many bytes have arrived."""
        return os.fstat(self._file.fileno()).st_size

    def version(self) -> Version | None:
        """Return which file the bytes belong to, ``None`` if unknown."""
        try:
            note = TextFile(self._note, DownloadError).json()
            return Version(note.text("address"), note.whole("total_bytes"), note.text("mark", empty=True))
        except DownloadError:
            return None

    def note(self, version: Version) -> None:
        """Write down which file the bytes belong to, before the first of them."""
        write_json(self._note, asdict(version))

    def restart(self) -> None:
        """Forget what has arrived."""
        self._note.unlink(missing_ok=True)
        self._file.truncate(0)

    def append(self, piece: bytes) -> None:
        """Add bytes at the end."""
        rest = memoryview(piece)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise DownloadError(
                f"cannot write {self.path}: {error.strerror}; {size_text(self.size_bytes)} are kept there: make room "
                "and the same command goes on"
            ) from error

    def hand_over(self, temporary: Path) -> None:
        """Give the whole file pooch's temporary name as well as its own.

        Pooch deletes what bears its name when Ctrl-C comes while it checks the hash; ours stays until :func:`discard`.
        """
        try:
            os.fsync(self._file.fileno())
            for other in temporary.parent.glob(f"{tempfile.gettempprefix()}*"):  # of a run killed during that check
                if other.exists() and other.samefile(self.path):
                    other.unlink()
            try:
                temporary.hardlink_to(self.path)
            except OSError:  # exFAT and others have no links
                self.path.rename(temporary)
        except OSError as error:
            raise DownloadError(f"cannot write {self.path}: {error.strerror}") from error


@contextmanager
def opened_partial(target: Path) -> Iterator[Partial]:
    """Open what has arrived of a file, for one process at a time.

    Raises
    ------
    DownloadError
        If it cannot be written, or another process is fetching it.
    """
    check_posix("fetching a file")
    path, _ = _paths(target)
    try:
        file = path.open("ab", buffering=0)
    except OSError as error:
        raise DownloadError(f"cannot write {path}: {error.strerror}") from error
    with file:
        if not try_lock(path, file):
            raise DownloadError(f"{path}: another process is fetching it; wait for that one")
        yield Partial(target, file)


def discard(target: Path) -> None:
    """Remove what :class:`Partial` keeps beside a file."""
    for path in _paths(target):
        if path.exists():  # not missing_ok: a read-only disk refuses even that
            path.unlink()


def _paths(target: Path) -> tuple[Path, Path]:
    return target.with_name(f"{target.name}.part"), target.with_name(f"{target.name}.part.json")
