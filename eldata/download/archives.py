"""Archives: what one holds and whether it is safe to unpack, checked before a byte of it is written.

They are zip, 7z, and blocks of mosaics in MATLAB's format. Zip is read by zipfile.
7z is read by py7zr. None of these learns of a folder to write to: members' bytes go to files that are made for them
(:mod:`eldata.download.members`), links and modes nowhere.
"""

from __future__ import annotations

import errno
import io
import shutil
import stat
import unicodedata
import zipfile
import zlib
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.base.array_files import read_array
from eldata.base.files import SmallReads, file_problem, path_problem, read_file
from eldata.base.visible import shown
from eldata.download.members import BY_HAND, Member
from eldata.errors import ArchiveError, DownloadError, EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from eldata.base.pixels import Declared
    from eldata.download.members import Kind, NewFile

Format = Literal["zip", "7z", "blocks"]

HEAD_BYTES = 512  # enough to see a tar file's mark, at byte 257
_MARKS: dict[bytes, Format] = {
    b"PK\x03\x04": "zip",
    b"PK\x05\x06": "zip",  # an empty one
    b"7z\xbc\xaf\x27\x1c": "7z",
    b"MATLAB 5.0 MAT-file": "blocks",
}
_COMPRESSED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00")

# Zip's deflate reaches 1000:1 on zeros; raw files of dark scenes shrink to a third, never to a hundredth.
MOST_EXPANSION = 100
SURELY_HARMLESS_BYTES = 64 * 2**20
MOST_MEMBERS = 500_000  # ten times as many as the largest of the known datasets has
# Of the methods that zipfile knows, those whose pieces it unpacks to a size that it is told: 4 kB of bzip2 may become
# gigabytes at once.
_ZIP_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
# A zip's table of contents; half a million members with names of 80 characters need as much.
_LARGEST_READ_BYTES = 64 * 2**20
_PIECE_BYTES = 2**20

_FETCH_AGAIN = "is its download whole? Fetch it again"
_UNSAFE = "it was not made by the publisher; do not unpack it"
_CUT_SHORT = "its download was not finished, or not all parts were joined: delete it and fetch it again"
# Of seeking to a place that cannot be: the archive's number is wrong, not the disk.
_WRONG_PLACE = (None, errno.EINVAL, errno.EOVERFLOW, errno.EFBIG)


@dataclass(frozen=True, slots=True)
class Archive:
    """An archive that :func:`open_archive` found complete and safe to unpack; ``files`` are its files."""

    path: Path
    files: tuple[Member, ...]
    form: Format

    def unpack(self, files: Sequence[tuple[Member, NewFile]]) -> dict[str, bool]:
        """Write members to their files; return, by name, whether each got its place, which was free.

        Raises
        ------
        ArchiveError
            If a member is damaged, or missing.
        DownloadError
            If a file cannot be written.
        """
        if not files:
            return {}
        unpack = {"zip": _unpack_zip, "blocks": _unpack_blocks, "7z": _unpack_seven_zip}[self.form]
        placed = read_file(partial(unpack, files), self.path, ArchiveError)
        lost = [member.name for member, _ in files if member.name not in placed]
        if lost:
            raise ArchiveError(
                self.path, f"member {shown(lost[0])} is listed, but did not come out of it; fetch it again"
            )
        return placed


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
    form = archive_format(head)
    if form is None:
        raise ArchiveError(
            path, f"is not a zip or 7z archive, or blocks of MATLAB, but {looks_like(head)}; save the archive itself"
        )
    list_members = {"zip": _zip_members, "blocks": _block_members, "7z": _seven_zip_members}[form]
    members = read_file(list_members, path, ArchiveError)
    check_members(path, members)
    files = tuple(member for member in members if member.kind == "file")
    if not files:
        raise ArchiveError(path, "holds no file")
    return Archive(path, files, form)


def archive_format(head: bytes) -> Format | None:
    """Return an archive's format by its first ``HEAD_BYTES`` bytes, ``None`` if it is none that eldata unpacks."""
    return next((form for mark, form in _MARKS.items() if head.startswith(mark)), None)


def looks_like(head: bytes) -> str:
    """Say what a file that is not an archive looks like by its first bytes."""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype", b"<html", b"<head", b"<?xml", b"<!--")):
        return "a web page, as Google Drive sends when it asks for a confirmation or a login"
    if head.startswith(b"Rar!"):
        return "a RAR archive; unpack it with unrar or 7z"
    if head[257:262] == b"ustar" or head.startswith(_COMPRESSED):
        return "a tar archive or a compressed file; unpack it by hand (tar xf, 7z x) and run eldata verify"
    if not head.strip(b"\0"):
        return "nothing but zeros" if head else "an empty file"
    return f"a file of another kind, which starts with {head[:8]!r}"


def check_members(path: Path, members: Sequence[Member]) -> None:
    """Refuse an archive whose list of members is unsafe.

    Raises
    ------
    ArchiveError
        See :func:`open_archive`.
    """
    if len(members) > MOST_MEMBERS:
        raise ArchiveError(path, f"lists {len(members)} members; {_UNSAFE}")
    seen: dict[str, str] = {}
    folders: dict[str, str] = {}
    for member in members:
        name = member.stored_name
        problem = path_problem(member.name) or {
            "link": "is a link, which could lead out of the folder",
            "special": "is a device or something like it",
        }.get(member.kind)
        if problem is not None:
            raise ArchiveError(path, f"member {shown(name)} {problem}; {_UNSAFE}")
        if member.kind == "folder":
            continue
        key = unicodedata.normalize("NFC", member.name).casefold()  # as file systems see it
        if key in seen:
            twice = f"members {shown(seen[key])} and {shown(name)} would be one file where case does not count"
            raise ArchiveError(path, f"{twice}; {_UNSAFE}")
        seen[key] = name
        for parent in PurePosixPath(key).parents:
            folders.setdefault(parent.as_posix(), name)
    for key, name in seen.items():
        if key in folders:
            both = f"member {shown(name)} is a file, and a folder of {shown(folders[key])}"
            raise ArchiveError(path, f"{both}; {_UNSAFE}")
    _check_sizes(path, members)


def _check_sizes(path: Path, members: Sequence[Member]) -> None:
    size = path.stat().st_size
    packed = sum(member.packed_bytes or 0 for member in members)
    if packed > size:  # members that share their bytes: a bomb that every ratio of one member misses
        raise ArchiveError(path, f"its members claim {packed} bytes of a file of {size}; it is damaged or a zip bomb")
    unpacked = sum(member.size_bytes for member in members)
    if unpacked > max(SURELY_HARMLESS_BYTES, MOST_EXPANSION * size):
        raise ArchiveError(
            path,
            f"would expand from {size} to {unpacked} bytes, more than {MOST_EXPANSION}-fold, as photographs never do; "
            "it is damaged or a zip bomb",
        )


def _clean(stored_name: str) -> str:
    """Return a member's name as a relative path."""
    name = stored_name.rstrip("/") if stored_name.strip("/") else stored_name
    while name.startswith("./"):
        name = name[2:]
    return name


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Turn whatever a library raises while it reads an archive into one line that names it; our own errors stay."""
    try:
        yield
    except EldataError:
        raise
    except Exception as error:  # a wrong number in a header surfaces as whatever it leads to
        system = isinstance(error, OSError)
        if isinstance(error, OSError) and error.errno not in _WRONG_PLACE:
            raise ArchiveError(path, f"cannot be read: {error.strerror}") from error
        said = (error.strerror if system else None) or str(error) or type(error).__name__  # type: ignore[attr-defined]
        raise ArchiveError(path, f"is damaged ({said.splitlines()[0].rstrip(':')}); {_CUT_SHORT}") from error


# --- zip --------------------------------------------------------------------------------------------------------------


def _zip_members(path: Path) -> tuple[Member, ...]:
    """Return every entry of the central directory."""
    try:
        with _damage_named(path), SmallReads(path, _LARGEST_READ_BYTES) as file, zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
    except ArchiveError as error:
        if isinstance(error.__cause__, zipfile.BadZipFile):
            reason = f"its table of contents (End-of-central-directory) is missing or damaged; {_CUT_SHORT}"
            raise ArchiveError(path, reason) from error.__cause__
        raise
    for info in infos:
        if info.flag_bits & 1:
            raise ArchiveError(path, f"member {shown(info.filename)} is encrypted; unpack it by hand")
        if info.compress_type not in _ZIP_METHODS:
            method = f"method {info.compress_type}, which eldata does not unpack"
            raise ArchiveError(path, f"member {shown(info.filename)} is packed by {method}; {BY_HAND}")
    return tuple(
        Member(_clean(one.filename), one.filename, _zip_kind(one), one.file_size, one.compress_size, one.CRC)
        for one in infos
    )


def _zip_kind(info: zipfile.ZipInfo) -> Kind:
    if info.filename.endswith("/"):  # is_dir() fails where there is no name
        return "folder"
    mode = info.external_attr >> 16
    if stat.S_ISLNK(mode):
        return "link"
    return "file" if stat.S_IFMT(mode) in (0, stat.S_IFREG) else "special"


def _unpack_zip(files: Sequence[tuple[Member, NewFile]], path: Path) -> dict[str, bool]:
    """Write members to files; zipfile checks the CRC of each at its end."""
    placed = {}
    with _damage_named(path), SmallReads(path, _LARGEST_READ_BYTES) as file, zipfile.ZipFile(file) as archive:
        for member, new in files:
            with archive.open(member.stored_name) as source, closing(new.open()) as target:
                shutil.copyfileobj(source, target, _PIECE_BYTES)
                placed[member.name] = new.finish()
    return placed


# --- 7z ---------------------------------------------------------------------------------------------------------------


@contextmanager
def _opened_seven_zip(path: Path) -> Iterator[Any]:
    try:
        import py7zr
    except ImportError as error:
        raise DownloadError(
            f"{path} is a 7z archive, which needs the package py7zr: pip install 'eldata[7z]'; or unpack it by hand "
            "(7z x) and run eldata verify"
        ) from error

    # An open file, not a path, or py7zr unpacks in threads of its own.
    with _damage_named(path), path.open("rb") as file:
        try:
            with py7zr.SevenZipFile(file) as archive:
                yield archive
        except py7zr.exceptions.PasswordRequired as error:
            raise ArchiveError(path, "is encrypted; unpack it by hand") from error
        except py7zr.exceptions.UnsupportedCompressionMethodError as error:
            raise ArchiveError(path, f"is packed by a method that py7zr does not know; {BY_HAND}") from error


def _seven_zip_members(path: Path) -> tuple[Member, ...]:
    """Return every entry of the header."""
    with _opened_seven_zip(path) as archive:
        if archive.needs_password():
            raise ArchiveError(path, "is encrypted; unpack it by hand")
        return tuple(
            Member(_clean(one.filename), one.filename, _seven_zip_kind(one), one.uncompressed, None, one.crc32)
            for one in archive.list()
        )


def _seven_zip_kind(info: Any) -> Kind:
    if info.is_symlink:
        return "link"
    if info.is_directory:
        return "folder"
    return "file" if info.is_file else "special"


def _unpack_seven_zip(files: Sequence[tuple[Member, NewFile]], path: Path) -> dict[str, bool]:
    """Write members to files; py7zr closes each once its CRC is right."""
    import py7zr

    new_of = {member.name: new for member, new in files}
    placed: dict[str, bool] = {}

    class OneMember(py7zr.io.Py7zIO):
        def __init__(self, name: str) -> None:
            self._name, self._new = name, new_of[name]
            self._file = self._new.open()
            begun.callback(self._file.close)  # py7zr drops one whose bytes are damaged

        def write(self, piece: bytes | bytearray) -> int:
            return self._file.write(piece)

        def close(self) -> None:
            self._file.close()
            placed[self._name] = self._new.finish()

        # The rest of py7zr's interface: it asks for nothing of it that would have to be answered.

        def read(self, size: int | None = None) -> bytes:  # noqa: ARG002 # it is never called
            raise io.UnsupportedOperation("read")

        def seek(self, offset: int, whence: int = 0) -> int:  # noqa: ARG002 # it is called before the file is closed
            return 0

        def flush(self) -> None:
            pass

        def size(self) -> int:
            return self._new.member_bytes

    class Members(py7zr.io.WriterFactory):
        def create(self, filename: str) -> py7zr.io.Py7zIO:
            return OneMember(filename)

    with ExitStack() as begun, _opened_seven_zip(path) as archive:
        archive.extract(targets=[member.stored_name for member, _ in files], factory=Members())
    return placed


# --- blocks -----------------------------------------------------------------------------------------------------------
# An array of MATLAB's, such as those of SIDD: (images, blocks of each, rows, columns). Compressed as a whole, and with
# the first side running fastest, it gives a block only to whom reads all of it: so blocks are unpacked once, each a
# member in NumPy's format, and are files like any others from then on.


def _block_members(path: Path) -> tuple[Member, ...]:
    """Return a member for each block, ``<array>/<image>_<block>.npy``, counted from 0 in two digits."""
    return tuple(Member(name, name, "file", len(content), None, zlib.crc32(content)) for name, content in _blocks(path))


def _unpack_blocks(files: Sequence[tuple[Member, NewFile]], path: Path) -> dict[str, bool]:
    """Write members to their files; return, by name, whether each got its place."""
    new_of = {member.name: new for member, new in files}
    placed = {}
    for name, content in _blocks(path):
        if name in new_of:
            with closing(new_of[name].open()) as target:
                target.write(content)
            placed[name] = new_of[name].finish()
    return placed


def _blocks(path: Path) -> Iterator[tuple[str, bytes]]:
    import scipy.io

    if path.suffix.lower() != ".mat":
        raise ArchiveError(path, "is a file of MATLAB's; give it a name that ends in .mat")
    try:
        held = [name for name, shape, _ in scipy.io.whosmat(path) if len(shape) == 4]
    except Exception as error:  # scipy's readers raise what a wrong number leads to
        raise ArchiveError(path, f"is damaged ({error}); {_FETCH_AGAIN}") from error
    if len(held) != 1:
        found = ", ".join(held) or "none"
        raise ArchiveError(path, f"expected one array of blocks, (images, blocks, rows, columns); found {found}")
    array = read_array(path, _any_shape, name=held[0], error=ArchiveError, advice=_FETCH_AGAIN)
    for image, block in np.ndindex(*array.shape[:2]):
        file = io.BytesIO()
        np.save(file, np.ascontiguousarray(array[image, block]), allow_pickle=False)
        yield f"{held[0]}/{image:02}_{block:02}.npy", file.getvalue()


def _any_shape(declared: Declared) -> None:
    """Take whatever array it is: its members are checked as an archive's are."""
