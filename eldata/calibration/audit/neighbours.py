"""How the pixels' noise depends on that of their neighbours: what a camera that filters its raw files leaves in them.

A sensor's pixels draw their read and shot noise independently. A camera that filters its raw files leaves traces:
noise reduction or resampling correlates neighbours, and a filter against hot pixels ("star-eater") leaves no value
far above all of its neighbours. Row noise does not count: each row's mean is taken off in each channel first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Mask, Mosaic, Plane, Values

OUTLIERS = (3, 4, 5, 6)
"""Standard deviations from which on a value counts as an outlier of that size."""

# Bands hold standardised values in sixteenths of a standard deviation, and end at eight of them, so that no single
# outlier decides anything.
UNITS = 16
_AWAY = 36  # columns beyond the reach of any filter in a raw file: whole periods of Bayer and of X-Trans
_LAGS = np.array([(0, 1), (0, 2), (1, -2), (1, -1), (1, 0), (1, 1), (1, 2), (2, -2), (2, -1), (2, 0), (2, 1), (2, 2)])
# What pixels far apart share, in the same row, in the same column, and in neither: drift, and what rounding makes of
# row noise that is larger than the pixels' own.
_FAR = np.array([(0, _AWAY), (0, _AWAY + 12), (12, 0), (18, 0), (1, _AWAY), (2, _AWAY), (1, -_AWAY), (2, -_AWAY)])
_FAR_KINDS = np.array([0, 0, 1, 1, 2, 2, 2, 2])
_NEIGHBOURS = 8


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
    outlier_wins
        (2, 4, 2): of values below and above their pixel's mean, by more than 3, 4, 5 and 6 standard deviations, how
        many have a neighbour of their colour that goes further to their side than all eight of a pixel 36 columns
        away, and of how many it is the other way round. Without a filter the two are equal but for chance.
    skewness, skewness_error
        Mean of the third powers of the values in standard deviations, and its standard error where there is none.
    """

    lags: Counts = field(repr=False)
    correlation: Values
    error: float
    outlier_wins: Counts
    skewness: float
    skewness_error: float


class Neighbours:
    """Accumulates standardised bands for :class:`NeighbourStatistics`.

    Parameters
    ----------
    pattern
        The CFA's period, channel indices.
    """

    def __init__(self, pattern: Counts) -> None:
        self._offsets = _same_colour(pattern)
        self._reach = int(np.abs(self._offsets).max())
        self._lags = np.concatenate([_LAGS, _FAR])
        self._products = np.zeros(len(self._lags), dtype=np.int64)
        self._pairs = np.zeros(len(self._lags))
        self._rows_took = np.array([_taken(pattern, int(across)) if not down else 0.0 for down, across in self._lags])
        self._induced = np.zeros(len(self._lags))
        self._squares = self._pixels = 0
        self._wins = np.zeros((2, len(OUTLIERS), 2), dtype=np.int64)
        self._powers = np.zeros(2)
        self._values = 0

    def add_difference(self, band: NDArray[np.int16]) -> None:
        """Add rows of the standardised difference of two frames; they start with the pattern's first."""
        height, width = band.shape
        lag_products(band, self._lags, self._products)
        self._squares += int(np.einsum("ij,ij->", band, band, dtype=np.int64))
        self._pixels += band.size
        pairs = (height - self._lags[:, 0]) * (width - np.abs(self._lags[:, 1]))
        self._pairs += pairs
        self._induced += pairs * self._rows_took / width

    def add_frame(self, band: NDArray[np.int16]) -> None:
        """Add rows of one frame less its pixels' means, standardised: what a filter has done to outliers."""
        outlier_neighbours(
            band, self._offsets, self._reach, _AWAY, np.array(OUTLIERS) * UNITS, self._wins, self._powers
        )
        self._values += band.size

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
            outlier_wins=self._wins[:, ::-1].cumsum(axis=1)[:, ::-1],
            skewness=float(self._powers[0]) / UNITS**3 / max(self._values, 1),
            # The values of a pixel add up to nothing, which makes the sum scatter a little less.
            skewness_error=math.sqrt(self._powers[1]) / UNITS**3 / max(self._values, 1),
        )


@kernel
def standardised(
    weight: int,
    mosaic: Mosaic,
    less: NDArray[np.unsignedinteger[Any]],
    defects: Mask,
    pattern: Counts,
    scale: Plane,
    limit: int,
    out: NDArray[np.int16],
) -> None:
    """Write ``weight mosaic - less``, less its means by row and channel, times ``scale`` (channel), within +-``limit``.

    Defects become 0. The rows start with the pattern's first.
    """
    period = pattern.shape[0]
    height, width = mosaic.shape
    sums = np.zeros(scale.size, dtype=np.int64)
    counts = np.zeros(scale.size, dtype=np.int64)
    values = np.zeros(width, dtype=np.int64)
    means = np.zeros(width, dtype=np.float32)
    factors = np.zeros(width, dtype=np.float32)
    edge, half = np.float32(limit), np.float32(0.5)
    for row in range(height):
        sums[:] = 0
        counts[:] = 0
        for column in range(width):
            value = weight * np.int64(mosaic[row, column]) - np.int64(less[row, column])
            values[column] = 0 if defects[row, column] else value
        for phase in range(period):
            added: Any = 0
            count: Any = 0
            for column in range(phase, width, period):
                added += values[column]
                count += not defects[row, column]
            sums[pattern[row % period, phase]] += added
            counts[pattern[row % period, phase]] += count
        for phase in range(period):
            channel = pattern[row % period, phase]
            means[phase::period] = sums[channel] / max(counts[channel], 1)
            factors[phase::period] = scale[channel]
        for column in range(width):
            scaled = (np.float32(values[column]) - means[column]) * factors[column]
            scaled = min(scaled, edge)
            scaled = max(scaled, -edge)
            out[row, column] = np.int16(0) if defects[row, column] else np.int16(np.floor(scaled + half))


@kernel
def lag_products(band: NDArray[np.int16], lags: Counts, sums: Counts) -> None:
    """Add, for each lag (rows, columns), the products of all pixels of the band that lie so far apart."""
    height, width = band.shape
    for index in range(lags.shape[0]):
        down, across = lags[index]
        first, last = max(0, -across), width - max(0, across)
        for row in range(height - down):
            here = band[row, first:last]
            there = band[row + down, first + across : last + across]
            added = np.int64(0)
            for column in range(here.size):
                added += np.int32(here[column]) * np.int32(there[column])
            sums[index] += added


@kernel
def outlier_neighbours(
    band: NDArray[np.int16], offsets: Counts, reach: int, away: int, levels: Counts, wins: Counts, powers: Values
) -> None:
    """Compare the neighbours of outliers with those of the pixel ``away`` columns from it.

    ``offsets`` (row phase, column phase, neighbours, 2) are within ``reach``. Counted in ``wins`` (side, levels, 2),
    for outliers below and above and the highest level that they exceed: whether one of the neighbours goes further to
    the outlier's side than all of those others, or the other way round. ``powers`` (2,) gets the sums of the
    third and sixth powers of all values.
    """
    height, width = band.shape
    period = offsets.shape[0]
    lowest = levels[0]
    for row in range(height):
        third: Any = 0
        sixth = 0.0
        for column in range(width):
            cube = np.int64(band[row, column]) * np.int64(band[row, column]) * np.int64(band[row, column])
            third += cube
            sixth += np.float64(cube) * np.float64(cube)
        powers[0] += third
        powers[1] += sixth
    for row in range(reach, height - reach):
        for column in range(reach, width - reach):
            value = np.int64(band[row, column])
            if -lowest < value < lowest:
                continue
            sign = 1 if value > 0 else -1
            there = column + away if column + away + reach < width else column - away
            own = np.int64(-(1 << 30))
            other = np.int64(-(1 << 30))
            for index in range(offsets.shape[2]):
                down, across = offsets[row % period, column % period, index]
                own = max(own, sign * np.int64(band[row + down, column + across]))
                other = max(other, sign * np.int64(band[row + down, there + across]))
            level = 0
            while level + 1 < levels.size and sign * value >= levels[level + 1]:
                level += 1
            if own != other:
                wins[(sign + 1) // 2, level, 0 if own > other else 1] += 1


@kernel
def variance_and_level(
    band: NDArray[np.int16],
    total: NDArray[np.uint32],
    first: Mosaic,
    second: Mosaic,
    defects: Mask,
    level: Plane,
    scale: Plane,
    size: int,
    clip: int,
    sums: Counts,
) -> None:
    """Add up, by block of ``size`` columns, the squares w of a band, clipped, and the levels f of its pixels.

    f is the deviation of ``total - first - second`` from ``level`` (row phase, columns), times ``scale`` (likewise),
    within +-64. Added to ``sums`` (blocks, 10): w, f, f^2, f w, f^2 w; and of the pixels with f < 0 how many they are,
    w, f, f^2, f w.
    """
    period = level.shape[0]
    edge, half = np.float32(64), np.float32(0.5)
    squares = np.zeros(size, dtype=np.int32)
    levels = np.zeros(size, dtype=np.int32)
    for row in range(band.shape[0]):
        phase = row % period
        for block in range(sums.shape[0]):
            start = block * size
            for index in range(size):
                column = start + index
                value: Any = np.int32(band[row, column])
                value = min(value, clip)
                value = max(value, -clip)
                squares[index] = value * value
                others = np.int64(total[row, column]) - np.int64(first[row, column]) - np.int64(second[row, column])
                fixed = (np.float32(others) - level[phase, column]) * scale[phase, column]
                fixed = min(fixed, edge)
                fixed = max(fixed, -edge)
                levels[index] = 0 if defects[row, column] else np.int32(np.floor(fixed + half))
            added = np.zeros(10, dtype=np.int64)
            for index in range(size):
                fixed_square = levels[index] * levels[index]
                product = levels[index] * squares[index]
                below = np.int32(1) if levels[index] < 0 else np.int32(0)
                added[0] += squares[index]
                added[1] += levels[index]
                added[2] += fixed_square
                added[3] += product
                added[4] += levels[index] * product
                added[5] += below
                added[6] += below * squares[index]
                added[7] += below * levels[index]
                added[8] += below * fixed_square
                added[9] += below * product
            sums[block] += added


def _same_colour(pattern: Counts) -> Counts:
    """Return the offsets of the eight nearest pixels of the same colour, (row, column, 8, 2)."""
    colour = np.where(pattern == 3, 1, pattern)  # both greens of Bayer
    period = len(pattern)
    places = sorted(
        ((dy, dx) for dy in range(-4, 5) for dx in range(-4, 5) if dy or dx),
        key=lambda place: (math.hypot(*place), place),
    )

    def nearest(row: int, column: int) -> list[tuple[int, int]]:
        alike = (
            (dy, dx) for dy, dx in places if colour[(row + dy) % period, (column + dx) % period] == colour[row, column]
        )
        return [place for place, _ in zip(alike, range(_NEIGHBOURS), strict=False)]

    return np.array([[nearest(row, column) for column in range(period)] for row in range(period)])


def _taken(pattern: Counts, across: int) -> float:
    """Return the correlation that taking off the mean of each row and channel makes at a lag, times the columns."""
    share = np.array([[np.count_nonzero(row == channel) for channel in row] for row in pattern]) / len(pattern)
    alike = np.roll(pattern, -across, axis=1) == pattern
    return -float(np.where(alike, 1 / share, 0.0).mean())
