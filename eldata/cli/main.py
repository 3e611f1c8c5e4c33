"""Entry point of the `eldata` command."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from eldata.base.console import command_line, run

if TYPE_CHECKING:
    import argparse

_COMMANDS = (
    *("demo", "info", "download", "manifest", "verify", "lock"),
    *("denoise", "baseline", "predict", "protocols", "evaluate", "compare"),
    *("calibrate", "synthesize", "profile", "pack"),
)

_FIRST = (
    *("eldata demo", "eldata info eld", "eldata evaluate preds --dataset eld --root data"),
    "python -m eldata.examples.train_denoiser --help",
)


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    description = "Data for denoising raw photographs taken in the dark: check it, load it, score denoisers on it."
    return command_line("eldata", description, "eldata.cli", _COMMANDS, _FIRST)


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    try:
        program = parser()
    except KeyboardInterrupt:  # while the commands are imported
        print("eldata: interrupted; nothing was begun", file=sys.stderr)
        return 130
    return run(program, argv)


if __name__ == "__main__":
    sys.exit(main())
