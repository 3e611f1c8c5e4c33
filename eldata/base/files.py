"""Files: hashing, atomic writing, locks, and paths that stay inside their root."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
import stat
import sys
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, TypeVar

from eldata.base.visible import has_unseen
from eldata.errors import ArgumentError, EldataError, FileError, ManifestError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping


Result = TypeVar("Result")

_LONGEST_PATH = 4096


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Add this file's name to an ``OSError`` of the block: the system names it only where it is opened."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def sha256_of(path: Path) -> str:
    """Return ``sha256:<hex>`` of a file's bytes, read in pieces; once where several frames lie in one."""
    with naming_file(path):
        status = path.stat()
        return _hash_file(path, status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=16)
def _hash_file(path: Path, *_: int) -> str:
    """Hash a file, which other arguments tell from an earlier one of its name."""
    with path.open("rb") as file:
        return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"


def file_problem(path: Path) -> str | None:
    """Describe why a path is not a readable file with something in it, links followed; ``None`` if it is.

    Ask before strangers' files are opened: a named pipe would be waited for, and a device read, for ever. A pointer or
    a web page that a download left instead of the file is named.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            return f"is {_describe_kind(status)}, not a file"
        with path.open("rb") as file:
            head = file.read(_LONGEST_HEAD)
    except OSError as error:  # a loop of links, too
        return f"cannot be read: {error.strerror}"
    except ValueError:
        return "cannot be read: its name holds a NUL character"
    return _describe_stand_in(head) if head else "is empty (0 bytes): copy or download it again"


def _describe_kind(status: os.stat_result) -> str:
    """Name the kind of a file that is not regular."""
    return "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, device or socket"


_LONGEST_HEAD = 256
_POINTER = re.compile(rb"version https://git-lfs.*?^size (\d+)|.*?/annex/objects/", re.DOTALL | re.MULTILINE)
_PAGE = re.compile(rb"(\xef\xbb\xbf)?\s*<(!doctype html|html|head|\?xml)\b", re.IGNORECASE)


def _describe_stand_in(head: bytes) -> str | None:
    """Describe a file that stands instead of another: a pointer, a web page, macOS's companion; else ``None``."""
    pointer = _POINTER.match(head)
    if pointer is not None and pointer[1]:
        return f"is a pointer of Git LFS to a file of {int(pointer[1])} bytes: fetch that one with git lfs pull"
    if pointer is not None:
        return "is a pointer of git-annex: fetch the file itself with git annex get"
    if _PAGE.match(head):
        return "is a web page (HTML or XML), such as a server sends instead of a file: download the file itself again"
    if head.startswith(b"\0\5\x16\7"):
        return "is what macOS puts beside a file (AppleDouble), not the file: copy the one without ._ before its name"
    return None


def is_hidden(relative: str) -> bool:
    """Tell whether a POSIX path has a part that begins with a dot, such as macOS's companion ``._IMG_1.dng``."""
    return relative.startswith(".") or "/." in relative


def visible_below(folder: Path, *, deep: bool = True) -> list[Path]:
    """List the files, folders and links below a folder, sorted, but for hidden ones; links are not followed.

    All below a hidden folder is passed over. A missing folder holds nothing.

    Raises
    ------
    EldataError
        If a folder cannot be read.
    """
    paths: list[Path] = []
    waiting = [folder] if folder.is_dir() else []
    while waiting:  # not recursive: folders may lie deeper than Python's stack
        place = waiting.pop()
        try:
            with os.scandir(place) as entries:
                visible = [entry for entry in entries if not is_hidden(entry.name)]
        except OSError as error:
            raise EldataError(f"{place}: cannot be read: {error.strerror}") from error
        paths += [place / entry.name for entry in visible]
        waiting += [place / entry.name for entry in visible if deep and entry.is_dir(follow_symlinks=False)]
    return sorted(paths)


def read_file(work: Callable[[Path], Result], path: Path, error: type[FileError]) -> Result:
    """Call ``work(path)`` on a file of unknown origin; refuse one that is not regular, links followed.

    Raises
    ------
    FileError
        ``error``, with the path and the reason, if the file cannot be read or needs more memory than there is.
    Exception
        Whatever else ``work`` raises.
    """
    if (problem := file_problem(path)) is not None:
        raise error(path, problem)
    try:
        return work(path)
    except MemoryError as lack:
        reason = "needs more memory than there is; is the file whole, and what it says it is?"
        raise error(path, reason) from lack
    except OSError as cause:
        if cause.errno is None:  # not the system's: a library that does not load, say
            raise
        raise error(path, f"cannot be read: {cause.strerror or cause}") from cause


def folder_problem(folder: Path) -> str | None:
    """Describe why a path is not a folder; ``None`` if it is, once links are followed."""
    if folder.is_dir():
        return None
    return "is a file, not a folder" if folder.exists() else "there is no such folder"


def write_problem(path: Path) -> str | None:
    """Describe why :func:`atomic_write` cannot write a file, or return ``None``; nothing is made, opened or changed.

    ``None`` is not certain: the disk may be full, and some systems tell only whoever writes.
    """
    folder = path.parent
    try:
        if path.exists() and not path.is_file():  # a file is replaced by renaming, and so would a device be
            return f"is {_describe_kind(path.stat())}, not a file"
        with suppress(FileNotFoundError):
            _name_temporary(path, secrets.token_hex(_TOKEN_BYTES)).lstat()  # its name is longer
        if not folder.exists():
            return f"there is no folder {folder}; make it first"
        place = folder.resolve()
        system = place == Path("/dev") or place.is_relative_to("/proc")  # where root may: /dev/stdout would be replaced
        if system or not os.access(folder, os.W_OK | os.X_OK):
            return f"no file can be made in the folder {folder}; choose another"
    except NotADirectoryError:
        return f"{folder} is not a folder"
    except (OSError, ValueError) as error:  # a loop of links, a name that is too long, NUL in it
        return str(getattr(error, "strerror", error))
    return None


def refuse_among(output: Path, folder: Path, files: Iterable[str] | None = None) -> None:
    """Refuse a folder for outputs that holds a dataset's files.

    Parameters
    ----------
    output
        Where files are written.
    folder
        The dataset's folder, which may not get any.
    files
        Its files, below it: their folders may not get any either. Without, no folder in it may: all are searched.

    Raises
    ------
    ArgumentError
        If it does.
    """
    try:
        place = output.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return  # it lies elsewhere
    if files is None or place == "." or any(file.startswith(f"{place}/") for file in files):
        raise ArgumentError(f"cannot write into {output}: the files of the set {folder} lie there; give another folder")


@contextmanager
def atomic_write(path: Path | str) -> Iterator[IO[bytes]]:
    """Write a file whole or not at all: a temporary file in the same folder, synced, then renamed.

    Whatever happens before the rename (an error, a full disk, Ctrl-C, kill -9) leaves an older ``path`` as it
    was, and all but the kill also remove the temporary file, which is hidden and ends in ``.part``. What a kill
    left is removed when the file is written again; :func:`remove_leftovers` does it for a whole folder.

    Raises
    ------
    EldataError
        If the operating system refuses; the message names the file and its reason.
    """
    path = Path(path)
    try:
        with temporary_file(path) as (file, temporary):
            yield file
            file.flush()
            os.fsync(file.fileno())
            if sys.platform == "win32":
                file.close()  # an open file cannot be renamed there
            temporary.replace(path)
    except OSError as error:
        if error.filename is not None and _LEFTOVER.fullmatch(Path(error.filename).name) is None:
            raise  # of another file, in the caller's block
        raise EldataError(f"cannot write {path}: {error.strerror or error}") from error


_MOST_TRIES = 20
_TOKEN_BYTES = 8
_LEFTOVER = re.compile(r"\..*\.(eldata|[0-9a-f]{16})\.part", re.DOTALL)


@contextmanager
def temporary_file(path: Path) -> Iterator[tuple[IO[bytes], Path]]:
    """Yield a new file in the folder of ``path``, and its path; it is removed unless the caller renames it.

    Its lock, held as long as it is open, tells it from what a dead process left; that is removed first. Where another
    process writes to the same ``path``, it gets a name of its own. Without locks (Windows, some network disks) nothing
    of others is removed.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    for unique in ("eldata", *(secrets.token_hex(_TOKEN_BYTES) for _ in range(_MOST_TRIES))):
        temporary = _name_temporary(path, unique)
        _remove_if_dead(temporary)
        made: os.stat_result | None = None
        try:
            with temporary.open("xb") as file:
                made = os.fstat(file.fileno())
                # Else another process took it for dead in the moment before, and removes it.
                if try_lock(file) is not False and _is_at(temporary, made):
                    yield file, temporary
                    return
        except FileExistsError:
            if made is not None:
                raise  # of the caller's block; else it is a live one, or somebody else's
        finally:
            if made is None:
                _remove_if_dead(temporary)  # Ctrl-C may have come once it was there
            elif _is_at(temporary, made):
                with suppress(OSError):
                    temporary.unlink()
    raise OSError(errno.EBUSY, "other processes take away what is written", str(temporary))


def _name_temporary(path: Path, unique: str) -> Path:
    """Name a hidden file in the folder of ``path``, to be written before it is renamed to ``path``."""
    return path.parent / f".{path.name}.{unique}.part"  # of any path, also of one without a name


def remove_leftovers(folder: Path) -> None:
    """Remove what dead processes that were writing files left in a folder: see :func:`temporary_file`.

    Raises
    ------
    OSError
        If the folder cannot be read.
    """
    for name in os.listdir(folder):  # noqa: PTH208 # a folder may hold very many names
        if _LEFTOVER.fullmatch(name) is not None:
            _remove_if_dead(folder / name)


def _remove_if_dead(temporary: Path) -> None:
    """Remove a temporary file unless a running process holds its lock."""
    with suppress(OSError):  # it is not there, or not ours
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        descriptor = os.open(temporary, flags)
        try:
            status = os.fstat(descriptor)
            # Its owner may have renamed it meanwhile, and another live process have made a new one of its name.
            if stat.S_ISREG(status.st_mode) and try_lock(descriptor) and _is_at(temporary, status):
                temporary.unlink()
        finally:
            os.close(descriptor)


def try_lock(file: int | IO[bytes], *, shared: bool = False, wait: bool = False) -> bool | None:
    """Lock an open file or folder for as long as it is open.

    Any number of processes hold a ``shared`` lock, while none has one that is not.

    Returns
    -------
    bool or None
        ``False`` if another process holds the lock, unless it is waited for; ``None`` where there are no locks: on
        Windows, some network disks.
    """
    try:
        import fcntl

        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return None
    return True


@contextmanager
def hold_lock(folder: str) -> Iterator[None]:
    """Hold a folder's lock while the block runs, where there are locks; wait for it."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:  # on Windows
        yield
        return
    try:
        try_lock(descriptor, wait=True)
        yield
    finally:
        with suppress(ImportError, OSError):  # a process that was forked meanwhile has it open too
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_UN)
        os.close(descriptor)


def _is_at(path: Path, file: os.stat_result) -> bool:
    """Tell whether a file still has its name: another process may have removed or renamed it."""
    try:
        return os.path.samestat(file, path.stat())
    except OSError:
        return False


def write_text(path: Path | str, text: str) -> None:
    r"""Write UTF-8 text whole or not at all, with line ends as given.

    What stands for a byte of a file name that is not UTF-8 is written by its number, ``\udcff``.
    """
    with atomic_write(path) as file:
        file.write(encoded(text))


def encoded(text: str) -> bytes:
    """Return the bytes that :func:`write_text` writes."""
    return text.encode("utf-8", "backslashreplace")


def write_json(path: Path | str, data: object, *, indent: int = 2) -> None:
    """Write plain types as JSON, whole or not at all."""
    write_text(path, json_text(data, indent=indent))


def json_text(data: object, *, indent: int | None = 2) -> str:
    r"""Return plain types as the text of a JSON file, on one line if ``indent`` is ``None``; all numbers are finite.

    What stands for a byte of a file name that is not UTF-8 becomes a number, ``\udcff``, which JSON reads back.
    """
    text = json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8", "backslashreplace").decode() + "\n"


def check_same_work(place: Path, begun: Mapping[str, object], wanted: Mapping[str, object]) -> None:
    """Raise :class:`ArgumentError` if unfinished work was started with another dataset or other options than now."""
    for name, value in wanted.items():
        if begun.get(name) != value:
            raise ArgumentError(
                f"{place}: was started with {name.replace('_', ' ')} {begun.get(name)}, now {value}; give the same "
                "data and options, or remove it to start again"
            )


_MEMBER = re.compile(r"(.+\.(?:npy|npz|h5|mat|tiff?))#([^/]+)", re.IGNORECASE)


def path_problem(relative: str) -> str | None:
    """Describe why a manifest's path is unsafe; ``None`` if it is a plain relative POSIX path."""
    parts = relative.split("/")
    problems = (
        (not relative, "is empty"),
        ("\\" in relative, "contains a backslash; manifests use '/'"),
        (has_unseen(relative), "contains a control character, or another one that does not show"),
        (relative.startswith("/"), "is absolute; paths are relative to the dataset's folder"),
        (":" in split_member(parts[0])[0], "names a drive; paths are relative to the dataset's folder"),
        (any(part in ("", ".", "..") for part in parts), "contains an empty, '.' or '..' part"),
        (max(map(len, parts)) > 255, "contains a name of more than 255 characters, which no file system has"),
        (len(relative) > _LONGEST_PATH, f"has more than {_LONGEST_PATH} characters, which no system opens"),
    )
    return next((problem for is_so, problem in problems if is_so), None)


def split_member(path: str) -> tuple[str, str]:
    """Split a path into its file's and what is meant of an array file's content: ``clip.npz#im:3`` gives ``im:3``.

    That is one frame of an array's first side (``#3``), an array by its name (``#im``), or a frame of one (``#im:3``).
    """
    found = _MEMBER.fullmatch(path)
    return (path, "") if found is None else (found[1], found[2])


def inside(root: Path, relative: str) -> Path:
    """Join ``root / relative``, if that file lies inside ``root`` once every link is followed.

    Of what is meant in an array file (:func:`split_member`) that is the file.

    The root itself may be a link; a link below it that leads out of it is refused, whether or not it dangles.

    Raises
    ------
    ManifestError
        If the path is unsafe as text or leads outside.
    """
    if (problem := path_problem(relative)) is not None:
        raise ManifestError(f"path {relative!r} {problem}")
    path = root.joinpath(*PurePosixPath(split_member(relative)[0]).parts)
    try:
        leads_outside = not path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError) as error:
        raise ManifestError(f"{path} cannot be followed ({error}); is it a loop of links, or too long?") from error
    if leads_outside:
        raise ManifestError(
            f"{path} leads outside of {root} through a link; move the files there, or point --root at their place"
        )
    return path
