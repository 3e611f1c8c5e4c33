"""What the second pass over bias frames gives: colour bias, row noise and read noise, whether or not black is clipped.

Read noise has two estimators of one face: by residuals (each value less its pixel's own mean,
the channel's drift and the row's offset), or, where the noise reaches 0, so that a pixel's mean over the frames is not
its level, by all values of a channel that are left above (:mod:`eldata.calibration.core._clipped_fit`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._clipped_fit import ClippedEquations
from eldata.calibration.core._clipped_noise import ClippedStatistics
from eldata.calibration.core._frames import channels_of, groups_of_rows, sums_by_row
from eldata.calibration.core._residual_fit import CELLS_PER_SIGMA, ResidualHistogram
from eldata.calibration.core.findings import BEHIND_CLIP, CLIPPED, Finding
from eldata.calibration.core.read_noise import probability_plot, read_noise, read_noise_findings
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
    from collections.abc import Iterator, Sequence

    from eldata.calibration.core._clipped_fit import ClippedFit
    from eldata.calibration.core._frames import Mosaic, Values
    from eldata.calibration.core._rounding import LevelFractions
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.read_noise import ProbabilityPlot, ReadNoise
    from eldata.calibration.core.row_noise import LineSums, RowNoise


_FRACTIONS = 128  # of a DN, in which local levels are counted
_HALF = 8192  # cells on each side of 0

MOST_ZEROS = 0.75
"""Share of a channel's values that may be 0: of more, what is left is a tail, and which one is not known."""

_REACH = 200  # standard deviations that are counted value by value


@dataclass(frozen=True, slots=True, eq=False)
class BiasFigures:
    """The figures of bias frames.

    Attributes
    ----------
    bias, rows, read
        Colour bias, row (and column) noise, read noise.
    plot
        Quantiles for the probability plots.
    findings
        What the estimates show of their own assumptions.
    residuals
        What the read noise is of, if not of clipped values.
    """

    bias: ColourBias
    rows: RowNoise
    read: ReadNoise
    plot: ProbabilityPlot
    findings: tuple[Finding, ...]
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
        self._values: ClippedValues | Residuals = ClippedValues(fixed) if fixed.clips_at_black else Residuals(fixed)

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        self._values.add(mosaic, self._lines.add(mosaic))

    def fixed_pattern(self) -> FixedPattern:
        """Return what stays from frame to frame, as it is without a clip.

        Raises
        ------
        DatasetError
            If black is clipped, and too few values are above 0.
        """
        if isinstance(self._values, ClippedValues):
            self._fit = self._values.solved(self._lines)
            self._fixed = self._fit.fixed
        return self._fixed

    def figures(self, black_level_dn: Sequence[float]) -> BiasFigures:
        """Return the figures over these recorded black levels; after :meth:`fixed_pattern`.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern, or do not show their noise.
        """
        lines, values = self._lines, self._values
        bias = colour_bias(lines, black_level_dn)
        residuals, findings = None, list[Finding]()
        if isinstance(values, Residuals):
            residuals = values.histogram()
            read = read_noise(residuals)
            plot = probability_plot(residuals, read)
        else:
            read, plot = self._fit.read, self._fit.plot
            bias = _colour_bias(self._fit, bias, values.fixed)
            findings += _findings(self._fit, float(values.zeros.max()), bias)
        rows = row_noise(lines, read.response)
        findings += read_noise_findings(read, bias, self._fixed.summary)
        return BiasFigures(bias, rows, read, plot, tuple(findings), residuals)


# --- black above 0 ----------------------------------------------------------------------------------------------------


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

    def add(self, mosaic: Mosaic, sums_of_lines: LineSums) -> None:
        """Add a bias frame, with its sums by :func:`~eldata.calibration.core.row_noise.line_sums`."""
        from eldata.calibration.core._kernels import residual_histogram

        fixed = self._fixed
        sums, squares, _ = sums_of_lines
        level, row = levels_and_lines(sums, self._pixels)
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


# --- black that is clipped --------------------------------------------------------------------------------------------


class ClippedValues:
    """Counts the values of bias frames that clip at 0.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.

    Attributes
    ----------
    counts
        (groups of rows, channels, values): sound pixels; the last value takes all beyond.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self.fixed = fixed
        groups = int(groups_of_rows(len(fixed.total_dn)).max()) + 1
        spread = math.sqrt(max(fixed.temporal_variance_dn2)) + max(fixed.summary.dsnu_dn)
        highest = min(65535, math.ceil(max(fixed.level_dn) + _REACH * max(spread, 0.5)))
        self.counts = np.zeros((groups, channels_of(fixed.pattern), highest + 1), dtype=np.int64)

    def add(self, mosaic: Mosaic, sums_of_lines: LineSums) -> None:
        """Add a bias frame; what its lines show is in the means of all."""
        del sums_of_lines
        from eldata.calibration.core._kernels import channel_histograms

        channel_histograms(mosaic, self.fixed.defects, self.fixed.pattern, self.counts)

    @property
    def zeros(self) -> Values:
        """Share of the values that are 0, by channel."""
        total = self.counts.sum(axis=0)
        return np.asarray(total[:, 0] / np.maximum(total.sum(axis=1), 1))

    def solved(self, lines: LineMeans) -> ClippedFit:
        """Return the noise behind the clip, of the same frames as these lines."""
        return ClippedEquations(ClippedStatistics.of(self.counts, lines)).solved()


def _colour_bias(fit: ClippedFit, recorded: ColourBias, fixed: FixedPattern) -> ColourBias:
    """Return the fitted levels, which lie below the recorded means (of ``fixed``), over the recorded black."""
    black = np.array(fixed.level_dn) - recorded.bias_dn  # up to drift, which the mean over frames holds as well
    deviations = (recorded.frame_bias_dn - np.array(recorded.bias_dn)) / fit.recorded_slope
    # What frames drift by, beyond what their pixels and rows scatter by, is not in the scatter between groups of rows.
    by_rows = np.array(recorded.row_error_dn) ** 2 * recorded.frames / fit.recorded_slope**2
    drift = np.maximum((deviations**2).sum(axis=0) / max(recorded.frames - 1, 1) - by_rows, 0.0)
    errors = np.sqrt(fit.level_variances_dn2 + drift / recorded.frames)
    bias = np.array(fit.fixed.level_dn) - black
    return ColourBias(
        bias_dn=tuple(bias.tolist()),
        standard_error_dn=tuple(errors.tolist()),
        row_error_dn=tuple((np.array(recorded.row_error_dn) / fit.recorded_slope).tolist()),
        frame_bias_dn=bias + deviations,
        frames=recorded.frames,
    )


def _findings(fit: ClippedFit, zeros: float, bias: ColourBias) -> Iterator[Finding]:
    """Yield what the clip leaves of the figures."""
    read = fit.read
    if zeros > MOST_ZEROS:
        yield CLIPPED.seen(
            zeros,
            MOST_ZEROS,
            f"{zeros:.0%} of the values of a channel are 0, so that only a tail of the noise is recorded: neither its "
            "shape nor the level that it belongs to is known from that; use raw files that keep the black level, or "
            "state this camera's noise from another source",
        ).of("withheld", CLIPPED.figures)
        return
    yield CLIPPED.seen(
        zeros,
        0.0,
        f"the camera clips at black: {zeros:.1%} of the values are 0. The noise is fitted to what lies above, taken "
        "to be symmetric, with a normal pattern; light, dark current, unlike pixels and lopsided noise cannot be told "
        "from the clip and were not looked for",
    )
    # As standard errors: with 1/sqrt(3) of it, that a pattern as far from normal as Laplace's makes lies within 1.96.
    allowed = np.abs(fit.if_laplace) / math.sqrt(3)
    shape, scale, level = float(allowed[0]), float(allowed[1]), float(allowed[2:].max())
    errors = max(shape / read.tukey_lambda_error, scale * read.sigma_tl_dn / read.sigma_tl_error_dn)
    if errors > 1:
        yield BEHIND_CLIP.seen(
            errors,
            1.0,
            "the pixels' own levels, which cannot be taken off below the clip, are not small beside the noise, and "
            f"were taken to be normal: if their distribution is another, lambda is off by some {shape:.2g} and "
            f"sigma_TL by {scale:.1%}",
        ).of("wider", ("read noise",), max(shape, scale))
    if level > min(bias.standard_error_dn):
        yield BEHIND_CLIP.seen(
            level,
            min(bias.standard_error_dn),
            f"the level below the clip follows from the same distribution: it may be off by {level:.2g} DN",
        ).of("wider", ("colour bias",), level)
