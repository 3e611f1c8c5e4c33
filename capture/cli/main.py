"""Entry point of the `capture` command."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from eldata.base.console import command_line, run

if TYPE_CHECKING:
    import argparse

_COMMANDS = ("protocol", "camera", "plan", "checklist", "run", "manifest", "check")


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    return command_line("capture", "Photograph scenes for a low-light denoising dataset.", "capture.cli", _COMMANDS)


def main(argv: list[str] | None = None) -> int:
    """Run the command ``capture``; return its exit code (:mod:`eldata.base.console`)."""
    return run(parser(), argv)


if __name__ == "__main__":
    sys.exit(main())
