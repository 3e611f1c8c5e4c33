"""Entry point of the `eldata` command."""

from __future__ import annotations

import sys

from eldata.base.stopping import exit_when_told

TYPE_CHECKING = False  # typing takes as long to import as all else that comes before Ctrl-C is handled
if TYPE_CHECKING:
    import argparse

_COMMANDS = (
    *("demo", "info", "download", "manifest", "verify", "lock"),
    *("baseline", "predict", "protocols", "evaluate", "compare", "reproduce"),
    *("calibrate", "synthesize", "profile"),
    *("pack", "shard", "export", "completion"),
)

_FIRST = ("eldata demo", "eldata info eld", "eldata evaluate preds --dataset eld --root data")
_RUNNING = ("root", "json", "jobs", "dask", "isolate", "debug")


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    from eldata.base.console import command_line

    description = "Data for denoising raw photographs taken in the dark: check it, load it, score denoisers on it."
    return command_line("eldata", description, "eldata.cli", _COMMANDS, _FIRST, _RUNNING)


def main(argv: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    if argv is None:  # a program of its own, and not a call from one
        exit_when_told("eldata")  # before the imports, which take most of the time of a short command
    from eldata.base.console import run

    return run(parser(), argv)


if __name__ == "__main__":
    sys.exit(main())
