"""What stores hold of a sensor: floats, and the fractions beside them."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import pytest

from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.raw import read_raw
from eldata.records import Sensor, exact_fraction, exact_number
from eldata.sources.store import open_store
from eldata.sources.store.format import more_of_sensor, sensor_data, sensor_of
from tests.raw.helpers import make_sensor, random_mosaic, write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

THIRDS = make_sensor(
    black_level_dn=tuple(map(exact_number, (Fraction(1535, 3), Fraction(512), Fraction(511), Fraction(514)))),
    white_balance=tuple(map(exact_number, (Fraction(15, 7), Fraction(1), Fraction(16, 11), Fraction(1)))),
    xyz_to_camera=tuple(
        tuple(exact_number(Fraction(n, 3)) for n in row) for row in ((2, -1, 0), (-1, 4, 1), (0, 1, 2))
    ),
    matrix_illuminant=23,
)


def fractions_of(sensor: Sensor) -> list[Any]:
    matrix = [exact_fraction(value) for row in sensor.xyz_to_camera or () for value in row]
    return [
        *(exact_fraction(level) for level in (*sensor.black_level_dn, *(sensor.white_balance or ()))),
        *matrix,
        sensor.matrix_illuminant,
    ]


def through_json(data: Any) -> Any:
    return json.loads(json.dumps(data))


def test_a_sensor_comes_back_with_its_fractions() -> None:
    back = sensor_of(through_json(sensor_data(THIRDS)), through_json(more_of_sensor(THIRDS)))
    assert back == THIRDS
    assert fractions_of(back) == fractions_of(THIRDS)


def test_a_sensor_is_floats_with_what_they_do_not_hold_beside_them() -> None:
    assert sorted(sensor_data(THIRDS)) == sorted(set(asdict(THIRDS)) - {"matrix_illuminant"})
    assert through_json(sensor_data(THIRDS))["black_level_dn"] == [float(Fraction(1535, 3)), 512.0, 511.0, 514.0]
    assert more_of_sensor(make_sensor()) == {}


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"white_balance": ["2", "1", "16/11", "1"]}, "white_balance: expected fractions beside a float"),
        ({"white_balance": ["15/7", "1", "16/11"]}, "white_balance: expected fractions beside a float"),
        ({"white_balance": [["15/7"], "1", "16/11", "1"]}, "white_balance: expected fractions beside a float"),
        ({"white_balance": [2.0, None, "16/11", "1"]}, "expected a number"),
        ({"white_balance": ["15/7" + "0" * 99, "1", "16/11", "1"]}, "expected a number"),
        ({"height": "60"}, "height: expected fractions beside a float"),
        ({"matrix_illuminant": "21"}, "matrix_illuminant: expected a whole number of 16 bits, found '21'"),
        ({"matrix_illuminant": -1}, "matrix_illuminant"),
        ({"matrix_illuminant": True}, "matrix_illuminant"),
    ],
    ids=str,
)
def test_what_does_not_go_together_is_refused(more: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        sensor_of(through_json(sensor_data(THIRDS)), more)


def test_a_store_keeps_fractions(tmp_path: Path) -> None:
    (tmp_path / "clean").mkdir()
    write_plain_dng(
        tmp_path / "clean" / "a.dng",
        random_mosaic(40, 48),
        ("RG", "GB"),
        (50714, "2I", 1, (1535, 3), True),
        (50728, "2I", 3, (493494, 10**6, 1, 1, 606815, 10**6), True),
    )
    store = tmp_path / "store.h5"
    assert main(["pack", str(tmp_path / "clean"), "-o", str(store), "--jobs", "1"]) == 0
    (held,) = open_store(store).frames
    source = read_raw(tmp_path / "clean" / "a.dng").sensor
    assert fractions_of(held.sensor) == fractions_of(source)
    assert exact_fraction(held.sensor.black_level_dn[0]) == Fraction(1535, 3)


def test_replaced_fields_are_plain_again() -> None:
    assert more_of_sensor(replace(THIRDS, white_balance=None, xyz_to_camera=None, black_level_dn=(1.0,) * 4)) == {
        "matrix_illuminant": 23
    }
