"""`capture checklist`: turn a plan into a checklist for the phone, or for paper.

Turn a plan into a checklist: preparation, then each shot in order with what to dial. The page (html) is one file for a
phone or tablet in the dark. It needs no network, plans a scene again from another metered time, and keeps ticks, file
names and remarks in the browser.

    capture checklist plan.json -o checklist.html
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from capture.checklist import FORMATS, plan_digest
from eldata.base.console import OK, add_output, add_shared, show_and_write
from eldata.base.files import write_text
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import argparse


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `capture checklist`."""
    parser.add_argument("plan", metavar="PLAN", help="a plan (capture plan)")
    add_output(parser, "-o", "--output", help="write it to FILE; without, md and txt go to the terminal")
    parser.add_argument("--format", choices=FORMATS, help="default: by the suffix of FILE; without FILE txt")
    add_shared(parser, run, json=True)


def run(arguments: argparse.Namespace) -> int:
    """Write the checklist of a plan (`capture checklist`)."""
    from capture.plan import Plan

    form = _choose_format(arguments)
    plan = Plan.load(arguments.plan)
    text = FORMATS[form](plan)
    if arguments.output is not None:
        write_text(arguments.output, text)
        text = f"{arguments.output}: {plan.extent}, {len(plan.shots)} frames\n"
    content = {"file": arguments.output, "format": form, "plan": plan_digest(plan), "frames": len(plan.shots)}
    show_and_write(arguments, lambda: text.removesuffix("\n"), lambda: content)
    return OK


def _choose_format(arguments: argparse.Namespace) -> str:
    """Choose the checklist's format, from the option or the output's suffix."""
    output = arguments.output
    if output is None:
        if arguments.format == "html":
            raise ArgumentError("a page needs a file: -o checklist.html")
        return arguments.format or "txt"
    suffix = Path(output).suffix.lower().removeprefix(".")
    if arguments.format is None and suffix not in FORMATS:
        raise ArgumentError(f"{output}: expected a name that ends in .html, .md or .txt, or --format")
    return arguments.format or suffix
