"""Compiled loops over one frame. All sums are of integers: exact, and the same in any order of frames.

``residual`` below is ``n x - sum over frames of x``: n times the deviation from the pixel's own mean, an integer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray


@kernel
def add_to_stack(
    mosaic: NDArray[np.uint16],
    total: NDArray[np.uint32],
    squares: NDArray[np.int64],
    lowest: NDArray[np.uint16],
    highest: NDArray[np.uint16],
) -> None:
    """Add one frame to the per-pixel sums, and keep each pixel's lowest and highest value."""
    for row in range(mosaic.shape[0]):
        for column in range(mosaic.shape[1]):
            value = mosaic[row, column]
            wide = np.int64(value)
            total[row, column] += np.uint32(value)
            squares[row, column] += wide * wide
            lowest[row, column] = value if value < lowest[row, column] else lowest[row, column]
            highest[row, column] = value if value > highest[row, column] else highest[row, column]


@kernel
def channel_histograms(
    mosaic: NDArray[np.uint16], defects: NDArray[np.bool_], pattern: NDArray[np.int64], counts: NDArray[np.int64]
) -> None:
    """Count the sound pixels by channel and value in ``counts`` (channel, 65536)."""
    period = pattern.shape[0]
    for row in range(mosaic.shape[0]):
        for phase in range(period):
            channel = pattern[row % period, phase]
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    counts[channel, mosaic[row, column]] += 1


@kernel
def residual_sums(
    mosaic: NDArray[np.uint16],
    total: NDArray[np.uint32],
    defects: NDArray[np.bool_],
    frames: int,
    pattern: NDArray[np.int64],
    row_sums: NDArray[np.int64],
    row_squares: NDArray[np.int64],
    column_sums: NDArray[np.int64],
) -> None:
    """Add the residuals by (row, channel) and by (column, channel), and their squares by row."""
    period = pattern.shape[0]
    for row in range(mosaic.shape[0]):
        squares: Any = 0
        for phase in range(period):
            channel = pattern[row % period, phase]
            sums: Any = 0
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = frames * np.int64(mosaic[row, column]) - np.int64(total[row, column])
                    sums += value
                    squares += value * value
                    column_sums[column, channel] += value
            row_sums[row, channel] += sums
        row_squares[row] += squares


@kernel
def residual_histogram(
    mosaic: NDArray[np.uint16],
    total: NDArray[np.uint32],
    defects: NDArray[np.bool_],
    frames: int,
    offsets: NDArray[np.int64],
    step: int,
    groups: int,
    counts: NDArray[np.int64],
) -> None:
    """Count the residuals less ``offsets`` (row, column phase) in cells of an odd ``step``, by group of rows.

    Cell j of ``counts`` (group, cells) is centred on (j - cells // 2) step; the first and last take all beyond.
    """
    period = offsets.shape[1]
    last = counts.shape[1] - 1
    start = (counts.shape[1] // 2) * step + step // 2
    for row in range(mosaic.shape[0]):
        group = (row // 2) % groups
        for phase in range(period):
            shift = start - offsets[row, phase]
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = frames * np.int64(mosaic[row, column]) - np.int64(total[row, column]) + shift
                    place = value // step if value > 0 else 0
                    counts[group, place if place < last else last] += 1


@kernel
def pair_segments(
    first: NDArray[np.uint16],
    second: NDArray[np.uint16],
    defects: NDArray[np.bool_],
    pattern: NDArray[np.int64],
    black: NDArray[np.float64],
    limit: float,
    width: int,
    level_dn: float,
    segments: NDArray[np.int64],
    clipped: NDArray[np.int64],
    freedom: NDArray[np.float64],
    variance: NDArray[np.float64],
    mean: NDArray[np.float64],
) -> None:
    """Add the segments of a pair to their levels, all (channel, levels).

    A segment is ``width`` columns of one row in one channel. Its level is its mean over black; added are its degrees
    of freedom, and times these Var(A - B) / 2 and the mean.
    """
    period = pattern.shape[0]
    levels = segments.shape[1]
    for row in range(first.shape[0]):
        for start in range(0, first.shape[1] - width + 1, width):
            for channel in range(black.size):
                count = 0
                sums: Any = 0
                differences: Any = 0
                squares: Any = 0
                is_clipped: Any = False
                for phase in range(period):
                    if pattern[row % period, (start + phase) % period] != channel:
                        continue
                    for column in range(start + phase, start + width, period):
                        if defects[row, column]:
                            continue
                        a = np.int64(first[row, column])
                        b = np.int64(second[row, column])
                        is_clipped = is_clipped or a == 0 or b == 0 or a >= limit or b >= limit
                        count += 1
                        sums += a + b
                        differences += a - b
                        squares += (a - b) * (a - b)
                if count < 8:
                    continue
                signal = 0.5 * sums / count - black[channel]
                level = min(max(int(signal / level_dn), 0), levels - 1)
                segments[channel, level] += 1
                if is_clipped:
                    clipped[channel, level] += 1
                    continue
                freedom[channel, level] += count - 1
                variance[channel, level] += 0.5 * (squares - differences * (differences / count))
                mean[channel, level] += (count - 1) * signal


# --- the Tukey-lambda distribution ----------------------------------------------------------------------------


@kernel
def tukey_lambda_tail(x: Any, shape: float) -> Any:
    """Return P(X > x) for scale 1: the v with ((1 - v)^l - v^l) / l = x, by Newton's method in ln((1 - v) / v).

    It starts at the solution of (1 - exp(-l t)) / l = x and approaches from one side, as x(t) is convex or concave.
    """
    if x < 0.0:
        return 1.0 - tukey_lambda_tail(-x, shape)
    flat = abs(shape) < 1e-9
    if flat:
        return 1.0 / (1.0 + np.exp(x))
    if shape * x >= 1.0:
        return 0.0
    t = -np.log1p(-shape * x) / shape
    for _ in range(50):
        v = 1.0 / (1.0 + np.exp(t))
        power = (1.0 - v) ** shape
        fall = np.exp(-shape * t)
        value = -power * np.expm1(-shape * t) / shape
        # dx/dt = v (1 - v) ((1 - v)^(l - 1) + v^(l - 1)), with v^l = power fall
        slope = power * (v + (1.0 - v) * fall)
        step = (x - value) / slope
        t = max(t + step, 0.0)
        if abs(step) < 1e-13 * (1.0 + t):
            break
    return 1.0 / (1.0 + np.exp(t))


@kernel
def smoothed_tails(
    x: NDArray[np.floating[Any]],
    shape: float,
    scale: float,
    nodes: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]],
) -> Any:
    """Return P(scale X + U > x), U being the discrete distribution of nodes and weights."""
    tails = np.zeros(x.size)
    for i in range(x.size):
        for j in range(nodes.size):
            tails[i] += weights[j] * tukey_lambda_tail((x[i] - nodes[j]) / scale, shape)
    return tails


@kernel
def tail_from_table(x: float, unit: float, step: float, table: NDArray[np.floating[Any]]) -> Any:
    """Return a symmetric distribution's P(X > x) from ln P on a grid of even steps in arsinh(x / unit), by cubics."""
    place = np.arcsinh(abs(x) / unit) / step
    last = table.size - 3
    i = min(max(int(place), 1), last)
    f = min(place - i, 2.0)
    a, b, c, d = table[i - 1], table[i], table[i + 1], table[i + 2]
    value = (
        -f * (f - 1.0) * (f - 2.0) / 6.0 * a
        + (f + 1.0) * (f - 1.0) * (f - 2.0) / 2.0 * b
        - (f + 1.0) * f * (f - 2.0) / 2.0 * c
        + (f + 1.0) * f * (f - 1.0) / 6.0 * d
    )
    tail = np.exp(value)
    return tail if x >= 0.0 else 1.0 - tail


@kernel
def mixture_tails(
    edges: NDArray[np.floating[Any]],
    own: float,
    nodes: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]],
    unit: float,
    step: float,
    table: NDArray[np.floating[Any]],
) -> Any:
    """Return P(own X + Z > edge) for each edge, with X from its table and Z discrete: nodes and weights."""
    tails = np.zeros(edges.size)
    for i in range(edges.size):
        for j in range(nodes.size):
            tails[i] += weights[j] * tail_from_table((edges[i] - nodes[j]) / own, unit, step, table)
    return tails


# --- the audit ------------------------------------------------------------------------------------------------


@kernel
def standardised(
    values: NDArray[np.int64],
    defects: NDArray[np.bool_],
    pattern: NDArray[np.int64],
    scale: NDArray[np.float64],
    limit: int,
    out: NDArray[np.int16],
) -> None:
    """Write the values less the means of their row and channel, times ``scale`` (channel), within +-``limit``.

    Defects become 0. The rows start with the pattern's first.
    """
    period = pattern.shape[0]
    means = np.zeros(scale.size)
    counts = np.zeros(scale.size, dtype=np.int64)
    edge = np.float64(limit)
    for row in range(values.shape[0]):
        means[:] = 0.0
        counts[:] = 0
        for phase in range(period):
            channel = pattern[row % period, phase]
            added: Any = 0
            count: Any = 0
            for column in range(phase, values.shape[1], period):
                added += 0 if defects[row, column] else values[row, column]
                count += 0 if defects[row, column] else 1
            means[channel] += added
            counts[channel] += count
        for phase in range(period):
            channel = pattern[row % period, phase]
            mean = means[channel] / max(counts[channel], 1)
            factor = scale[channel]
            for column in range(phase, values.shape[1], period):
                value = (values[row, column] - mean) * factor
                value = edge if value > edge else value
                value = -edge if value < -edge else value
                value = np.floor(value + 0.5)
                out[row, column] = np.int16(0) if defects[row, column] else np.int16(value)


@kernel
def lag_products(band: NDArray[np.int16], lags: NDArray[np.int64], sums: NDArray[np.int64]) -> None:
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
    band: NDArray[np.int16],
    offsets: NDArray[np.int64],
    reach: int,
    away: int,
    levels: NDArray[np.int64],
    wins: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> None:
    """Compare the neighbours of outliers with those of the pixel ``away`` columns from it.

    ``offsets`` (row phase, column phase, neighbours, 2) are within ``reach``. Counted in ``wins`` (side, levels, 2),
    for outliers below and above and the highest level that they exceed: whether one of the neighbours goes further to
    the outlier's side than all of those others, or the other way round. ``counts`` (side, levels) are the outliers.
    """
    height, width = band.shape
    period = offsets.shape[0]
    lowest = levels[0]
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
            counts[(sign + 1) // 2, level] += 1
            if own != other:
                wins[(sign + 1) // 2, level, 0 if own > other else 1] += 1


@kernel
def variance_and_level(
    band: NDArray[np.int16],
    others: NDArray[np.int64],
    defects: NDArray[np.bool_],
    pattern: NDArray[np.int64],
    level: NDArray[np.float64],
    scale: NDArray[np.float64],
    size: int,
    clip: int,
    sums: NDArray[np.float64],
) -> None:
    """Add up, by block of ``size`` columns, the clipped squares w of a band and the levels f of its pixels.

    f is the deviation of ``others`` from ``level`` (blocks, channel), times ``scale`` (channel), within +-4. Added to
    ``sums`` (blocks, 5): pixels, w, f, f^2, f w.
    """
    period = pattern.shape[0]
    for row in range(band.shape[0]):
        for block in range(sums.shape[0]):
            for phase in range(period):
                channel = pattern[row % period, phase]
                centre, factor = level[block, channel], scale[channel]
                count: Any = 0
                squared: Any = 0
                first = second = product = 0.0
                for column in range(block * size + phase, (block + 1) * size, period):
                    if defects[row, column]:
                        continue
                    value: Any = np.int64(band[row, column])
                    value = clip if value > clip else value
                    value = -clip if value < -clip else value
                    fixed = (others[row, column] - centre) * factor
                    fixed = 4.0 if fixed > 4.0 else fixed
                    fixed = -4.0 if fixed < -4.0 else fixed
                    count += 1
                    squared += value * value
                    first += fixed
                    second += fixed * fixed
                    product += fixed * (value * value)
                sums[block, 0] += count
                sums[block, 1] += squared
                sums[block, 2] += first
                sums[block, 3] += second
                sums[block, 4] += product


@kernel
def add_sizes(
    band: NDArray[np.int16],
    defects: NDArray[np.bool_],
    step: int,
    size: int,
    total: NDArray[np.uint8],
    counts: NDArray[np.int64],
    sums: NDArray[np.int64],
) -> None:
    """Add abs(band) // step to each sound pixel's total, and count these sizes by value.

    By block of ``size`` columns, ``sums`` (blocks, 2) gets them and their squares.
    """
    for row in range(band.shape[0]):
        for block in range(sums.shape[0]):
            for column in range(block * size, (block + 1) * size):
                if not defects[row, column]:
                    value = abs(np.int64(band[row, column])) // step
                    total[row, column] += np.uint8(value)
                    counts[value] += 1
                    sums[block, 0] += value
                    sums[block, 1] += value * value
