"""Tables of response curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.errors import FileError
from eldata.isp.response import read_response_table
from tests.isp.curves import GRID, family

if TYPE_CHECKING:
    from pathlib import Path


def test_a_table_of_two_columns(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("# irradiance, brightness\n0, 0\n\n0.25, 0.5 # grey\n1;1\n")
    curve = read_response_table(path)
    assert (curve.irradiance.tolist(), curve.brightness.tolist()) == ([[0, 0.25, 1]], [[0, 0.5, 1]])
    assert curve.name == "mine"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 0\n0.5 0.7\n0.6 0.6\n1 1\n", "brightness must never fall"),
        ("0 0\n1 one\n", "line 2: expected a finite number, found 'one'"),
        ("0 0\nnan 1\n", "line 2: expected a finite number, found 'nan'"),
        ("0 0 0\n1 1 1\n", "lines of 2 numbers"),
        ("0 0\n0.5\n1 1\n", "lines of 2 numbers"),
        ("# nothing\n", "no line of numbers"),
        ("0 0\n", "2 or more points"),
        ("0 0\n0.5 0.5\n", "go from 0 to 1"),
    ],
)
def test_a_table_that_is_none_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "curve.txt"
    path.write_text(text)
    with pytest.raises(FileError, match=rf"curve\.txt: .*{words}"):
        read_response_table(path)


@pytest.mark.parametrize("colours", [1, 3])
def test_a_table_of_four_columns(colours: int, tmp_path: Path) -> None:
    """As numpy writes it, to the last bit; of two columns too."""
    brightness = np.array([curve.brightness[0] for curve in family()[2 : 2 + colours]])
    np.savetxt(
        tmp_path / "curve.txt", np.column_stack([GRID, *brightness]), fmt="%.17g", header="irradiance brightness"
    )
    curve = read_response_table(tmp_path / "curve.txt")
    np.testing.assert_array_equal(curve.brightness, brightness)
    np.testing.assert_array_equal(curve.irradiance, np.broadcast_to(GRID, brightness.shape))
