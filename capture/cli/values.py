"""Options that several commands share: a plan and the part of it, names of files that end as they should."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from capture.plan import Plan


def add_plan(parser: argparse.ArgumentParser) -> None:
    """Add the plan, and ``--only`` for scenes of it, or its calibration frames; :func:`load_plan` reads both."""
    parser.add_argument("plan", metavar="PLAN", help="the plan (capture plan)")
    part = "only this scene, or calibration, of the plan; may be repeated"
    parser.add_argument("--only", action="append", metavar="SCENE", help=part)


def load_plan(arguments: argparse.Namespace) -> Plan:
    """Load the plan that a command names, or the part of it that ``--only`` asks for."""
    from capture.plan import Plan

    plan = Plan.load(arguments.plan)
    return plan.only(arguments.only) if arguments.only else plan


def name_ending(suffix: str) -> Callable[[str], str]:
    """Make an option's type: a file's name with this ending."""

    def read(text: str) -> str:
        if not text.endswith(suffix):
            raise argparse.ArgumentTypeError(f"expected a name that ends in {suffix}, found {text!r}")
        return text

    return read
