"""Exact positive numbers ``c 2^s``: the exposure times that cameras give, which are not fractions.

A shutter marked 1/60 s opens for 2^-6 s, the next faster one for 2^(-19/3) s. With ``c`` and ``s`` as fractions,
products, quotients and comparisons stay exact, so that rounding to a camera's steps has no near misses.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from eldata.base.visible import shown
from eldata.errors import ArgumentError

# Bounded: a mistyped key must not ask for products of thousands of digits.
_SECONDS: Final = re.compile(r"(?:[0-9]{1,9}(?:/[0-9]{1,9}|\.[0-9]{1,9})?|\.[0-9]{1,9})")


@dataclass(frozen=True, slots=True)
class ExactNumber:
    """The number ``coefficient * 2 ** stops``, kept with ``stops`` in [0, 1) so that equal numbers have equal fields.

    Attributes
    ----------
    coefficient
        A positive fraction.
    stops
        Exponent of two: stops in a photographer's sense.

    Raises
    ------
    ArgumentError
        If the coefficient is not above 0.
    """

    coefficient: Fraction
    stops: Fraction = Fraction(0)

    def __post_init__(self) -> None:
        if not self.coefficient > 0:
            raise ArgumentError(f"coefficient must be above 0, found {self.coefficient}")
        whole = math.floor(self.stops)
        object.__setattr__(self, "coefficient", Fraction(self.coefficient) * Fraction(2) ** whole)
        object.__setattr__(self, "stops", Fraction(self.stops) - whole)

    @property
    def log2(self) -> float:
        """Its logarithm to the base 2: stops over 1."""
        return math.log2(self.coefficient.numerator) - math.log2(self.coefficient.denominator) + float(self.stops)

    def __float__(self) -> float:
        return float(self.coefficient) * math.exp2(float(self.stops))

    def __mul__(self, other: ExactNumber | Fraction | int) -> ExactNumber:
        factor = as_exact(other)
        return ExactNumber(self.coefficient * factor.coefficient, self.stops + factor.stops)

    def __truediv__(self, other: ExactNumber | Fraction | int) -> ExactNumber:
        divisor = as_exact(other)
        return ExactNumber(self.coefficient / divisor.coefficient, self.stops - divisor.stops)

    def __lt__(self, other: ExactNumber) -> bool:
        # c1 2^s1 < c2 2^s2 is (c1 / c2)^d < 2^(d (s2 - s1)), and with a common denominator d both sides are fractions.
        common = math.lcm(self.stops.denominator, other.stops.denominator)
        exponent = (other.stops - self.stops) * common
        return (self.coefficient / other.coefficient) ** common < Fraction(2) ** int(exponent)

    def __le__(self, other: ExactNumber) -> bool:
        return not other < self


def as_exact(value: ExactNumber | Fraction | int) -> ExactNumber:
    """Return a fraction as an :class:`ExactNumber`."""
    return value if isinstance(value, ExactNumber) else ExactNumber(Fraction(value))


def parse_seconds(text: object) -> Fraction:
    """Return the seconds that a text such as ``4``, ``1/2`` or ``0.5`` names, exactly.

    Raises
    ------
    ArgumentError
        If it is not a time above 0.
    """
    if not isinstance(text, str):
        raise ArgumentError(f'expected seconds as text, such as "1/2", found {shown(text)}')
    sign = text[:1] == "-"
    if _SECONDS.fullmatch(text[sign:]) is None:
        raise ArgumentError(f"expected seconds such as 4, 1/2 or 0.5, found {shown(text)}")
    try:
        seconds = Fraction(text)
    except ZeroDivisionError:
        raise ArgumentError(f"expected seconds such as 1/2, found {text!r}: a division by 0") from None
    if seconds <= 0:
        raise ArgumentError(f"expected a time above 0 seconds, found {text!r}")
    return seconds
