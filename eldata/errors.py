"""The errors that this package raises on purpose.

Each message is written for the person who reads it: which file, which field, what was expected, what was
found, what to do. The command line prints it as one line; a traceback shows only with ``--debug``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable
    from pathlib import Path


class EldataError(Exception):
    """Base class of every error below."""


class ArgumentError(EldataError, ValueError):
    """An argument is not one that the function accepts."""


def name_missing_torch(load: Callable[[str], Any]) -> Callable[[str], Any]:
    """Make a package's lazy ``__getattr__`` say how to install torch, if a name needs it."""

    def load_or_explain(name: str) -> Any:
        try:
            return load(name)
        except ModuleNotFoundError as error:
            if error.name != "torch":
                raise
            text = f"{name} needs torch, which is not installed: pip install torch"
            raise ModuleNotFoundError(text, name="torch") from None

    return load_or_explain


def check_choice(name: str, value: object, known: Collection[object]) -> None:
    """Raise :class:`ArgumentError`, which lists the known values, unless an argument is one of them."""
    if value not in known:
        raise ArgumentError(f"{name} must be one of {', '.join(map(repr, known))}; found {value!r}")


def nearest(name: str, known: Iterable[str], *, alike: float = 0.6) -> str | None:
    """Return the known name that another was probably meant to be, or ``None``; case does not matter.

    ``alike`` is the least ratio of :class:`difflib.SequenceMatcher`: 0.6 finds two letters swapped in a name of three.
    """
    from difflib import get_close_matches

    spelt = {one.casefold(): one for one in known}
    asked = name[:_LONGEST_COMPARED].casefold()
    near = get_close_matches(asked, spelt, n=3, cutoff=alike)
    near.sort(key=lambda one: not one.startswith(asked))  # an abbreviation, of names that are equally near
    return spelt[near[0]] if near else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence about an unknown name: ``"; did you mean eld?"``, or nothing."""
    near = nearest(name, known)
    return "" if near is None else f"; did you mean {near}?"


# What is compared of a name: the time grows with its length, and a stranger's file may hold any.
_LONGEST_COMPARED = 100


class FileError(EldataError):
    """Something is wrong with one file: ``path`` is the file, ``reason`` what is wrong with it."""

    def __init__(self, path: Path | str, reason: str = "") -> None:
        super().__init__(path, reason)
        self.path = path
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}" if self.reason else str(self.path)


class RawFileError(FileError):
    """A raw file cannot be used."""


class UnusableRawError(RawFileError):
    """A raw file is whole but cannot be used as it is: to copy it again would not help. ``advice`` is what would."""

    def __init__(self, path: Path | str, found: str, advice: str) -> None:
        super().__init__(path, f"{found}; {advice}")
        self.args = path, found, advice  # for copies and other processes
        self.found = found.removeprefix("is ")
        self.advice = advice


class PredictionError(FileError):
    """A prediction cannot be scored."""


class ShadingError(FileError):
    """The file of a dark shading cannot be used."""


class ManifestError(EldataError):
    """A manifest or a dataset card is malformed."""


class DatasetError(EldataError):
    """A dataset's files are not what was asked for."""


class ProfileError(EldataError):
    """A camera profile is malformed or unknown."""


class DownloadError(EldataError):
    """A file cannot be fetched or written; what has arrived is kept, unless the message says that it is not."""


class ArchiveError(FileError):
    """An archive is damaged, unsafe to unpack, or not the one that was asked for."""
