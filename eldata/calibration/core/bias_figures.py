"""What the second pass over bias frames gives: colour bias, row noise and read noise, whether or not black is clipped.

Read noise has two estimators of one face (:class:`ReadNoiseSums`): by residuals, or by all values where the noise
reaches 0, so that a pixel's mean over the frames is not its level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from eldata.calibration.core.clipped_black import ClippedValues
from eldata.calibration.core.read_noise import read_noise_findings
from eldata.calibration.core.residuals import Residuals
from eldata.calibration.core.row_noise import LineMeans, colour_bias, row_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.read_noise import ProbabilityPlot, ReadFigures, ReadNoise
    from eldata.calibration.core.row_noise import ColourBias, LineSums, RowNoise


class ReadNoiseSums(Protocol):
    """Accumulates bias frames for an estimate of the read noise."""

    def add(self, mosaic: NDArray[np.uint16], sums_of_lines: LineSums) -> None:
        """Add a bias frame."""

    def solve(self, lines: LineMeans) -> FixedPattern:
        """Return what stays from frame to frame as it is without a clip, by what lines show, too."""

    def figures(self, bias: ColourBias) -> ReadFigures:
        """Return the figures, given the bias of the recorded means; after :meth:`solve`."""


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
    residuals: ResidualHistogram | None


class BiasSums:
    """Accumulates the bias frames that made a fixed pattern, for all of their figures.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self._lines = LineMeans(fixed)
        self._values: ReadNoiseSums = ClippedValues(fixed) if fixed.clips_at_black else Residuals(fixed)

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a bias frame."""
        self._values.add(mosaic, self._lines.add(mosaic))

    def fixed_pattern(self) -> FixedPattern:
        """Return what stays from frame to frame, as it is without a clip."""
        self._fixed = self._values.solve(self._lines)
        return self._fixed

    def figures(self, black_level_dn: Sequence[float]) -> BiasFigures:
        """Return the figures over these recorded black levels; after :meth:`fixed_pattern`.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern, or do not show their noise.
        """
        found = self._values.figures(colour_bias(self._lines, black_level_dn))
        findings = (*found.findings, *read_noise_findings(found.read, found.bias, self._fixed.summary))
        rows = row_noise(self._lines, found.read.response)
        return BiasFigures(found.bias, rows, found.read, found.plot, findings, found.residuals)
