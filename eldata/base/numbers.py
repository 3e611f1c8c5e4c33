"""Numbers of callers, in text and in JSON, bounded before they are parsed."""

from __future__ import annotations

import math
import os
import re
import sys
from fractions import Fraction
from functools import lru_cache
from operator import index
from typing import TYPE_CHECKING, Any, Final, TypeVar

from eldata.base.visible import shown
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable

Number = TypeVar("Number", int, float, Fraction)

LARGEST_WHOLE: Final = 2**63 - 1
# In a whole number, and in either part of a fraction. The time that longer ones cost grows with their square.
_MOST_DIGITS: Final = 40
_MOST_PARTS: Final = 10**6  # of a number that people or cameras write
_LARGEST_FLOAT: Final = sys.float_info.max
_FRACTION: Final = re.compile(r"(?P<whole>[0-9]+)(?:\.(?P<tenths>[0-9]+))?(?:/(?P<divisor>[0-9]+))?")
_WHOLE: Final = re.compile(rf"[0-9]{{1,{_MOST_DIGITS}}}")
_DECIMAL: Final = re.compile(r"[+-]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,4})?")


def available_cpus() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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


def simplest_fraction(number: float | Fraction) -> Fraction:
    """Return the simple fraction that a finite float is the nearest one to, as 1/3 or 21/10; else the number itself."""
    exact = number if isinstance(number, Fraction) else Fraction(float(number))
    simple = exact.limit_denominator(_MOST_PARTS)
    return simple if float(simple) == number else exact


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, as ``1 pair`` or ``2 pairs``; the noun is one whose plural ends in s alone."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """Return a key that sorts texts with the numbers in them as numbers: ``scene-2`` before ``scene-10``."""
    parts = re.split(r"([0-9]+)", text)
    return tuple((0, int(part), part) if index % 2 else (1, 0, part) for index, part in enumerate(parts) if part)


# --- numbers in text, and in JSON -----------------------------------------------------------------------------------


def fraction_of(text: object, *, above: float = -math.inf, digits: int = 18) -> Fraction:
    """Return the exact number that a text such as ``800``, ``0.005`` or ``1/30`` names.

    Parameters
    ----------
    text
        Without sign, exponent or spaces.
    above
        What the number must be above.
    digits
        How many digits each part may have: ``Fraction("1e16000000")`` would compute for minutes.

    Raises
    ------
    ArgumentError
        If it is anything else; the message says what was expected and found.
    """
    value = _parse_fraction(text, digits) if isinstance(text, str) and len(text) <= 4 * digits + 3 else None
    return _check(value, text, "a number{} as text, such as 800, 0.005 or 1/30", above=above)


@lru_cache(maxsize=4096)  # the rows of a table share most of their numbers
def _parse_fraction(text: str, digits: int) -> Fraction | None:
    """Parse a decimal number or ``1/30`` exactly; ``None`` if it is neither, or too long."""
    match = _FRACTION.fullmatch(text)
    if match is None or max(len(part) for part in match.groups("")) > digits:
        return None
    whole, tenths, divisor = match["whole"], match["tenths"] or "", int(match["divisor"] or 1)
    return Fraction(int(whole + tenths), 10 ** len(tenths) * divisor) if divisor else None


def whole_of(source: object, *, at_least: int = 0, at_most: int = LARGEST_WHOLE, text: bool = True) -> int:
    """Read a whole number: a text of decimal digits or, without ``text``, an int as JSON has it.

    Raises
    ------
    ArgumentError
        If it is anything else or out of range; the message says what was expected and found.
    """
    if text:
        value = int(source) if isinstance(source, str) and _WHOLE.fullmatch(source) else None
    else:
        value = source if isinstance(source, int) and not isinstance(source, bool) else None
    return _check(value, source, "a whole number{}", at_least=at_least, at_most=at_most)


def number_of(source: object, *, at_least: float = -math.inf, above: float = -math.inf, text: bool = True) -> float:
    """Read a finite number: a text such as ``0.5`` or ``1e-05`` or, without ``text``, a number as JSON has it.

    Raises
    ------
    ArgumentError
        If it is anything else or out of range; the message says what was expected and found.
    """
    value: float | None = None
    if text:
        value = float(source) if isinstance(source, str) and _DECIMAL.fullmatch(source) else None
    elif isinstance(source, (int, float)) and not isinstance(source, bool):
        value = source
    # Compared, not converted: Python has whole numbers that no float can hold.
    is_finite = value is not None and -_LARGEST_FLOAT <= value <= _LARGEST_FLOAT
    number = float(value) if value is not None and is_finite else None
    return _check(number, source, "a finite number{}", at_least=at_least, above=above)


def _check(
    value: Number | None,
    source: object,
    kind: str,
    *,
    at_least: float = -math.inf,
    above: float = -math.inf,
    at_most: float = math.inf,
) -> Number:
    """Return a value that could be read (not ``None``) and is in its range; ``kind`` says where its limits stand."""
    if value is not None and at_least <= value <= at_most and value > above:
        return value
    limits = f" of {at_least} or more" if at_least > -math.inf else ""
    if above > -math.inf:
        limits = f" above {above}"
    elif at_most < LARGEST_WHOLE:
        limits = f" from {at_least} to {at_most}"
    raise ArgumentError(f"expected {kind.format(limits)}, found {shown(source)}")


def replace_infinities(value: Any, replace: Callable[[float], object] = lambda _: None) -> Any:
    """Replace nan and infinities in nested plain types, by default by ``None``: JSON has neither."""
    if isinstance(value, dict):
        return {name: replace_infinities(item, replace) for name, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [replace_infinities(item, replace) for item in value]
    return replace(value) if isinstance(value, float) and not math.isfinite(value) else value


def checked_index(place: int, length: int) -> int:
    """Resolve an index, which may count from the end; raise :class:`IndexError` outside of ``length`` items."""
    try:
        place = index(place)
    except TypeError:
        advice = "torch.utils.data.Subset(dataset, range(10)) holds the first ten"
        raise ArgumentError(f"an item's index is one whole number; found {place!r}; {advice}") from None
    if not -length <= place < length:
        raise IndexError(f"index {place} is outside of {length} items")
    return place % length
