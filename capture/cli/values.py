"""Options that several commands share: a plan, and the part of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse

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
