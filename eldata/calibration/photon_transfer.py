"""System gain K from flat-field frames: the slope of the photon transfer line ``Var(D) = K (K I) + Var(N_o)``.

Two methods. ``pairs`` is the one to use: the variance is temporal, half that of the difference of two equal flats, so
that everything that stays (fixed pattern, PRNU, shading) cancels. ``spatial`` is the published one, the variance inside
of single frames over their median; it takes PRNU and shading, which grow with the square of the signal, for shot noise.

The intercept is free and never used as read noise: it also holds row noise, quantisation and black-level errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration._frames import FrameSums, checked_black_level
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import Cfa

_LEVELS = 512  # from black to saturation
_SEGMENT = 96  # mosaic columns: whole periods of Bayer and of X-Trans
_CLIPPED_SHARE = 0.01  # of a level's segments; more, and the level is left out
_MARGIN = 0.02  # of the range from black to white


@dataclass(frozen=True, slots=True, eq=False)
class PhotonTransferLine:
    """The line of one channel.

    Attributes
    ----------
    gain_dn_per_e, gain_error
        Slope K in DN/e- and its standard error.
    intercept_dn2, intercept_error
        Variance at no light and its standard error, DN^2; not the read noise.
    chi2_per_dof
        About 1 where the line and the errors of the points hold; nan with two points.
    signal_dn, variance_dn2, variance_error_dn2
        The points: mean over black, variance, its standard error.
    """

    gain_dn_per_e: float
    gain_error: float
    intercept_dn2: float
    intercept_error: float
    chi2_per_dof: float
    signal_dn: NDArray[np.float64] = field(repr=False)
    variance_dn2: NDArray[np.float64] = field(repr=False)
    variance_error_dn2: NDArray[np.float64] = field(repr=False)

    def variance_at(self, signal_dn: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the line's variance at these signals, DN^2."""
        return self.gain_dn_per_e * signal_dn + self.intercept_dn2

    def pooled(self, levels: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the points pooled to at most ``levels``: weighted means of neighbours, which stay on a line."""
        order = np.argsort(self.signal_dn, kind="stable")
        groups = np.array_split(order, min(levels, order.size))
        weights = [self.variance_error_dn2[group] ** -2.0 for group in groups]
        signal, variance = (
            np.array([np.average(values[group], weights=weight) for group, weight in zip(groups, weights, strict=True)])
            for values in (self.signal_dn, self.variance_dn2)
        )
        return signal, variance, np.array([weight.sum() ** -0.5 for weight in weights])


@dataclass(frozen=True, slots=True, eq=False)
class PhotonTransfer:
    """System gain K.

    Attributes
    ----------
    gain_dn_per_e, gain_error
        K of all channels together, DN/e-, and its standard error: one slope, an intercept per channel.
    agreement_chi2_per_dof
        Of the channels' own K around it; far above 1, the channels differ or the flats are not what they should be.
    channels
        The line of each CFA channel.
    frames
        Flat frames that went in.
    left_out
        Share of the measurements that clipping or saturation excluded.
    """

    gain_dn_per_e: float
    gain_error: float
    agreement_chi2_per_dof: float
    channels: tuple[PhotonTransferLine, ...]
    frames: int
    left_out: float


class _Flats(FrameSums):
    """Sums of flat frames; parameters as :class:`FlatPairs`."""

    def __init__(
        self,
        cfa: Cfa,
        black_level_dn: Sequence[float],
        white_level_dn: float,
        *,
        defects: NDArray[np.bool_] | None = None,
        margin: float = _MARGIN,
    ) -> None:
        super().__init__(cfa, defects)
        self._black = checked_black_level(black_level_dn, self.channels)
        self._limit = _saturation_dn(self._black, white_level_dn, margin)
        self._make_room()

    def _make_room(self) -> None:
        """Set up what the frames are added to, if anything."""


class FlatPairs(_Flats):
    """Accumulates pairs of equal flat frames, of any number of levels, for :func:`photon_transfer`.

    Parameters
    ----------
    cfa, black_level_dn, white_level_dn
        As in :class:`eldata.records.Sensor`; measured levels are better than recorded ones.
    defects
        (H, W) True where a pixel is not to be used.
    margin
        Pixels within this share of the range below white count as saturated.
    """

    def _make_room(self) -> None:
        self._level_dn = (self._limit - float(self._black.min())) / _LEVELS
        self._segments, self._clipped = np.zeros((2, self.channels, _LEVELS), dtype=np.int64)
        self._freedom, self._variance, self._mean = np.zeros((3, self.channels, _LEVELS))

    def add(self, first: NDArray[np.uint16], second: NDArray[np.uint16]) -> None:
        """Add two frames of the same scene, exposure and ISO; use each frame in one pair only.

        A slow drift of the light between the two is harmless: each segment of a row is taken about its own difference.
        """
        from eldata.calibration._kernels import pair_segments

        self._check(first)
        defects = self._check(second)
        if first.shape[1] < _SEGMENT:
            raise ArgumentError(f"flat frames must be {_SEGMENT} pixels wide or more; found {first.shape[1]}")
        pair_segments(
            first,
            second,
            defects,
            self.pattern,
            self._black,
            self._limit,
            _SEGMENT,
            self._level_dn,
            self._segments,
            self._clipped,
            self._freedom,
            self._variance,
            self._mean,
        )

    @property
    def left_out(self) -> float:
        """Share of the measurements in levels that are left out, clipped segments included."""
        total = int(self._segments.sum())
        kept = np.where(self._usable, self._segments - self._clipped, 0).sum()
        return 1 - float(kept) / total if total else 0.0

    @property
    def _usable(self) -> NDArray[np.bool_]:
        usable: NDArray[np.bool_] = (self._freedom > 0) & (self._clipped <= _CLIPPED_SHARE * self._segments)
        return usable

    def points(self, channel: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return signal (DN over black), variance (DN^2) and degrees of freedom of a channel's usable levels."""
        chosen = self._usable[channel]
        freedom = self._freedom[channel, chosen]
        return self._mean[channel, chosen] / freedom, self._variance[channel, chosen] / freedom, freedom


def photon_transfer(flats: FlatPairs) -> PhotonTransfer:
    """Estimate K by weighted least squares of the temporal variance over the mean (equation "photon-transfer").

    Per segment of a row and channel, ``s^2 = Var(A - B) / 2`` about the segment's own mean difference and
    ``mean = (A + B) / 2 - black``; segments pool by level. So shading inside a frame gives levels, and drift, row
    noise and flicker between the frames of a pair do not enter. The weights are
    ``1 / Var(s^2)``, ``Var(s^2) = (2 sigma^4 + K^3 mean / 2) / nu`` with nu degrees of freedom and sigma^2 from the
    fitted line, repeated until it stays; the second term is the fourth cumulant of shot noise.

    Raises
    ------
    DatasetError
        If a channel has fewer than two usable levels, or the slope is not positive.
    """
    if flats.frames == 0:
        raise DatasetError("no flat frames were given: take pairs of equal flats at several exposures")
    lines = tuple(_weighted_line(*flats.points(channel), channel) for channel in range(flats.channels))
    return _joined(lines, flats.frames, flats.left_out)


def _weighted_line(
    signal: NDArray[np.float64], variance: NDArray[np.float64], freedom: NDArray[np.float64], channel: int
) -> PhotonTransferLine:
    if len(signal) < 2 or not np.ptp(signal) > 0:
        raise DatasetError(
            f"channel {channel} has {len(signal)} usable level(s) and a line needs two: the flats are saturated, "
            "clipped or all of one brightness. Take pairs at four exposures or more, from a tenth to nine "
            "tenths of the range"
        )
    spread = np.maximum(variance, 1e-12)
    error2 = 2 * spread**2 / freedom
    gain = intercept = math.nan
    for _ in range(50):
        before = gain
        gain, intercept, covariance = _line(signal, variance, error2)
        expected = np.maximum(gain * signal + intercept, 0.05 * spread)
        error2 = (2 * expected**2 + 0.5 * max(gain, 0.0) ** 3 * np.maximum(signal, 0.0)) / freedom
        if abs(gain - before) <= 1e-10 * abs(gain):
            break
    if not gain > 0:
        raise DatasetError(
            f"the variance of channel {channel} does not grow with its signal (slope {gain:.3g}): these are not pairs "
            "of flats at different exposures, or the camera has filtered them"
        )
    residuals = (variance - gain * signal - intercept) ** 2 / error2
    return PhotonTransferLine(
        gain_dn_per_e=gain,
        gain_error=math.sqrt(covariance[0]),
        intercept_dn2=intercept,
        intercept_error=math.sqrt(covariance[1]),
        chi2_per_dof=float(residuals.sum()) / (len(signal) - 2) if len(signal) > 2 else math.nan,
        signal_dn=signal,
        variance_dn2=variance,
        variance_error_dn2=np.sqrt(error2),
    )


def _line(
    x: NDArray[np.float64], y: NDArray[np.float64], error2: NDArray[np.float64]
) -> tuple[float, float, tuple[float, float]]:
    """Return slope, intercept and the variances of both."""
    weight = 1 / error2
    total = float(weight.sum())
    centre = float(weight @ x) / total
    deviation = x - centre
    lever = float(weight @ deviation**2)
    slope = float(weight @ (deviation * y)) / lever
    intercept = float(weight @ y) / total - slope * centre
    return slope, intercept, (1 / lever, 1 / total + centre**2 / lever)


def _joined(lines: tuple[PhotonTransferLine, ...], frames: int, left_out: float) -> PhotonTransfer:
    # One slope with an intercept per channel is the inverse-variance mean of the channels' slopes.
    gains = np.array([line.gain_dn_per_e for line in lines])
    weights = np.array([line.gain_error for line in lines]) ** -2.0
    gain = float(weights @ gains / weights.sum())
    return PhotonTransfer(
        gain_dn_per_e=gain,
        gain_error=float(weights.sum() ** -0.5),
        agreement_chi2_per_dof=float(weights @ (gains - gain) ** 2) / (len(lines) - 1),
        channels=lines,
        frames=frames,
        left_out=left_out,
    )


def _saturation_dn(black: NDArray[np.float64], white_level_dn: float, margin: float) -> float:
    if not math.isfinite(white_level_dn) or not white_level_dn > black.max():
        raise ArgumentError(
            f"the white level ({white_level_dn} DN) must lie above every black level ({black.tolist()})"
        )
    if not 0 <= margin < 1:
        raise ArgumentError(f"the margin is a share of the range, from 0 to below 1; found {margin}")
    return float(white_level_dn - margin * (white_level_dn - black.max()))


# --- the published method -------------------------------------------------------------------------------------


class FlatFrames(_Flats):
    """Accumulates single flat frames for :func:`spatial_photon_transfer`; parameters as :class:`FlatPairs`."""

    def _make_room(self) -> None:
        self.points: list[list[tuple[float, float]]] = [[] for _ in self._black]
        """Median over black and variance of each frame that is neither clipped nor saturated, by channel."""

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a flat frame."""
        from eldata.calibration._kernels import channel_histograms

        counts = np.zeros((self.channels, 65536), dtype=np.int64)
        channel_histograms(mosaic, self._check(mosaic), self.pattern, counts)
        values = np.arange(65536)  # integers: exact, and no BLAS, whose threads would wait in vain
        for channel, histogram in enumerate(counts):
            total = int(histogram.sum())
            bad = int(histogram[0]) + int(histogram[math.ceil(self._limit) :].sum())
            if total < 2 or bad > _CLIPPED_SHARE * 0.01 * total:
                continue
            median = float(np.searchsorted(np.cumsum(histogram), total / 2))
            first, second = int(histogram @ values), int(histogram @ values**2)
            variance = (second - first * first / total) / (total - 1)
            self.points[channel].append((median - float(self._black[channel]), variance))


def spatial_photon_transfer(flats: FlatFrames) -> PhotonTransfer:
    """Estimate K as published: ordinary least squares of each frame's variance over its median.

    For comparison only: PRNU of p adds ``(p signal)^2``, and shading more. The standard errors come from the scatter
    around the line and allow for neither.

    Raises
    ------
    DatasetError
        If a channel has fewer than three usable frames.
    """
    return _joined(
        tuple(_plain_line(points, channel) for channel, points in enumerate(flats.points)),
        flats.frames,
        1 - sum(map(len, flats.points)) / max(1, flats.frames * len(flats.points)),
    )


def _plain_line(points: Sequence[tuple[float, float]], channel: int) -> PhotonTransferLine:
    table: NDArray[Any] = np.array(points, dtype=np.float64).reshape(-1, 2)
    signal, variance = table[:, 0], table[:, 1]
    if len(signal) < 3 or not np.ptp(signal) > 0:
        raise DatasetError(
            f"channel {channel} has {len(signal)} usable flat frame(s) and the spatial method needs three of different "
            "brightness: take flats at four exposures or more, from a tenth to nine tenths of the range"
        )
    slope, intercept, scales = _line(signal, variance, np.ones(len(signal)))
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
