"""Tar archives, plain or compressed by gzip, bzip2 or xz, read forwards.

Only single headers are parsed by :mod:`tarfile`. Its own walk over an archive seeks where a header says, nests as
deeply as headers do and searches them for minutes in releases of Python that are in use (CVE-2024-6232,
CVE-2025-8194).
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import tarfile
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

from eldata.base.fields import shown
from eldata.download.readers import (
    BY_HAND,
    CUT_SHORT,
    MOST_MEMBERS,
    PIECE_BYTES,
    Member,
    bomb,
    clean_name,
    damage_named,
    damaged,
    send,
    too_many,
)
from eldata.errors import ArchiveError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from eldata.download.readers import Kind, Sink

_BLOCK = tarfile.BLOCKSIZE
_PAX = (tarfile.XHDTYPE, tarfile.SOLARIS_XHDTYPE, tarfile.XGLTYPE)
_LONG = (tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK)
# Of a header that says more about the next one: paths have 4 kB at most, access lists and the like 64 kB each.
_LARGEST_HEADER_BYTES = 2**20
# Such headers in a row: pax and GNU have two, and an archive may begin with one for all.
_MOST_HEADERS = 8
_MOST_DIGITS = 19


class TarReader:
    """Reads tar archives."""

    def members(self, path: Path, most_bytes: int) -> tuple[Member, ...]:
        """Return every entry; a compressed archive is read through for it."""
        with _opened(path) as file:
            walk = _Walk(path, file, most_bytes)
            found = tuple(entry.member for entry in walk.entries() if entry.member.stored_name != ".")
            walk.finish()  # the checksum of a compressed archive stands at its very end
        return found

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks."""
        wanted = {member.stored_name: member for member in members}
        with _opened(path) as file:
            for entry in _Walk(path, file).entries():
                member = wanted.get(entry.member.stored_name)
                if member is not None and entry.member.kind == "file":
                    send(path, member, entry.content, receive(member))


@contextmanager
def _opened(path: Path) -> Iterator[IO[bytes]]:
    """Open an archive's tar, unpacked as it is read; errors of the caller's block are its own."""
    with ExitStack() as opened:
        with damage_named(path):
            packed = opened.enter_context(path.open("rb"))
            head = packed.read(6)
            packed.seek(0)
            file: Any = packed  # three libraries' classes, which do not share one
            if head.startswith(b"\x1f\x8b"):
                file = opened.enter_context(gzip.GzipFile(fileobj=packed))
            elif head.startswith(b"BZh"):
                file = opened.enter_context(bz2.BZ2File(packed))
            elif head.startswith(b"\xfd7zXZ\x00"):
                file = opened.enter_context(lzma.LZMAFile(packed))
        yield file


@dataclass(frozen=True, slots=True)
class _Entry:
    """A member, and its bytes: to be read before the next entry is asked for."""

    member: Member
    content: _Content


class _Walk:
    """One walk over a tar, from its beginning to its end mark."""

    def __init__(self, path: Path, file: IO[bytes], most_bytes: int | None = None) -> None:
        self._path = path
        self._file = file
        self._most_bytes = most_bytes
        self._at = 0
        self._for_all: dict[str, str] = {}

    def entries(self) -> Iterator[_Entry]:
        """Yield every entry, with what the headers before it say about it."""
        count = headers = 0
        given: dict[str, str] = {}
        while (info := self._header()) is not None:
            if info.type in _PAX or info.type in _LONG:
                headers += 1
                if headers > _MOST_HEADERS:
                    raise damaged(self._path, f"{headers} headers in a row are about one member")
                payload = self._payload(info)
                if info.type in _PAX:
                    found = self._records(payload)
                    if info.type == tarfile.XGLTYPE:
                        self._for_all |= found
                    else:
                        given = found | given  # of two that say the same, the first holds
                elif info.type == tarfile.GNUTYPE_LONGNAME:
                    given.setdefault("path", _text(payload.partition(b"\0")[0]))
                continue
            count += 1
            if count > MOST_MEMBERS:
                raise too_many(self._path, count)
            member, stored = self._member(info, self._for_all | given)
            headers, given = 0, {}
            content = _Content(self, stored)
            yield _Entry(member, content)
            self._skip(content.left + -stored % _BLOCK)

    def finish(self) -> None:
        """Read what follows the end mark."""
        while self.take(PIECE_BYTES):
            pass

    def take(self, size: int) -> bytes:
        """Return the next bytes, fewer only at the end."""
        with damage_named(self._path):
            found = self._file.read(size)
        self._at += len(found)
        if self._most_bytes is not None and self._at > self._most_bytes:
            raise bomb(self._path, f"at least {self._at}")
        return found

    def _whole(self, size: int) -> bytes:
        found = self.take(size)
        if len(found) < size:
            raise ArchiveError(self._path, f"ends within a member; {CUT_SHORT}")
        return found

    def _skip(self, size: int) -> None:
        if isinstance(self._file, io.BufferedReader) and size:  # not compressed: nothing has to be read
            with damage_named(self._path):
                self._file.seek(self._at + size - 1)
            self._at += size - 1
            size = 1
        while size:
            size -= len(self._whole(min(size, PIECE_BYTES)))

    def _header(self) -> tarfile.TarInfo | None:
        """Return the next header; nothing, at the end mark."""
        block = self.take(_BLOCK)
        if len(block) < _BLOCK:
            # A tar file that is cut between two members looks whole but for its end mark, a block of zeros.
            raise ArchiveError(self._path, f"its end mark is missing; {CUT_SHORT}")
        if not any(block):
            return None
        with damage_named(self._path):
            info = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
        if info.size < 0:
            raise damaged(self._path, f"member {shown(info.name)} has {info.size} bytes")
        return info

    def _payload(self, info: tarfile.TarInfo) -> bytes:
        if info.size > _LARGEST_HEADER_BYTES:
            raise damaged(self._path, f"a header of {info.size} bytes")
        return self._whole(info.size + -info.size % _BLOCK)[: info.size]

    def _records(self, payload: bytes) -> dict[str, str]:
        """Return what a pax header says: lines such as ``18 path=scene-1/a``, which begin with their own length."""
        found: dict[str, str] = {}
        at = 0
        while at < len(payload):
            digits = payload[at : at + 8].partition(b" ")[0]
            end = at + (int(digits) if digits.isdigit() else 0)
            key, equals, value = payload[at + len(digits) + 1 : end].partition(b"=")
            if not (equals and value.endswith(b"\n")):
                raise damaged(self._path, f"byte {at} of a pax header does not begin a record")
            found[_text(key)] = _text(value[:-1])
            at = end
        return found

    def _member(self, info: tarfile.TarInfo, given: dict[str, str]) -> tuple[Member, int]:
        """Return an entry, and how many bytes it takes in the archive."""
        name = given.get("path", info.name)
        if info.type == tarfile.GNUTYPE_SPARSE or any(key.startswith("GNU.sparse.") for key in given):
            raise ArchiveError(
                self._path,
                f"member {shown(given.get('GNU.sparse.name', name))} is stored as a sparse file, which eldata does not "
                f"unpack; {BY_HAND}",
            )
        size = info.size
        if "size" in given:  # of what is too large for the header's own field
            text = given["size"]
            if len(text) > _MOST_DIGITS or not (text.isascii() and text.isdigit()):
                raise damaged(self._path, f"member {shown(name)} has {shown(text)} bytes")
            size = int(text)
        kind: Kind = "special"
        if info.issym() or info.islnk():
            kind = "link"
        elif info.isdir():
            kind = "folder"
        elif info.isreg():
            kind = "file"
        # What tar does not know is stored like a file; links, folders and devices have no bytes, whatever they state.
        stored = size if kind == "file" or info.type not in tarfile.SUPPORTED_TYPES else 0
        return Member(clean_name(name), name, kind, size), stored


class _Content:
    """The bytes of one member, as they come."""

    def __init__(self, walk: _Walk, size: int) -> None:
        self._walk = walk
        self.left = size

    def read(self, size: int) -> bytes:
        """Return the next bytes, fewer only at the end."""
        found = self._walk.take(min(size, self.left))
        self.left -= len(found)
        return found


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")
