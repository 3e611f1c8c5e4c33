"""What bias frames that clip at black show: values by channel, and what pixels and rows share from frame to frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._frames import channels_of, checked_mosaic, classes_of_rows, sums_by_row
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.calibration.core.colour_bias import ChannelMeans
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.row_noise import LineMeans

    Values: TypeAlias = NDArray[np.float64]

_GROUPS = 64  # of rows
_REACH = 200  # standard deviations that are counted value by value
_CELLS_PER_SIGMA = 20
_CORE = 6  # standard deviations over the mean; beyond, cells grow
_GROWTH = 1.05
_LEAST_IN_TAIL = 20  # values in the outermost cell of the likelihood
_LEAST_CELLS = 4


class ClippedValues:
    """Counts the values of bias frames, for :func:`~eldata.calibration.core.clipped_black.clipped_fit`.

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
        height = len(fixed.total_dn)
        groups = max(1, min(_GROUPS, height // 4))
        self.group = np.arange(height) // 2 % groups  # as the kernel has it
        spread = math.sqrt(max(fixed.temporal_variance_dn2)) + max(fixed.summary.dsnu_dn)
        highest = min(65535, math.ceil(max(fixed.level_dn) + _REACH * max(spread, 0.5)))
        self.counts = np.zeros((groups, channels_of(fixed.pattern), highest + 1), dtype=np.int64)
        self.added = 0

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a bias frame."""
        from eldata.calibration.core._kernels import channel_histograms

        fixed = self.fixed
        height, width = fixed.total_dn.shape
        checked_mosaic(mosaic, (height, width), len(fixed.pattern))
        channel_histograms(mosaic, fixed.defects, fixed.pattern, self.counts)
        self.added += 1

    @property
    def zeros(self) -> Values:
        """Share of the values that are 0, by channel."""
        total = self.counts.sum(axis=0)
        return np.asarray(total[:, 0] / np.maximum(total.sum(axis=1), 1))


@dataclass(frozen=True, slots=True, eq=False)
class ClippedStatistics:
    """What the frames show, by group of rows.

    ``counts`` (groups, channels, cells) of values in cells that begin at ``starts``, of which the first is 0 alone;
    ``pixels`` (groups, channels); ``products`` (groups, channels) the sums over pixels of the product of deviations in
    two frames, on average over all two frames; ``rows`` (groups,) sums of the variance of rows' means over time, less
    what the pixels' noise puts there, and ``lines`` how many rows; ``drift_dn2`` variance of channels' means over time.
    """

    fixed: FixedPattern
    starts: NDArray[np.int64]
    counts: Values
    pixels: Values
    products: Values
    rows: Values
    lines: Values
    drift_dn2: float

    @classmethod
    def of(cls, values: ClippedValues, lines: LineMeans, means: ChannelMeans) -> ClippedStatistics:
        """Sum up the frames; arguments as of :func:`~eldata.calibration.core.clipped_black.clipped_fit`."""
        fixed, frames, counts = values.fixed, values.fixed.frames, values.counts
        groups, _, size = counts.shape
        each = np.arange(size, dtype=np.int64)
        number, sums, squares = (counts @ power for power in (np.ones_like(each), each, each**2))
        mean = sums.sum(axis=0) / number.sum(axis=0)
        by_frame = np.array(means.means_dn)
        drift = ((by_frame - by_frame.mean(axis=0)) ** 2).sum(axis=0)
        # Of the deviations' sum over frames, squared, the frames' own squares are taken off; both are of one mean, from
        # which drift moves the frames apart, to the sum 0.
        totals = sums_by_row(np.where(fixed.defects, 0, fixed.total_dn).astype(np.int64) ** 2, fixed.pattern)
        of_totals = np.stack([np.bincount(values.group, one, minlength=groups) for one in totals.T], axis=1)
        both = of_totals - 2 * frames * mean * sums + number * frames * mean**2
        own = squares - 2 * mean * sums + number * mean**2
        products = (both - own + number / frames * drift) / (frames * (frames - 1))

        pixels = lines.row_pixels.sum(axis=1)
        used = pixels > 0
        of_pixels = lines.squares / ((frames - 1) * float(np.maximum(pixels - 1, 0).sum()))
        kept = np.count_nonzero(used) - classes_of_rows(fixed.pattern)
        of_rows = (np.array(lines.rows_dn) ** 2).sum(axis=0) / (frames - 1) * np.count_nonzero(used) / kept
        of_rows = np.where(used, of_rows - of_pixels / np.maximum(pixels, 1), 0.0)
        starts = _cell_starts(counts.sum(axis=(0, 1)), float(mean.max()), math.sqrt(max(fixed.temporal_variance_dn2)))
        return cls(
            fixed,
            starts,
            np.add.reduceat(counts, starts, axis=2).astype(np.float64),
            number / frames,
            products,
            np.bincount(values.group, of_rows, minlength=groups).astype(np.float64),
            np.bincount(values.group, used, minlength=groups).astype(np.float64),
            max(float(np.mean(drift / (frames - 1) - np.mean(means.row_variances_dn2, axis=0))), 0.0),
        )


def _cell_starts(counts: NDArray[np.int64], mean: float, sigma: float) -> NDArray[np.int64]:
    """Return where cells begin: 0 alone, then some twentieths of the standard deviation, and ever wider far out."""
    width = max(1.0, sigma / _CELLS_PER_SIGMA)
    starts = [0, 1]
    while starts[-1] + round(width) < len(counts):
        starts.append(starts[-1] + round(width))
        width *= _GROWTH if starts[-1] > mean + _CORE * sigma else 1.0
    tail = np.cumsum(counts[::-1])[::-1]
    kept = [start for start in starts if start <= 1 or tail[start] >= _LEAST_IN_TAIL]
    if len(kept) < _LEAST_CELLS:
        raise DatasetError(
            f"next to all values of the bias frames are 0, and the others lie in {len(kept) - 1} cells: they do not "
            "show a distribution; leave the bias frames out: flats alone still give K"
        )
    return np.array(kept, dtype=np.int64)
