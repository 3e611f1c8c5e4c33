"""Black levels of DNGs by truth known by construction: what was laid under the pixels comes back for their level.

The files in ``field/`` are small ones that readers get wrong.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from pathlib import Path

import pytest

from eldata.errors import RawFileError, UnusableRawError
from eldata.raw import read_header, read_raw, write_dng
from eldata.records import exact_fraction
from tests.raw.helpers import (
    BAYER,
    Tag,
    active_area,
    black_levels,
    letters,
    random_mosaic,
    write_plain_dng,
)

FIELD = Path(__file__).parent / "field"
MARGINS = [(0, 0), (1, 0), (2, 3)]


def masked(*areas: tuple[int, int, int, int]) -> Tag:
    return 50830, "I", 4 * len(areas), tuple(number for area in areas for number in area), True


# --- counts -------------------------------------------------------------------------------------------------------


REPEAT, BLACK = 50713, 50714


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ([(REPEAT, "H", 2, (2, 2), True), (BLACK, "I", 2, (1, 2), True)], "has 2 numbers, expected 4 by"),
        ([(REPEAT, "H", 1, 2, True), (BLACK, "I", 4, (1, 2, 3, 4), True)], "has 4 numbers, expected 1 by"),
        ([(REPEAT, "H", 2, (1, 2), True), (BLACK, "I", 1, 64, True)], "has 1 number, expected 2 by"),
    ],
)
def test_counts_that_do_not_fit(tags: list[Tag], words: str, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    for read in (read_raw, read_header):
        with pytest.raises(UnusableRawError, match=rf"a\.dng: .*{words}.*; write it again"):
            read(tmp_path / "a.dng")


@pytest.mark.parametrize("kind", ["f", "d"])
def test_a_level_written_as_a_float_is_exact(kind: str, tmp_path: Path) -> None:
    """LibRaw has 511 of it."""
    tags: list[Tag] = [(REPEAT, "H", 2, (1, 2), True), (BLACK, kind, 2, (511.625, 512.0), True)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (511.625, 512, 512, 511.625)
    tags[1] = (BLACK, kind, 2, (float("nan"), 512.0), True)
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    with pytest.raises(RawFileError, match="its BlackLevel is not a number"):
        read_raw(tmp_path / "a.dng")


# --- what is refused -------------------------------------------------------------------------------------------


def test_masked_pixels_alone_are_no_level(tmp_path: Path) -> None:
    tags = active_area(0, 2, 64, 66), masked((0, 0, 64, 2))
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    for read in (read_raw, read_header):
        with pytest.raises(
            UnusableRawError, match=r"states no BlackLevel, only the MaskedAreas.*; measure it there and"
        ):
            read(tmp_path / "a.dng")


@pytest.mark.parametrize("repeat", [(1, 3), (4, 2), (8, 8)])
def test_a_pattern_that_does_not_fit_the_cfa_is_named(repeat: tuple[int, int], tmp_path: Path) -> None:
    rows, columns = repeat
    levels = [[64] * columns for _ in range(rows)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *black_levels(levels))
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (64,) * 4  # one level whatever it repeats after
    levels[0][0] = 65
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *black_levels(levels))
    words = rf"BlackLevel .repeated every {rows} x {columns} pixels. differs between sites of one colour"
    with pytest.raises(UnusableRawError, match=words):
        read_raw(tmp_path / "a.dng")


@pytest.mark.parametrize("name", BAYER)
@pytest.mark.parametrize("margins", MARGINS)
def test_a_level_for_each_channel_is_exact(name: str, margins: tuple[int, int], tmp_path: Path) -> None:
    """It counts from the active area's corner, as the CFA does."""
    top, left = margins
    stated = [[Fraction(257, 4), Fraction(61)], [Fraction(1, 3), Fraction(62)]]
    parts = tuple(part for row in stated for level in row for part in level.as_integer_ratio())
    tags = active_area(top, left, 64, 66), (REPEAT, "H", 2, (2, 2), True), (BLACK, "2I", 4, parts, True)
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), letters(BAYER[name]), *tags)
    found = read_raw(tmp_path / "a.dng")
    expected = {BAYER[name][y][x]: stated[y][x] for y, x in product(range(2), repeat=2)}
    assert [exact_fraction(level) for level in found.sensor.black_level_dn] == [expected[k] for k in range(4)]
    write_dng(tmp_path / "b.dng", found.mosaic, found.sensor, found.exposure)
    assert read_raw(tmp_path / "b.dng").sensor == found.sensor
