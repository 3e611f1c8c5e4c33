"""Pairs of flats by segments, pieces of one row in one channel: which have an edge in them, and how the others vary."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from eldata.calibration.core._frames import Counts, Mask, Mosaic, Values

SEGMENT = 96
"""Mosaic columns of a piece of a row: whole periods of Bayer and of X-Trans."""

ROWS = 240
"""Of a pair at a time, likewise."""

_BLOCK = 12  # columns of a part of a segment, likewise
_BLOCKS = SEGMENT // _BLOCK
_AROUND = 7  # segments across the rows, among which an edge is looked for
_FEWEST_PIXELS = 8  # of a segment
# A segment of n pixels, whose mean is SNR times its noise, knows the ratio of its two frames to sqrt(2 / n) / SNR. The
# ratio's error adds 1 / (n SNR^2) of the variance: below 1e-4 from an SNR of 20 on. What a wrong ratio would leave of a
# fixed pattern of share p is (p SNR d)^2 of it, with d the error of the whole frames' ratio: below 4e-4 up to there, at
# p = 2 % and d = 5 %.
_BRIGHT = 20.0
# Of a segment, how far smooth light may be off a parabola: a block by all of it, the segments across the rows by half
# of it in all, which is what a step of so much leaves there. A lens that darkens the corners of a frame of 96 x 96
# pixels to a half is off by 0.9 and 0.7 %; light that falls like a normal curve of 90 pixels by 2 and 0.2 %.
_STEP = 0.02


@kernel
def segment_sums(
    first: Mosaic,
    second: Mosaic,
    defects: Mask,
    pattern: Counts,
    channel: int,
    limit: float,
    segments: Counts,
    blocks: Counts,
) -> None:
    """Add up the sound pixels of a channel by segment, and by block of columns; all sums are whole numbers.

    ``segments`` (15, rows, segments) gets how many pixels there are, and of these clipped; sums of a, b, a^2, b^2, a b;
    of neighbours with a' and b' before a and b in one block: how many, sums of a + a', b + b', a a', b b', a b' + b a';
    and of all neighbours how many, and the squares of a + b - a' - b'. ``blocks`` (2, rows, blocks + 2) gets the number
    of pixels and the sum of a + b, with nothing before the first and after the last.
    """
    period = pattern.shape[0]
    for row in range(first.shape[0]):
        for phase in range(period):
            if pattern[row % period, phase] != channel:
                continue
            zero: Any = (0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
            a_before, b_before = zero[:2]
            was_sound = False
            for place in range(blocks.shape[2] - 2):
                if place % _BLOCKS == 0:
                    n, clipped, a_sum, b_sum, aa, bb, ab = zero[:7]
                    neighbours, a_two, b_two, aa_two, bb_two, ab_two, pairs, jumps = zero[:8]
                    was_sound = False
                is_beside = False
                size, both = zero[:2]
                for column in range(place * _BLOCK + phase, (place + 1) * _BLOCK, period):
                    if defects[row, column]:
                        is_beside = was_sound = False
                        continue
                    a, b = np.int64(first[row, column]), np.int64(second[row, column])
                    size += 1
                    both += a + b
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
                    if was_sound:
                        pairs += 1
                        jumps += (a + b - a_before - b_before) ** 2
                    a_before, b_before, is_beside, was_sound = a, b, True, True
                n += size
                blocks[0, row, place + 1] += size
                blocks[1, row, place + 1] += both
                if place % _BLOCKS == _BLOCKS - 1:
                    found = (n, clipped, a_sum, b_sum, aa, bb, ab)
                    more = (neighbours, a_two, b_two, aa_two, bb_two, ab_two, pairs, jumps)
                    for index in range(7):
                        segments[index, row, place // _BLOCKS] += found[index]
                    for index in range(8):
                        segments[7 + index, row, place // _BLOCKS] += more[index]


def pair_segments(
    first: Mosaic,
    second: Mosaic,
    defects: Mask,
    pattern: Counts,
    channel: int,
    top: int,
    *,
    black: float,
    limit: float,
    ratio: float,
) -> tuple[Values, Counts, Values]:
    """Return level, kind and figures of a channel's segments in the :data:`ROWS` from ``top`` on.

    A segment is ``SEGMENT`` columns of one row in one channel; its level is its mean over black. Its kind is 0 if it is
    whole, 1 if it is clipped, and 2 if an edge crosses it. The figures, (7, whole segments), are degrees of freedom;
    times these, with r the ratio of A to B, Var(A - r B) / (1 + r^2), the mean that goes with it, and the variance of
    single frames; neighbours of one colour, and the products of their differences; degrees of freedom times the square
    of the first variance.

    ``ratio`` is that of the whole frames; a segment whose mean is many times its noise has its own. There is an edge
    where the light departs from a parabola by more than noise and a share of the segment: along the row, in one of the
    means of the segment's blocks and of the two beside it; across the rows, in the means of the segments about it.
    """
    height, width, period = *first.shape, len(pattern)
    begin, end = max(top - (_AROUND - 1) * period, 0), min(top + ROWS + (_AROUND - 1) * period, height)
    sums = np.zeros((15, end - begin, width // SEGMENT), dtype=np.int64)
    blocks = np.zeros((2, end - begin, width // _BLOCK + 2), dtype=np.int64)
    rows = slice(begin, end)
    segment_sums(first[rows], second[rows], defects[rows], pattern, channel, limit, sums, blocks)
    with np.errstate(divide="ignore", invalid="ignore"):  # not a number where a segment has no sound pixel
        # A pixel's variance, from the differences between a channel's next sound pixels.
        means = ((sums[2] + sums[3]) / sums[0]).astype(np.float32)
        noises = (0.5 * sums[14] / sums[13]).astype(np.float32)

    chosen = np.flatnonzero((pattern == channel).any(axis=1)[np.arange(top, min(top + ROWS, height)) % period])
    own = chosen + top - begin
    sums, blocks = sums[:, own], blocks[:, own]
    n, clipped, a_sum, b_sum, aa, bb, ab, neighbours, a_two, b_two, aa_two, bb_two, ab_two, _, _ = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_a, mean_b = a_sum / n - black, b_sum / n - black
        least = _STEP * np.abs(mean_a + mean_b)
        around = _rows_around(chosen + top, height, period) - begin
        noise, is_crossed = _along_columns(means[around], noises[around], means[own], n, least)
        is_crossed |= _has_edge(blocks, noise, least)
        freedom = n - 1
        a_square, b_square, product = aa - a_sum * (a_sum / n), bb - b_sum * (b_sum / n), ab - a_sum * (b_sum / n)
        plain = (a_square + b_square - 2 * product) / (2 * freedom)
        is_bright = (np.minimum(mean_a, mean_b) > 0) & (mean_a * mean_b > _BRIGHT * _BRIGHT * plain)
        r = np.where(is_bright, mean_a / mean_b, ratio)
        scale = 1 + r * r
        variance = (a_square - 2 * r * product + r * r * b_square) / scale
        centre = (a_sum - r * b_sum) / n
        together = aa_two - r * ab_two + r * r * bb_two - centre * (a_two - r * b_two) + neighbours * centre * centre
        # About their own mean, independent values have a covariance of -1/n of their variance.
        products = together / scale + neighbours * variance / (freedom * n)
        mean = freedom * (mean_a + r * r * mean_b) / scale
        spread = 0.5 * (a_square + b_square)
        figures = (freedom, variance, mean, spread, neighbours, products, variance * variance / freedom)
    enough = n >= _FEWEST_PIXELS
    kind = np.where(clipped > 0, 1, np.where(is_crossed, 2, 0))
    whole = enough & (kind == 0)
    return 0.5 * (mean_a + mean_b)[enough], kind[enough], np.stack([one[whole] for one in figures])


def _rows_around(rows: Counts, height: int, period: int) -> Counts:
    """Return seven rows of the channel about each, a period apart, or only the row where the frame has fewer."""
    number = (height - 1 - rows % period) // period + 1
    first = np.clip(rows // period - _AROUND // 2, 0, np.maximum(number - _AROUND, 0)) * period + rows % period
    around: Counts = np.where(number < _AROUND, rows, first + period * np.arange(_AROUND)[:, None])
    return around


def _along_columns(means: Values, noises: Values, own: Values, n: Counts, least: Values) -> tuple[Values, Mask]:
    """Return a pixel's variance about segments of n pixels, and whether an edge crosses the segments around them.

    The variance is the median of the seven's: rows beyond an edge may be brighter. What a parabola through their means
    leaves has four degrees of freedom; it goes beyond 5.5 standard errors once in 200,000 segments, and a step between
    two has half of itself or more (0.49 to 0.62) in it.
    """
    middle = np.count_nonzero(~np.isnan(noises), axis=0, keepdims=True) // 2
    noise = np.take_along_axis(np.sort(noises, axis=0), middle, axis=0)[0].astype(np.float64)
    levels = [there.astype(np.float64) - own for there in means]
    places = range(-(_AROUND // 2), _AROUND // 2 + 1)
    total, centre = sum(level * level for level in levels), sum(levels)
    tilt = sum(x * level for x, level in zip(places, levels, strict=True))
    bend = sum((x * x - 4) * level for x, level in zip(places, levels, strict=True))
    left = total - centre * centre / 7 - tilt * tilt / 28 - bend * bend / 84
    return noise, left > (0.5 * least + 5.5 * np.sqrt(noise / n)) ** 2


def _has_edge(blocks: Counts, noise: Values, least: Values) -> Mask:
    """Return whether a block's mean is off the parabola through those of a segment; ``noise`` is a pixel's variance.

    Of a step between two of ten blocks 0.38 to 0.47 is left, where a straight line would leave 0.42 to 0.65. Noise
    alone brings one of ten beyond five standard errors once in 170,000 segments.
    """
    size, total = (
        np.stack([each[:, place:][:, : noise.shape[1] * _BLOCKS : _BLOCKS] for place in range(_BLOCKS + 2)])
        for each in blocks
    )
    is_there = size > 0  # at the frame's edge, or where all are defects, there is none
    mean = np.where(is_there, total / size, 0.0)
    # Sums of powers of the place, from the middle of those that there are, and of the means times them.
    count = is_there.sum(axis=0)
    place = np.arange(_BLOCKS + 2)[:, None, None]
    x = np.where(is_there, place - (is_there * place).sum(axis=0) / count, 0.0)
    square = x * x
    second, third, fourth, centre, tilt, bend = (
        sum(each) for each in (square, x * square, square * square, mean, x * mean, square * mean)
    )
    # The part of the square that no line has is x^2 - lean x - second / count.
    lean = third / second
    curve = (bend - lean * tilt - second / count * centre) / (fourth - lean * third - second / count * second)
    curve = np.where(count > 2, curve, 0.0)
    slope = np.where(count > 1, tilt / second - curve * lean, 0.0)
    centre = centre / count - curve * second / count
    off = np.abs(mean - centre - (slope + curve * x) * x) > least + 5 * np.sqrt(noise / size)
    found: Mask = (off & is_there).any(axis=0)
    return found
