"""Entry point of the `capture` command."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from capture.cli import camera, check, checklist, manifest, plan, protocol
from capture.cli import run as tethered
from eldata import __version__
from eldata.base.console import Parser, run

if TYPE_CHECKING:
    import argparse

_COMMANDS = (protocol, camera, plan, checklist, tethered, manifest, check)


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    result = Parser(
        prog="capture",
        description="Photograph scenes for a low-light denoising dataset.",
        epilog="Exit codes: 0 all well, 1 problems were found and listed, 2 wrong usage or unusable input.",
    )
    result.add_argument("--version", action="version", version=f"capture {__version__}")
    commands = result.add_subparsers(title="commands", metavar="COMMAND")
    for module in _COMMANDS:
        module.add_parser(commands)
    return result


def main(argv: list[str] | None = None) -> int:
    """Run the command ``capture``; return its exit code (:mod:`eldata.base.console`)."""
    return run(parser(), argv)


if __name__ == "__main__":
    sys.exit(main())
