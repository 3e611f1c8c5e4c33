"""Records: frozen, comparable, fit to travel between processes."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from eldata.errors import EldataError, PredictionError, RawFileError
from eldata.records import RawFrame
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, letters, make_sensor, random_mosaic

RAW = RawFrame(Path("a.ARW"), random_mosaic(60, 64), make_sensor(), EXPOSURE)


@pytest.mark.parametrize("cfa", [BAYER["GBRG"], XTRANS["xtrans-35"]], ids=["Bayer", "X-Trans"])
def test_the_cfa_as_an_array(cfa: tuple[tuple[int, ...], ...]) -> None:
    pattern = make_sensor(cfa).cfa_pattern
    assert pattern.dtype == np.uint8
    assert pattern.shape == (len(cfa), len(cfa))
    assert ["".join("RGBG"[index] for index in row) for row in pattern] == letters(cfa)
    pattern[0, 0] = 9  # the caller's own copy
    assert make_sensor(cfa).cfa == cfa


def test_a_raw_frame_pickles_whole_and_is_equal_to_itself_alone() -> None:
    back = pickle.loads(pickle.dumps(RAW))
    np.testing.assert_array_equal(back.mosaic, RAW.mosaic, strict=True)
    assert (back.path, back.sensor, back.exposure) == (RAW.path, RAW.sensor, RAW.exposure)
    assert back != RAW  # comparing two arrays has no one truth value
    assert len({RAW, back}) == 2
    assert "a.ARW" in repr(RAW)
    assert "mosaic" not in repr(RAW)


@pytest.mark.parametrize("kind", [RawFileError, PredictionError])
def test_errors_of_files_pickle_and_read_as_one_line(kind: type[RawFileError | PredictionError]) -> None:
    error = kind(Path("a/b.ARW"), "is empty")
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is kind
    assert isinstance(back, EldataError)
    assert (str(back), back.path, back.reason) == ("a/b.ARW: is empty", Path("a/b.ARW"), "is empty")
