"""Compiled loops of the audit over bands of bias frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Mask, Mosaic, Plane, Values


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
            scaled = edge if scaled > edge else scaled
            scaled = -edge if scaled < -edge else scaled
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
                value = clip if value > clip else value
                value = -clip if value < -clip else value
                squares[index] = value * value
                others = np.int64(total[row, column]) - np.int64(first[row, column]) - np.int64(second[row, column])
                fixed = (np.float32(others) - level[phase, column]) * scale[phase, column]
                fixed = edge if fixed > edge else fixed
                fixed = -edge if fixed < -edge else fixed
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
