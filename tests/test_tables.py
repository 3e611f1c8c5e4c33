"""Text tables and numbers with their errors."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldata.tables import text_table, with_error


def test_columns_are_aligned() -> None:
    rows = [("a", "1", "left"), ("long name", "1000", "l")]
    assert text_table(("name", "n", "text"), rows, left=(0, 2)) == (
        "name          n  text\n"
        "---------  ----  ----\n"
        "a             1  left\n"
        "long name  1000  l"
    )  # fmt: skip
    assert text_table(("name", "n"), [("a", "10")], left=()) == "name   n\n----  --\n   a  10"


def test_a_table_without_rows_is_its_header() -> None:
    assert text_table(("name", "n"), []) == "name  n\n----  -"


def test_rows_of_another_length_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="shorter"):
        text_table(("a", "b"), [("1",)])


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (1.23456, 0.029, "1.235 ± 0.029"),
        (1.23456, 0.031, "1.23 ± 0.03"),
        (1.23456, 0.099, "1.23 ± 0.10"),
        (27.0163, 0.0118, "27.016 ± 0.012"),
        (123.456, 1.4, "123.5 ± 1.4"),
        (123.456, 4.0, "123 ± 4"),
        (123.456, 42.0, "123 ± 42"),
        (1234.5, 1e4, "1234 ± 10000"),
        (-0.0004, 0.02, "0.000 ± 0.020"),
        (-2.0, 0.5, "-2.0 ± 0.5"),
        (0.00012345, 1.5e-6, "0.0001234 ± 0.0000015"),
        (1.23456789, 0.0, "1.2346"),
        (1.23456789, math.nan, "1.2346"),
        (1.23456789, math.inf, "1.2346"),
        (1.23456789, -1.0, "1.2346"),
        (math.nan, 0.1, "nan"),
    ],
)
def test_values_with_errors(value: float, error: float, text: str) -> None:
    assert with_error(value, error) == text


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_no_digit_that_matters_is_lost(value: float, error: float) -> None:
    """The printed value is within a sixth of the error of the true one, and the printed error within a fifth."""
    shown_value, shown_error = (float(part) for part in with_error(value, error).split(" ± "))
    assert abs(shown_value - value) <= error / 6 + 1e-9 * abs(value)
    assert shown_error == pytest.approx(error, rel=0.17)
