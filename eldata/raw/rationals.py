"""The fractions of TIFF: two whole numbers of 32 bits."""

from __future__ import annotations

from fractions import Fraction

RATIONAL = 2**32 - 1
"""The largest part of a RATIONAL."""
SRATIONAL = 2**31 - 1
"""The largest part, without its sign, of an SRATIONAL."""


def nearest_fraction(value: Fraction, largest: int) -> Fraction:
    """Return the fraction nearest to a value whose numerator and denominator are at most ``largest``.

    The value itself if its parts fit. Else, from 1 / ``largest`` to ``largest``, it is off by less than one part in
    ``largest`` - 1; below that it is off by less than 1 / ``largest``.

    Raises
    ------
    ValueError
        If the value, without its sign, is above ``largest``.
    """
    size = abs(value)
    if size > largest:
        raise ValueError(f"{value} is beyond {largest}")
    denominator = largest if size <= 1 else int(largest / size)
    candidates = [size.limit_denominator(denominator)]
    if size > 1:  # the one denominator more at which the numerator is still near enough to count
        candidates.append(Fraction(largest, denominator + 1))
    best = min(candidates, key=lambda candidate: abs(candidate - size))
    return best if value >= 0 else -best
