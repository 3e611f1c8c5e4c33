"""Unpacking an archive into a dataset's folder: files appear there once they are complete, and none is replaced.

Members are written into the hidden folder ``.eldata-unpacking`` of the dataset's folder, so on the same disk, and
renamed into place one by one. A run that ends early, even by kill -9, leaves complete files and that hidden folder, a
sign that files may be missing. The next run goes on with those, and removes the folder at its end.
"""

from __future__ import annotations

import os
import shutil
import stat
import threading
import zlib
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import check_posix, inside, try_lock
from eldata.base.visible import shown
from eldata.download.card_downloads import check_room, progress_bar
from eldata.download.members import BY_HAND, NewFile, disk_named
from eldata.errors import ArchiveError, DownloadError, ManifestError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from tqdm import tqdm

    from eldata.download.archives import Archive
    from eldata.download.members import Member

STAGING = ".eldata-unpacking"
_PIECE_BYTES = 2**20
_LOOK_S = 0.5  # how often the progress is looked at


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
    verdicts: dict[str, str] = {}
    total_bytes = sum(member.size_bytes for member in members)
    with (
        _staging_folder(folder) as staging,
        progress_bar(f"unpacking {archive.path.name}", total_bytes) as bar,
    ):
        new: list[tuple[Member, NewFile]] = []
        for member in members:
            place = places[member.name]
            with disk_named(place, "read"):
                if not os.path.lexists(place):
                    new.append((member, NewFile(staging / "member", place, member.size_bytes)))
                    continue
                verdicts[member.name] = "identical" if _is_member(place, member) else "differing"
                bar.update(member.size_bytes)
        check_room(folder, sum(member.size_bytes for member, _ in new), "to be unpacked")
        with _progress(bar, [file for _, file in new]):
            placed = archive.unpack(new)
        verdicts |= {name: "written" if free else "differing" for name, free in placed.items()}

    def of(verdict: str) -> tuple[str, ...]:
        return tuple(sorted(targets[name] for name, found in verdicts.items() if found == verdict))

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


def _is_member(place: Path, member: Member) -> bool:
    """Return whether a member is there already, by size and CRC; an empty one has no CRC."""
    if not place.is_file() or place.stat().st_size != member.size_bytes:
        return False
    crc = 0
    with place.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            crc = zlib.crc32(piece, crc)
    return crc == (member.crc32 or 0)


@contextmanager
def _progress(bar: tqdm[Any], files: Sequence[NewFile]) -> Iterator[None]:
    """Let a bar show how much of some files is there, whoever writes them."""
    before, done = bar.n, threading.Event()

    def look() -> None:
        while not done.wait(_LOOK_S):
            paths = [file.place for file in files] + [file.staged for file in files[:1]]
            bar.n = before + sum(path.stat().st_size for path in paths if path.exists())
            bar.refresh()

    thread = threading.Thread(target=look, daemon=True)
    if not bar.disable:
        thread.start()
    try:
        yield
    finally:
        done.set()
        if not bar.disable:
            thread.join()


@contextmanager
def _staging_folder(folder: Path) -> Iterator[Path]:
    """Give one process at a time an empty hidden folder; it is gone at the end if all went well."""
    check_posix("unpacking an archive")
    staging = folder / STAGING
    with disk_named(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    try:
        if not try_lock(folder, handle):
            raise DownloadError(f"{folder}: another process is unpacking there; wait for that one")
        with disk_named(staging):
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
