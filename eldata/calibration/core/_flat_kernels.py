"""Compiled loops over a pair of flats."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from eldata.calibration.core._frames import Counts, Mask, Mosaic, Plane, Values

SEGMENT = 96
"""Mosaic columns of a piece of a row: whole periods of Bayer and of X-Trans."""

BLOCK = 12
"""Columns of a part of a segment, likewise."""

_BLOCKS = SEGMENT // BLOCK


@kernel
def segment_means(
    first: Mosaic,
    second: Mosaic,
    defects: Mask,
    pattern: Counts,
    means: Plane,
    noise: Plane,
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
def pair_segments(
    first: Mosaic,
    second: Mosaic,
    defects: Mask,
    pattern: Counts,
    black: Values,
    limit: float,
    level_dn: float,
    means: Plane,
    noises: Plane,
    ratios: Values,
    bright: float,
    step: float,
    counts: Counts,
    segments: Counts,
    sums: Values,
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
    ordered, whole = np.empty(7), np.empty(13, dtype=np.int64)
    for row in range(first.shape[0]):
        for channel in range(black.size):
            phases = np.flatnonzero(pattern[row % period] == channel)
            if phases.size == 0:
                continue
            ones, twos, bad, of_values = first[row], second[row], defects[row], counts[channel]
            for start in range(0, first.shape[1] - SEGMENT + 1, SEGMENT):
                _add_segment(ones, twos, bad, start, phases, period, limit, of_values, block, size, whole)
                n, clipped, a_sum, b_sum, aa, bb, ab = whole[:7]
                neighbours, a_two, b_two, aa_two, bb_two, ab_two = whole[7:]
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
def _add_segment(
    ones: Mosaic,
    twos: Mosaic,
    bad: Mask,
    start: int,
    phases: Counts,
    period: int,
    limit: float,
    counts: Counts,
    block: Values,
    size: Values,
    whole: Counts,
) -> None:
    """Sum up a segment of two rows, and the blocks beside it.

    ``block`` and ``size`` become the sum of each block's sound pixels in both frames, and how many there are. Of those
    within the segment, ``counts`` gets the values, and ``whole`` how many pixels there are, and of these clipped; sums
    of a, b, a^2, b^2, a b; and of neighbours with a' and b' before a and b: how many, sums of a + a', b + b', a a',
    b b', a b' + b a'. All are whole numbers.
    """
    none: Any = (0, 0, 0, 0, 0, 0)
    n, clipped, neighbours, a_sum, b_sum = none[:5]
    aa, bb, ab, aa_two, bb_two, ab_two = none
    a_two, b_two = none[:2]
    block[:] = 0.0
    size[:] = 0.0
    for place in range(-1, _BLOCKS + 1):
        begin = start + place * BLOCK
        if begin < 0 or begin + BLOCK > ones.size:
            continue
        is_within = 0 <= place < _BLOCKS
        both: Any = 0
        sound: Any = 0
        for phase in phases:
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
                counts[a] += 1
                counts[b] += 1
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
        n += sound * is_within
    found = (n, clipped, a_sum, b_sum, aa, bb, ab, neighbours, a_two, b_two, aa_two, bb_two, ab_two)
    for index in range(13):
        whole[index] = found[index]


@kernel
def _has_edge(block: Values, size: Values, noise: float, least: float) -> Any:
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
    means: Plane,
    noises: Plane,
    row: int,
    place: int,
    channel: int,
    period: int,
    n: int,
    least: float,
    ordered: Values,
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
