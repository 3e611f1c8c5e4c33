"""Files that commands write: tried before the work, and none takes the place of what the command reads."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_problem
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_NAMES = ("N", "NAME")  # metavars of what is never a file


class Output(argparse.Action):
    """Keeps the name of a file that is to be written, and that it is one: ``outputs``, by ``dest``."""

    def __init__(self, *, beside: Sequence[str], makes_folder: bool, **options: Any) -> None:
        super().__init__(**options)
        self.beside, self.makes_folder = beside, makes_folder

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


def add_output(
    parser: argparse._ActionsContainer,
    *names: str,
    beside: Sequence[str] = (),
    makes_folder: bool = False,
    **options: Any,
) -> None:
    """Add an option that names a file to write, which :func:`check_outputs` looks at before the subcommand's work.

    ``beside`` has the suffixes of what is written in the same folder under the same name. The folder has to be there,
    unless the subcommand makes it. What has been computed is written through :func:`eldata.base.console.each_of`.
    """
    options.setdefault("metavar", "FILE")
    parser.add_argument(*names, action=Output, beside=beside, makes_folder=makes_folder, **options)


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse a command whose files cannot be written, or would take the place of what it reads, by whatever name.

    Raises
    ------
    ArgumentError
        If so, of the first such file.
    """
    for action, option, name in arguments.outputs.values():
        if not name and action.nargs == "?":
            continue  # it is printed
        if not name:
            raise ArgumentError(f"cannot write {option}: expected the name of a file, found nothing")
        for path in (Path(name), *(Path(name).with_suffix(suffix) for suffix in action.beside)):
            shown = name if path == Path(name) else path
            problem = None if action.makes_folder and not path.parent.exists() else write_problem(path)
            if problem is not None:
                raise ArgumentError(f"cannot write {shown}: {problem}")
            _refuse_inputs(f"{option} {name}:{'' if shown is name else f' its {path}'}", path, arguments)


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


def refuse_among(output: Path, folder: Path, files: Iterable[str] | None = None) -> None:
    """Refuse a folder for outputs that holds what is read.

    Parameters
    ----------
    output
        Where files are written.
    folder
        A dataset's folder, which may not get any.
    files
        What it holds, below it: the folders of these may not either. Without, no folder in it may: all are searched.

    Raises
    ------
    ArgumentError
        If so.
    """
    try:
        place = output.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return  # it lies elsewhere
    if files is None or place == "." or any(file.startswith(f"{place}/") for file in files):
        raise ArgumentError(f"cannot write into {output}: the files of the set {folder} lie there; give another folder")
