"""Values of the command line's options: whole numbers, exact seconds, scenes with their metered times."""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING

from capture.protocol import COUNTS
from capture.shutter import parse_seconds
from eldata.base.console import whole_number
from eldata.base.visible import shown
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

_MOST_SCENES = 1000
_SCENES_END = 1_000_000  # scene-999999 is the last that a plan may have


def seconds(text: str) -> Fraction:
    """Return seconds above 0, exactly."""
    try:
        return parse_seconds(text)
    except ArgumentError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def scene_time(text: str) -> tuple[str, Fraction]:
    """Return scene and seconds of a text such as ``scene-2=1/4``."""
    name, equals, time = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"expected a scene and its metered time, such as scene-2=1/4; found {text!r}")
    return name, seconds(time)


def metered(text: str) -> tuple[str | None, Fraction]:
    """Return seconds for every scene (``None``) or, as ``scene-3=4``, for one."""
    return scene_time(text) if "=" in text else (None, seconds(text))


def aperture(text: str) -> tuple[str | None, Fraction]:
    """Return the f-number for every scene (``None``) or, as ``scene-3=5.6``, for one."""
    name, equals, number = text.rpartition("=")
    if equals and not name:
        raise argparse.ArgumentTypeError(f"expected an f-number such as 5.6, or scene-3=5.6; found {shown(text)}")
    try:
        found = parse_seconds(number.lower().removeprefix("f/"))
    except ArgumentError:
        found = None
    if found is None or not 0.5 <= found <= 128:
        raise argparse.ArgumentTypeError(f"expected an f-number from 0.5 to 128, such as 5.6; found {shown(number)}")
    return name or None, found


def scene_numbers(text: str) -> range:
    """Return the scenes that a text such as ``10``, the first ten, or ``11-15`` names."""
    first, dash, last = text.rpartition("-")
    whole = whole_number(0)
    found = range(whole(first) if dash and first else 1, whole(last) + 1)
    if not 1 <= len(found) <= _MOST_SCENES or not 1 <= found[0] <= found[-1] < _SCENES_END:
        raise argparse.ArgumentTypeError(
            f"expected a number of scenes from 1 to {_MOST_SCENES}, or the first and the last, as 11-15; found {text!r}"
        )
    return found


def add_numbers(
    parser: argparse._ActionsContainer, name: str, metavar: str, words: str, default: tuple[int, ...] | None = None
) -> None:
    """Add an option that takes whole numbers."""
    parser.add_argument(name, type=whole_number(1), nargs="+", default=default, metavar=metavar, help=words)


def add_alike(parser: argparse._ActionsContainer) -> None:
    """Add ``--repeats`` and ``--references`` to a subcommand: how often the protocol takes something."""
    add = partial(parser.add_argument, type=whole_number(1), metavar="N")
    add("--repeats", help="noisy frames of each ISO and factor, one after the other (default: 1; LRID has 10)")
    add(
        "--references",
        help="reference frames before and after the noisy ones of each ISO (default: 1); each noisy frame is compared "
        "with the one nearest to it",
    )


def given_counts(arguments: argparse.Namespace) -> dict[str, int]:
    """Return those of the protocol's counts that are given."""
    return {name: count for name in COUNTS if (count := getattr(arguments, name)) is not None}


def add_only(parser: argparse._ActionsContainer) -> None:
    """Add ``--only`` to a subcommand: scenes of the plan, or its calibration frames."""
    parser.add_argument(
        "--only",
        action="append",
        metavar="SCENE",
        help="only this scene, or calibration, of the plan; may be repeated",
    )


def or_dash(value: object, form: str = "{}") -> str:
    """Return a cell of a table: the value in this form, or a dash for ``None``."""
    return "-" if value is None else form.format(value)


def spaced(numbers: Sequence[int]) -> str:
    """Return numbers as the command line takes them."""
    return " ".join(map(str, numbers))
