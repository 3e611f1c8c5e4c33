"""Flips and transposes of mosaics that keep the CFA in order.

Flipping packed channels would put each colour where another stood: the channels would no longer be those of any sensor.
Here the mosaic itself is flipped or transposed, and then cropped by the few rows and columns after which its CFA starts
as it did. Bayer and X-Trans patterns allow all eight orientations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.cfa import with_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Orientation:
    """One of the eight orientations: first the transpose, then the flips."""

    transpose: bool = False
    flip_rows: bool = False
    flip_columns: bool = False


ORIENTATIONS = tuple(Orientation(*flags) for flags in product((False, True), repeat=3))


def oriented(mosaic: NDArray[Scalar], cfa: CfaRows, orientation: Orientation) -> NDArray[Scalar]:
    """Return a view of a mosaic (H, W) in an orientation, its CFA as before.

    The view has lost up to one period less one of rows at the top and of columns at the left; the caller crops it.

    Raises
    ------
    ArgumentError
        If the mosaic's sides are not multiples of the CFA's period, which the flips need.
    """
    period = len(cfa)
    if mosaic.ndim != 2 or any(side % period for side in mosaic.shape):
        raise ArgumentError(f"expected a mosaic whose sides are multiples of {period}; found shape {mosaic.shape}")
    top, left = _offset(cfa, orientation)
    return _turned(mosaic, orientation)[top:, left:]


def copy_oriented(mosaic: NDArray[Scalar], cfa: CfaRows, orientation: Orientation, copy: NDArray[Scalar]) -> None:
    """Fill ``copy`` (height, width) with ``oriented(mosaic, cfa, orientation)[:height, :width]``.

    Packing reads rows: from a transposed view it takes ten times as long as this copy and the packing of it.

    Raises
    ------
    ArgumentError
        As :func:`oriented`; or if the turned mosaic is smaller than that.
    """
    from eldata.raw._kernels import mirror, transpose

    view = oriented(mosaic, cfa, orientation)
    if copy.shape[0] > view.shape[0] or copy.shape[1] > view.shape[1]:
        raise ArgumentError(f"a turned mosaic of {view.shape} pixels does not fill {copy.shape}")
    # What the view lost at the top and left, it lost at these ends of the mosaic.
    top, left = _offset(cfa, orientation)
    rows, columns = (left, top) if orientation.transpose else (top, left)
    flips = orientation.flip_rows, orientation.flip_columns
    flip_mosaic_rows, flip_mosaic_columns = reversed(flips) if orientation.transpose else flips
    part = mosaic[
        slice(None, mosaic.shape[0] - rows) if flip_mosaic_rows else slice(rows, None),
        slice(None, mosaic.shape[1] - columns) if flip_mosaic_columns else slice(columns, None),
    ]
    turn = transpose if orientation.transpose else mirror
    turn(with_rows(part), copy, orientation.flip_rows, orientation.flip_columns)


def turned_levels(levels: tuple[float, ...], orientation: Orientation) -> tuple[float, ...]:
    """Return the levels of a CFA's channels, 3 for X-Trans and else 4, as the channels of the turned mosaic have them.

    The first green is the one in red's rows. A flip leaves it there; a transpose puts the other in its place, with its
    level, of which that of the first may differ by some DN.
    """
    if not orientation.transpose or len(levels) != 4:
        return levels
    red, first, blue, second = levels
    return red, second, blue, first


def _turned(array: NDArray[Scalar], orientation: Orientation) -> NDArray[Scalar]:
    turned = array.T if orientation.transpose else array
    return turned[:: -1 if orientation.flip_rows else 1, :: -1 if orientation.flip_columns else 1]


@cache
def _offset(cfa: CfaRows, orientation: Orientation) -> tuple[int, int]:
    pattern = np.asarray(cfa)
    # Which of the two greens is which follows from the place: they are told apart again after the turn.
    colours = np.where(pattern == 3, 1, pattern)
    turned = _turned(colours, orientation)
    period = len(cfa)
    for top, left in sorted(product(range(period), repeat=2), key=sum):
        if np.array_equal(np.roll(turned, (-top, -left), axis=(0, 1)), colours):
            return top, left
    raise ArgumentError(f"the CFA {cfa} has no orientation {orientation}")
