"""Orientations of mosaics: the pixels are turned, the CFA is not."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from eldata.datasets.crops import ORIENTATIONS, Orientation, copy_turned, turn_levels, turn_mosaic
from eldata.errors import ArgumentError
from eldata.raw.levels import XTRANS_CFA, pack, packed_black_level_dn
from tests.cases import in_one_test
from tests.raw.helpers import BAYER, NONA, QUAD, SOME_CFAS, XTRANS, Cfa

# Of nona those where a period may begin: 36 phases of it would take longer than all else.
ALL_CFAS: dict[str, Cfa] = {
    **BAYER, **XTRANS, **QUAD, **{name: NONA[name] for name in ("nona-00", "nona-03", "nona-33", "nona-14")}
}  # fmt: skip


def colours(cfa: Cfa, height: int, width: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """A mosaic of colours, the two greens alike."""
    period = len(cfa)
    pattern = np.array([[1 if value == 3 else value for value in row] for row in cfa])
    return np.tile(pattern, (height // period, width // period))


def name(orientation: Orientation) -> str:
    flags = ("transpose", orientation.transpose), ("rows", orientation.flip_rows), ("columns", orientation.flip_columns)
    return "+".join(word for word, on in flags if on) or "identity"


EACH = pytest.mark.parametrize("orientation", ORIENTATIONS, ids=name)


def expected(
    mosaic: np.ndarray[tuple[int, ...], np.dtype[np.int64]], orientation: Orientation
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """The turned mosaic, pixel by pixel."""
    height, width = mosaic.shape[::-1] if orientation.transpose else mosaic.shape
    out = np.empty((height, width), dtype=mosaic.dtype)
    for y, x in np.ndindex(height, width):
        row = height - 1 - y if orientation.flip_rows else y
        column = width - 1 - x if orientation.flip_columns else x
        out[y, x] = mosaic[column, row] if orientation.transpose else mosaic[row, column]
    return out


@EACH
@in_one_test("cfa", ALL_CFAS.values())
def test_the_cfa_stays_and_the_pixels_are_the_turned_ones(cfa: Cfa, orientation: Orientation) -> None:
    period = len(cfa)
    height, width = 3 * period, 4 * period
    mosaic = np.arange(height * width).reshape(height, width)
    view = turn_mosaic(mosaic, cfa, orientation)
    turned = expected(mosaic, orientation)
    # Less than a period is lost, at the top and at the left only.
    top, left = (turned.shape[0] - view.shape[0], turned.shape[1] - view.shape[1])
    assert 0 <= top < period
    assert 0 <= left < period
    np.testing.assert_array_equal(view, turned[top:, left:])
    # Each pixel's colour is the one that the CFA has there.
    of_pixel = colours(cfa, height, width).ravel()
    wanted = colours(cfa, 5 * period, 5 * period)[: view.shape[0], : view.shape[1]]
    np.testing.assert_array_equal(of_pixel[view], wanted)
    # And no smaller loss would have done.
    for other_top, other_left in itertools.product(range(period), repeat=2):
        if other_top + other_left < top + left:
            rest = of_pixel[turned[other_top:, other_left:]]
            whole = colours(cfa, 5 * period, 5 * period)[: rest.shape[0], : rest.shape[1]]
            assert not np.array_equal(rest, whole)


@EACH
@in_one_test("cfa", ALL_CFAS.values())
def test_levels_go_with_their_pixels(cfa: Cfa, orientation: Orientation) -> None:
    """Of a mosaic whose pixels have their channel's level as their value."""
    levels = (500.0, 520.0, 505.0, 560.0)[: int(np.max(cfa)) + 1]
    mosaic = np.tile(np.array(levels, np.uint16)[np.array(cfa)], (4, 4))
    packed = pack(turn_mosaic(mosaic, cfa, orientation), cfa)
    expected = packed_black_level_dn(cfa, turn_levels(levels, orientation))
    np.testing.assert_array_equal(packed, np.broadcast_to(expected[:, None, None], packed.shape))


@EACH
@in_one_test("cfa", [*SOME_CFAS.values(), ((0,),)])
def test_a_copy_is_the_view(cfa: Cfa, orientation: Orientation) -> None:
    """At sizes below, at and above what the compiled loops take at once; of a part of a larger mosaic too."""
    period = len(cfa)
    generator = np.random.default_rng(0)
    for rows, columns in ((2, 2), (3, 7), (8, 5), (9, 16)):
        whole = generator.integers(0, 65536, (rows * period + 5, columns * period + 3), dtype=np.uint16)
        for mosaic in (
            whole[2 : 2 + rows * period, 1 : 1 + columns * period],
            whole[: rows * period, : columns * period],
        ):
            view = turn_mosaic(mosaic, cfa, orientation)
            for height, width in (view.shape, (view.shape[0] - period + 1, view.shape[1]), (1, 1)):
                copy = np.empty((height, width), np.uint16)
                copy_turned(mosaic, cfa, orientation, copy)
                np.testing.assert_array_equal(copy, view[:height, :width])
            with pytest.raises(ArgumentError, match="does not fill"):
                copy_turned(mosaic, cfa, orientation, np.empty((view.shape[0] + 1, 1), np.uint16))


@pytest.mark.parametrize(
    ("shape", "cfa"),
    [
        ((5, 4), BAYER["RGGB"]),
        ((6, 8), XTRANS_CFA),
        ((6, 8), QUAD["quad-13"]),
        ((2, 2, 2), BAYER["RGGB"]),
    ],
)
def test_shapes_that_do_not_fit(shape: tuple[int, ...], cfa: Cfa) -> None:
    with pytest.raises(ArgumentError, match=rf"sides are multiples of {len(cfa)}; found shape"):
        turn_mosaic(np.zeros(shape), cfa, Orientation())
