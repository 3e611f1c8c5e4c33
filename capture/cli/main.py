"""Entry point of the `capture` command."""

from __future__ import annotations

import sys

from eldata.base.stopping import exit_when_told

TYPE_CHECKING = False  # typing takes as long to import as all else that comes before Ctrl-C is handled
if TYPE_CHECKING:
    import argparse

_COMMANDS = ("protocol", "camera", "plan", "checklist", "script", "manifest", "check", "average", "completion")

_FIRST = ("capture camera --example cam.json", "capture plan --camera cam.json --scenes 10 --metered 4 -o plan.json")
_RUNNING = ("root", "json", "jobs", "debug")


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    from eldata.base.console import command_line

    description = "Photograph scenes for a low-light denoising dataset."
    return command_line("capture", description, "capture.cli", _COMMANDS, _FIRST, _RUNNING)


def main(argv: list[str] | None = None) -> int:
    """Run the command ``capture``; return its exit code (:mod:`eldata.base.console`)."""
    if argv is None:  # a program of its own, and not a call from one
        exit_when_told("capture")  # before the imports, which take most of the time of a short command
    from eldata.base.console import run

    return run(parser(), argv)


if __name__ == "__main__":
    sys.exit(main())
