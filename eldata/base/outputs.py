"""Files that commands write: none takes the place of what a command reads, or of a file that it did not make.

An option that names a file to write is added by :func:`add_output`, with its :class:`FileKind`: how one that an earlier
run of the command wrote is told from all else. :func:`check_outputs` looks before the work begins.
"""

from __future__ import annotations

import argparse
import os
import re
from codecs import BOM_UTF8
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile
from eldata.base.files import write_problem
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, FileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_HEAD_BYTES = 1 << 12
_MOST_SHOWN = 4
_MOST_SHOWN_CHARACTERS = 40
_NAMES = ("N", "NAME")  # metavars of what is never a file
_BEGINS = {
    b"II": "a raw file or a TIFF",
    b"MM": "a raw file or a TIFF",
    b"FUJIFILM": "a raw file",
    b"\x89HDF": "an HDF5 file",
    b"\x93NUMPY": "an array (.npy)",
    b"PK\x03\x04": "an archive (.zip, .npz)",
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"<!DOCTYPE html>": "another page",
}


@dataclass(frozen=True, slots=True)
class FileKind:
    """What the files of one option have in common.

    Attributes
    ----------
    begins
        Regular expression of their first bytes.
    fields
        Names of fields of an object in JSON that they have, all of one of these sets at least; empty: no JSON.
    """

    begins: bytes
    fields: tuple[frozenset[str], ...] = ()

    def problem(self, path: Path) -> str | None:
        """Return what a file is that is there and not of this kind; ``None`` if it is, is empty or is not there."""
        try:
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
        except FileNotFoundError:
            return None
        except OSError as error:
            return f"cannot be read: {error.strerror}"
        if not head:
            return None
        fields: frozenset[str] = frozenset()
        if head.removeprefix(BOM_UTF8).lstrip().startswith(b"{"):
            try:
                fields = frozenset(TextFile(path, FileError).json().data)
            except FileError as error:
                return error.reason
        if re.match(self.begins, head, re.DOTALL) and (not self.fields or any(one <= fields for one in self.fields)):
            return None
        return _what_is(head, fields)


def json_kind(*fields: str, begins: bytes = b"") -> FileKind:
    """Return the kind of JSON files with these fields, in one text; several texts: with those of one of them."""
    return FileKind(begins, tuple(frozenset(text.split()) for text in fields))


def page_kind(name: str) -> FileKind:
    """Return the kind of the pages that a template makes, which state its name as their generator."""
    return FileKind(rb'\s*<!DOCTYPE html>.*?<meta name="generator" content="eldata %s">' % name.encode())


NEW = FileKind(rb"(?!)")  # any file that is there is another one
PROFILE = json_kind("schema camera source gain_range_dn_per_e rows")
RESULT = json_kind("protocol provenance coverage")
SCORES = FileKind(rb"(path|scene,split),camera,")
COMPARISON_DATA = json_kind("methods warnings statistics")
COMPARISON_PAGE = page_kind("compare")
CARD = json_kind("name title folder")
CROISSANT = json_kind("@context @type conformsTo")


class Output(argparse.Action):
    """Keeps the name of a file that is to be written, and that it is one: ``outputs``, by ``dest``."""

    def __init__(self, *, kind: FileKind, beside: Mapping[str, FileKind], makes_folder: bool, **options: Any) -> None:
        super().__init__(**options)
        self.kind, self.beside, self.makes_folder = kind, beside, makes_folder

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002 # argparse hands it over
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        """Keep the option as it was given, and the name."""
        setattr(namespace, self.dest, values)
        namespace.outputs = getattr(namespace, "outputs", {}) | {self.dest: (self, option, values)}

    def files(self, name: str) -> Iterator[tuple[Path, FileKind]]:
        """Yield the files that are written under a name: its own, and those beside it."""
        yield Path(name), self.kind
        for suffix, kind in self.beside.items():
            yield Path(name).with_suffix(suffix), kind


def add_output(
    parser: argparse._ActionsContainer,
    *names: str,
    kind: FileKind,
    beside: Mapping[str, FileKind] | None = None,
    makes_folder: bool = False,
    **options: Any,
) -> None:
    """Add an option that names a file to write, which :func:`check_outputs` looks at before the subcommand's work.

    ``beside`` has the suffixes of what is written in the same folder under the same name. The folder has to be there,
    unless the subcommand makes it. What has been computed is written through :func:`eldata.base.console.each_of`.
    """
    options.setdefault("metavar", "FILE")
    parser.add_argument(*names, action=Output, kind=kind, beside=beside or {}, makes_folder=makes_folder, **options)


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse a command whose files cannot be written, or would take the place of others.

    Others are what it reads, by whatever name, what it writes itself, and what is there and is not of an option's
    :class:`FileKind`.

    Raises
    ------
    ArgumentError
        If so, of the first such file.
    """
    taken: dict[str, str] = {}
    for action, option, name in arguments.outputs.values():
        if not name and action.nargs == "?":
            continue  # it is printed
        if not name:
            raise ArgumentError(f"cannot write {option}: expected the name of a file, found nothing")
        for path, kind in action.files(name):
            shown = name if path == Path(name) else path
            problem = None if action.makes_folder and not path.parent.exists() else write_problem(path)
            if problem is not None:
                raise ArgumentError(f"cannot write {shown}: {problem}")
            place = os.path.normcase(Path(os.path.realpath(path.parent), path.name))
            if place in taken:
                raise ArgumentError(f"{taken[place]} and {option} both write {shown}; give each a file of its own")
            taken[place] = option
            which = f"{option} {name}:" if shown is name else f"{option} {name}: its {path}"
            _refuse_inputs(which, path, arguments)
            check_output(which, path, kind)


def check_output(which: str, path: Path, kind: FileKind) -> None:
    """Refuse to write a file where one is that is not of its kind; ``which`` are the words for it.

    Raises
    ------
    ArgumentError
        If so; the message says what is there.
    """
    found = kind.problem(path)
    if found is not None:
        other = "" if kind is NEW else f", and {found}; only what this option wrote is replaced"
        raise ArgumentError(f"{which} is there already{other}. Give another name, or move that file away")


def _refuse_inputs(which: str, path: Path, arguments: argparse.Namespace) -> None:
    for action in arguments.actions:
        if isinstance(action, Output) or action.metavar in _NAMES:
            continue
        value = getattr(arguments, action.dest, None)
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, str | Path) and _is_same(path, one):
                label = "/".join(action.option_strings) or action.metavar
                raise ArgumentError(f"{which} is what {label} names, and this command reads it; give another name")


def _is_same(path: Path, other: str | Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them is not there, or no path at all
        return False


def _what_is(content: bytes, fields: frozenset[str]) -> str:
    if fields:
        some = sorted(fields)[:_MOST_SHOWN]
        return in_line(f"is JSON with the fields {', '.join(some)}{', ...' if len(fields) > len(some) else ''}")
    for begin, what in _BEGINS.items():
        if content.startswith(begin):
            return f"is {what}"
    try:
        line = content.decode().strip().partition("\n")[0]
    except UnicodeDecodeError:
        return "holds something else"
    return in_line(f"is text that begins with {line[:_MOST_SHOWN_CHARACTERS]!r}")
