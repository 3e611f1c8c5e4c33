"""PRNU, each pixel's own response to light: what the two flats of a pair have in common."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.audit.bias_checks import CHANCE
from eldata.calibration.audit.telegraph import BLOCK, spread_bands

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core.defects import FixedPattern

_MOST_PIXELS = 1 << 20  # and of a flat for PRNU
_REACH = 8.0
_BY_SECOND = 1.5  # variance of a pixel less the mean of two others, over that of a pixel
_SATURATED = 1e-4  # share of pixels from which on a pair is left out
_FEWEST_BLOCKS = 24


class ResponsePattern:
    """Accumulates pairs of flats for PRNU: what the two frames of a pair have in common, pixel by pixel.

    Of each pixel the mean of the next two of its site to the left and to the right is taken off, and with it light that
    changes straight over them, and what a row has in common. The products of two frames have the pattern's variance,
    ``3/2 (prnu^2 signal^2 + v / n)``: the mean of n bias frames, with noise of variance v, was taken off both.

    Parameters
    ----------
    fixed
        Of the bias frames.
    limit_dn
        From which value on a pixel counts as saturated.
    """

    def __init__(self, fixed: FixedPattern, limit_dn: float) -> None:
        self._fixed, self._limit = fixed, limit_dn
        self._places = spread_bands(fixed.total_dn.shape, _MOST_PIXELS)
        self._sums = np.zeros((2, 0))

    def add(self, first: NDArray[np.uint16], second: NDArray[np.uint16]) -> None:
        """Add a pair of equal flats; one that saturates is left out.

        Its weight is the inverse of the square of what its noise adds to prnu^2.
        """
        sums, noise = [], []
        for rows in self._places:
            flats = first[rows], second[rows]
            if max(float(np.mean(flat >= self._limit)) for flat in flats) > _SATURATED:
                return
            found, spread = self._of_band(rows, *flats)
            sums.append(found)
            noise.append(spread)
        pair = np.concatenate(sums, axis=1)
        signal2 = float(pair[1].sum()) / max(float(pair[2].sum()), 1.0)
        if signal2 > 0:
            weight = signal2 / float(np.mean(noise)) ** 2
            self._sums = weight * pair[:2] + (self._sums if self._sums.size else 0.0)

    def _of_band(
        self, rows: slice, first: NDArray[np.uint16], second: NDArray[np.uint16]
    ) -> tuple[NDArray[np.float64], float]:
        """Return, by block of columns, the products over the noise's share, the signals' products, how many; noise."""
        fixed, pattern = self._fixed, self._fixed.pattern
        period, blocks = len(pattern), first.shape[1] // BLOCK
        sums, noise = np.zeros((3, blocks)), []
        mean = fixed.total_dn[rows].astype(np.float32) / np.float32(fixed.frames)
        for (y, x), channel in np.ndenumerate(pattern):
            site = slice(y, None, period), slice(x, blocks * BLOCK, period)
            a, b = (flat[site] - mean[site] for flat in (first, second))
            sound = ~fixed.defects[rows][site]
            sound = sound[:, 1:-1] & sound[:, :-2] & sound[:, 2:]
            high = [plane[:, 1:-1] - (plane[:, :-2] + plane[:, 2:]) / 2 for plane in (a, b)]
            for plane in high:
                low, top = np.quantile(plane, (0.159, 0.841))
                sound &= np.abs(plane) < _REACH * max(float(top - low) / 2, 0.5)
            dark = _BY_SECOND * fixed.temporal_variance_dn2[channel] / fixed.frames
            columns = np.arange(1, a.shape[1] - 1) * period // BLOCK
            for number, values in enumerate((high[0] * high[1] - dark, a[:, 1:-1] * b[:, 1:-1], np.ones_like(high[0]))):
                sums[number] += np.bincount(columns, (values * sound).sum(axis=0, dtype=np.float64), blocks)
            noise.append(float(np.mean((high[0] - high[1]) ** 2)) / 2)
        return sums, float(np.mean(noise))

    def prnu(self) -> tuple[float | None, float]:
        """Return the PRNU and its standard error, by the scatter of blocks; 0 where it is not told from nothing.

        The blocks' sums are those of all pairs: what a pattern of finitely many pixels adds to the error is in it.
        """
        from scipy.special import stdtrit

        products, signals = self._sums
        if products.size < _FEWEST_BLOCKS or not signals.sum() > 0:
            return None, math.nan
        blocks, total = products.size, _BY_SECOND * float(signals.sum())
        square = float(products.sum()) / total
        left = products - square * _BY_SECOND * signals
        error = math.sqrt(float(left @ left) * blocks / (blocks - 1)) / total
        if square <= float(stdtrit(blocks - 1, 1 - CHANCE)) * error:
            return 0.0, math.sqrt(error)
        return math.sqrt(square), error / (2 * math.sqrt(square))
