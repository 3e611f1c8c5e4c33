"""How the pixels' noise depends on that of their neighbours: what a camera that filters its raw files leaves in them.

A sensor's pixels draw their read and shot noise independently; noise reduction or resampling correlates neighbours. Row
noise does not count: each row's mean is taken off in each channel first.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._kernels import lag_products

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Values

# Bands hold standardised values in sixteenths of a standard deviation, and end at eight of them, so that no single
# outlier decides anything.
UNITS = 16
LIMIT = 8 * UNITS - 1
_AWAY = 36  # columns beyond the reach of any filter in a raw file: whole periods of Bayer and of X-Trans
_LAGS = np.array([(0, 1), (0, 2), (1, -2), (1, -1), (1, 0), (1, 1), (1, 2), (2, -2), (2, -1), (2, 0), (2, 1), (2, 2)])
# What pixels far apart share, in the same row, in the same column, and in neither: drift, and what rounding makes of
# row noise that is larger than the pixels' own.
_FAR = np.array([(0, _AWAY), (0, _AWAY + 12), (12, 0), (18, 0), (1, _AWAY), (2, _AWAY), (1, -_AWAY), (2, -_AWAY)])
_FAR_KINDS = np.array([0, 0, 1, 1, 2, 2, 2, 2])


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourStatistics:
    """How the pixels' noise depends on that of their neighbours.

    Attributes
    ----------
    lags
        (lags, 2): rows and columns between two pixels; one of each two opposite directions.
    correlation
        Of the temporal noise of pixels so far apart, less that of pixels 36 columns or 12 rows apart or more.
    error
        Standard error of each correlation, where there is none.
    """

    lags: Counts = field(repr=False)
    correlation: Values
    error: float


class Neighbours:
    """Accumulates standardised bands for :class:`NeighbourStatistics`.

    Parameters
    ----------
    pattern
        The CFA's period, channel indices.
    """

    def __init__(self, pattern: Counts) -> None:
        self._lags = np.concatenate([_LAGS, _FAR])
        self._products = np.zeros(len(self._lags), dtype=np.int64)
        self._pairs = np.zeros(len(self._lags))
        self._rows_took = np.array([_taken(pattern, int(across)) if not down else 0.0 for down, across in self._lags])
        self._induced = np.zeros(len(self._lags))
        self._squares = self._pixels = 0

    def add(self, band: NDArray[np.int16]) -> None:
        """Add rows of the standardised difference of two frames; they start with the pattern's first."""
        height, width = band.shape
        lag_products(band, self._lags, self._products)
        self._squares += int(np.einsum("ij,ij->", band, band, dtype=np.int64))
        self._pixels += band.size
        pairs = (height - self._lags[:, 0]) * (width - np.abs(self._lags[:, 1]))
        self._pairs += pairs
        self._induced += pairs * self._rows_took / width

    def statistics(self) -> NeighbourStatistics:
        """Return what was found."""
        variance = self._squares / self._pixels
        correlation = self._products / (self._pairs * variance) - self._induced / self._pairs
        near = len(_LAGS)
        kinds = np.where(_LAGS[:, 0] == 0, 0, np.where(_LAGS[:, 1] == 0, 1, 2))
        far = np.array([correlation[near:][kind == _FAR_KINDS].mean() for kind in range(3)])
        # The product of two independent values has the variance of the one times that of the other, whatever their
        # tails. The mean of the far ones adds to it.
        error = np.sqrt((1 + 1 / np.bincount(_FAR_KINDS)[kinds]) / self._pairs[:near])
        return NeighbourStatistics(
            lags=_LAGS,
            correlation=correlation[:near] - far[kinds],
            error=float(error.max()),
        )


def _taken(pattern: Counts, across: int) -> float:
    """Return the correlation that taking off the mean of each row and channel makes at a lag, times the columns."""
    share = np.array([[np.count_nonzero(row == channel) for channel in row] for row in pattern]) / len(pattern)
    alike = np.roll(pattern, -across, axis=1) == pattern
    return -float(np.where(alike, 1 / share, 0.0).mean())
