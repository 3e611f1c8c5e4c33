"""The compiled loops. Each takes one band of one channel: two C-contiguous (rows, columns) float arrays.

No fast-math, so a plain ``total += ...`` loop cannot use SIMD. The loops keep one float64 sum per column
instead, and fold those at the end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import helper, kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.metrics._images import Block


WINDOW = 7
"""Side of the SSIM window."""

AREA = WINDOW * WINDOW
"""Number of its entries."""

_MARGIN = WINDOW - 1
_STRIP = 256  # columns at a time, so that the sums and the ring below stay in the L1 and L2 caches
_STRIDE = _STRIP + 16  # room for the margin; constant, which lets LLVM see that the rows do not overlap


@helper
def clamp(value: float, low: float, high: float) -> float:
    """Limit a value to [low, high]; NaN stays NaN."""
    if value < low:
        return low
    if value > high:
        return high
    return value  # NaN comes this way, which min and max do not promise


@kernel
def products(prediction: Block, reference: Block, low: float, high: float) -> tuple[float, float]:
    """Sum <p, g> and <p, p>, with p clamped to [low, high], over the entries where g is not exactly 1 (saturated)."""
    rows, columns = prediction.shape
    sums = np.zeros((2, _STRIP))
    for row in range(rows):
        for start in range(0, columns, _STRIP):
            stop = start + _STRIP if start + _STRIP < columns else columns
            ps, gs = prediction[row, start:stop], reference[row, start:stop]
            for j in range(ps.size):
                g = np.float64(gs[j])
                p = clamp(np.float64(ps[j]), low, high) if g != 1.0 else 0.0
                sums[0, j] += p * g
                sums[1, j] += p * p
    of_both, of_prediction = 0.0, 0.0
    for j in range(_STRIP):
        of_both += sums[0, j]
        of_prediction += sums[1, j]
    return of_both, of_prediction


@kernel
def squared_error(prediction: Block, reference: Block) -> float:
    """Sum (p - g)^2."""
    rows, columns = prediction.shape
    sums = np.zeros(_STRIP)
    for row in range(rows):
        for start in range(0, columns, _STRIP):
            for j in range(_STRIP if start + _STRIP < columns else columns - start):
                column = np.uint64(start + j)  # unsigned: the compiler sees that none is negative
                d = np.float64(prediction[row, column]) - np.float64(reference[row, column])
                sums[j] += d * d
    total = 0.0
    for j in range(_STRIP):
        total += sums[j]
    return total


@kernel
def error_and_similarity(
    prediction: Block,
    reference: Block,
    owned_rows: int,
    treatment: tuple[float, float, float, float, float],
    c1: float,
    c2: float,
    degrees: float,
) -> tuple[float, float]:
    """Sum the squared errors and the SSIM map of one band.

    ``treatment`` of the prediction: it is clamped to [first, second], multiplied by the third number and clamped to
    [fourth, fifth]. The error counts the first ``owned_rows`` rows (the rest belong to the next band), the SSIM map
    every full window. ``degrees`` divides the covariances: 48 of a sample, 49 of a population.

    With s = x + y and d = x - y, SSIM needs only the window sums of s, d, s^2 and d^2: 2xy = (s^2 - d^2) / 2
    and x^2 + y^2 = (s^2 + d^2) / 2. Numerator and denominator then differ in the sign of the d terms alone,
    so equal images give exactly 1. Every factor is kept multiplied by twice the powers of the window area
    that would divide it.
    """
    low, high, factor, final_low, final_high = treatment
    rows, columns = prediction.shape
    width = columns - _MARGIN
    strips = (width + _STRIP - 1) // _STRIP
    a1 = 2.0 * c1 * AREA * AREA
    a2 = 2.0 * c2 * AREA * degrees
    error = 0.0
    similarity = 0.0
    for strip in range(strips):
        start = width * strip // strips
        stop = width * (strip + 1) // strips
        inner = stop - start
        outer = inner + _MARGIN
        sums = np.zeros((10, _STRIDE))
        s1, d1, s2, d2 = sums[0], sums[1], sums[2], sums[3]  # per column, over the last 7 rows
        s1_3, d1_3, s2_3, d2_3 = sums[4], sums[5], sums[6], sums[7]  # the same over 3 neighbouring columns
        errors, similarities = sums[8], sums[9]
        # s and d of those rows. Before the first they count as zero: leaving the window, they take nothing away.
        ring = np.zeros((2 * WINDOW, _STRIDE))
        for row in range(rows):
            ss = ring[2 * (row % WINDOW)]
            ds = ring[2 * (row % WINDOW) + 1]
            for j in range(outer):
                column = np.uint64(start + j)
                x = clamp(clamp(np.float64(prediction[row, column]), low, high) * factor, final_low, final_high)
                y = np.float64(reference[row, column])
                s = x + y
                d = x - y
                old_s = ss[j]
                old_d = ds[j]
                ss[j] = s
                ds[j] = d
                s1[j] += s - old_s
                d1[j] += d - old_d
                s2[j] += s * s - old_s * old_s
                d2[j] += d * d - old_d * old_d
            if row < owned_rows:
                for j in range(outer):
                    errors[j] += ds[j] * ds[j]
            if row < _MARGIN:
                continue
            for j in range(inner + 4):
                s1_3[j] = s1[j] + s1[j + 1] + s1[j + 2]
                d1_3[j] = d1[j] + d1[j + 1] + d1[j + 2]
                s2_3[j] = s2[j] + s2[j + 1] + s2[j + 2]
                d2_3[j] = d2[j] + d2[j + 1] + d2[j + 2]
            for j in range(inner):
                s = (s1_3[j] + s1_3[j + 3]) + s1[j + 6]
                d = (d1_3[j] + d1_3[j + 3]) + d1[j + 6]
                s_squared = s * s
                d_squared = d * d
                luminance = s_squared + a1
                variance_s = (AREA * ((s2_3[j] + s2_3[j + 3]) + s2[j + 6]) - s_squared) + a2
                variance_d = AREA * ((d2_3[j] + d2_3[j + 3]) + d2[j + 6]) - d_squared
                similarities[j] += ((luminance - d_squared) * (variance_s - variance_d)) / (
                    (luminance + d_squared) * (variance_s + variance_d)
                )
        for j in range(outer if strip == strips - 1 else inner):  # the overlap belongs to the next strip
            error += errors[j]
        for j in range(inner):
            similarity += similarities[j]
    return error, similarity


# --- Gaussian windows -------------------------------------------------------------------------------------------------


SIGMA = 1.5
RADIUS = 5
GAUSSIAN_WINDOW = 2 * RADIUS + 1
"""Side of the window: 11."""

_GAUSSIAN_MARGIN = GAUSSIAN_WINDOW - 1
_KEPT = GAUSSIAN_WINDOW + 1
_WIDTH = 256  # columns at a time: the kept rows below stay in the L2 cache
_UNSCALED = [math.exp(-0.5 * (offset / SIGMA) ** 2) for offset in range(RADIUS + 1)]
_SUM = _UNSCALED[0] + 2.0 * math.fsum(_UNSCALED[1:])
WEIGHTS = tuple(value / _SUM for value in _UNSCALED)
"""Weight of the centre and of each offset up to the radius; they sum to 1 over the window."""

_W0, _W1, _W2, _W3, _W4, _W5 = WEIGHTS


@helper
def _filter_along_row(row: NDArray[np.float64], out: NDArray[np.float64], count: int) -> None:
    """Filter a row with the Gaussian window of 11 weights: ``count`` values into ``out``."""
    for j in range(count):
        out[j] = (
            (_W5 * (row[j] + row[j + 10]) + _W4 * (row[j + 1] + row[j + 9]))
            + (_W3 * (row[j + 2] + row[j + 8]) + _W2 * (row[j + 3] + row[j + 7]))
            + (_W1 * (row[j + 4] + row[j + 6]) + _W0 * row[j + 5])
        )


@helper
def _filter_along_columns(
    rows: NDArray[np.float64], first: int, above: NDArray[np.float64], below: NDArray[np.float64], count: int
) -> None:
    """Filter for two windows that lie one above the other: the rows that they share are loaded once."""
    for j in range(count):
        r0, r1, r2, r3 = rows[first, j], rows[first + 1, j], rows[first + 2, j], rows[first + 3, j]
        r4, r5, r6, r7 = rows[first + 4, j], rows[first + 5, j], rows[first + 6, j], rows[first + 7, j]
        r8, r9, r10, r11 = rows[first + 8, j], rows[first + 9, j], rows[first + 10, j], rows[first + 11, j]
        above[j] = (
            (_W5 * (r0 + r10) + _W4 * (r1 + r9)) + (_W3 * (r2 + r8) + _W2 * (r3 + r7)) + (_W1 * (r4 + r6) + _W0 * r5)
        )
        below[j] = (
            (_W5 * (r1 + r11) + _W4 * (r2 + r10)) + (_W3 * (r3 + r9) + _W2 * (r4 + r8)) + (_W1 * (r5 + r7) + _W0 * r6)
        )


@helper
def _mix(filtered: NDArray[np.float64], weights: NDArray[np.float64], mixed: NDArray[np.float64], count: int) -> None:
    """Weigh the channels that a window spans."""
    mixed[:] = 0.0
    for channel in range(len(filtered)):
        for which in range(4):
            for j in range(count):
                mixed[which, j] += weights[channel] * filtered[channel, which, j]


@kernel
def gaussian_error_and_similarity(
    prediction: NDArray[Any],
    reference: NDArray[Any],
    owned_rows: int,
    treatment: tuple[float, float, float, float, float],
    mixing: NDArray[np.float64],
    c1: float,
    c2: float,
    covariance_scale: float,
) -> tuple[float, float]:
    """Sum the squared errors and the SSIM map of one band of some channels.

    ``prediction`` and ``reference`` are (channels, rows, columns). The prediction is first treated as
    :func:`eldata.metrics._kernels.error_and_similarity` does. The error counts the first ``owned_rows`` rows, the SSIM
    map every full window. ``mixing`` (channels, channels) weighs the channels that a window spans.

    As there, SSIM is written in s = x + y and d = x - y: equal images give exactly 1.
    """
    low, high, factor, final_low, final_high = treatment
    channels, rows, columns = prediction.shape
    width = columns - _GAUSSIAN_MARGIN
    strips = (width + _WIDTH - 1) // _WIDTH
    a1 = 2.0 * c1
    a2 = 2.0 * c2
    values = np.empty((4, _WIDTH + _GAUSSIAN_MARGIN))  # s, d and their squares in one row
    sums, differences, squared_sums, squared_differences = values[0], values[1], values[2], values[3]
    # The last 12 rows of each of them, filtered along the row, each kept twice so that any 12 follow each other, as two
    # windows are taken at a time, one above the other.
    kept = np.empty((channels, 4, 2 * _KEPT, _WIDTH))
    filtered = np.empty((2, channels, 4, _WIDTH))
    mixed = np.empty((4, _WIDTH))
    errors = np.empty(_WIDTH + _GAUSSIAN_MARGIN)
    similarities = np.empty(_WIDTH)
    error = 0.0
    similarity = 0.0
    for strip in range(strips):
        start = width * strip // strips
        stop = width * (strip + 1) // strips
        inner = stop - start
        outer = inner + _GAUSSIAN_MARGIN
        errors[:] = 0.0
        similarities[:] = 0.0
        for row in range(rows):
            slot = row % _KEPT
            for channel in range(channels):
                xs = prediction[channel, row, start : stop + _GAUSSIAN_MARGIN]
                ys = reference[channel, row, start : stop + _GAUSSIAN_MARGIN]
                for j in range(outer):
                    x = clamp(clamp(np.float64(xs[j]), low, high) * factor, final_low, final_high)
                    y = np.float64(ys[j])
                    sums[j] = x + y
                    differences[j] = x - y
                for j in range(outer):
                    squared_sums[j] = sums[j] * sums[j]
                    squared_differences[j] = differences[j] * differences[j]
                if row < owned_rows:
                    for j in range(outer):
                        errors[j] += squared_differences[j]
                for which in range(4):
                    line = kept[channel, which, slot]
                    again = kept[channel, which, slot + _KEPT]
                    _filter_along_row(values[which], line, inner)
                    for j in range(inner):
                        again[j] = line[j]
            done = row - _GAUSSIAN_MARGIN + 1  # windows that end in this row or above
            if done <= 0 or (done % 2 == 1 and row < rows - 1):
                continue
            # Of an odd number the last window stands alone: what is filtered below it does not count.
            alone = done % 2
            first = (slot + 1) % _KEPT + alone
            for channel in range(channels):
                for which in range(4):
                    above, below = filtered[0, channel, which], filtered[1, channel, which]
                    _filter_along_columns(kept[channel, which], first, above, below, inner)
            for place in range(2 - alone):
                for channel in range(channels):
                    if channels == 1:
                        window = filtered[place, 0]
                    else:
                        _mix(filtered[place], mixing[channel], mixed, inner)
                        window = mixed
                    for j in range(inner):
                        s_squared = window[0, j] * window[0, j]
                        d_squared = window[1, j] * window[1, j]
                        luminance = s_squared + a1
                        variance_s = covariance_scale * (window[2, j] - s_squared) + a2
                        variance_d = covariance_scale * (window[3, j] - d_squared)
                        similarities[j] += ((luminance - d_squared) * (variance_s - variance_d)) / (
                            (luminance + d_squared) * (variance_s + variance_d)
                        )
        for j in range(outer if strip == strips - 1 else inner):  # the overlap belongs to the next strip
            error += errors[j]
        for j in range(inner):
            similarity += similarities[j]
    return error, similarity
