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
def remainder_counts(
    total: NDArray[np.uint32], defects: NDArray[np.bool_], pattern: NDArray[np.int64], counts: NDArray[np.int64]
) -> None:
    """Count the sound pixels' sums of n frames modulo n, in ``counts`` (group of rows, channel, n)."""
    period = pattern.shape[0]
    groups, frames = counts.shape[0], counts.shape[2]
    for row in range(total.shape[0]):
        group = (row // 2) % groups
        for phase in range(period):
            channel = pattern[row % period, phase]
            for column in range(phase, total.shape[1], period):
                if not defects[row, column]:
                    counts[group, channel, total[row, column] % frames] += 1


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


@kernel
def product(
    left: NDArray[np.inexact[Any]],
    right: NDArray[np.complexfloating[Any, Any]],
    result: NDArray[np.complexfloating[Any, Any]],
) -> None:
    """Write the matrix product of two small matrices, in this thread alone; entries of ``left`` near 0 cost nothing."""
    for i in range(left.shape[0]):
        for k in range(right.shape[1]):
            result[i, k] = 0.0
        for j in range(left.shape[1]):
            factor = left[i, j]
            if abs(factor) > 1e-15:
                for k in range(right.shape[1]):
                    result[i, k] += factor * right[j, k]


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
