"""Bias frames that clip at black: their figures, as of those that do not; and what cannot be had.

The fit takes all values of a channel, whatever is left of them above 0 (:mod:`eldata.calibration.core._clipped_fit`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._clipped_fit import ClippedEquations
from eldata.calibration.core._clipped_noise import ClippedStatistics
from eldata.calibration.core._frames import channels_of, groups_of_rows
from eldata.calibration.core.findings import BEHIND_CLIP, CLIPPED
from eldata.calibration.core.read_noise import ReadFigures
from eldata.calibration.core.row_noise import ColourBias, check_same_frames

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.calibration.core._clipped_fit import ClippedFit
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.row_noise import LineMeans, LineSums

    Values: TypeAlias = NDArray[np.float64]

MOST_ZEROS = 0.75
"""Share of a channel's values that may be 0: of more, what is left is a tail, and which one is not known."""

_REACH = 200  # standard deviations that are counted value by value


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
    added
        Number of frames so far.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self.fixed = fixed
        groups = int(groups_of_rows(len(fixed.total_dn)).max()) + 1
        spread = math.sqrt(max(fixed.temporal_variance_dn2)) + max(fixed.summary.dsnu_dn)
        highest = min(65535, math.ceil(max(fixed.level_dn) + _REACH * max(spread, 0.5)))
        self.counts = np.zeros((groups, channels_of(fixed.pattern), highest + 1), dtype=np.int64)
        self.added = 0

    def add(self, mosaic: NDArray[np.uint16], sums_of_lines: LineSums) -> None:
        """Add a bias frame; what its lines show is in the means of all."""
        del sums_of_lines
        from eldata.calibration.core._kernels import channel_histograms

        channel_histograms(mosaic, self.fixed.defects, self.fixed.pattern, self.counts)
        self.added += 1

    @property
    def zeros(self) -> Values:
        """Share of the values that are 0, by channel."""
        total = self.counts.sum(axis=0)
        return np.asarray(total[:, 0] / np.maximum(total.sum(axis=1), 1))

    def solve(self, lines: LineMeans) -> FixedPattern:
        """Fit the noise behind the clip, and return what stays from frame to frame, as it is there.

        Parameters
        ----------
        lines
            Of the same frames.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern, or too few values are above 0.
        """
        check_same_frames(self.added, self.fixed)
        self._fit = ClippedEquations(ClippedStatistics.of(self.counts, lines)).solved()
        return self._fit.fixed

    def figures(self, bias: ColourBias) -> ReadFigures:
        """Return the figures that :meth:`solve` has found, given the bias of the recorded means."""
        behind = _colour_bias(self._fit, bias, self.fixed)
        findings = tuple(_findings(self._fit, float(self.zeros.max()), behind))
        return ReadFigures(self._fit.read, self._fit.plot, behind, findings)


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
