"""Records: frozen, comparable, fit to travel between processes."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata.errors import EldataError, PredictionError, RawFileError
from eldata.records import Exposure, FrameRecord, PairRecord, RawFrame, RawHeader, Sensor
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, letters, make_sensor, random_mosaic

FRAME = FrameRecord("a/b.ARW", "noisy", "A7S2", iso=Fraction(800), flags=("misaligned",))
PAIR = PairRecord("a/b.ARW", "a/c.ARW", "A7S2", "scene-1", "test", Fraction(800), Fraction(1, 30), Fraction(100))
RAW = RawFrame(Path("a.ARW"), random_mosaic(60, 64), make_sensor(), EXPOSURE)
HEADER = RawHeader(Path("a.ARW"), "Acme", "Nocturne 1", EXPOSURE)
RECORDS: list[Any] = [make_sensor(), EXPOSURE, FRAME, PAIR, HEADER]


@pytest.mark.parametrize("cfa", [BAYER["GBRG"], XTRANS["xtrans-35"]], ids=["Bayer", "X-Trans"])
def test_the_cfa_as_an_array(cfa: tuple[tuple[int, ...], ...]) -> None:
    pattern = make_sensor(cfa).cfa_pattern
    assert pattern.dtype == np.uint8
    assert pattern.shape == (len(cfa), len(cfa))
    assert ["".join("RGBG"[index] for index in row) for row in pattern] == letters(cfa)
    pattern[0, 0] = 9  # the caller's own copy
    assert make_sensor(cfa).cfa == cfa


@pytest.mark.parametrize("record", [*RECORDS, RAW], ids=lambda record: type(record).__name__)
def test_records_are_frozen_and_take_no_new_names(record: Any) -> None:
    for field in dataclasses.fields(record):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(record, field.name, None)
    with pytest.raises((AttributeError, TypeError)):
        record.sensro = 1
    assert not hasattr(record, "__dict__")


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_records_pickle_copy_compare_and_hash(record: Any) -> None:
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        back = pickle.loads(pickle.dumps(record, protocol))
        assert type(back) is type(record)
        assert back == record
        assert hash(back) == hash(record)
    assert copy.deepcopy(record) == record


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_each_field_counts_in_a_comparison(record: Any) -> None:
    for field in dataclasses.fields(record):
        assert dataclasses.replace(record, **{field.name: "another"}) != record


def test_a_raw_frame_pickles_whole_and_is_equal_to_itself_alone() -> None:
    back = pickle.loads(pickle.dumps(RAW))
    np.testing.assert_array_equal(back.mosaic, RAW.mosaic, strict=True)
    assert (back.path, back.sensor, back.exposure) == (RAW.path, RAW.sensor, RAW.exposure)
    assert back != RAW  # comparing two arrays has no one truth value
    assert len({RAW, back}) == 2


def test_a_raw_frame_prints_without_its_pixels() -> None:
    assert "mosaic" not in repr(RAW)
    assert "a.ARW" in repr(RAW)


def test_fractions_stay_fractions() -> None:
    back = pickle.loads(pickle.dumps(Exposure(exposure_s=Fraction(1, 3))))
    assert back.exposure_s == Fraction(1, 3)
    assert isinstance(back.exposure_s, Fraction)
    assert (back.iso, back.f_number) == (None, None)


def test_a_sensor_may_say_nothing_of_colour() -> None:
    sensor = Sensor("", "", BAYER["RGGB"], (0.0,) * 4, 1.0, 2, 2)
    assert sensor.xyz_to_camera is None
    assert sensor.white_balance is None


@pytest.mark.parametrize("kind", [RawFileError, PredictionError])
def test_errors_of_files_pickle_and_read_as_one_line(
    kind: type[RawFileError | PredictionError],
) -> None:
    error = kind(Path("a/b.ARW"), "is empty")
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is kind
    assert isinstance(back, EldataError)
    assert (str(back), back.path, back.reason) == ("a/b.ARW: is empty", Path("a/b.ARW"), "is empty")
