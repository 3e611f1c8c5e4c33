"""One band of the steerable pyramid: the one that ST-RRED reads, and nothing else.

The pyramid of Simoncelli and Freeman ("The steerable pyramid", ICIP 1995) with the six-orientation filters that
Karasaridis and Simoncelli designed ("A filter design technique for steerable pyramid image transforms",
ICASSP 1996). The taps are data published with matlabPyrTools as ``sp5Filters``. A whole pyramid has six bands at
each of its levels; ST-RRED reads one, so only what leads there is computed.

A whole-sample mirrored image stays so under a filter that is symmetric itself, so the first two filters, both at
full resolution, are applied as one. The halvings must stay apart: an even number of rows is no longer mirrored
about its last row once every other row is gone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from collections.abc import Sequence

Plane: TypeAlias = npt.NDArray[np.float64]

HALVINGS = 3
"""How often the image is halved before the band is taken."""


def _mirrored(quadrant: Sequence[Sequence[float]]) -> Plane:
    """Return the filter whose lower right quadrant, the centre included, is given."""
    taps = np.asarray(quadrant)
    radius = len(taps) - 1
    return np.pad(taps, ((radius, 0), (radius, 0)), "reflect")


_FIRST_LOW_PASS = _mirrored(
    [
        [0.40304148, 0.15925570, -0.03848215],
        [0.15925570, 0.05586982, -0.01551246],
        [-0.03848215, -0.01551246, 0.00341614],
    ]
)
# Twice the taps of a low pass that keeps the mean: each halving doubles the signal, as the published filter does.
_LOW_PASS = 2.0 * _mirrored(
    [
        [0.10096540, 0.08169618, 0.03981393, 0.01002988, -0.00962054],
        [0.08169618, 0.06426333, 0.03277038, 0.00410600, -0.00944432],
        [0.03981393, 0.03277038, 0.01396746, -0.00661117, -0.00387812],
        [0.01002988, 0.00410600, -0.00661117, -0.00523281, -0.00244917],
        [-0.00962054, -0.00944432, -0.00387812, -0.00244917, 0.00085404],
    ]
)
_BOTH_LOW_PASSES = ndimage.convolve(np.pad(_LOW_PASS, len(_FIRST_LOW_PASS) // 2), _FIRST_LOW_PASS, mode="constant")
_LOWER_BAND = np.pad(  # odd down the rows, even along the columns
    [
        [-0.11732297, -0.08226445, -0.03075356, -0.01021852],
        [0.02755155, 0.01189859, -0.00893064, -0.00986904],
        [0.01455399, 0.01026699, 0.00496194, 0.00277643],
    ],
    ((0, 0), (3, 0)),
    "reflect",
)
_BAND = np.concatenate([-_LOWER_BAND[::-1], np.zeros((1, 7)), _LOWER_BAND])


def coarse_band(image: Plane) -> Plane:
    """Return the band of the fourth level that answers to what changes down the rows, at an eighth of the size.

    It is the fourth of the six orientations in matlabPyrTools and pyrtools, and the first in scikit-video, which
    reads the same taps in transposed order.

    Parameters
    ----------
    image
        (H, W), at least 41 x 41; any range. Other sizes than multiples of 8 are halved to the larger half.

    Returns
    -------
    Plane
        (h, w) with h = ceil(H / 8) and w = ceil(W / 8), in units of the image. Level 0 is the high-pass
        residue and level 1 the oriented bands at full size, each later level half of the one before. Edges are
        mirrored without repeating the edge pixel.
    """
    plane = _halved(image, _BOTH_LOW_PASSES)
    for _ in range(HALVINGS - 1):
        plane = _halved(plane, _LOW_PASS)
    return ndimage.correlate(plane, _BAND, mode="mirror")


def _halved(image: Plane, taps: Plane) -> Plane:
    """Filter, then keep every other row and column, from the first."""
    radius = len(taps) // 2
    padded = np.pad(image, radius, "reflect")
    # Apart, the columns that meet one tap lie side by side, which SIMD needs.
    even = np.ascontiguousarray(padded[:, 0::2])
    odd = np.ascontiguousarray(padded[:, 1::2])
    rows, columns = image.shape
    out = np.zeros(((rows + 1) // 2, (columns + 1) // 2))
    _filter_every_other(even, odd, taps, out)
    return out


@kernel
def _filter_every_other(even: Plane, odd: Plane, taps: Plane, out: Plane) -> None:
    """Add to ``out`` the filtered image at every other row and column.

    ``even`` and ``odd`` hold the columns of the padded image. Symmetric taps share their product, first between
    two rows, then between two columns.
    """
    size = taps.shape[0]
    radius = size // 2
    rows, columns = out.shape
    folded = np.empty((2, even.shape[1]))
    for row in range(rows):
        total = out[row]
        for a in range(radius + 1):
            for parity in range(2):
                source = odd if parity else even
                fold = folded[parity]
                upper = source[2 * row + a]
                lower = source[2 * row + size - 1 - a]
                if a < radius:
                    for j in range(upper.size):
                        fold[j] = upper[j] + lower[j]
                else:
                    for j in range(upper.size):
                        fold[j] = upper[j]
            for b in range(radius):
                fold = folded[b % 2]
                left = fold[b // 2 : b // 2 + columns]
                right = fold[(size - 1 - b) // 2 : (size - 1 - b) // 2 + columns]
                tap = taps[a, b]
                for j in range(columns):
                    total[j] += tap * (left[j] + right[j])
            middle = folded[radius % 2][radius // 2 : radius // 2 + columns]
            tap = taps[a, radius]
            for j in range(columns):
                total[j] += tap * middle[j]
