"""Zip archives, through zipfile."""

from __future__ import annotations

import io
import stat
import zipfile
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from eldata.base.fields import shown
from eldata.download.readers import BY_HAND, CUT_SHORT, Member, clean_name, damage_named, send
from eldata.errors import ArchiveError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from eldata.download.readers import Kind, Sink

# Of the methods that zipfile knows, those whose pieces it unpacks to a size that it is told: 4 kB of bzip2 may become
# gigabytes at once.
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
# A table of contents; half a million members with names of 80 characters need as much.
_LARGEST_READ_BYTES = 64 * 2**20


class ZipReader:
    """Reads zip archives."""

    def members(self, path: Path, most_bytes: int) -> tuple[Member, ...]:  # noqa: ARG002 # the table of contents has sizes
        """Return every entry of the central directory."""
        with _opened(path) as archive:
            infos = archive.infolist()
        for info in infos:
            if info.flag_bits & 1:
                raise ArchiveError(path, f"member {shown(info.filename)} is encrypted; unpack it by hand")
            if info.compress_type not in _METHODS:
                raise ArchiveError(
                    path,
                    f"member {shown(info.filename)} is packed by method {info.compress_type}, which eldata does not "
                    f"unpack; {BY_HAND}",
                )
        return tuple(
            Member(clean_name(info.filename), info.filename, _kind(info), info.file_size, info.compress_size, info.CRC)
            for info in infos
        )

    def deliver(self, path: Path, members: Sequence[Member], receive: Callable[[Member], Sink]) -> None:
        """Send members' bytes to sinks; zipfile checks the CRC of each."""
        with _opened(path) as archive:
            for member in members:
                sink = receive(member)
                with damage_named(path):
                    source = archive.open(member.stored_name)
                with source:
                    send(path, member, source, sink)


def _kind(info: zipfile.ZipInfo) -> Kind:
    if info.filename.endswith("/"):  # is_dir() fails where there is no name
        return "folder"
    mode = info.external_attr >> 16
    if stat.S_ISLNK(mode):
        return "link"
    return "file" if stat.S_IFMT(mode) in (0, stat.S_IFREG) else "special"


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive; errors of the caller's block are its own."""
    with ExitStack() as opened:
        try:
            with damage_named(path):
                file = opened.enter_context(_Bounded(path))
                archive = opened.enter_context(zipfile.ZipFile(file))
        except ArchiveError as error:
            if isinstance(error.__cause__, zipfile.BadZipFile):
                reason = f"its table of contents (End-of-central-directory) is missing or damaged; {CUT_SHORT}"
                raise ArchiveError(path, reason) from error.__cause__
            raise
        yield archive


class _Bounded(io.FileIO):
    """A file of which nobody reads more at once than a table of contents may have."""

    def read(self, size: int | None = -1, /) -> bytes:
        wanted = _LARGEST_READ_BYTES if size is None or size < 0 else size
        if wanted > _LARGEST_READ_BYTES:
            raise ValueError(f"a table of contents of {size} bytes")
        return super().read(wanted)
