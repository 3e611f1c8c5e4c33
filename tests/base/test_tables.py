"""Tables as text, Markdown and LaTeX, and numbers with their errors."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldata.base.tables import Strong, latex_table, markdown_table, markdown_text, text_table, with_error


def test_columns_are_aligned() -> None:
    rows = [("a", "1", "left"), ("long name", "1000", "l")]
    assert text_table(("name", "n", "text"), rows, left=(0, 2)) == (
        "name          n  text\n"
        "---------  ----  ----\n"
        "a             1  left\n"
        "long name  1000  l"
    )  # fmt: skip
    assert text_table(("name", "n"), [("a", "10")], left=()) == "name   n\n----  --\n   a  10"


# --- Markdown -----------------------------------------------------------------------------------------------------

HOSTILE = "a_b*c|d`e`<img src=x>[f](javascript:g)~h~ \\ $i$ &amp; \n# {j}"


def test_markdown_is_aligned_and_says_which_side() -> None:
    rows = [("DemoAlpha", "x100", Strong("38.32")), ("", "x200", "35.10")]
    assert markdown_table(("camera", "factor", "dB"), rows) == (
        "| camera    | factor |        dB |\n"
        "| --------- | -----: | --------: |\n"
        "| DemoAlpha |   x100 | **38.32** |\n"
        "|           |   x200 |     35.10 |"
    )
    assert markdown_table(("a", "b"), [("1", "2")], left=(0, 1)).splitlines()[1] == "| --- | --- |"


def test_markdown_shows_hostile_text_as_it_is() -> None:
    text = r"a\_b\*c\|d\`e\`\<img src=x\>\[f\](javascript:g)\~h\~ \\ \$i\$ \&amp; # \{j\}"
    assert markdown_text(HOSTILE) == text
    assert f"| {text} | **1** |" in markdown_table(("name", "x"), [(HOSTILE, Strong("1"))])


# --- LaTeX --------------------------------------------------------------------------------------------------------


def test_latex_table_is_a_booktabs_table() -> None:
    text = latex_table(
        ("camera_x", "dB", "dB"),
        [("Sony & co", Strong("38.32"), "-0.5"), (r"[\{}$%#~^]", "1-2", "+1")],
        caption="50% of a_b",
        label="tab:my net/x_y",
        rules=[1],
    )
    assert text.splitlines() == [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        r"\caption{50\% of a\_b}",
        r"\label{tab:my-net-x-y}",
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"camera\_x & dB & dB \\",
        r"\midrule",
        r"Sony \& co & \textbf{38.32} & $-$0.5 \\",
        r"\midrule",
        r"{[}\textbackslash{}\{\}\$\%\#\textasciitilde{}\textasciicircum{}{]} & 1-2 & +1 \\",
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]


# --- numbers ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (1.23456, 0.031, "1.23 ± 0.03"),
        (1.23456, 0.099, "1.23 ± 0.10"),
        (123.456, 1.4, "123.5 ± 1.4"),
        (1234.5, 1e4, "1234 ± 10000"),
        (-0.0004, 0.02, "0.000 ± 0.020"),
        (0.00012345, 1.5e-6, "0.0001234 ± 0.0000015"),
        (1.23456789, 0.0, "1.2346"),
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
