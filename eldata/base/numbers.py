"""Numbers that a caller gave: checked where they come in, and named in what is said about them; and counts in words."""

from __future__ import annotations

import math
from operator import index
from typing import Any

from eldata.errors import ArgumentError


def checked_number(name: str, value: Any, *, above: float = -math.inf) -> float:
    """Return one finite number above a limit, as a float. Text is not one, even if it could be read as one.

    Raises
    ------
    ArgumentError
        If it is something else; the message begins with ``name``.
    """
    if type(value) is float and above < value < math.inf:  # most are: the rest takes eight times as long
        return value
    limit = "" if math.isinf(above) else f" and above {above:g}"
    try:
        number = None if isinstance(value, (str, bytes)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None:
        raise ArgumentError(f"{name} must be one number, finite{limit}; found {value!r:.100}")
    if not (math.isfinite(number) and number > above):
        raise ArgumentError(f"{name} must be finite{limit}; found {value!r:.100}")
    return number


def checked_whole(name: str, value: Any, *, at_least: int = 0, bits: int | None = None) -> int:
    """Return a whole number, ``at_least`` or more and, if ``bits`` are given, below 2^bits.

    Raises
    ------
    ArgumentError
        If it is something else; the message begins with ``name``.
    """
    try:
        number = index(value)
    except TypeError as error:
        raise ArgumentError(f"{name} must be a whole number, {at_least} or more; found {value!r:.100}") from error
    if number < at_least:
        raise ArgumentError(f"{name} must be {at_least} or more; found {number}")
    if bits is not None and number >= 1 << bits:
        raise ArgumentError(f"{name} must be below 2^{bits}; found {number}")
    return number


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, as ``1 pair`` or ``2 pairs``; the noun is one whose plural ends in s alone."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
