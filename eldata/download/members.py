"""Members of archives, and the files that they become: whole, or not at all."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from eldata.errors import ArchiveError, DownloadError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Kind = Literal["file", "folder", "link", "special"]

BY_HAND = "unpack it by hand (7z x) and run eldata verify"


@dataclass(frozen=True, slots=True)
class Member:
    """One entry of an archive.

    ``name`` is a clean relative path, ``stored_name`` what the archive calls it. ``packed_bytes`` and ``crc32`` are
    ``None`` where the format does not state them.
    """

    name: str
    stored_name: str
    kind: Kind
    size_bytes: int
    packed_bytes: int | None = None
    crc32: int | None = None


@dataclass(slots=True)
class NewFile:
    """A file that is not there yet: it is written at ``staged``, and gets its ``place`` once it is whole."""

    staged: Path
    place: Path
    member_bytes: int

    def open(self) -> _Staged:
        """Begin it; what is written is refused beyond ``member_bytes``."""
        with disk_named(self.place):
            return _Staged(self)

    def finish(self) -> bool:
        """Give it its place, if that is still free; return whether it was."""
        if self.staged.stat().st_size != self.member_bytes:
            raise ArchiveError(
                self.place, f"should have {self.member_bytes} bytes, and {self.staged.stat().st_size} came out"
            )
        with disk_named(self.place):
            with self.staged.open("rb") as file:
                os.fsync(file.fileno())
            self.place.parent.mkdir(parents=True, exist_ok=True)
            # A link would refuse to replace a file that appeared meanwhile, but not every disk has links.
            if os.path.lexists(self.place):
                return False
            self.staged.rename(self.place)
        return True


class _Staged:
    """The open file of a :class:`NewFile`."""

    def __init__(self, new: NewFile) -> None:
        self._new, self._left = new, new.member_bytes
        self._file = new.staged.open("wb", buffering=0)
        self.close = self._file.close

    def write(self, piece: bytes | bytearray) -> int:
        self._left -= len(piece)
        if self._left < 0:  # a bomb that lies about its size
            raise ArchiveError(
                self._new.place, f"is longer than the {self._new.member_bytes} bytes that the archive states"
            )
        with disk_named(self._new.place):
            rest = memoryview(piece)
            while rest:
                rest = rest[self._file.write(rest) :]
        return len(piece)


@contextmanager
def disk_named(path: Path, what: str = "write") -> Iterator[None]:
    """Say of the system's errors which file was to be written, or read."""
    try:
        yield
    except OSError as error:
        advice = "files unpacked before are whole, and the same command goes on"
        if error.errno == errno.ENAMETOOLONG:
            advice = f"no file can have that name on this disk; {BY_HAND}"
        raise DownloadError(f"cannot {what} {path}: {error.strerror}; {advice}") from error
