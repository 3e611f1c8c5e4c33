"""Archives: what one holds and whether it is safe to unpack, checked before a byte of it is written."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from eldata.base.fields import shown
from eldata.base.files import file_problem, path_problem
from eldata.download.readers import (
    HEAD_BYTES,
    MOST_EXPANSION,
    MOST_MEMBERS,
    UNSAFE,
    archive_format,
    bomb,
    looks_like,
    too_many,
)
from eldata.download.seven_zip_reader import SevenZipReader
from eldata.download.tar_reader import TarReader
from eldata.download.zip_reader import ZipReader
from eldata.errors import ArchiveError, DownloadError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from eldata.download.readers import Format, Member, Reader, Sink

SURELY_HARMLESS_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class Archive:
    """An archive that :func:`open_archive` found complete and safe to unpack; ``files`` are its files."""

    path: Path
    files: tuple[Member, ...]
    reader: Reader

    def deliver(self, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks (see :class:`~eldata.download.readers.Reader`).

        Raises
        ------
        ArchiveError
            If a member is damaged.
        """
        self.reader.deliver(self.path, members, receive)


def open_archive(path: Path) -> Archive:
    """Look into an archive, by its content and not by its name, and refuse what is not safe to unpack.

    Raises
    ------
    ArchiveError
        If it is not an archive, is cut short or encrypted, expands beyond reason, or has a member that would leave the
        folder, is a link or a device, or collides with another; the message names it.
    DownloadError
        If the package that reads the format is missing; the message says how to go on.
    """
    problem = file_problem(path)
    if problem is not None:
        raise ArchiveError(path, problem)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise ArchiveError(path, f"cannot be read: {error.strerror}") from error
    found = archive_format(head)
    if found is None:
        raise ArchiveError(path, f"is not a zip, tar or 7z archive but {looks_like(head)}; save the archive itself")
    reader = reader_of(found, path)
    members = reader.members(path, _most_bytes(path))
    check_members(path, members)
    files = tuple(member for member in members if member.kind == "file")
    if not files:
        raise ArchiveError(path, "holds no file")
    return Archive(path, files, reader)


def check_members(path: Path, members: Sequence[Member]) -> None:
    """Refuse an archive whose list of members is unsafe.

    Raises
    ------
    ArchiveError
        See :func:`open_archive`.
    """
    if len(members) > MOST_MEMBERS:
        raise too_many(path, len(members))
    seen: dict[str, str] = {}
    folders: dict[str, str] = {}
    for member in members:
        name = member.stored_name
        problem = path_problem(member.name)
        if problem is not None:
            raise ArchiveError(path, f"member {shown(name)} {problem}; {UNSAFE}")
        if member.kind == "link":
            raise ArchiveError(path, f"member {shown(name)} is a link, which could lead out of the folder; {UNSAFE}")
        if member.kind == "special":
            raise ArchiveError(path, f"member {shown(name)} is a device or something like it; {UNSAFE}")
        if member.kind == "folder":
            continue
        key = _as_file_systems_see(member.name)
        if key in seen:
            raise ArchiveError(
                path,
                f"members {shown(seen[key])} and {shown(name)} would be one file where case does not count; {UNSAFE}",
            )
        seen[key] = name
        for parent in PurePosixPath(key).parents:
            folders.setdefault(parent.as_posix(), name)
    for key, name in seen.items():
        if key in folders:
            raise ArchiveError(path, f"member {shown(name)} is a file, and a folder of {shown(folders[key])}; {UNSAFE}")
    _check_sizes(path, members)


def _as_file_systems_see(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _check_sizes(path: Path, members: Sequence[Member]) -> None:
    size = path.stat().st_size
    packed = sum(member.packed_bytes or 0 for member in members)
    if packed > size:  # members that share their bytes: a bomb that every ratio of one member misses
        raise ArchiveError(path, f"its members claim {packed} bytes of a file of {size}; it is damaged or a zip bomb")
    unpacked = sum(member.size_bytes for member in members)
    if unpacked > _most_bytes(path):
        raise bomb(path, str(unpacked))


def _most_bytes(path: Path) -> int:
    """Return how many bytes may come out of an archive."""
    return max(SURELY_HARMLESS_BYTES, MOST_EXPANSION * path.stat().st_size)


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
