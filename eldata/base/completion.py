"""A shell's completion of a program's commands, options and names: a script that is printed once.

It is made by shtab from the parsers, so a TAB starts no Python. argcomplete, the other kept library, asks the program
at each TAB, which takes as long as ``--help``; it would know names that packages register later, for which the script
is printed again.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from eldata.base.console import running_options
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")

# What options and arguments are called that take one.
_FOLDERS = ("root", "out", "folder", "clean", "copy_to", "link_to")
_PLAIN = (argparse._StoreAction, argparse._AppendAction)  # noqa: SLF001 # actions that take any text


def completion_script(parser: argparse.ArgumentParser, shell: str, names: Mapping[str, Sequence[str]]) -> str:
    """Return the script of one of :data:`SHELLS`.

    Parameters
    ----------
    parser
        The program's, which is changed: use it for nothing else.
    shell
        For which one.
    names
        What may stand in an option or argument, by its ``dest``; in the others, files.

    Raises
    ------
    EldataError
        If shtab is not installed, or too old for the shell.
    """
    try:
        import shtab
    except ImportError:
        raise EldataError("shell completion needs the package shtab: pip install shtab") from None
    if shell not in shtab.SUPPORTED_SHELLS:
        raise EldataError(f"the installed shtab cannot complete in {shell}: pip install --upgrade shtab")
    for action in _actions(parser):
        if action.dest in names:
            action.choices = list(names[action.dest])
        elif action.choices is None and isinstance(action, _PLAIN) and action.type is None:
            marked: Any = action  # shtab looks for an attribute that argparse does not know
            marked.complete = shtab.DIRECTORY if action.dest in _FOLDERS else shtab.FILE
    script: str = shtab.complete(parser, shell=shell)
    return script


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:  # noqa: SLF001 # nothing public lists them
        if action.help == argparse.SUPPRESS and action.dest in running_options():
            action.help = running_options()[action.dest]["help"]
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 # its only name
            for one in action.choices.values():
                yield from _actions(one)
        else:
            yield action
