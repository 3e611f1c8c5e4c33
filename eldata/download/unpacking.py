"""Unpacking an archive into a dataset's folder: files appear there once they are complete, and none is replaced.

Members are written into the hidden folder ``.eldata-unpacking`` of the dataset's folder, so on the same disk, and
renamed into place one by one. A run that ends early, even by kill -9, leaves complete files and that hidden folder, a
sign that files may be missing. The next run goes on with those, and removes the folder at its end.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import zlib
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

from eldata.base.fields import shown
from eldata.base.files import check_posix, inside, try_lock
from eldata.download.readers import BY_HAND
from eldata.download.sizes import check_room, progress_bar
from eldata.errors import ArchiveError, DownloadError, ManifestError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from tqdm import tqdm

    from eldata.download.archives import Archive
    from eldata.download.readers import Member, Sink

STAGING = ".eldata-unpacking"
_PIECE_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Unpacked:
    """What :func:`unpack_archive` did, as paths relative to the dataset's folder.

    ``differing`` were there already with other content (or were not files) and were left alone.
    """

    written: tuple[str, ...]
    identical: tuple[str, ...]
    differing: tuple[str, ...]


def unpack_archive(archive: Archive, targets: Mapping[str, str], folder: Path) -> Unpacked:
    """Write an archive's files below ``folder``, without following links out of it and without replacing a file.

    Parameters
    ----------
    targets
        Where each member, by name, belongs, relative to ``folder``. Other members stay in the archive.

    Raises
    ------
    ArchiveError
        If a member is damaged, or would be written through a link that leads out of the folder. Files written before
        that are complete and stay.
    DownloadError
        If the disk is full or cannot be written to, or another process is unpacking there.
    """
    members = [member for member in archive.files if member.name in targets]
    places = {member.name: _place(archive.path, member, folder, targets[member.name]) for member in members}
    result: dict[str, str] = {}
    total_bytes = sum(member.size_bytes for member in members)
    with (
        _staging_folder(folder) as staging,
        progress_bar(f"unpacking {archive.path.name}", total_bytes) as bar,
    ):
        to_read, missing = [], 0
        for member in members:
            with _disk_named(places[member.name], "read"):
                verdict = _verdict(member, places[member.name], bar)
            if verdict is not None:
                result[member.name] = verdict
                continue
            to_read.append(member)
            missing += 0 if places[member.name].exists() else member.size_bytes
        check_room(folder, missing, "to be unpacked")
        with ExitStack() as opened:

            def receive(member: Member) -> Sink:
                opened.close()  # members come one after the other
                place = places[member.name]
                if place.exists():
                    return opened.enter_context(closing(_Comparison(member, place, result, bar)))
                return opened.enter_context(closing(_NewFile(member, staging, place, result, bar)))

            archive.deliver(to_read, receive)
    lost = [member.name for member in members if member.name not in result]
    if lost:
        raise ArchiveError(
            archive.path, f"member {shown(lost[0])} is listed, but did not come out of it; fetch it again"
        )

    def of(verdict: str) -> tuple[str, ...]:
        return tuple(sorted(targets[name] for name, found in result.items() if found == verdict))

    return Unpacked(of("written"), of("identical"), of("differing"))


def _place(archive: Path, member: Member, folder: Path, target: str) -> Path:
    """Return where a member goes, if it can lie there."""
    try:
        place = inside(folder, target)
        with suppress(FileNotFoundError, NotADirectoryError):
            place.lstat()
    except ManifestError as error:
        raise ArchiveError(archive, str(error)) from error
    except OSError as error:  # a name or path that is too long for this disk
        reason = f"member {shown(member.name)} cannot lie at {place}: {error.strerror}; {BY_HAND}"
        raise ArchiveError(archive, reason) from error
    return place


def _verdict(member: Member, place: Path, bar: tqdm[Any]) -> str | None:
    """Return what is known of a member without reading it: identical, differing, or nothing yet."""
    if not os.path.lexists(place):
        return None
    if not place.is_file() or place.stat().st_size != member.size_bytes:
        verdict = "differing"
    elif member.crc32 is None:
        return None  # only the archive's bytes can tell
    else:
        verdict = "identical" if _crc32_of(place) == member.crc32 else "differing"
    bar.update(member.size_bytes)
    return verdict


def _crc32_of(path: Path) -> int:
    crc = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            crc = zlib.crc32(piece, crc)
    return crc


class _NewFile:
    """Writes a member that is not there yet."""

    def __init__(self, member: Member, staging: Path, place: Path, result: dict[str, str], bar: tqdm[Any]) -> None:
        self._member = member
        self._place = place
        self._result = result
        self._bar = bar
        self._staged = staging / "member"
        self._left = member.size_bytes
        with _disk_named(place):
            self._file: IO[bytes] = self._staged.open("wb", buffering=0)

    def write(self, piece: bytes) -> None:
        self._left -= len(piece)
        if self._left < 0:  # a bomb that lies about its size
            self._file.close()
            raise ArchiveError(
                self._place, f"is longer than the {self._member.size_bytes} bytes that the archive states"
            )
        with _disk_named(self._place):
            rest = memoryview(piece)
            while rest:
                rest = rest[self._file.write(rest) :]
        self._bar.update(len(piece))

    def close(self) -> None:
        self._file.close()

    def finish(self) -> None:
        with _disk_named(self._place):
            os.fsync(self._file.fileno())
            self.close()
            self._place.parent.mkdir(parents=True, exist_ok=True)
            # A link would refuse to replace a file that appeared meanwhile, but not every disk has links.
            if os.path.lexists(self._place):
                self._result[self._member.name] = "differing"
                return
            self._staged.rename(self._place)
        self._result[self._member.name] = "written"


class _Comparison:
    """Compares a member with the file of its size that is there already."""

    def __init__(self, member: Member, place: Path, result: dict[str, str], bar: tqdm[Any]) -> None:
        self._member = member
        self._result = result
        self._bar = bar
        self._place = place
        with _disk_named(place, "read"):
            self._file = place.open("rb")
        self._same = True

    def write(self, piece: bytes) -> None:
        with _disk_named(self._place, "read"):
            self._same = self._same and self._file.read(len(piece)) == piece
        self._bar.update(len(piece))

    def close(self) -> None:
        self._file.close()

    def finish(self) -> None:
        self._result[self._member.name] = "identical" if self._same else "differing"


@contextmanager
def _staging_folder(folder: Path) -> Iterator[Path]:
    """Give one process at a time an empty hidden folder; it is gone at the end if all went well."""
    check_posix("unpacking an archive")
    staging = folder / STAGING
    with _disk_named(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    try:
        if not try_lock(folder, handle):
            raise DownloadError(f"{folder}: another process is unpacking there; wait for that one")
        with _disk_named(staging):
            if os.path.lexists(staging):  # left by a run that was killed
                _remove(staging)
            staging.mkdir()
        try:
            yield staging
        finally:
            for left in staging.iterdir():
                left.unlink()
        staging.rmdir()
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if stat.S_ISDIR(path.lstat().st_mode):
        shutil.rmtree(path)
    else:
        path.unlink()  # a link is removed, not followed


@contextmanager
def _disk_named(path: Path, what: str = "write") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        advice = "files unpacked before are whole, and the same command goes on"
        if error.errno == errno.ENAMETOOLONG:
            advice = f"no file can have that name on this disk; {BY_HAND}"
        raise DownloadError(f"cannot {what} {path}: {error.strerror}; {advice}") from error
