"""The archive formats: telling them apart, and a reader of each.

No reader writes a file: members' bytes go to sinks, links and modes nowhere.
"""

from __future__ import annotations

import io
import lzma
import stat
import tarfile
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, Literal, Protocol

from eldata.errors import ArchiveError, DownloadError

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

_PIECE_BYTES = 2**20
_CUT_SHORT = "its download was not finished, or not all parts were joined: delete it and fetch it again"


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


class Reader(Protocol):
    """Reads one archive format."""

    def members(self, path: Path) -> tuple[Member, ...]:
        """Return every entry, files and others, as stored."""

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


def reader_of(name: Format, path: Path) -> Reader:
    """Return the reader of a format.

    Raises
    ------
    DownloadError
        If it needs a package that is not installed.
    """
    if name == "zip":
        return ZipReader()
    if name == "tar":
        return TarReader()
    try:
        import py7zr  # noqa: F401 # is it installed?
    except ImportError as error:
        raise DownloadError(
            f"{path} is a 7z archive, which needs the package py7zr: pip install 'eldata[7z]'; or unpack it by hand "
            "(7z x) and run eldata verify"
        ) from error
    return SevenZipReader()


@contextmanager
def _damage_named(path: Path, *kinds: type[Exception]) -> Iterator[None]:
    """Turn a library's errors about a damaged archive into one line that names it."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:  # the system's, not gzip's
            raise
        raise ArchiveError(path, f"is damaged ({error}); {_CUT_SHORT}") from error
    except Exception as error:
        if not isinstance(error, (EOFError, zlib.error, lzma.LZMAError, *kinds)):
            raise
        reason = (str(error) or type(error).__name__).splitlines()[0].rstrip(":")
        raise ArchiveError(path, f"is damaged ({reason}); {_CUT_SHORT}") from error


def _clean(stored_name: str) -> str:
    name = stored_name.rstrip("/") if stored_name.strip("/") else stored_name
    while name.startswith("./"):
        name = name[2:]
    return name


def _copy(path: Path, member: Member, source: IO[bytes], sink: Sink) -> None:
    size = 0
    with source:
        while piece := source.read(_PIECE_BYTES):
            sink.write(piece)
            size += len(piece)
    _check_size(path, member, size)
    sink.finish()


class ZipReader:
    """Reads zip archives."""

    # What zipfile unpacks: stored, deflate, bzip2, LZMA.
    _METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)

    def members(self, path: Path) -> tuple[Member, ...]:
        """Return every entry of the central directory."""
        try:
            # zipfile raises NotImplementedError for an archive of a version or method that it does not know.
            with _damage_named(path, NotImplementedError, ValueError), zipfile.ZipFile(path) as archive:
                infos = archive.infolist()
        except zipfile.BadZipFile as error:
            raise ArchiveError(
                path, f"its table of contents (End-of-central-directory) is missing or damaged; {_CUT_SHORT}"
            ) from error
        for info in infos:
            if info.flag_bits & 1:
                raise ArchiveError(path, f"member {info.filename!r} is encrypted; unpack it by hand")
            if info.compress_type not in self._METHODS:
                raise ArchiveError(
                    path,
                    f"member {info.filename!r} is packed by method {info.compress_type}, which Python cannot unpack; "
                    "unpack it by hand (7z x) and run eldata verify",
                )
        return tuple(
            Member(
                _clean(info.filename),
                info.filename,
                self._kind(info),
                info.file_size,
                info.compress_size,
                info.CRC,
            )
            for info in infos
        )

    @staticmethod
    def _kind(info: zipfile.ZipInfo) -> Kind:
        if info.is_dir():
            return "folder"
        mode = info.external_attr >> 16
        if stat.S_ISLNK(mode):
            return "link"
        return "file" if stat.S_IFMT(mode) in (0, stat.S_IFREG) else "special"

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks; zipfile checks the CRC of each."""
        # NotImplementedError as above: a member's own header may ask for another method than the table of contents.
        with _damage_named(path, zipfile.BadZipFile, NotImplementedError), zipfile.ZipFile(path) as archive:
            for member in members:
                sink = receive(member)
                _copy(path, member, archive.open(member.stored_name), sink)


class TarReader:
    """Reads tar archives, plain or compressed by gzip, bzip2 or xz."""

    def members(self, path: Path) -> tuple[Member, ...]:
        """Return every entry; a compressed archive is read through for it."""
        with _damage_named(path, tarfile.TarError), tarfile.open(path, "r:*") as archive:
            infos = archive.getmembers()
            # A tar file that is cut between two members looks whole but for its end mark, a block of zeros.
            if not self._ends(archive.fileobj, archive.offset):
                raise ArchiveError(path, f"its end mark is missing; {_CUT_SHORT}")
            while archive.fileobj.read(_PIECE_BYTES):
                pass  # the checksum of a compressed archive stands at its very end
        return tuple(
            Member(_clean(info.name), info.name, self._kind(info), info.size) for info in infos if info.name != "."
        )

    @staticmethod
    def _ends(file: Any, offset: int) -> bool:
        file.seek(offset)  # a block back, which is still in memory
        return bool(file.read(tarfile.BLOCKSIZE) == bytes(tarfile.BLOCKSIZE))

    @staticmethod
    def _kind(info: tarfile.TarInfo) -> Kind:
        if info.issym() or info.islnk():
            return "link"
        if info.isdir():
            return "folder"
        return "file" if info.isreg() else "special"

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks."""
        wanted = {member.stored_name: member for member in members}
        with _damage_named(path, tarfile.TarError), tarfile.open(path, "r:*") as archive:
            for info in archive:
                member = wanted.get(info.name)
                source = archive.extractfile(info) if member is not None and info.isreg() else None
                if member is not None and source is not None:
                    _copy(path, member, source, receive(member))


class SevenZipReader:
    """Reads 7z archives through py7zr, which never learns of a folder to write to."""

    def members(self, path: Path) -> tuple[Member, ...]:
        """Return every entry of the header."""
        import py7zr

        # A damaged header surfaces as whatever its first wrong number leads to.
        damages = (py7zr.exceptions.ArchiveError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError)
        try:
            with _damage_named(path, *damages), py7zr.SevenZipFile(path) as archive:
                if archive.needs_password():
                    raise ArchiveError(path, "is encrypted; unpack it by hand")
                infos = archive.list()
        except py7zr.exceptions.PasswordRequired as error:
            raise ArchiveError(path, "is encrypted; unpack it by hand") from error
        return tuple(
            Member(_clean(info.filename), info.filename, self._kind(info), info.uncompressed, None, info.crc32)
            for info in infos
        )

    @staticmethod
    def _kind(info: Any) -> Kind:
        if info.is_symlink:
            return "link"
        if info.is_directory:
            return "folder"
        return "file" if info.is_file else "special"

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks, after the CRC of each."""
        import py7zr

        wanted = {member.name: member for member in members}

        class OneMember(py7zr.io.Py7zIO):
            def __init__(self, member: Member) -> None:
                self._member = member
                self._sink = receive(member)
                self._size = 0

            def write(self, piece: bytes | bytearray) -> int:
                self._sink.write(bytes(piece))
                self._size += len(piece)
                return len(piece)

            def close(self) -> None:  # called if the CRC was right
                _check_size(path, self._member, self._size)
                self._sink.finish()

            def read(self, size: int | None = None) -> bytes:  # noqa: ARG002 # py7zr's interface has it and never calls it
                raise io.UnsupportedOperation("read")

            def seek(self, offset: int, whence: int = 0) -> int:  # noqa: ARG002 # py7zr calls it before it closes, and needs no answer
                return 0

            def flush(self) -> None:
                pass

            def size(self) -> int:
                return self._size

        class Members(py7zr.io.WriterFactory):
            def create(self, filename: str) -> py7zr.io.Py7zIO:
                return OneMember(wanted[filename])

        damages = (py7zr.exceptions.ArchiveError, ValueError)
        # An open file, not a path, or py7zr unpacks in threads of its own.
        with _damage_named(path, *damages), path.open("rb") as file, py7zr.SevenZipFile(file) as archive:
            archive.extract(targets=[member.stored_name for member in members], factory=Members())


def _check_size(path: Path, member: Member, size: int) -> None:
    if size != member.size_bytes:
        raise ArchiveError(
            path, f"member {member.name!r} should have {member.size_bytes} bytes, has {size}; {_CUT_SHORT}"
        )
