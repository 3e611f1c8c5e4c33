"""What the paper takes from single frames: probability plots, K from a flat's own variance, the power spectrum.

The estimate takes each pixel's own mean off first (:mod:`eldata.calibration.core.read_noise`), so its R^2 is another
number: non-uniformity, which is not noise, takes part in the published one. Both follow the extreme tails, since a
probability plot weighs a residual by its square; defects are left out of both, or a handful of hot pixels would be all
they show. Likewise the pairs of flats (:mod:`eldata.calibration.core.photon_transfer`) free K of what stays. So both
are there for comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.core._frames import sites, sums_by_row
from eldata.calibration.core.photon_transfer import (
    CLIPPED_SHARE,
    FlatSums,
    PhotonTransfer,
    PhotonTransferLine,
    join_lines,
    straight_line,
)
from eldata.calibration.core.row_noise import levels_and_lines
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Mosaic, Plane
    from eldata.calibration.core.defects import FixedPattern

_UNITS = 256  # of a DN: rows' means are rounded to them
_CELLS_PER_SIGMA = 20
_HALF = 8192  # cells on each side of 0: 400 standard deviations


@dataclass(frozen=True, slots=True)
class SingleFramePlot:
    """Coefficients of determination of one frame's probability plots.

    Attributes
    ----------
    r_squared_tl, r_squared_gauss
        Against Tukey lambda at the shape that fits best (PPCC), and against the normal distribution.
    tukey_lambda
        That shape.
    """

    r_squared_tl: float
    r_squared_gauss: float
    tukey_lambda: float


def single_frame_plot(mosaic: Mosaic, fixed: FixedPattern) -> SingleFramePlot:
    """Return R^2 of the probability plots of a bias frame's sound pixels less their channels' and their rows' means."""
    from eldata.calibration.core._kernels import residual_histogram
    from eldata.calibration.core._tukey_lambda import correlation, normal_correlation
    from eldata.calibration.core.read_noise import ppcc

    sound = ~fixed.defects
    sums, pixels = sums_by_row(mosaic * sound, fixed.pattern), sums_by_row(sound, fixed.pattern)
    level, row = levels_and_lines(sums, pixels)
    phases = np.arange(len(row)) % len(fixed.pattern)
    offsets = np.rint(_UNITS * (row[:, None] + level[fixed.pattern[phases]])).astype(np.int64)
    sigma = math.sqrt(float(np.mean(fixed.temporal_variance_dn2)) + max(fixed.summary.dsnu_dn) ** 2)
    step = max(1, round(_UNITS * sigma / _CELLS_PER_SIGMA)) | 1  # odd: cell 0 is symmetric
    of_group = np.zeros((1, 2 * _HALF + 1), dtype=np.int64)
    nothing = np.broadcast_to(np.uint32(0), mosaic.shape)
    residual_histogram(mosaic, nothing, fixed.defects, _UNITS, offsets, step, of_group)
    counts = of_group[0]
    filled = np.flatnonzero(counts)
    values = np.asarray((filled - _HALF) * (step / _UNITS), dtype=np.float64)
    number = counts[filled].astype(np.float64)
    shape, _, _ = ppcc(values, number)
    return SingleFramePlot(
        r_squared_tl=correlation(values, number, shape)[0] ** 2,
        r_squared_gauss=normal_correlation(values, number)[0] ** 2,
        tukey_lambda=shape,
    )


class FlatFrames(FlatSums):
    """Accumulates single flat frames for :func:`spatial_photon_transfer`.

    Parameters as of :class:`~eldata.calibration.core.photon_transfer.FlatPairs`.
    """

    def _make_room(self) -> None:
        self.points: list[list[tuple[float, float]]] = [[] for _ in self.black]
        """Median over black and variance of each frame that is neither clipped nor saturated, by channel."""

    def add(self, mosaic: Mosaic) -> None:
        """Add a flat frame."""
        from eldata.calibration.core._kernels import channel_histograms

        counts = np.zeros((1, self.channels, 65536), dtype=np.int64)
        channel_histograms(mosaic, self._check(mosaic), self.pattern, counts)
        values = np.arange(65536)  # integers: exact, and no BLAS, whose threads would wait in vain
        for channel, histogram in enumerate(counts[0]):
            total = int(histogram.sum())
            bad = int(histogram[: self.floor_dn + 1].sum()) + int(histogram[math.ceil(self.limit_dn) :].sum())
            if total < 2 or bad > CLIPPED_SHARE * 0.01 * total:
                continue
            median = float(np.searchsorted(np.cumsum(histogram), total / 2))
            first, second = int(histogram @ values), int(histogram @ values**2)
            variance = (second - first * first / total) / (total - 1)
            self.points[channel].append((median - float(self.black[channel]), variance))


def spatial_photon_transfer(flats: FlatFrames) -> PhotonTransfer:
    """Estimate K as published: ordinary least squares of each frame's variance over its median.

    For comparison only: PRNU of p adds ``(p signal)^2``, and shading more. The standard errors come from the scatter
    around the line and allow for neither.

    Raises
    ------
    DatasetError
        If a channel has fewer than three usable frames.
    """
    return join_lines(
        tuple(_plain_line(points, channel) for channel, points in enumerate(flats.points)),
        flats.frames,
        1 - sum(map(len, flats.points)) / max(1, flats.frames * len(flats.points)),
    )


def _plain_line(points: Sequence[tuple[float, float]], channel: int) -> PhotonTransferLine:
    table: NDArray[Any] = np.array(points, dtype=np.float64).reshape(-1, 2)
    signal, variance = table[:, 0], table[:, 1]
    if len(signal) < 3 or not np.ptp(signal) > 0:
        raise DatasetError(
            f"channel {channel} has {counted(len(signal), 'usable flat frame')} and the spatial method needs three of "
            "different brightness: take flats at four exposures or more, from a tenth to nine tenths of the range"
        )
    even = np.ones(len(signal))
    slope, intercept, scales = straight_line(signal, variance, even, even)
    scatter = float(((variance - slope * signal - intercept) ** 2).sum()) / (len(signal) - 2)
    return PhotonTransferLine(
        gain_dn_per_e=slope,
        gain_error=max(math.sqrt(scatter * scales[0]), 1e-300),
        intercept_dn2=intercept,
        intercept_error=math.sqrt(scatter * scales[1]),
        chi2_per_dof=math.nan,
        signal_dn=signal,
        variance_dn2=variance,
        variance_error_dn2=np.full(len(signal), math.sqrt(scatter)),
    )


# --- spectrum ---------------------------------------------------------------------------------------------------------

TILE = 256
_MOST_TILES = 64


def power_spectrum(mosaic: Mosaic, fixed: FixedPattern) -> Plane:
    """Return the centred power spectrum of a bias frame less its channels' means, DN^2 per pixel.

    The average over tiles of 256 x 256 pixels (up to 64 of them, evenly spread): white noise of variance s^2 gives s^2
    throughout. Noise that a row shares lies on the column of horizontal frequency 0, that of a column on the row of
    vertical frequency 0. Defects count as their channel's mean; fixed patterns stay in.

    Raises
    ------
    DatasetError
        If the frame is smaller than a tile.
    """
    height, width = mosaic.shape
    if height < TILE or width < TILE:
        raise DatasetError(f"the spectrum needs a frame of {TILE} x {TILE} pixels or more; found {height} x {width}")
    down, across = height // TILE, width // TILE
    step = max(1, round((down * across / _MOST_TILES) ** 0.5))
    power = np.zeros((TILE, TILE))
    tiles = 0
    for y in range(0, down, step):
        for x in range(0, across, step):
            place = slice(y * TILE, (y + 1) * TILE), slice(x * TILE, (x + 1) * TILE)
            tile = mosaic[place].astype(np.float64)
            tile[fixed.defects[place]] = np.nan
            for within, _ in sites(fixed.pattern):  # by site, not by channel: the two greens of Bayer may differ
                tile[within] -= np.nanmean(tile[within])
            power += np.abs(np.fft.fft2(np.nan_to_num(tile))) ** 2
            tiles += 1
    spectrum: Plane = np.fft.fftshift(power / (tiles * TILE * TILE)).astype(np.float32)
    return spectrum
