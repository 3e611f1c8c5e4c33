"""Compiled loops over one frame. All sums are of integers: exact, and the same in any order of frames.

``residual`` below is ``n x - sum over frames of x``: n times the deviation from the pixel's own mean, an integer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Mask, Mosaic


@kernel
def channel_histograms(mosaic: Mosaic, defects: Mask, pattern: Counts, counts: Counts) -> None:
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
    mosaic: Mosaic,
    total: NDArray[np.uint32],
    defects: Mask,
    frames: int,
    pattern: Counts,
    row_sums: Counts,
    row_squares: Counts,
    column_sums: Counts,
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
    mosaic: Mosaic, total: NDArray[np.uint32], defects: Mask, frames: int, offsets: Counts, step: int, counts: Counts
) -> None:
    """Count the residuals less ``offsets`` (row, column phase) in cells of an odd ``step``, by group of rows.

    Cell j of ``counts`` (group, cells) is centred on (j - cells // 2) step; the first and last take all beyond.
    """
    period = offsets.shape[1]
    groups, last = counts.shape[0], counts.shape[1] - 1
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
