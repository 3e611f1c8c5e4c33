"""`eldata completion`: print the script that lets your shell complete commands, options and names.

Print the script with which a shell completes commands, options, names of datasets, protocols, cameras and profiles
(those that packages register too), and files. Keep it where the shell looks for such scripts; print it again after an
update. The first example is for the session that runs it.

    eval "$(eldata completion bash)"
    eldata completion bash > ~/.local/share/bash-completion/completions/eldata
    eldata completion fish > ~/.config/fish/completions/eldata.fish
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from eldata.base import console
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")

# What options and arguments are called that take one.
_FOLDERS = ("root", "out", "folder", "clean", "copy_to", "link_to")
_PLAIN = (argparse._StoreAction, argparse._AppendAction)  # noqa: SLF001 # actions that take any text


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    parser.add_argument("shell", choices=SHELLS, help="for which shell")
    console.add_shared(parser, run)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.cli.main import parser
    from eldata.manifest.catalogue import carded_names, known_names, shipped_card
    from eldata.noise.profile_files import shipped_profiles
    from eldata.protocols.named import FAMILIES, PROTOCOLS

    protocols = (*PROTOCOLS, *FAMILIES)
    cameras = dict.fromkeys(camera for name in carded_names() for camera in shipped_card(name).cameras)
    names = {
        "dataset": known_names(),
        "manifests": known_names(),
        "protocol": protocols,
        "cameras": tuple(cameras),
        "camera": shipped_profiles(),
        "profile": shipped_profiles(),
        "profiles": shipped_profiles(),
    }
    print(completion_script(parser(), arguments.shell, names))
    return console.OK


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
    if parser.get_default("running"):
        console.add_running(parser, shown=True)
    for action in parser._actions:  # noqa: SLF001 # nothing public lists them
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 # its only name
            for one in action.choices.values():
                yield from _actions(one)
        else:
            yield action
