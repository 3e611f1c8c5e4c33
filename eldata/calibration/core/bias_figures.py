"""What the second pass over bias frames gives: colour bias, row noise and read noise.

Read noise is that of residuals: each value less its pixel's own mean, the channel's drift and the row's offset. Where
the noise reaches a floor, at which recorded values end, a pixel's mean is not its level, and no noise is given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.core._frames import groups_of_rows, sums_by_row
from eldata.calibration.core._residual_fit import CELLS_PER_SIGMA, ResidualHistogram
from eldata.calibration.core.findings import CLIPPED, Finding
from eldata.calibration.core.read_noise import probability_plot, read_noise
from eldata.calibration.core.row_noise import (
    ColourBias,
    LineMeans,
    check_same_frames,
    colour_bias,
    levels_and_lines,
    row_noise,
)
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Mosaic
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.read_noise import ProbabilityPlot, ReadNoise
    from eldata.calibration.core.row_noise import LineSums, RowNoise


_HALF = 8192  # cells on each side of 0


@dataclass(frozen=True, slots=True, eq=False)
class BiasFigures:
    """The figures of bias frames.

    Attributes
    ----------
    bias, rows
        Colour bias, row (and column) noise.
    findings
        That values end at a floor.
    read
        Read noise; ``None`` where values end at a floor.
    plot
        Quantiles for the probability plots.
    residuals
        What the read noise is of.
    """

    bias: ColourBias
    rows: RowNoise
    findings: tuple[Finding, ...]
    read: ReadNoise | None = None
    plot: ProbabilityPlot | None = None
    residuals: ResidualHistogram | None = None


class BiasSums:
    """Accumulates the bias frames that made a fixed pattern, for all of their figures.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self._fixed, self._lines = fixed, LineMeans(fixed)
        self._residuals = None if fixed.clips_at_black else Residuals(fixed)
        self._at_floor = 0

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        sums = self._lines.add(mosaic)
        if self._residuals is not None:
            self._residuals.add(mosaic, sums)
        else:
            self._at_floor += int(np.count_nonzero(mosaic <= (self._fixed.floor_dn or 0)))

    def figures(self, black_level_dn: Sequence[float]) -> BiasFigures:
        """Return the figures over these recorded black levels.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern, or do not show their noise.
        """
        rows = row_noise(self._lines)
        bias = colour_bias(self._lines, rows, black_level_dn)
        if self._residuals is None:
            return BiasFigures(bias, rows, (self._clipped(),))
        residuals = self._residuals.histogram()
        read = read_noise(residuals)
        plot = probability_plot(residuals, read)
        return BiasFigures(bias, rows, (), read, plot, residuals)

    def _clipped(self) -> Finding:
        """Return that values end at the floor, so that the noise below is gone."""
        share = self._at_floor / (self._fixed.frames * self._fixed.total_dn.size)
        seen = CLIPPED.seen(
            share,
            0.0,
            f"values end at {self._fixed.floor_dn} DN, where {100 * share:.2g} % of the bias frames' values lie: what "
            "the noise has below, if anything, is gone, and with it its shape, its scale and the level that it belongs "
            "to; use raw files that keep the black level (converters and some raw modes take it off), or state this "
            "camera's noise from another source",
        )
        return seen.of("withheld", CLIPPED.figures)


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
        self._squares = np.zeros(len(self._counts))  # of residuals, in units of 1/n DN

    def add(self, mosaic: Mosaic, sums_of_lines: LineSums) -> None:
        """Add a bias frame, with its sums by :func:`~eldata.calibration.core.row_noise.line_sums`."""
        from eldata.calibration.core._kernels import residual_histogram

        fixed = self._fixed
        sums, squares, _ = sums_of_lines
        level, row = levels_and_lines(sums, self._pixels)
        phases = np.arange(len(row)) % len(fixed.pattern)
        by_channel = row[:, None] + level
        left = squares - 2 * (by_channel * sums).sum(axis=1) + (by_channel**2 * self._pixels).sum(axis=1)
        self._squares += np.bincount(self._group, left, minlength=len(self._squares))
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
        if fixed.clips_at_black:
            raise DatasetError(
                f"the black level ({min(fixed.level_dn):.1f} DN) is too close to {fixed.floor_dn} DN for noise of "
                f"{math.sqrt(max(fixed.temporal_variance_dn2)):.1f} DN: much of it is clipped, and residuals do not "
                "show it"
            )
        return ResidualHistogram(
            self._counts.copy(),
            self._step / frames,
            frames,
            float(self._pixels.sum(axis=1).mean()),
            is_cut=fixed.floor_dn is not None,
            squares_dn2=None if fixed.floor_dn is not None else self._squares / frames**2,
            level_waves=self._level_waves(),
        )

    def _level_waves(self) -> NDArray[np.complexfloating[Any, Any]]:
        """Return by channel the mean of exp(2 pi i mean level)."""
        from eldata.calibration.core._kernels import channel_histograms

        fixed, frames = self._fixed, self._fixed.frames
        remainders = np.zeros((1, len(fixed.level_dn), frames), dtype=np.int64)
        of_pixels = np.empty(fixed.total_dn.shape, dtype=np.uint16)
        np.remainder(fixed.total_dn, frames, out=of_pixels, casting="unsafe")
        channel_histograms(of_pixels, fixed.defects, fixed.pattern, remainders)
        turns = np.exp(2j * math.pi * np.arange(frames) / frames)
        return np.asarray(remainders[0] @ turns / np.maximum(remainders[0].sum(axis=1), 1))
