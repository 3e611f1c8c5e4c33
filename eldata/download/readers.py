"""What all archive formats share: telling them apart, members, where their bytes go, and how damage is named.

No reader writes a file: members' bytes go to sinks, links and modes nowhere.
"""

from __future__ import annotations

import errno
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

from eldata.base.fields import shown
from eldata.errors import ArchiveError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

Format = Literal["zip", "7z", "tar"]
Kind = Literal["file", "folder", "link", "special"]

# Enough to see a tar file's mark, at byte 257.
HEAD_BYTES = 512

_MARKS: tuple[tuple[bytes, Format], ...] = (
    (b"PK\x03\x04", "zip"),
    (b"PK\x05\x06", "zip"),  # an empty one
    (b"7z\xbc\xaf\x27\x1c", "7z"),
    (b"\x1f\x8b", "tar"),
    (b"BZh", "tar"),
    (b"\xfd7zXZ\x00", "tar"),
)

# Zip's deflate reaches 1000:1 on zeros; raw files of dark scenes shrink to a third, never to a hundredth.
MOST_EXPANSION = 100
MOST_MEMBERS = 500_000  # ten times as many as the largest of the known datasets has

PIECE_BYTES = 2**20
UNSAFE = "it was not made by the publisher; do not unpack it"
BY_HAND = "unpack it by hand (7z x) and run eldata verify"
CUT_SHORT = "its download was not finished, or not all parts were joined: delete it and fetch it again"
# Of seeking to a place that cannot be: the archive's number is wrong, not the disk.
_WRONG_PLACE = (None, errno.EINVAL, errno.EOVERFLOW, errno.EFBIG)


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


class Sink(Protocol):
    """Takes one member's bytes; ``finish`` is called once all have arrived and their checksum is right."""

    def write(self, piece: bytes) -> None:
        """Take the next bytes."""

    def finish(self) -> None:
        """Note that the member is complete."""


class MemberBytes(Protocol):
    """Gives one member's bytes."""

    def read(self, size: int, /) -> bytes:
        """Return the next bytes, none at the end."""


class Reader(Protocol):
    """Reads one archive format."""

    def members(self, path: Path, most_bytes: int) -> tuple[Member, ...]:
        """Return every entry, files and others, as stored; refuse an archive as soon as more than that comes out."""

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send each of these members' bytes to the sink that ``receive`` opens for it, in the archive's order."""


def archive_format(head: bytes) -> Format | None:
    """Return an archive's format by its first ``HEAD_BYTES`` bytes, ``None`` if it is not an archive."""
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name
    return "tar" if head[257:262] == b"ustar" else None


def looks_like(head: bytes) -> str:
    """Say what a file that is not an archive looks like by its first bytes."""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype", b"<html", b"<head", b"<?xml", b"<!--")):
        return "a web page, as Google Drive sends when it asks for a confirmation or a login"
    if head.startswith(b"Rar!"):
        return "a RAR archive; unpack it with unrar or 7z"
    if not head.strip(b"\0"):
        return "nothing but zeros" if head else "an empty file"
    return f"a file of another kind, which starts with {head[:8]!r}"


def damaged(path: Path, reason: str) -> ArchiveError:
    """Return the error that an archive is damaged, to be raised."""
    return ArchiveError(path, f"is damaged ({reason}); {CUT_SHORT}")


def bomb(path: Path, unpacked: str) -> ArchiveError:
    """Return the error that an archive expands beyond reason, to be raised."""
    return ArchiveError(
        path,
        f"would expand from {path.stat().st_size} to {unpacked} bytes, more than {MOST_EXPANSION}-fold, as photographs "
        "never do; it is damaged or a zip bomb",
    )


def too_many(path: Path, count: int) -> ArchiveError:
    """Return the error that an archive has more members than any dataset, to be raised."""
    return ArchiveError(path, f"lists {count} members; {UNSAFE}")


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn whatever a library raises while it reads an archive into one line that names it.

    Not to be held around a sink: what that raises is not the archive's fault.
    """
    try:
        yield
    except EldataError:
        raise
    except OSError as error:
        if error.errno in _WRONG_PLACE:
            raise damaged(path, _reason(error)) from error
        raise ArchiveError(path, f"cannot be read: {error.strerror}") from error
    except Exception as error:  # a wrong number in a header surfaces as whatever it leads to
        raise damaged(path, _reason(error)) from error


def _reason(error: Exception) -> str:
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return (said or type(error).__name__).splitlines()[0].rstrip(":")


def clean_name(stored_name: str) -> str:
    """Return a member's name as a relative path."""
    name = stored_name.rstrip("/") if stored_name.strip("/") else stored_name
    while name.startswith("./"):
        name = name[2:]
    return name


def send(path: Path, member: Member, source: MemberBytes, sink: Sink) -> None:
    """Send a member's bytes to its sink.

    Raises
    ------
    ArchiveError
        If they are damaged, or not as many as the archive states.
    """
    size = 0
    while piece := _piece(path, source, member.size_bytes + 1 - size):
        size += len(piece)
        sink.write(piece)
    check_size(path, member, size)
    sink.finish()


def _piece(path: Path, source: MemberBytes, most: int) -> bytes:
    with damage_named(path):
        return source.read(min(PIECE_BYTES, most))


def check_size(path: Path, member: Member, size: int) -> None:
    """Refuse a member of another size than stated."""
    if size != member.size_bytes:
        raise ArchiveError(
            path, f"member {shown(member.name)} should have {member.size_bytes} bytes, has {size}; {CUT_SHORT}"
        )
