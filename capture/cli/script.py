"""`capture script`: turn a plan into a shell script for a camera on the cable (gphoto2).

Turn a plan into a shell script that shoots it with a camera on the USB cable, through the program gphoto2. Read it
before you run it: it is a line a shot. Before each scene it waits for Enter, it puts each frame into a folder beside
itself, and it skips frames that are there. Not tried with a real camera.

    capture script plan.json -o shots/shoot.sh

Then: capture manifest PLAN DIR -o manifests/mine.csv --copy-to data/mine
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from capture.cli.values import add_only
from eldata.base.console import OK, add_shared
from eldata.base.files import write_text
from eldata.base.outputs import FileKind, add_output

if TYPE_CHECKING:
    import argparse

_SCRIPT = FileKind(rb"#!/bin/sh\n# [^\n]*\n# Written by capture script")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("plan", metavar="PLAN", help="the plan (capture plan)")
    add_output(
        parser, "-o", "--output", kind=_SCRIPT, required=True, help="the script; frames go into folders beside it"
    )
    add_only(parser)
    add_shared(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from capture.gphoto_script import gphoto_script, script_minutes
    from capture.plan import Plan

    plan, path = Plan.load(arguments.plan), Path(arguments.output)
    if arguments.only:
        plan = plan.only(arguments.only)
    write_text(path, gphoto_script(plan, Path(arguments.plan).name))
    mode = path.stat().st_mode
    path.chmod(mode | (mode & 0o444) >> 2)  # whoever may read it may run it
    print(f"{path}: {len(plan.shots)} frames, about {script_minutes(plan)}; read it before you run it")
    return OK
