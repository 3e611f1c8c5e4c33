"""The compiled loops. Each takes one band of one channel: two C-contiguous (rows, columns) float arrays.

No fast-math, so a plain ``total += ...`` loop cannot use SIMD. The loops keep one float64 sum per column
instead, and fold those at the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from eldata.metrics._images import Block

WINDOW = 7
"""Side of the SSIM window."""

AREA = WINDOW * WINDOW
"""Number of its entries."""

_MARGIN = WINDOW - 1
_STRIP = 256  # columns at a time, so that the sums and the ring below stay in the L1 and L2 caches
_STRIDE = _STRIP + 16  # room for the margin; constant, which lets LLVM see that the rows do not overlap


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """Return a value limited to [low, high]; NaN stays NaN."""
    if value < low:
        return low
    if value > high:
        return high
    return value  # NaN comes this way, which min and max do not promise


@kernel
def products(prediction: Block, reference: Block, low: float, high: float, masked: float) -> tuple[float, float]:
    """Return <p, g> and <p, p>, with p clamped to [low, high], over the entries where g is not exactly ``masked``."""
    rows, columns = prediction.shape
    sums = np.zeros((2, _STRIP))
    for row in range(rows):
        for start in range(0, columns, _STRIP):
            ps = prediction[row, start : min(start + _STRIP, columns)]
            gs = reference[row, start : min(start + _STRIP, columns)]
            for j in range(ps.size):
                g = np.float64(gs[j])
                p = clamp(np.float64(ps[j]), low, high) if g != masked else 0.0  # true for all if masked is NaN
                sums[0, j] += p * g
                sums[1, j] += p * p
    pg = 0.0
    pp = 0.0
    for j in range(_STRIP):
        pg += sums[0, j]
        pp += sums[1, j]
    return pg, pp


@kernel
def squared_error(prediction: Block, reference: Block) -> float:
    """Return the sum of (p - g)^2."""
    rows, columns = prediction.shape
    sums = np.zeros(_STRIP)
    for row in range(rows):
        for start in range(0, columns, _STRIP):
            ps = prediction[row, start : min(start + _STRIP, columns)]
            gs = reference[row, start : min(start + _STRIP, columns)]
            for j in range(ps.size):
                d = np.float64(ps[j]) - np.float64(gs[j])
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
    """Return the sum of squared errors and the sum of the SSIM map of one band.

    ``treatment`` of the prediction: it is clamped to [first, second], multiplied by the third number and clamped to
    [fourth, fifth]. The error counts the first ``owned_rows`` rows (the rest belong to the next band), the SSIM map
    every full window. ``degrees`` divides the covariances: 48 for those of a sample, 49 for those of a population.

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
    sums = np.empty((10, _STRIDE))
    ring = np.empty((2 * WINDOW, _STRIDE))  # s and d of the last 7 rows
    s1, d1, s2, d2 = sums[0], sums[1], sums[2], sums[3]  # per column, over those rows
    s1_3, d1_3, s2_3, d2_3 = sums[4], sums[5], sums[6], sums[7]  # the same over 3 neighbouring columns
    errors, similarities = sums[8], sums[9]
    error = 0.0
    similarity = 0.0
    for strip in range(strips):
        start = width * strip // strips
        stop = width * (strip + 1) // strips
        inner = stop - start
        outer = inner + _MARGIN
        sums[:] = 0.0
        ring[:] = 0.0  # rows before the first count as zero: leaving the window, they take nothing away
        for row in range(rows):
            ss = ring[2 * (row % WINDOW)]
            ds = ring[2 * (row % WINDOW) + 1]
            xs = prediction[row, start : stop + _MARGIN]
            ys = reference[row, start : stop + _MARGIN]
            for j in range(outer):
                x = clamp(clamp(np.float64(xs[j]), low, high) * factor, final_low, final_high)
                y = np.float64(ys[j])
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
