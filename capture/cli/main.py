"""Entry point of the `capture` command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import command_line, run

if TYPE_CHECKING:
    import argparse

_COMMANDS = ("camera", "plan", "checklist", "script", "manifest", "check")

_FIRST = ("capture camera --example cam.json", "capture plan --camera cam.json --scenes 10 --metered 4 -o plan.json")


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    description = "Photograph scenes for a low-light denoising dataset."
    return command_line("capture", description, "capture.cli", _COMMANDS, _FIRST)


def main(argv: list[str] | None = None) -> int:
    """Run the command ``capture``; return its exit code (:mod:`eldata.base.console`)."""
    return run(parser(), argv)
