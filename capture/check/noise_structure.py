"""Did the camera work on the raw values? Noise that it smoothed is not white, values that it coarsened have gaps.

Fine noise
    What is left of a noisy frame after its reference (:mod:`capture.check.common_shift`) is noise, and a sensor's is
    white but for rows and columns, which are left out: as strong at 0.35 to 0.5 cycles per packed pixel as at 0.15 to
    0.3. Noise reduction and filters against stars take the finer part. Standard error: jackknife over tiles.
Gaps
    The share of values that never occur where those around them do. A file of 14 bits that holds 12 lacks 3 of 4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.measures import Estimate
from capture.check.shift import frequencies, on_lines, unshift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.check.common_shift import CommonShift

_MIDDLE: Final = (0.15, 0.3)  # cycles per packed pixel
_FINE: Final = (0.35, 0.5)
_LEAST_TILES: Final = 4
_NEAR: Final = 8  # values on either side, whose mean says how often one should occur
_LEAST_EACH: Final = 30  # pixels a value: chance leaves one empty once in 1e13
_TAILS: Final = (0.05, 0.95)


def fine_noise(found: CommonShift) -> Estimate | None:
    """Return the power of the finest noise over that of coarser noise, 1 for white noise; ``None`` of too few tiles."""
    first, second = found.tiles
    side = first.side
    if len(first.spectra) < _LEAST_TILES:
        return None
    fy, fx = frequencies(side)
    radius = np.hypot(fy, fx)
    lines = on_lines(side)
    ones = np.ones(1)
    undo = unshift(found.shift.down.value * ones, found.shift.right.value * ones, side)[0]
    powers: list[NDArray[np.float64]] = []
    for low, high in (_FINE, _MIDDLE):
        band = (radius >= low) & (radius <= high) & ~lines
        one, two = first.spectra[:, band], (second.spectra * undo)[:, band]
        # The gain of the band itself: lenses and the luminance's filter are in both frames.
        gain = np.sum((np.conj(one) * two).real) / np.sum(np.abs(one) ** 2)
        powers.append(np.mean(np.abs(two - gain * one) ** 2, axis=1, dtype=np.float64))
    fine, middle = powers
    value = fine.sum() / middle.sum()
    left_out = (fine.sum() - fine) / (middle.sum() - middle)
    tiles = len(fine)
    error = np.sqrt((tiles - 1) / tiles * np.sum((left_out - left_out.mean()) ** 2))
    return Estimate(float(value), float(error))


def empty_share(mosaic: NDArray[np.uint16]) -> float:
    """Return the share of values that never occur, of those whose neighbours are frequent; 0 if none is.

    Neighbours on both sides: beside a saturated area or a peak of black, values that do not occur are not a gap.
    """
    counts = np.bincount(mosaic.ravel())
    below = np.cumsum(counts)
    low, high = (int(np.searchsorted(below, share * mosaic.size)) for share in _TAILS)
    inner = counts[low : high + 1]
    if len(inner) < _NEAR:
        return 0.0
    sums = np.convolve(inner, np.ones(_NEAR, np.int64))
    before, after = np.concatenate([[0], sums])[: len(inner)], np.append(sums, 0)[_NEAR : _NEAR + len(inner)]
    frequent = np.minimum(before, after) >= _NEAR * _LEAST_EACH
    return float(np.mean(inner[frequent] == 0)) if frequent.any() else 0.0
