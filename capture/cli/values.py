"""Values of the command line's options: whole numbers, exact seconds, scenes with their metered times."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING

from capture.exact import parse_seconds
from eldata.base.fields import shown
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

# Bounded: a mistyped key must not ask for numbers of thousands of digits.
_WHOLE = re.compile(r"-?[0-9]{1,9}")


def nine_digits(text: str) -> int:
    """Return a whole number of at most nine digits; what it stands for says later which it may be."""
    if _WHOLE.fullmatch(text) is None:
        raise argparse.ArgumentTypeError(f"expected a whole number of at most nine digits, found {shown(text)}")
    return int(text)


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


def or_dash(value: object, form: str = "{}") -> str:
    """Return a cell of a table: the value in this form, or a dash for ``None``."""
    return "-" if value is None else form.format(value)


def spaced(numbers: Sequence[int]) -> str:
    """Return numbers as the command line takes them."""
    return " ".join(map(str, numbers))
