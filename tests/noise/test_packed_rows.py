"""Rows of the mosaic under packed data, against rows that are packed themselves."""

from __future__ import annotations

import numpy as np
import pytest

from eldata.errors import ArgumentError
from eldata.noise import NoiseParameters
from eldata.noise.mosaic import channel_bias_dn, packed_rows
from eldata.raw.cfa import XTRANS_CFA, pack, packed_area
from tests.cases import in_one_test
from tests.raw.helpers import BAYER, NONA, QUAD, XTRANS, XTRANS_COLOURS, Cfa


def rows_by_layout(channels: int, height: int, width: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """The mosaic row of each packed entry, as the layout's text says."""
    layout = packed_rows(channels)
    rows = np.empty((channels, height, width), dtype=np.int64)
    for c, y, x in np.ndindex(rows.shape):
        rows[c, y, x] = (y // layout.sub) * layout.period + layout.table[c, y % layout.sub, x % layout.sub]
    return rows


def row_numbers(height: int, width: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    return np.repeat(np.arange(height, dtype=np.int64)[:, None], width, axis=1)


@pytest.mark.parametrize("phase", ["RGGB", "GRBG"])
def test_bayer_rows_where_red_comes_first(phase: str) -> None:
    np.testing.assert_array_equal(rows_by_layout(4, 7, 5), pack(row_numbers(14, 10), BAYER[phase]))


@pytest.mark.parametrize("phase", BAYER)
def test_bayer_entries_share_a_layout_row_just_if_they_share_a_mosaic_row(phase: str) -> None:
    ours, real = rows_by_layout(4, 7, 5).ravel(), pack(row_numbers(14, 10), BAYER[phase]).ravel()
    np.testing.assert_array_equal(ours[:, None] == ours, real[:, None] == real)


@in_one_test("name", XTRANS)
def test_xtrans_rows(name: str) -> None:
    cfa: Cfa = XTRANS[name]
    mosaic = row_numbers(30, 36)
    packed = pack(mosaic, cfa)
    top = packed_area((30, 36), cfa).top
    np.testing.assert_array_equal(rows_by_layout(9, *packed.shape[1:]), packed - top)


def test_xtrans_rows_at_the_patterns_own_phase() -> None:
    np.testing.assert_array_equal(rows_by_layout(9, 8, 6), pack(row_numbers(24, 18), XTRANS_CFA))


@in_one_test("name", [*QUAD, *NONA])
def test_entries_of_quad_and_nona_share_a_layout_row_just_if_they_share_a_mosaic_row(name: str) -> None:
    cfa = {**QUAD, **NONA}[name]
    real = pack(row_numbers(20, 14), cfa)
    ours = rows_by_layout(*real.shape).ravel()
    np.testing.assert_array_equal(ours[:, None] == ours, real.ravel()[:, None] == real.ravel())


@pytest.mark.parametrize("cfa", [QUAD["quad-00"], NONA["nona-00"]], ids=["quad", "nona"])
def test_rows_of_quad_and_nona_where_red_comes_first(cfa: Cfa) -> None:
    real = pack(row_numbers(24, 18), cfa)
    np.testing.assert_array_equal(rows_by_layout(*real.shape), real)


@pytest.mark.parametrize(("channels", "sub", "period"), [(4, 1, 2), (9, 2, 6), (16, 1, 4), (36, 1, 6)])
def test_the_size_of_the_tables(channels: int, sub: int, period: int) -> None:
    layout = packed_rows(channels)
    assert (layout.sub, layout.period) == (sub, period)
    assert layout.table.shape == (channels, sub, sub)
    assert layout.table.dtype == np.int64
    assert set(layout.table.ravel().tolist()) == set(range(period))


@pytest.mark.parametrize("channels", [0, 1, 3, 5, 8, 10])
def test_another_number_of_channels(channels: int) -> None:
    with pytest.raises(
        ArgumentError, match=rf"4 \(Bayer\), 9 \(X-Trans\), .* or 36 \(nona-Bayer\) channels; found {channels}"
    ):
        packed_rows(channels)


def test_the_bias_of_each_channel() -> None:
    parameters = NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0, (1.0, 2.0, 4.0, 5.0))
    assert channel_bias_dn(parameters, 4) == (1.0, 2.0, 4.0, 5.0)
    # X-Trans has one green: the mean of the two.
    of_colour = {"R": 1.0, "G": 3.5, "B": 4.0}
    assert channel_bias_dn(parameters, 9) == tuple(of_colour[colour] for colour in XTRANS_COLOURS)
    assert channel_bias_dn(parameters, 16) == (*[1.0] * 4, *[2.0] * 4, *[4.0] * 4, *[5.0] * 4)
    assert channel_bias_dn(parameters, 36) == (*[1.0] * 9, *[2.0] * 9, *[4.0] * 9, *[5.0] * 9)
