"""`capture completion`: print the script that lets your shell complete commands, options and names.

Print the script with which a shell completes commands, options, names of protocols and files. Keep it where the shell
looks for such scripts; print it again after an update. The first example is for the session that runs it.

    eval "$(capture completion bash)"
    capture completion bash > ~/.local/share/bash-completion/completions/capture
    capture completion fish > ~/.config/fish/completions/capture.fish
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.completion import SHELLS, completion_script
from eldata.base.console import OK, add_shared

if TYPE_CHECKING:
    import argparse


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("shell", choices=SHELLS, help="for which shell")
    add_shared(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from capture.cli.main import parser

    print(completion_script(parser(), arguments.shell, {}))
    return OK
