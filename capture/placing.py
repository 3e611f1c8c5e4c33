"""Files into the dataset's layout by copy or hard link: originals stay, what is there already is never replaced.

Symbolic links are not made: ``eldata verify`` and every reader refuse a dataset whose files are elsewhere, since a link
that leads out of its folder is how a manifest from a stranger would reach other files.
"""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Final

from capture.capture_errors import MappingError
from eldata.base.files import naming_file, remove_leftovers, sha256_of, temporary_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from eldata.records import FrameRecord

_PIECE: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Placement:
    """A row of a manifest, the file that it is made from, and where this goes."""

    path: Path
    target: Path
    record: FrameRecord


def check_free(placements: Iterable[Placement]) -> None:
    """Refuse, before anything is written, if a target holds another content.

    Raises
    ------
    MappingError
        If so; the message names the first such file.
    """
    for placement in placements:
        if os.path.lexists(placement.target) and not _holds(placement):
            raise MappingError(
                f"{placement.target} is there already with another content than {placement.path}; nothing was "
                "copied. Choose another folder, or move that file away"
            )


def make_folders(placements: Iterable[Placement]) -> None:
    """Make the folders of the targets, and remove from them what a run that was killed left."""
    for folder in sorted({placement.target.parent for placement in placements}):
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)


def copy(placement: Placement) -> None:
    """Copy a file, whole or not at all, unless its target holds the same content already.

    Raises
    ------
    MappingError
        If the target holds something else, or the source changed meanwhile.
    """
    source, target = placement.path, placement.target
    if _holds(placement):
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with source.open("rb") as reading, _new_file(target) as (writing, temporary):
        while piece := _read_piece(reading, source):
            writing.write(piece)
        writing.flush()
        seen = os.fstat(reading.fileno())
        if sha256_of(temporary) != placement.record.sha256:
            raise MappingError(f"{source} changed while it was being copied; run this again")
        os.utime(temporary, ns=(seen.st_atime_ns, seen.st_mtime_ns))


@contextmanager
def _new_file(target: Path) -> Iterator[tuple[IO[bytes], Path]]:
    try:
        with temporary_file(target) as (writing, temporary):
            yield writing, temporary
            writing.flush()
            os.fsync(writing.fileno())
            if sys.platform == "win32":
                writing.close()  # an open file cannot be renamed there
            rename_to_new(temporary, target)
    except FileExistsError:
        raise _occupied(target) from None
    except OSError as error:
        if error.filename is not None:
            raise
        raise MappingError(
            f"cannot write {target}: {error.strerror or error}; the files copied before it stay, and the same command "
            "goes on"
        ) from error


def _read_piece(file: IO[bytes], path: Path) -> bytes:
    with naming_file(path):
        return file.read(_PIECE)


def link(placement: Placement) -> None:
    """Give a file a second name (a hard link), unless its target holds the same content already.

    Raises
    ------
    MappingError
        If the target holds something else, or lies on another file system.
    """
    if _holds(placement):
        return
    placement.target.parent.mkdir(parents=True, exist_ok=True)
    try:
        placement.target.hardlink_to(placement.path)
    except FileExistsError:
        raise _occupied(placement.target) from None
    except OSError as error:
        raise MappingError(
            f"{placement.target} cannot be a hard link to {placement.path} ({error.strerror}); use --copy-to"
        ) from error


def _holds(placement: Placement) -> bool:
    source, target = placement.path, placement.target
    if not target.is_file():
        return False
    if target.samefile(source):
        return True
    return target.stat().st_size == source.stat().st_size and sha256_of(target) == placement.record.sha256


def rename_to_new(source: Path, target: Path) -> None:
    """Rename a file, but never over another one: a plain rename would replace it without a word.

    Raises
    ------
    FileExistsError
        If the target exists.
    OSError
        If the disk refuses.
    """
    try:
        target.hardlink_to(source)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links, such as a memory card's
        if os.path.lexists(target):
            raise FileExistsError from None
        source.rename(target)
    else:
        source.unlink()


def _occupied(target: Path) -> MappingError:
    return MappingError(f"{target} appeared meanwhile; it was left as it is. Is another copy of this command running?")
