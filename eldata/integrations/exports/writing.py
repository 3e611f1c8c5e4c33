"""What is exported, and how it is written: links first, the lists that name them last, nothing over anything."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

from eldata.base.files import atomic_write, sha256_of
from eldata.base.numbers import counted
from eldata.errors import EldataError, check_choice

if TYPE_CHECKING:
    from pathlib import Path

Linking = Literal["symbolic", "hard", "copy"]
LINKINGS: tuple[Linking, ...] = get_args(Linking)


@dataclass(slots=True)
class ExportPlan:
    """What published code is given.

    Attributes
    ----------
    links
        Path below the folder, and the file that it is to lead to.
    lists
        Path below the folder, and the content of a list or info.
    usage
        What to set in the published code, in sentences.
    remarks
        What that code will do otherwise than the manifest says.
    """

    links: dict[str, Path] = field(default_factory=dict)
    lists: dict[str, bytes] = field(default_factory=dict)
    usage: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class ExportReport:
    """What was written.

    Attributes
    ----------
    folder
        Where.
    pairs
        Number of pairs.
    linked, there
        Links made, and files that were there already as wanted.
    lists
        Paths of lists and infos, below the folder.
    usage, remarks
        What to set in the published code, and what it will do otherwise than the manifest says.
    """

    folder: Path
    pairs: int
    linked: int
    there: int
    lists: tuple[str, ...]
    usage: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def format_text(self) -> str:
        """Return it as lines of text."""
        before = f", {counted(self.there, 'file')} there before" if self.there else ""
        lines = [f"{counted(self.pairs, 'pair')} below {self.folder}: {counted(self.linked, 'link')} made{before}"]
        lines += [f"  {path}" for path in self.lists]
        lines += [f"to use it: {line}" for line in self.usage]
        return "\n".join([*lines, *(f"note: {line}" for line in self.remarks)])


def write_export(folder: Path, plan: ExportPlan, pairs: int, linking: Linking) -> ExportReport:
    """Write a plan. What is there as wanted is left, so the same call goes on after an interruption.

    Raises
    ------
    EldataError
        If something else lies where a link or list is to be: nothing is written then. If the system refuses.
    ArgumentError
        If ``linking`` is unknown.
    """
    check_choice("link", linking, LINKINGS)
    links = {path: file for path, file in plan.links.items() if not _is_linked(folder / path, file)}
    lists = {path: content for path, content in plan.lists.items() if not _holds(folder / path, content)}
    taken = [path for path in (*links, *lists) if os.path.lexists(folder / path)]
    if taken:
        raise EldataError(
            f"{folder / taken[0]}: is there already, and not what would be written ({counted(len(taken), 'file')} in "
            "all); nothing was written: name a new folder, or move it away"
        )
    try:
        for path, file in links.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            _link(folder / path, file, linking)
    except OSError as error:
        advice = "; a hard link must lie on the disk of its file: take --link symbolic" if linking == "hard" else ""
        raise EldataError(f"cannot write {folder / path}: {error.strerror or error}{advice}") from error
    for path, content in lists.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(folder / path) as out:
            out.write(content)
    there = len(plan.links) - len(links) + len(plan.lists) - len(lists)
    return ExportReport(folder, pairs, len(links), there, tuple(plan.lists), tuple(plan.usage), tuple(plan.remarks))


def _link(path: Path, file: Path, linking: Linking) -> None:
    if linking == "symbolic":
        path.symlink_to(file)
    elif linking == "hard":
        path.hardlink_to(file.resolve())
    else:
        with file.open("rb") as source, atomic_write(path) as out:
            shutil.copyfileobj(source, out)


def _is_linked(path: Path, file: Path) -> bool:
    """Return whether a path is a link to this file, or a copy of it."""
    try:
        if path.samefile(file):
            return True
        return path.stat().st_size == file.stat().st_size and sha256_of(path) == sha256_of(file)
    except OSError:
        return False


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
