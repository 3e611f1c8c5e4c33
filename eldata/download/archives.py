"""Archives: what one holds, checked before a byte of it is written, and its files, unpacked whole or not at all.

They are zip, 7z, and blocks of mosaics in MATLAB's format. zipfile and py7zr unpack no more of a member than the size
that it states, and compare its checksum. Members come out into the hidden folder ``.eldata-unpacking`` of the dataset's
folder, so on the same disk, and are renamed into place one by one; none replaces a file. A run that ends early, even by
kill -9, leaves complete files and that hidden folder, a sign that files may be missing; the next run goes on.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
import stat
import unicodedata
import zipfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from eldata.base.files import file_problem, inside, is_hidden, path_problem
from eldata.base.visible import shown
from eldata.errors import ArchiveError, DownloadError, EldataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    Outcome = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]

STAGING = ".eldata-unpacking"
FORMATS = {
    b"PK\x03\x04": "zip",
    b"PK\x05\x06": "zip",  # an empty one
    b"7z\xbc\xaf\x27\x1c": "7z",
    b"MATLAB 5.0 MAT-file": "blocks",
}
# Zip's deflate reaches 1000:1 on zeros; raw files of dark scenes shrink to a third, never to a hundredth.
MOST_EXPANSION = 100
SURELY_HARMLESS_BYTES = 64 * 2**20
_BY_HAND = "if you trust it, unpack it by hand (7z x) and run eldata verify"
_LINK = "is a link or a device, which could lead out of the folder"


@dataclass(frozen=True, slots=True)
class Member:
    """A file of an archive, or a folder, whose ``name`` ends in a slash; ``fault`` says why it cannot be unpacked."""

    name: str
    size_bytes: int
    fault: str = ""


def read_members(path: Path) -> list[Member]:
    """Return an archive's files, if it is safe to unpack; its content, and not its name, says what it is.

    Hidden files, such as those that macOS packs beside every file, are passed over.

    Raises
    ------
    ArchiveError
        If it is not an archive, is cut short or damaged, expands beyond reason, or has a member that would leave the
        folder, is a link or a device, or collides with another; the message names it.
    DownloadError
        If the package that reads the format is missing; the message says how to go on.
    """
    problem = file_problem(path)
    if problem is not None:
        raise ArchiveError(path, problem)
    read = {"zip": _zip_members, "7z": _seven_zip_members, "blocks": _block_members}[read_format(path)]
    with _name_damage(path):
        members = list(read(path))
    names: dict[str, str] = {}
    for member in members:
        if problem := path_problem(member.name.removesuffix("/")) or member.fault:
            raise ArchiveError(path, f"member {shown(member.name)} {problem}; {_BY_HAND}")
        key = unicodedata.normalize("NFC", member.name).casefold()  # as file systems see it
        if key in names:
            both = f"{shown(names[key])} and {shown(member.name)}"
            raise ArchiveError(path, f"members {both} would be one file where case does not count; {_BY_HAND}")
        names[key] = member.name
    _check_expansion(path, sum(member.size_bytes for member in members))
    files = [member for member in members if not (member.name.endswith("/") or is_hidden(member.name))]
    if not files:
        raise ArchiveError(path, "holds no file")
    return files


def read_format(path: Path) -> str:
    """Return an archive's format by its first bytes, one of :data:`FORMATS`; raises like :func:`read_members`."""
    with path.open("rb") as file:
        head = file.read(64)
    for mark, form in FORMATS.items():
        if head.startswith(mark):
            return form
    what = f"is not a zip or 7z archive, or blocks as MATLAB's -v7 saves them: it starts with {head!r}"
    raise ArchiveError(path, f"{what}; {_BY_HAND}")


def _check_expansion(path: Path, unpacked_bytes: int) -> None:
    """Refuse an archive, perhaps a zip bomb, that would unpack to many times its size."""
    size = path.stat().st_size
    if unpacked_bytes > max(SURELY_HARMLESS_BYTES, MOST_EXPANSION * size):
        more = f"from {size} to {unpacked_bytes} bytes, more than {MOST_EXPANSION}-fold, as photographs never do"
        raise ArchiveError(path, f"would expand {more}; it is damaged or a zip bomb")


@contextmanager
def _name_damage(path: Path) -> Iterator[None]:
    """Turn whatever a library raises while it reads an archive into one line that names it; our own errors stay."""
    try:
        yield
    except EldataError:
        raise
    except Exception as error:  # a wrong number in a header surfaces as whatever it leads to
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):  # of the disk
            raise
        said = (str(error) or type(error).__name__).splitlines()[0].rstrip(":")
        cut_short = "was its download not finished, or not all parts joined? Delete it and fetch it again"
        raise ArchiveError(path, f"is damaged, or not of a kind that eldata unpacks ({said}); {cut_short}") from error


def unpack_archive(path: Path, members: Iterable[Member], targets: Mapping[str, str], folder: Path) -> Outcome:
    """Write an archive's files below ``folder``, without following links out of it and without replacing a file.

    Parameters
    ----------
    path, members
        The archive and what :func:`read_members` tells of it.
    targets
        Where each member, by name, belongs, relative to ``folder``. Other members stay in the archive.

    Returns
    -------
    tuple
        What was written; what was there already, of the same size; and what was there with another size or is not a
        file. Both of these were left alone.

    Raises
    ------
    ArchiveError
        If a member is damaged. Files written before that are complete and stay.
    ManifestError
        If a member would be written through a link that leads out of the folder.
    DownloadError
        If the disk is full or cannot be written to.
    """
    size_of = {member.name: member.size_bytes for member in members if member.name in targets}
    places = {name: inside(folder, targets[name]) for name in size_of}
    there = {name for name, place in places.items() if os.path.lexists(place)}
    same = {name for name in there if places[name].is_file() and places[name].stat().st_size == size_of[name]}
    new = [name for name in size_of if name not in there]
    missing_bytes, staging = sum(size_of[name] for name in new), folder / STAGING
    try:
        folder.mkdir(parents=True, exist_ok=True)
        check_room(folder, missing_bytes, "to be unpacked")
        if staging.exists():  # left by a run that ended early
            shutil.rmtree(staging)
        staging.mkdir()
        with _name_damage(path), progress_bar(f"unpacking {path.name}", missing_bytes) as bar:
            for name, staged in _extract(path, new, staging) if new else ():
                places[name].parent.mkdir(parents=True, exist_ok=True)
                staged.rename(places[name])
                bar.update(size_of[name])
        shutil.rmtree(staging)
    except OSError as error:
        advice = "files unpacked before are whole, and the same command goes on"
        raise DownloadError(f"cannot unpack {path} into {folder}: {error.strerror or error}; {advice}") from error
    groups = (new, same, there - same)
    written, same_size, differing = (tuple(sorted(targets[name] for name in group)) for group in groups)
    return written, same_size, differing


def _extract(path: Path, names: Sequence[str], staging: Path) -> Iterator[tuple[str, Path]]:
    """Yield members' names and where they have come out."""
    form = read_format(path)
    if form == "zip":
        with zipfile.ZipFile(path) as archive:
            for name in names:
                yield name, Path(archive.extract(name, staging))
    elif form == "7z":
        with _open_seven_zip(path) as archive:
            archive.extract(staging, names)
        for name in names:
            (staging / name).chmod(0o644)  # not the archive's
            yield name, staging / name
    else:
        yield from _extract_blocks(path, names, staging / "block")


def size_text(size_bytes: int) -> str:
    """Return a size in decimal units, as publishers and disks state it: ``25.1 GB``."""
    power = min((len(str(size_bytes)) - 1) // 3, 4)
    return f"{size_bytes / 1000**power:.3g} {('bytes', 'kB', 'MB', 'GB', 'TB')[power]}"


def progress_bar(name: str, total_bytes: int | None = None) -> tqdm[Any]:
    """Return a bar that counts bytes, seen only in a terminal."""
    return tqdm(desc=name, total=total_bytes, unit="B", unit_scale=True, unit_divisor=1000, disable=None, leave=False)


def check_room(folder: Path, missing_bytes: int, purpose: str) -> None:
    """Raise :class:`~eldata.errors.DownloadError` if this many bytes do not fit on the folder's disk."""
    free = shutil.disk_usage(folder).free
    if missing_bytes > free:
        sizes = f"{size_text(missing_bytes)} are {purpose}, {size_text(free)} are free"
        raise DownloadError(f"{folder}: {sizes}; make room, or choose another disk with --root")


# --- zip, 7z, blocks --------------------------------------------------------------------------------------------------


def _zip_members(path: Path) -> Iterator[Member]:
    """Yield a zip archive's members, links and unknown compression named as their faults."""
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            fault = ""
            if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG, stat.S_IFDIR):
                fault = _LINK
            # Of the methods that zipfile knows, those whose pieces it unpacks to a size that it is told: 4 kB of bzip2
            # may become gigabytes at once.
            elif info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 1:
                fault = f"is encrypted or packed by a method ({info.compress_type}) that eldata does not unpack"
            yield Member(info.filename, info.file_size, fault)


@contextmanager
def _open_seven_zip(path: Path) -> Iterator[Any]:
    """Open a 7z archive; without py7zr, say how to install it."""
    try:
        import py7zr
    except ImportError as error:
        needs = "is a 7z archive, which needs the package py7zr: pip install 'eldata[7z]'"
        raise DownloadError(f"{path} {needs}; or unpack it by hand (7z x) and run eldata verify") from error
    # An open file, not a path, or py7zr unpacks in threads of its own.
    with path.open("rb") as file, py7zr.SevenZipFile(file) as archive:
        yield archive


def _seven_zip_members(path: Path) -> Iterator[Member]:
    """Yield a 7z archive's members, links named as their faults."""
    with _open_seven_zip(path) as archive:
        for info in archive.list():
            fault = _LINK if info.is_symlink or not (info.is_file or info.is_directory) else ""
            yield Member(f"{info.filename}/" if info.is_directory else info.filename, info.uncompressed, fault)


# An array of MATLAB's, such as those of SIDD: (images, blocks of each, rows, columns). Compressed as a whole, and with
# the first side running fastest, it gives a block only to whom reads all of it: so blocks are unpacked once, each a
# member in NumPy's format, and are files like any others from then on.


def _block_members(path: Path) -> Iterator[Member]:
    """Yield a member for each block, ``<array>/<image>_<block>.npy``, counted from 0 in two digits."""
    import scipy.io

    arrays = scipy.io.whosmat(path)
    if all(len(shape) != 4 for _, shape, _ in arrays):
        raise ArchiveError(path, f"expected an array of blocks, (images, blocks, rows, columns); found {arrays}")
    for name, (*counts, height, width), kind in arrays:
        if len(counts) == 2:
            values = np.dtype({"single": "float32", "double": "float64"}.get(kind, kind))
            block_bytes = height * width * values.itemsize + 128  # numpy's header
            _check_expansion(path, math.prod(counts) * block_bytes)
            for image, block in np.ndindex(*counts):
                yield Member(f"{name}/{image:02}_{block:02}.npy", block_bytes)


def _extract_blocks(path: Path, names: Sequence[str], staged: Path) -> Iterator[tuple[str, Path]]:
    """Yield the named blocks of a MATLAB array, each saved in turn as the .npy file ``staged``."""
    import scipy.io

    array = scipy.io.loadmat(path, variable_names=[names[0].partition("/")[0]])[names[0].partition("/")[0]]
    for name in names:
        image, block = map(int, Path(name).stem.split("_"))
        with staged.open("wb") as file:
            np.save(file, np.ascontiguousarray(array[image, block]), allow_pickle=False)
        yield name, staged
