from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.errors import ArgumentError
from eldata.isp.radiometric import CurveModel
from eldata.isp.response import ResponseCurve
from eldata.isp.response_files import (
    ResponseFileError,
    read_curve_model,
    read_dorf,
    read_published_response,
    read_response_table,
    write_response_table,
)
from tests.isp.curves import GRID, family, write_dorf, write_emor

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

EMOR, INVEMOR = ("E", "f0", "h"), ("B", "g0", "hinv")


# --- tables -------------------------------------------------------------------------------------------------------


def test_a_table_of_two_columns(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("# irradiance, brightness\n0, 0\n\n0.25, 0.5 # grey\n1;1\n")
    curve = read_response_table(path)
    assert (curve.irradiance.tolist(), curve.brightness.tolist()) == ([[0, 0.25, 1]], [[0, 0.5, 1]])
    assert curve.name == "mine"


@pytest.mark.parametrize("colours", [1, 3])
def test_a_written_table_comes_back_equal(colours: int, tmp_path: Path) -> None:
    brightness = np.array([curve.brightness[0] for curve in family()[2 : 2 + colours]])
    curve = ResponseCurve(np.broadcast_to(GRID, brightness.shape), brightness)
    write_response_table(tmp_path / "curve.txt", curve)
    again = read_response_table(tmp_path / "curve.txt")
    np.testing.assert_array_equal(again.brightness, curve.brightness)
    np.testing.assert_array_equal(again.irradiance, curve.irradiance)


def test_curves_of_different_irradiances_make_no_table(tmp_path: Path) -> None:
    inverse = np.array([curve.brightness[0] for curve in family()[:3]])
    with pytest.raises(ArgumentError, match="different irradiances"):
        write_response_table(tmp_path / "x.txt", ResponseCurve(inverse, np.broadcast_to(GRID, inverse.shape)))
    assert list(tmp_path.iterdir()) == []


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
    with pytest.raises(ResponseFileError, match=rf"curve\.txt: .*{words}"):
        read_response_table(path)


# --- DoRF ---------------------------------------------------------------------------------------------------------


def test_dorf(tmp_path: Path) -> None:
    write_dorf(tmp_path / "dorfCurves.txt", family())
    curves = read_dorf(tmp_path / "dorfCurves.txt")
    assert [curve.name for curve in curves] == [curve.name for curve in family()]
    for found, wanted in zip(curves, family(), strict=True):
        np.testing.assert_allclose(found.brightness, wanted.brightness, atol=1e-9)


def test_dorf_cut_short_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dorfCurves.txt"
    write_dorf(path, family())
    whole = path.read_text()
    path.write_text(whole[: whole.rindex("B =")])
    with pytest.raises(ResponseFileError, match="six lines per curve; found 94 lines"):
        read_dorf(path)
    path.write_text(whole[:-200])  # in the last line of numbers
    with pytest.raises(ResponseFileError, match=r"shoulder 0\.9: expected 2 or more points"):
        read_dorf(path)
    path.write_text(whole.replace("B = ", "C = ", 1))
    with pytest.raises(ResponseFileError, match="line 5: expected the label 'B ='; found 'C ='"):
        read_dorf(path)


# --- EMoR ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("labels", "inverse"), [(EMOR, False), (INVEMOR, True)])
def test_emor(labels: tuple[str, str, str], inverse: bool, tmp_path: Path) -> None:
    model = CurveModel.of_curves(family(), 4, inverse=inverse)
    write_emor(tmp_path / "model.txt", labels, model.grid, model.mean, *model.components)
    again = read_curve_model(tmp_path / "model.txt")
    assert again.inverse == inverse
    for name in ("grid", "mean", "components"):
        np.testing.assert_allclose(getattr(again, name), getattr(model, name), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[: len(text) * 2 // 3], r"section h\(2\) has \d+ numbers, but E has 1024; is the file whole"),
        (lambda text: text.replace("f0 =", "f1 ="), "expected the sections E, f0"),
        (lambda text: text.replace("h(1)=", "h(2)="), "expected the sections E, f0"),
        (lambda text: text[: text.index("h(1)")], "expected the sections E, f0"),
        (lambda text: text[text.index("\n") + 1 :], "line 1: expected a label"),
        (lambda text: text[:0], "found none"),
        (lambda text: text.replace("0.000000000e+00", "3.0e-01", 2), "grid must rise from 0 to 1"),
    ],
)
def test_emor_that_is_damaged_is_refused(change: Callable[[str], str], words: str, tmp_path: Path) -> None:
    model = CurveModel.of_curves(family(), 3)
    path = tmp_path / "emor.txt"
    write_emor(path, EMOR, model.grid, model.mean, *model.components)
    path.write_text(change(path.read_text()))
    with pytest.raises(ResponseFileError, match=words):
        read_curve_model(path)


# --- the published curve's layout ---------------------------------------------------------------------------------


def test_the_published_layout(tmp_path: Path) -> None:
    path = tmp_path / "CRF_SonyA7S2_5.txt"
    brightness = np.array([curve.brightness[0] for curve in family()[3:6]])
    np.savetxt(path, brightness)
    curve = read_published_response(path)
    np.testing.assert_array_equal(curve.brightness, brightness)
    np.testing.assert_array_equal(curve.irradiance, np.broadcast_to(GRID, (3, 1024)))
    np.savetxt(path, brightness[:2])
    with pytest.raises(ResponseFileError, match=r"expected three lines of one length.*\[1024, 1024\]"):
        read_published_response(path)


# --- every reader -------------------------------------------------------------------------------------------------

READERS = [read_response_table, read_published_response, read_dorf, read_curve_model]


@pytest.mark.parametrize("reader", READERS)
def test_files_that_cannot_be_read_are_named(reader: Callable[[Path], Any], tmp_path: Path) -> None:
    with pytest.raises(ResponseFileError, match=r"absent\.txt: cannot be read: No such file"):
        reader(tmp_path / "absent.txt")
    with pytest.raises(ResponseFileError, match="cannot be read: Is a directory"):
        reader(tmp_path)
    (tmp_path / "picture.txt").write_bytes(bytes(range(256)))
    with pytest.raises(ResponseFileError, match=r"picture\.txt: is not a text file"):
        reader(tmp_path / "picture.txt")
