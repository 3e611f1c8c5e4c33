"""A file on its way: the bytes that have come, and which file they are a part of."""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import IO, TYPE_CHECKING

from eldata.download.errors import DownloadError
from eldata.download.sizes import size_text
from eldata.files import check_posix, try_lock, write_text

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
    """A file on its way: ``<name>.part`` and what it is a part of."""

    def __init__(self, target: Path) -> None:
        self.target = target
        self.path = target.with_name(f"{target.name}.part")
        self._note = target.with_name(f"{target.name}.part.json")

    @contextmanager
    def opened(self) -> Iterator[IO[bytes]]:
        """Open it for one process at a time."""
        check_posix("fetching a file")
        try:
            file = self.path.open("ab", buffering=0)
        except OSError as error:
            raise DownloadError(f"cannot write {self.path}: {error.strerror}") from error
        with file:
            if not try_lock(self.path, file):
                raise DownloadError(f"{self.path}: another process is fetching it; wait for that one")
            yield file

    @staticmethod
    def size_of(file: IO[bytes]) -> int:
        """Return how many bytes have come."""
        return os.fstat(file.fileno()).st_size

    def version(self) -> Version | None:
        """Return which file the bytes belong to, ``None`` if that is not known."""
        try:
            data = json.loads(self._note.read_text(encoding="utf-8"))
            return Version(str(data["address"]), int(data["total_bytes"]), str(data["mark"]))
        except (OSError, ValueError, LookupError, TypeError):
            return None

    def note(self, version: Version) -> None:
        """Write down which file the bytes belong to, before the first of them."""
        write_text(self._note, json.dumps(asdict(version)) + "\n")

    def restart(self, file: IO[bytes]) -> None:
        """Forget what has come."""
        self._note.unlink(missing_ok=True)
        file.truncate(0)

    def append(self, file: IO[bytes], piece: bytes) -> None:
        """Add bytes at the end."""
        rest = memoryview(piece)
        try:
            while rest:
                rest = rest[file.write(rest) :]
        except OSError as error:
            raise DownloadError(
                f"cannot write {self.path}: {error.strerror}; {size_text(self.size_of(file))} are kept there: make "
                "room and the same command goes on"
            ) from error

    def sync(self, file: IO[bytes]) -> None:
        """Make sure that the bytes are on the disk."""
        try:
            os.fsync(file.fileno())
        except OSError as error:
            raise DownloadError(f"cannot write {self.path}: {error.strerror}") from error

    def discard(self) -> None:
        """Remove what is left of it."""
        self.path.unlink(missing_ok=True)
        self._note.unlink(missing_ok=True)
