"""Numbers: of callers, text and JSON, bounded before they are parsed; and figures, which have a name and a unit.

A figure is declared once. Tables, pages, drawings, files and help read the declaration. Drawings are another thing:
:mod:`eldata.plots` and :mod:`eldata.reports.html`.
"""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from operator import index
from typing import Any, Final, Literal, TypeVar

from eldata.base.tables import with_error
from eldata.base.visible import shown
from eldata.errors import ArgumentError

Number = TypeVar("Number", int, float, Fraction)

LARGEST_WHOLE: Final = 2**63 - 1
# In a whole number, and in either part of a fraction. The time that longer ones cost grows with their square.
_MOST_DIGITS: Final = 40
_LARGEST_FLOAT: Final = sys.float_info.max
_FRACTION: Final = re.compile(r"(?P<whole>[0-9]+)(?:\.(?P<tenths>[0-9]+))?(?:/(?P<divisor>[0-9]+))?")
_WHOLE: Final = re.compile(rf"[0-9]{{1,{_MOST_DIGITS}}}")
_DECIMAL: Final = re.compile(r"[+-]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][+-]?[0-9]{1,4})?")


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


# --- numbers in text, and in JSON -----------------------------------------------------------------------------------


def fraction_of(text: object, *, above: int | None = None, digits: int = 18) -> Fraction:
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
    value = _fraction(text, digits) if isinstance(text, str) and len(text) <= 4 * digits + 3 else None
    return _checked(value, text, "a number", " as text, such as 800, 0.005 or 1/30", above=above)


@lru_cache(maxsize=4096)  # the rows of a table share most of their numbers
def _fraction(text: str, digits: int) -> Fraction | None:
    match = _FRACTION.fullmatch(text)
    if match is None or max(len(part) for part in match.groups("")) > digits:
        return None
    whole, tenths, divisor = match["whole"], match["tenths"] or "", int(match["divisor"] or 1)
    return Fraction(int(whole + tenths), 10 ** len(tenths) * divisor) if divisor else None


def whole_of(source: object, *, at_least: int = 0, at_most: int = LARGEST_WHOLE, text: bool = True) -> int:
    """Take a whole number: a text of decimal digits or, without ``text``, an int as JSON has it.

    Raises
    ------
    ArgumentError
        If it is anything else or out of range; the message says what was expected and found.
    """
    if text:
        value = int(source) if isinstance(source, str) and _WHOLE.fullmatch(source) else None
    else:
        value = source if isinstance(source, int) and not isinstance(source, bool) else None
    return _checked(value, source, "a whole number", at_least=at_least, at_most=at_most)


def number_of(source: object, *, at_least: float | None = None, above: float | None = None, text: bool = True) -> float:
    """Take a finite number: a text such as ``0.5`` or ``1e-05`` or, without ``text``, a number as JSON has it.

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
    return _checked(
        float(value) if value is not None and is_finite else None,
        source,
        "a finite number",
        at_least=at_least,
        above=above,
    )


def _checked(
    value: Number | None,
    source: object,
    kind: str,
    example: str = "",
    *,
    at_least: float | None = None,
    above: float | None = None,
    at_most: float | None = None,
) -> Number:
    """Return the value that was read from what was found, if one could be (not ``None``) and it is in its range."""
    if (
        value is not None
        and (at_least is None or value >= at_least)
        and (above is None or value > above)
        and (at_most is None or value <= at_most)
    ):
        return value
    if above is not None:
        kind = f"{kind} above {above}"
    elif at_most not in (None, LARGEST_WHOLE):
        kind = f"{kind} from {at_least} to {at_most}"
    elif at_least is not None:
        kind = f"{kind} of {at_least} or more"
    raise ArgumentError(f"expected {kind}{example}, found {shown(source)}")


# --- figures --------------------------------------------------------------------------------------------------------

Better = Literal["higher", "lower", "neither"]

WITHHELD = "withheld"
"""In place of a value that an assumption forbids to give."""

NOT_KNOWN = "-"
"""In place of a value that there is none of."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """What is said of a number wherever it is shown: a score, such as PSNR, or a camera's, such as K.

    Attributes
    ----------
    name
        Its column in CSV and key in JSON, such as ``psnr_db``.
    label
        What tables and sentences call it, in plain letters, such as ``PSNR`` or ``sigma_TL``.
    meaning
        One line that says what it is.
    unit
        In plain letters, such as ``dB`` or ``DN/e-``; empty: it has none.
    decimals
        Of a mean in a table; ``None``: as many as its standard error warrants.
    fine_decimals
        Of a difference of two, and of one value among many. Default: ``decimals``.
    better
        Which of two values is the better one.
    computed_by
        The function that does it, ``module:name``, so that a declaration imports nothing; empty: it is not told.
    """

    name: str
    label: str
    meaning: str
    unit: str = ""
    decimals: int | None = None
    fine_decimals: int | None = None
    better: Better = "neither"
    computed_by: str = ""

    def __post_init__(self) -> None:
        if self.fine_decimals is None:
            object.__setattr__(self, "fine_decimals", self.decimals)

    @property
    def heading(self) -> str:
        """Its label with the unit, as the head of a column of text, Markdown and LaTeX: ``PSNR [dB]``."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def sign(self) -> int:
        """1 if a higher value is better, -1 if a lower one is, else 0: times a difference, who is ahead."""
        return {"higher": 1, "lower": -1, "neither": 0}[self.better]

    def format(self, value: float | None, error: float = math.nan) -> str:
        """Return a value as tables show it.

        Parameters
        ----------
        value
            ``None`` is ``withheld``, nan ``-``, an infinite one ``inf``.
        error
            Its standard error, which decides the digits of a figure without ``decimals``.
        """
        return self._written(value, self.decimals, error)

    def format_single(self, value: float | None) -> str:
        """Return one value among many, such as one image's, as :meth:`format` does a mean."""
        return self._written(value, self.fine_decimals)

    def format_difference(self, value: float | None) -> str:
        """Return a difference of two values with its sign."""
        decimals = self.fine_decimals
        if value is None or math.isnan(value) or decimals is None:
            return self._written(value, decimals)
        return f"{value:+.{decimals}f}"

    def _written(self, value: float | None, decimals: int | None, error: float = math.nan) -> str:
        if value is None:
            return WITHHELD
        if math.isnan(value):
            return NOT_KNOWN
        return with_error(value, error) if decimals is None else f"{value:.{decimals}f}"
