"""Neutrals, matrices and levels are the numbers that a file states, and stay the same from file to file."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import rawpy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eldata.base.numbers import simplest_fraction
from eldata.raw import read_raw, write_dng
from eldata.raw.colour import camera_to_srgb
from eldata.raw.tiff import RATIONAL, round_fraction
from tests.raw.helpers import BAYER, CFAS, EXPOSURE, Tag, letters, levels_of, random_mosaic, write_plain_dng

ONE_FILE = settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])

# What cameras and converters use.
DENOMINATORS = (100, 1024, 4096, 10**4, 10**6)
parts = st.integers(1, RATIONAL)
neutrals = st.builds(  # over one denominator, as cameras write them
    lambda parts, d: tuple((n, d) for n in parts),
    st.tuples(*[st.integers(1, 10**7)] * 3),
    st.sampled_from(DENOMINATORS),
)
blacks = st.builds(lambda n, d: (n % (4000 * d), d), parts, st.sampled_from(DENOMINATORS))
entries = st.tuples(st.integers(-30000, 30000), st.sampled_from(DENOMINATORS))
matrices = st.lists(entries, min_size=9, max_size=9).filter(lambda values: any(n for n, _ in values))

Parts = tuple[int, int]


def rational_tag(code: int, values: Iterable[Parts], kind: str = "2I") -> Tag:
    parts = tuple(part for value in values for part in value)
    return code, kind, len(parts) // 2, parts, True


# --- the number ---------------------------------------------------------------------------------------------


@given(st.fractions(min_value=-(10**6), max_value=10**6, max_denominator=1000))
def test_a_simple_fraction_comes_back_from_its_float(fraction: Fraction) -> None:
    assert simplest_fraction(float(fraction)) == fraction


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_no_float_is_changed(number: float) -> None:
    assert float(simplest_fraction(number)) == number


# --- rounding to what a field can hold ----------------------------------------------------------------------


@given(st.fractions(min_value=Fraction(1, RATIONAL), max_value=RATIONAL))
def test_rounding_is_off_by_less_than_one_part_in_four_billion(value: Fraction) -> None:
    found = round_fraction(value, RATIONAL)
    assert max(found.numerator, found.denominator) <= RATIONAL
    assert found == value or abs(found / value - 1) < Fraction(1, RATIONAL - 1)


# --- from a foreign file to ours and back -------------------------------------------------------------------


@given(
    name=st.sampled_from([*BAYER, "xtrans-00", "xtrans-25"]),
    neutral=neutrals,
    black=st.lists(blacks, min_size=4, max_size=4),
    matrix=matrices,
    illuminant=st.sampled_from([0, 1, 3, 17, 21, 23, 255]),
)
@ONE_FILE
def test_what_a_foreign_dng_states_comes_back_to_the_last_digit(
    name: str, neutral: tuple[Parts, ...], black: list[Parts], matrix: list[Parts], illuminant: int, tmp_path: Path
) -> None:
    cfa = CFAS[name]
    at_sites = [black[index] for row in cfa for index in row]
    write_plain_dng(
        tmp_path / "foreign.dng",
        random_mosaic(24, 30),
        letters(cfa),
        (50713, "H", 2, (len(cfa), len(cfa)), True),
        rational_tag(50714, at_sites),
        rational_tag(50721, matrix, "2i"),
        rational_tag(50728, neutral),
        *([(50778, "H", 1, illuminant, True)] if illuminant else []),
    )
    frame = read_raw(tmp_path / "foreign.dng")
    found = frame.sensor
    red, green, blue = (Fraction(*value) for value in neutral)
    assert found.white_balance == (float(green / red), 1, float(green / blue), 1)
    assert found.black_level_dn == tuple(float(Fraction(*value)) for value in black[: levels_of(cfa)])
    assert sum(found.xyz_to_camera or (), ()) == tuple(float(Fraction(*value)) for value in matrix)
    assert found.matrix_illuminant == illuminant

    write_dng(tmp_path / "ours.dng", frame.mosaic, frame.sensor, EXPOSURE)
    again = read_raw(tmp_path / "ours.dng")
    assert again.sensor == found
    np.testing.assert_array_equal(again.mosaic, frame.mosaic)


# --- two matrices -------------------------------------------------------------------------------------------


MATRICES = (
    ((0.6612, -0.1321, -0.0534), (-0.5041, 1.3012, 0.2217), (-0.1034, 0.2159, 0.6105)),
    ((1.0405, -0.3755, -0.127), (-0.5461, 1.3787, 0.1793), (-0.104, 0.2015, 0.6785)),
)


@pytest.mark.parametrize(
    "illuminants",
    [pair for pair in itertools.permutations((1, 3, 4, 17, 20, 21, 22, 23), 2) if set(pair) & {17, 21, 23, 3}],
)
def test_of_two_matrices_that_is_taken_which_libraw_takes(illuminants: tuple[int, int], tmp_path: Path) -> None:
    tags: list[Tag] = [(50778 + at, "H", 1, light, True) for at, light in enumerate(illuminants)]
    for at, matrix in enumerate(MATRICES):
        entries = [(round(value * 10**4), 10**4) for row in matrix for value in row]
        tags.append(rational_tag(50721 + at, entries, "2i"))
    write_plain_dng(tmp_path / "a.dng", random_mosaic(24, 30), ("RG", "GB"), *tags)
    sensor = read_raw(tmp_path / "a.dng").sensor
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        libraw = raw.color_matrix[:, :3].astype(np.float64)
    taken = [at for at, matrix in enumerate(MATRICES) if np.allclose(camera_to_srgb(matrix), libraw, atol=2e-6)]
    assert [sensor.xyz_to_camera] == [MATRICES[at] for at in taken]
    assert [sensor.matrix_illuminant] == [illuminants[at] for at in taken]
