"""Files: hashing, atomic writing, locks, and paths that stay inside their root."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import sys
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING

from eldata.errors import ArgumentError, EldataError, ManifestError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


def sha256_of(path: Path) -> str:
    """Return ``sha256:<hex>`` of a file's bytes, read in pieces."""
    with path.open("rb") as file:
        return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"


@contextmanager
def atomic_write(path: Path | str) -> Iterator[IO[bytes]]:
    """Write a file whole or not at all: a temporary file in the same folder, synced, then renamed.

    Whatever happens before the rename (an error, a full disk, Ctrl-C, kill -9) leaves an older ``path`` as it
    was, and all but the kill also remove the temporary file, which is hidden and ends in ``.part``.

    Raises
    ------
    EldataError
        If the operating system refuses; the message names the file and its reason.
    """
    path = Path(path)
    temporary = path.parent / f".{path.name}.{secrets.token_hex(8)}.part"
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.filename is not None and Path(error.filename) != temporary:
            raise  # of another file, in the caller's block
        raise EldataError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Write UTF-8 text whole or not at all, with line ends as given."""
    with atomic_write(path) as file:
        file.write(text.encode())


def write_json(path: Path | str, data: object, *, indent: int = 2) -> None:
    """Write plain types as JSON, whole or not at all."""
    write_text(path, json_text(data, indent=indent))


def json_text(data: object, *, indent: int = 2) -> str:
    """Return plain types as the text of a JSON file; only finite numbers are allowed."""
    return json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False) + "\n"


def check_same_work(place: Path, begun: Mapping[str, object], wanted: Mapping[str, object]) -> None:
    """Raise :class:`ArgumentError` if unfinished work was begun with another dataset or other options than now."""
    for name, value in wanted.items():
        if begun.get(name) != value:
            raise ArgumentError(
                f"{place}: was begun with another {name.replace('_', ' ')}: expected {value}, found {begun.get(name)}; "
                "give the same data and options as then, or remove it to start again"
            )


def check_posix(what: str) -> None:
    """Raise :class:`EldataError` if this system lacks the locks, and with them the calls, of POSIX.

    Call it before the first ``os.pread``, ``os.O_CLOEXEC`` and their kin, which Windows does not have either.
    """
    try:
        import fcntl  # noqa: F401 # only to see whether it exists
    except ImportError:
        raise EldataError(
            f"{what} needs a POSIX system such as Linux or macOS: this Python ({sys.platform}) has no module fcntl; "
            "on Windows, run it under WSL"
        ) from None


def try_lock(path: Path, file: int | IO[bytes]) -> bool:
    """Lock an open file or folder for as long as it is open; ``False`` if another process holds the lock.

    Raises
    ------
    EldataError
        If its disk does not support locks.
    """
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise EldataError(f"{path}: cannot be locked ({error.strerror}); choose a place on another disk") from error
    return True


def path_problem(relative: str) -> str | None:
    """Return why a manifest's path is unsafe, or ``None`` if it is a plain relative POSIX path."""
    if not relative:
        return "is empty"
    if "\\" in relative:
        return "contains a backslash; manifests use '/'"
    if any(ord(character) < 32 or ord(character) == 127 for character in relative):
        return "contains a control character"
    if relative.startswith("/"):
        return "is absolute; paths are relative to the dataset's folder"
    if ":" in relative.partition("/")[0]:
        return "names a drive; paths are relative to the dataset's folder"
    parts = relative.split("/")
    if any(part in ("", ".", "..") for part in parts):
        return "contains an empty, '.' or '..' part"
    if max(map(len, parts)) > 255:
        return "contains a name of more than 255 characters, which no file system has"
    return None


def inside(root: Path, relative: str) -> Path:
    """Return ``root / relative``, if that file lies inside ``root`` once every link is followed.

    The root itself may be a link; a link below it that leads out of it is refused, whether or not it dangles.

    Raises
    ------
    ManifestError
        If the path is unsafe as text or leads outside.
    """
    problem = path_problem(relative)
    if problem is not None:
        raise ManifestError(f"path {relative!r} {problem}")
    path = root.joinpath(*PurePosixPath(relative).parts)
    try:
        leads_outside = not path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError) as error:
        raise ManifestError(f"{path} cannot be followed ({error}); is it a loop of links?") from error
    if leads_outside:
        raise ManifestError(
            f"{path} leads outside of {root} through a link; move the files there, or point --root at their place"
        )
    return path
