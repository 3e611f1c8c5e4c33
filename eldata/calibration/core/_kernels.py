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
    lowest: NDArray[np.uint16],
    highest: NDArray[np.uint16],
    squared_rows: NDArray[np.intp],
    squares: NDArray[np.int64],
) -> None:
    """Add one frame to the sums by pixel, those of squares in some rows; keep the lowest and highest values."""
    for row in range(mosaic.shape[0]):
        for column in range(mosaic.shape[1]):
            value = mosaic[row, column]
            total[row, column] += np.uint32(value)
            lowest[row, column] = value if value < lowest[row, column] else lowest[row, column]
            highest[row, column] = value if value > highest[row, column] else highest[row, column]
    for place in range(squared_rows.size):
        for column in range(mosaic.shape[1]):
            wide = np.int64(mosaic[squared_rows[place], column])
            squares[place, column] += wide * wide


@kernel
def distances_from_median(
    total: NDArray[np.uint32],
    lowest: NDArray[np.uint16],
    highest: NDArray[np.uint16],
    side: int,
    distances: NDArray[np.int32],
) -> None:
    """Write twice the distance of ``total - lowest - highest`` from its median in blocks of ``side`` x ``side``.

    The arrays hold one site of the CFA. Blocks that reach over an edge are filled up with what lies before it, as in a
    mirror.
    """
    height, width = total.shape
    half = side * side // 2
    values = np.empty(side * side, dtype=np.int64)
    for top in range(0, height, side):
        for left in range(0, width, side):
            for i in range(side * side):
                row = (top + i // side) % (2 * height)
                column = (left + i % side) % (2 * width)
                row = row if row < height else 2 * height - 1 - row
                column = column if column < width else 2 * width - 1 - column
                values[i] = (
                    np.int64(total[row, column]) - np.int64(lowest[row, column]) - np.int64(highest[row, column])
                )
            ordered = np.partition(values, half)
            twice_median = ordered[half] + ordered[:half].max()
            for row in range(top, min(top + side, height)):
                for column in range(left, min(left + side, width)):
                    value = values[(row - top) * side + column - left]
                    distances[row, column] = abs(2 * value - twice_median)


@kernel
def block_moments(
    total: NDArray[np.uint32],
    defects: NDArray[np.bool_],
    side: int,
    count: NDArray[np.int64],
    sums: NDArray[np.int64],
    squares: NDArray[np.float64],
) -> None:
    """Write count, sum and sum of squared deviations of the sound pixels of each block of ``side`` x ``side``.

    The arrays hold one site of the CFA.
    """
    height, width = total.shape
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            rows = range(i * side, min((i + 1) * side, height))
            columns = range(j * side, min((j + 1) * side, width))
            number: Any = 0
            added: Any = 0
            for row in rows:
                for column in columns:
                    if not defects[row, column]:
                        number += 1
                        added += np.int64(total[row, column])
            mean = added / max(number, 1)
            squared = 0.0
            for row in rows:
                for column in columns:
                    if not defects[row, column]:
                        squared += (total[row, column] - mean) ** 2
            count[i, j], sums[i, j], squares[i, j] = number, added, squared


@kernel
def channel_histograms(
    mosaic: NDArray[np.uint16], defects: NDArray[np.bool_], pattern: NDArray[np.int64], counts: NDArray[np.int64]
) -> None:
    """Count the sound pixels by group of rows, channel and value in ``counts``; its last value takes all beyond."""
    period = pattern.shape[0]
    groups, last = counts.shape[0], counts.shape[2] - 1
    for row in range(mosaic.shape[0]):
        group = (row // 2) % groups
        for phase in range(period):
            channel = pattern[row % period, phase]
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = np.int64(mosaic[row, column])
                    counts[group, channel, value if value < last else last] += 1


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


SEGMENT = 96
"""Mosaic columns of a piece of a row: whole periods of Bayer and of X-Trans."""

BLOCK = 12
"""Columns of a part of a segment, likewise."""

_BLOCKS = SEGMENT // BLOCK


@kernel
def segment_means(
    first: NDArray[np.uint16],
    second: NDArray[np.uint16],
    defects: NDArray[np.bool_],
    pattern: NDArray[np.int64],
    means: NDArray[np.float32],
    noise: NDArray[np.float32],
) -> None:
    """Write the mean of A + B in each segment and a pixel's variance, both (rows, segments, channels).

    The variance is half the mean square of the differences between a channel's next sound pixels, a period apart. nan
    where there are none.
    """
    period = pattern.shape[0]
    channels = means.shape[2]
    total = np.empty(channels, dtype=np.int64)
    count = np.empty(channels, dtype=np.int64)
    jumps = np.empty(channels, dtype=np.int64)
    neighbours = np.empty(channels, dtype=np.int64)
    for row in range(first.shape[0]):
        for place in range(means.shape[1]):
            total[:] = 0
            count[:] = 0
            jumps[:] = 0
            neighbours[:] = 0
            for phase in range(period):
                whole: Any = (0, 0, 0, 0)
                sums, sound, steps, pairs = whole
                before: Any = 0
                was_sound: Any = 0
                for column in range(place * SEGMENT + phase, (place + 1) * SEGMENT, period):
                    is_sound = np.int64(not defects[row, column])
                    value = is_sound * (np.int64(first[row, column]) + np.int64(second[row, column]))
                    sums += value
                    sound += is_sound
                    steps += is_sound * was_sound * (value - before) ** 2
                    pairs += is_sound * was_sound
                    before, was_sound = value, is_sound
                channel = pattern[row % period, phase]
                total[channel] += sums
                count[channel] += sound
                jumps[channel] += steps
                neighbours[channel] += pairs
            for channel in range(channels):
                means[row, place, channel] = total[channel] / count[channel] if count[channel] else np.nan
                noise[row, place, channel] = (
                    0.5 * jumps[channel] / neighbours[channel] if neighbours[channel] else np.nan
                )


@kernel
def offset_histogram(
    mosaic: NDArray[np.uint16],
    defects: NDArray[np.bool_],
    offsets: NDArray[np.int64],
    units: int,
    step: int,
    counts: NDArray[np.int64],
) -> None:
    """Count ``units`` times each sound value less ``offsets`` (row, column phase) in cells of an odd ``step``."""
    period = offsets.shape[1]
    last = counts.size - 1
    start = (counts.size // 2) * step + step // 2
    for row in range(mosaic.shape[0]):
        for phase in range(period):
            shift = start - offsets[row, phase]
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = units * np.int64(mosaic[row, column]) + shift
                    place = value // step if value > 0 else 0
                    counts[place if place < last else last] += 1


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
    level_dn: float,
    means: NDArray[np.float32],
    noises: NDArray[np.float32],
    ratios: NDArray[np.float64],
    bright: float,
    step: float,
    counts: NDArray[np.int64],
    segments: NDArray[np.int64],
    sums: NDArray[np.float64],
) -> None:
    """Add the segments of a pair to their levels, and their pixels to ``counts`` (channel, 65536).

    A segment is ``SEGMENT`` columns of one row in one channel; its level is its mean over black. ``segments`` (channel,
    levels, 3) counts those that are whole, clipped, and crossed by an edge. ``sums`` (channel, levels, 7) are of the
    whole ones: degrees of freedom; times these, with r the ratio of A to B, Var(A - r B) / (1 + r^2), the mean that
    goes with it, and the variance of single frames; neighbours of one colour, and the products of their differences;
    degrees of freedom times the square of the first variance.

    ``ratios`` are those of the whole frames; a segment whose mean is ``bright`` times its noise has its own. There is
    an edge where the light departs from a parabola by more than noise and the share ``step`` of the segment: along the
    row, in one of the means of the segment's blocks and of the two beside it; across the rows, in the means of the
    segments about it. ``means`` and ``noises`` are those of :func:`segment_means`.
    """
    period = pattern.shape[0]
    levels = segments.shape[1]
    block, size = np.empty(_BLOCKS + 2), np.empty(_BLOCKS + 2)
    ordered = np.empty(7)
    phases = np.empty(period, dtype=np.int64)
    for row in range(first.shape[0]):
        for channel in range(black.size):
            places = 0
            for phase in range(period):
                if pattern[row % period, phase] == channel:
                    phases[places] = phase
                    places += 1
            if places == 0:
                continue
            ones, twos, bad = first[row], second[row], defects[row]
            for start in range(0, first.shape[1] - SEGMENT + 1, SEGMENT):
                # Whole numbers: of the pixels, and of neighbours with a' and b' before a and b.
                whole: Any = (0, 0, 0, 0, 0, 0)
                n, clipped, neighbours, a_sum, b_sum = whole[:5]
                aa, bb, ab, aa_two, bb_two, ab_two = whole
                a_two, b_two = whole[:2]
                block[:] = 0.0
                size[:] = 0.0
                for place in range(-1, _BLOCKS + 1):
                    begin = start + place * BLOCK
                    if begin < 0 or begin + BLOCK > first.shape[1]:
                        continue
                    is_within = 0 <= place < _BLOCKS
                    both: Any = 0
                    sound: Any = 0
                    for phase in phases[:places]:
                        a_before: Any = 0
                        b_before: Any = 0
                        is_beside: Any = False
                        for column in range(begin + phase, begin + BLOCK, period):
                            if bad[column]:
                                is_beside = False
                                continue
                            a, b = np.int64(ones[column]), np.int64(twos[column])
                            both += a + b
                            sound += 1
                            if not is_within:
                                continue
                            counts[channel, a] += 1
                            counts[channel, b] += 1
                            clipped += np.int64(a == 0 or b == 0 or a >= limit or b >= limit)
                            a_sum += a
                            b_sum += b
                            aa += a * a
                            bb += b * b
                            ab += a * b
                            if is_beside:
                                neighbours += 1
                                a_two += a + a_before
                                b_two += b + b_before
                                aa_two += a * a_before
                                bb_two += b * b_before
                                ab_two += a * b_before + b * a_before
                            a_before, b_before, is_beside = a, b, True
                    block[place + 1] = both
                    size[place + 1] = sound
                    if is_within:
                        n += sound
                if n < 8:
                    continue
                mean_a, mean_b = a_sum / n - black[channel], b_sum / n - black[channel]
                level = min(max(int(0.5 * (mean_a + mean_b) / level_dn), 0), levels - 1)
                if clipped:
                    segments[channel, level, 1] += 1
                    continue
                least = step * abs(mean_a + mean_b)
                noise, is_crossed = _along_column(
                    means, noises, row, start // SEGMENT, channel, period, n, least, ordered
                )
                if is_crossed or _has_edge(block, size, noise, least):
                    segments[channel, level, 2] += 1
                    continue
                segments[channel, level, 0] += 1
                freedom = n - 1
                a_square, b_square = aa - a_sum * (a_sum / n), bb - b_sum * (b_sum / n)
                product = ab - a_sum * (b_sum / n)
                plain = (a_square + b_square - 2 * product) / (2 * freedom)
                ratio = ratios[channel]
                if min(mean_a, mean_b) > 0 and mean_a * mean_b > bright * bright * plain:
                    ratio = mean_a / mean_b
                scale = 1 + ratio * ratio
                variance = (a_square - 2 * ratio * product + ratio * ratio * b_square) / scale
                centre = (a_sum - ratio * b_sum) / n
                together = (
                    aa_two
                    - ratio * ab_two
                    + ratio * ratio * bb_two
                    - centre * (a_two - ratio * b_two)
                    + neighbours * centre * centre
                )
                sums[channel, level, 0] += freedom
                sums[channel, level, 1] += variance
                sums[channel, level, 2] += freedom * (mean_a + ratio * ratio * mean_b) / scale
                sums[channel, level, 3] += 0.5 * (a_square + b_square)
                sums[channel, level, 4] += neighbours
                # About their own mean, independent values have a covariance of -1/n of their variance.
                sums[channel, level, 5] += together / scale + neighbours * variance / (freedom * n)
                sums[channel, level, 6] += variance * variance / freedom


@kernel
def _has_edge(block: NDArray[np.float64], size: NDArray[np.float64], noise: float, least: float) -> Any:
    """Whether a block's mean, of sums and sizes, is off the parabola through all; ``noise`` is a pixel's variance.

    Of a step between two of ten blocks 0.38 to 0.47 is left, where a straight line would leave 0.42 to 0.65. Noise
    alone brings one of ten beyond five standard errors once in 170,000 segments.
    """
    count: Any = 0.0
    middle: Any = 0.0
    for j in range(block.size):
        if size[j] > 0:  # at the frame's edge, or where all are defects, there is none
            block[j] /= size[j]
            count += 1.0
            middle += j
    middle /= count
    # Sums of powers of the place, from the middle of those that there are, and of the means times them.
    second: Any = 0.0
    third: Any = 0.0
    fourth: Any = 0.0
    centre: Any = 0.0
    tilt: Any = 0.0
    bend: Any = 0.0
    for j in range(block.size):
        if size[j] > 0:
            x = j - middle
            square = x * x
            second += square
            third += x * square
            fourth += square * square
            centre += block[j]
            tilt += x * block[j]
            bend += square * block[j]
    slope: Any = 0.0
    curve: Any = 0.0
    if count > 2:
        # The part of the square that no line has is x^2 - lean x - second / count.
        lean = third / second
        curve = (bend - lean * tilt - second / count * centre) / (fourth - lean * third - second / count * second)
        slope = tilt / second - curve * lean
    elif count > 1:
        slope = tilt / second
    centre = centre / count - curve * second / count
    for j in range(block.size):
        if size[j] > 0:
            x = j - middle
            if abs(block[j] - centre - (slope + curve * x) * x) > least + 5 * np.sqrt(noise / size[j]):
                return True
    return False


@kernel
def _along_column(
    means: NDArray[np.float32],
    noises: NDArray[np.float32],
    row: int,
    place: int,
    channel: int,
    period: int,
    n: int,
    least: float,
    ordered: NDArray[np.float64],
) -> Any:
    """Return a pixel's variance about a segment of n pixels, and whether an edge crosses the segments around it.

    These are seven of the channel, ``period`` rows apart, or the one alone where the frame has fewer. The variance is
    their median: rows beyond an edge may be brighter. What a parabola through their means leaves has four degrees of
    freedom; it goes beyond 5.5 standard errors once in 200,000 segments, and a step between two has half of itself or
    more (0.49 to 0.62) in it. ``ordered`` (7,) is room.
    """
    first = row - 3 * period
    while first < 0:
        first += period
    while first + 6 * period >= means.shape[0]:
        first -= period
    if first < 0:
        return np.float64(noises[row, place, channel]), False
    known = 0
    centre: Any = 0.0
    tilt: Any = 0.0
    bend: Any = 0.0
    total: Any = 0.0
    own = np.float64(means[row, place, channel])
    for j in range(7):
        there = first + j * period
        value = np.float64(noises[there, place, channel])
        if not np.isnan(value):
            i = known
            while i > 0 and ordered[i - 1] > value:
                ordered[i] = ordered[i - 1]
                i -= 1
            ordered[i] = value
            known += 1
        x = j - 3.0
        level = np.float64(means[there, place, channel]) - own
        total += level * level
        centre += level
        tilt += x * level
        bend += (x * x - 4.0) * level
    noise = ordered[known // 2] if known else np.nan
    # Not a number where a segment has no sound pixel, which is not an edge.
    left = total - centre * centre / 7 - tilt * tilt / 28 - bend * bend / 84
    return noise, left > (0.5 * least + 5.5 * np.sqrt(noise / n)) ** 2


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


# --- the audit ------------------------------------------------------------------------------------------------


@kernel
def standardised(
    weight: int,
    mosaic: NDArray[np.uint16],
    less: NDArray[np.unsignedinteger[Any]],
    defects: NDArray[np.bool_],
    pattern: NDArray[np.int64],
    scale: NDArray[np.float32],
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
    powers: NDArray[np.float64],
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
    first: NDArray[np.uint16],
    second: NDArray[np.uint16],
    defects: NDArray[np.bool_],
    level: NDArray[np.float32],
    scale: NDArray[np.float32],
    size: int,
    clip: int,
    sums: NDArray[np.int64],
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


@kernel
def add_sizes(
    band: NDArray[np.int16],
    step: int,
    size: int,
    total: NDArray[np.uint8],
    counts: NDArray[np.int64],
    sums: NDArray[np.int64],
) -> None:
    """Add abs(band) // step to each pixel's total, and count these sizes by value, defects among them.

    By block of ``size`` columns, ``sums`` (blocks, 2) gets them and their squares.
    """
    height, width = band.shape
    sizes = np.zeros(width, dtype=np.int64)
    several = np.zeros((4, counts.size), dtype=np.int64)  # so that one addition need not wait for the one before
    for row in range(height):
        for column in range(width):
            sizes[column] = np.uint16(abs(band[row, column])) // np.uint16(step)
            total[row, column] += np.uint8(sizes[column])
        for column in range(width):
            several[column & 3, sizes[column]] += 1
        for block in range(sums.shape[0]):
            added: Any = 0
            squared: Any = 0
            for column in range(block * size, (block + 1) * size):
                added += sizes[column]
                squared += sizes[column] * sizes[column]
            sums[block, 0] += added
            sums[block, 1] += squared
    counts += several.sum(axis=0)
