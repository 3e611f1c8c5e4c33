"""`eldata demo`: the whole path on simulated raw files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.console import OK, add_debug

if TYPE_CHECKING:
    import argparse


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = commands.add_parser(
        "demo",
        help="the whole path on simulated raw files, without a download",
        description=(
            "Photograph procedural scenes with two simulated cameras into real DNG files, verify them, denoise them, "
            "score the results and draw a contact sheet. DIR must be new, empty, or an earlier demo."
        ),
    )
    parser.add_argument("folder", metavar="DIR", nargs="?", default="eldata-demo", help="default: %(default)s")
    parser.add_argument("--scenes", type=int, default=4, metavar="N", help="scenes per camera (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the noise (default: %(default)s)")
    add_debug(parser)
    parser.set_defaults(run=run, command="demo")


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from pathlib import Path

    from eldata.demo.run import run_demo

    run_demo(Path(arguments.folder), scenes=arguments.scenes, seed=arguments.seed)
    return OK
