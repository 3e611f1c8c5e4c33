"""`capture completion`: commands, options, scenes' protocols and files at the TAB key."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.completion import add_completion, completion_script
from eldata.base.console import OK

if TYPE_CHECKING:
    import argparse


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    add_completion(commands, "capture", "names of protocols and files", run)


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from capture.cli.main import parser

    print(completion_script(parser(), arguments.shell, {}))
    return OK
