"""Residuals of bias frames: each value less its pixel's own mean, the channel's drift and the row's offset, counted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._frames import groups_of_rows, sums_by_row
from eldata.calibration.core._residual_fit import CELLS_PER_SIGMA, ResidualHistogram
from eldata.calibration.core.read_noise import ReadFigures, probability_plot, read_noise
from eldata.calibration.core.row_noise import check_same_frames
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._rounding import LevelFractions
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.row_noise import ColourBias, LineMeans, LineSums

_FRACTIONS = 128  # of a DN, in which local levels are counted
_HALF = 8192  # cells on each side of 0


class Residuals:
    """Accumulates the residuals of the bias frames that made a fixed pattern.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self._fixed = fixed
        self._pixels = sums_by_row(~fixed.defects, fixed.pattern)
        self._added = 0
        sigma = math.sqrt(float(np.mean(fixed.temporal_variance_dn2)))
        step = round(fixed.frames * sigma / CELLS_PER_SIGMA)
        self._step = max(1, step - 1 + step % 2)  # odd, so that cell 0 is symmetric; in units of 1/n DN
        self._group = groups_of_rows(len(self._pixels))
        self._counts = np.zeros((int(self._group.max()) + 1, 2 * _HALF + 1), dtype=np.int64)
        self._squares = np.zeros(len(self._counts))  # of residuals and of offsets, in units of 1/n DN
        self._offset_squares = 0.0

    def add(self, mosaic: NDArray[np.uint16], sums_of_lines: LineSums) -> None:
        """Add a bias frame, with its sums by :func:`~eldata.calibration.core.row_noise.line_sums`."""
        from eldata.calibration.core._kernels import residual_histogram

        fixed = self._fixed
        sums, squares, _ = sums_of_lines
        level = sums.sum(axis=0) / np.maximum(self._pixels.sum(axis=0), 1)
        row = (sums - self._pixels * level).sum(axis=1) / np.maximum(self._pixels.sum(axis=1), 1)
        phases = np.arange(len(row)) % len(fixed.pattern)
        by_channel = row[:, None] + level
        of_offsets = (by_channel**2 * self._pixels).sum(axis=1)
        left = squares - 2 * (by_channel * sums).sum(axis=1) + of_offsets
        self._squares += np.bincount(self._group, left, minlength=len(self._squares))
        self._offset_squares += float(of_offsets.sum())
        offsets = np.rint(row[:, None] + level[fixed.pattern[phases]]).astype(np.int64)
        residual_histogram(mosaic, fixed.total_dn, fixed.defects, fixed.frames, offsets, self._step, self._counts)
        self._added += 1

    def histogram(self) -> ResidualHistogram:
        """Return the counts so far.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern, or black is too close to 0.
        """
        fixed, frames = self._fixed, self._fixed.frames
        check_same_frames(self._added, fixed)
        pixels = float(self._pixels.sum(axis=1).mean())
        if fixed.clips_at_black:
            raise DatasetError(
                f"the black level ({min(fixed.level_dn):.1f} DN) is too close to 0 for noise of "
                f"{math.sqrt(max(fixed.temporal_variance_dn2)):.1f} DN: much of it is clipped, and residuals do not "
                "show it; ClippedValues do"
            )
        return ResidualHistogram(
            self._counts.copy(),
            self._step / frames,
            frames,
            pixels,
            reach_dn=fixed.reach_dn,
            squares_dn2=self._squares / frames**2,
            fractions=self._fractions(pixels),
        )

    def solve(self, lines: LineMeans) -> FixedPattern:
        """Return what stays from frame to frame: as the first pass has it."""
        del lines
        return self._fixed

    def figures(self, bias: ColourBias) -> ReadFigures:
        """Return the figures, and the colour bias as it is."""
        residuals = self.histogram()
        read = read_noise(residuals)
        return ReadFigures(read, probability_plot(residuals, read), bias, residuals=residuals)

    def _fractions(self, row_pixels: float) -> LevelFractions:
        from eldata.calibration.core._kernels import channel_histograms
        from eldata.calibration.core._rounding import LevelFractions

        fixed, frames = self._fixed, self._fixed.frames
        channels = len(fixed.level_dn)
        remainders = np.zeros((len(self._counts), channels, frames), dtype=np.int64)
        of_pixels = np.empty(fixed.total_dn.shape, dtype=np.uint16)
        np.remainder(fixed.total_dn, frames, out=of_pixels, casting="unsafe")
        channel_histograms(of_pixels, fixed.defects, fixed.pattern, remainders)
        residuals = float(self._pixels.sum()) * frames
        pixel_variance = float(self._squares.sum()) / residuals / frames**2 / ((1 - 1 / frames) * (1 - 1 / row_pixels))
        offset_variance = self._offset_squares / residuals / frames**2 - pixel_variance * (1 - 1 / frames) / row_pixels
        levels = np.array(fixed.level_dn)[:, None] + fixed.summary.shading_dn.reshape(channels, -1)
        places = np.rint(levels % 1 * _FRACTIONS).astype(np.int64) % _FRACTIONS
        local = np.stack([np.bincount(of_channel, minlength=_FRACTIONS) for of_channel in places]) / places.shape[1]
        period = len(fixed.pattern)
        rows = np.stack([self._pixels[kind::period].sum(axis=0) for kind in range(period)]) / self._pixels.sum()
        return LevelFractions(remainders, local, np.array(fixed.summary.dsnu_dn), rows, offset_variance, pixel_variance)
