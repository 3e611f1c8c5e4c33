from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture.camera import ExactNumber, parse_seconds
from eldata.errors import ArgumentError

fractions = st.fractions(Fraction(1, 10**4), 10**6, max_denominator=10**4)
stops = st.builds(Fraction, st.integers(-60, 60), st.sampled_from((1, 2, 3, 6)))
numbers = st.builds(ExactNumber, fractions, stops)


@given(fractions, stops)
def test_value_is_kept(coefficient: Fraction, exponent: Fraction) -> None:
    number = ExactNumber(coefficient, exponent)
    assert 0 <= number.stops < 1
    assert math.isclose(float(number), float(coefficient) * 2.0 ** float(exponent), rel_tol=1e-12)
    assert math.isclose(number.log2, math.log2(coefficient) + float(exponent), abs_tol=1e-9)
    assert (number.stops == 0) == (exponent.denominator == 1)  # a fraction, or irrational


@given(numbers, numbers)
def test_order_is_that_of_the_values(one: ExactNumber, other: ExactNumber) -> None:
    assert (one < other) + (other < one) + (one == other) == 1
    if abs(float(one) / float(other) - 1) > 1e-9:
        assert (one < other) == (float(one) < float(other))


@pytest.mark.parametrize("coefficient", [Fraction(0), Fraction(-1, 3)])
def test_not_positive_is_refused(coefficient: Fraction) -> None:
    with pytest.raises(ArgumentError, match="above 0"):
        ExactNumber(coefficient)


@given(st.fractions(Fraction(1, 10**8), 10**8, max_denominator=10**8))
def test_seconds_are_read_back(seconds: Fraction) -> None:
    if seconds.numerator < 10**9:
        assert parse_seconds(str(seconds)) == seconds


@pytest.mark.parametrize(
    "text", ["", "1/", "/2", "1e3", "nan", "1/2/3", "1 s", "٣", "1_000", "1/0", "0", "-1", "9" * 20]
)
def test_what_names_no_time_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError):
        parse_seconds(text)
