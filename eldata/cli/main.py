"""Entry point of the `eldata` command."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from eldata import __version__
from eldata.base.console import Parser, run
from eldata.cli import (
    calibrate,
    compare,
    demo,
    download,
    evaluate,
    info,
    lock,
    pack,
    profile,
    protocols,
    shard,
    synthesize,
    verify,
)

if TYPE_CHECKING:
    import argparse

_COMMANDS = (
    *(demo, info, download, verify, lock),
    *(protocols, evaluate, compare),
    *(calibrate, synthesize, profile),
    *(pack, shard),
)


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    result = Parser(
        prog="eldata",
        description="Data for denoising raw photographs taken in the dark: check it, load it, score denoisers on it.",
        epilog="Exit codes: 0 all well, 1 problems were found and listed, 2 wrong usage or unusable input.",
    )
    result.add_argument("--version", action="version", version=f"eldata {__version__}")
    commands = result.add_subparsers(title="commands", metavar="COMMAND")
    for module in _COMMANDS:
        module.add_parser(commands)
    return result


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    return run(parser(), argv)


if __name__ == "__main__":
    sys.exit(main())
