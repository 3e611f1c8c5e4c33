"""System gain K from flat-field frames: the slope of the photon transfer line ``Var(D) = K (K I) + Var(N_o)``.

Two methods. ``pairs`` is the one to use: the variance is temporal, half that of the difference of two equal flats, so
that everything that stays (fixed pattern, PRNU, shading) cancels. ``spatial`` is the published one, the variance inside
of single frames over their median; it takes PRNU and shading, which grow with the square of the signal, for shot noise.

The intercept is free and never used as read noise: it also holds row noise, quantisation and black-level errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.core._frames import FrameSums, checked_black_level
from eldata.calibration.core.saturation import MARGIN, Saturation, saturation
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.core._frames import Counts, Mask, Mosaic, Values
    from eldata.raw.cfa import Cfa

_LEVELS = 512  # from black to saturation
CLIPPED_SHARE = 0.01  # of a level's segments; more, and the level is left out


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
    signal_dn: Values = field(repr=False)
    variance_dn2: Values = field(repr=False)
    variance_error_dn2: Values = field(repr=False)

    def variance_at(self, signal_dn: Values) -> Values:
        """Return the line's variance at these signals, DN^2."""
        return self.gain_dn_per_e * signal_dn + self.intercept_dn2

    def pooled(self, levels: int) -> tuple[Values, Values, Values]:
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
    edges
        Share of the measurements that have an edge in them, as on a colour chart, and were left out.
    correlation, correlation_error
        Of neighbours of one colour in the differences of pairs, and its standard error; 0 in honest frames.
    saturation
        Where each channel saturates below the recorded white level; ``None`` where nothing shows. Empty for single
        frames, as the three above.
    """

    gain_dn_per_e: float
    gain_error: float
    agreement_chi2_per_dof: float
    channels: tuple[PhotonTransferLine, ...]
    frames: int
    left_out: float
    edges: float = math.nan
    correlation: float = math.nan
    correlation_error: float = math.nan
    saturation: tuple[Saturation | None, ...] = ()


class FlatSums(FrameSums):
    """Sums of flat frames; parameters as :class:`FlatPairs`."""

    def __init__(
        self, cfa: Cfa, black_level_dn: Sequence[float], white_level_dn: float, *, defects: Mask | None = None
    ) -> None:
        super().__init__(cfa, defects)
        self.black = checked_black_level(black_level_dn, self.channels)
        if not math.isfinite(white_level_dn) or not white_level_dn > self.black.max():
            raise ArgumentError(
                f"the white level ({white_level_dn} DN) must lie above every black level ({self.black.tolist()})"
            )
        self.limit_dn = float(white_level_dn - MARGIN * (white_level_dn - self.black.max()))
        """From which value on a pixel counts as saturated."""
        self._make_room()

    def _make_room(self) -> None:
        """Set up what the frames are added to, if anything."""


class FlatPairs(FlatSums):
    """Accumulates pairs of equal flat frames, of any number of levels, for :func:`photon_transfer`.

    Parameters
    ----------
    cfa, black_level_dn, white_level_dn
        As in :class:`eldata.records.Sensor`; measured levels are better than recorded ones.
    defects
        (H, W) True where a pixel is not to be used.
    """

    def _make_room(self) -> None:
        self._level_dn = (self.limit_dn - float(self.black.min())) / _LEVELS
        self._segments = np.zeros((self.channels, _LEVELS, 3), dtype=np.int64)
        self._sums = np.zeros((self.channels, _LEVELS, 7))
        self._counts = np.zeros((self.channels, 65536), dtype=np.int64)
        self._saturation: tuple[Saturation | None, ...] | None = None

    def add(self, first: Mosaic, second: Mosaic) -> None:
        """Add two frames of the same scene, exposure and ISO; use each frame in one pair only.

        The light may change between the two, at once or from row to row: each segment of a row is scaled by its own
        ratio, so that what stays in the pixels cancels. Where a segment has an edge in it, as on a colour chart, it is
        left out: a camera that moves a tenth of a pixel would be seen there.
        """
        from eldata.calibration.core._kernels import channel_histograms
        from eldata.calibration.core.flat_segments import ROWS, SEGMENT, pair_segments

        self._check(first)
        defects = self._check(second)
        self._saturation = None
        height, width = first.shape
        if width < SEGMENT:
            raise ArgumentError(f"flat frames must be {SEGMENT} pixels wide or more; found {width}")
        width -= width % SEGMENT
        for frame in (first, second):
            channel_histograms(frame[:, :width], defects[:, :width], self.pattern, self._counts[None])
        ratios, every = self._ratios(first, second, defects), np.arange(_LEVELS)
        for top, channel in product(range(0, height, ROWS), range(self.channels)):
            options = {"black": self.black[channel], "limit": self.limit_dn, "ratio": ratios[channel]}
            signal, kind, figures = pair_segments(first, second, defects, self.pattern, channel, top, **options)
            level = np.clip((signal / self._level_dn).astype(np.int64), 0, _LEVELS - 1)
            np.add.at(self._segments[channel], (level, kind), 1)
            places, sums = np.append(every, level[kind == 0]), self._sums[channel]
            for index, added in enumerate(figures):
                # One after another onto what there is, so that the sums do not depend on the cut into pieces.
                sums[:, index] = np.bincount(places, np.append(sums[:, index], added))

    def _ratios(self, first: Mosaic, second: Mosaic, defects: Mask) -> Values:
        """Return the light of the first frame over that of the second, by channel; 1 where it is not well known."""
        period = len(self.pattern)
        ratios = np.ones(self.channels)
        for channel in range(self.channels):
            one, two = [], []
            for y, x in np.argwhere(self.pattern == channel):
                rows = slice(y, None, period * max(1, len(first) // (64 * period)))
                a, b = first[rows, x::period].astype(np.int64), second[rows, x::period].astype(np.int64)
                used = ~defects[rows, x::period] & (np.minimum(a, b) > 0) & (np.maximum(a, b) < self.limit_dn)
                one.append(a[used])
                two.append(b[used])
            a, b = np.concatenate(one), np.concatenate(two)
            if len(a) < 2:
                continue
            light = (a.mean() - self.black[channel], b.mean() - self.black[channel])
            if min(light) > 0 and (a - b).std() < 0.01 * min(light) * math.sqrt(len(a)):
                ratios[channel] = light[0] / light[1]
        return ratios

    @property
    def left_out(self) -> float:
        """Share of the measurements in levels that are left out as saturated, clipped segments included."""
        whole, clipped, _ = np.moveaxis(self._segments, 2, 0)
        total = int(whole.sum() + clipped.sum())
        return 1 - float(whole[self._usable].sum()) / total if total else 0.0

    @property
    def edges(self) -> float:
        """Share of the measurements that have an edge in them and were left out."""
        total = int(self._segments.sum())
        return float(self._segments[:, :, 2].sum()) / total if total else 0.0

    @property
    def saturation(self) -> tuple[Saturation | None, ...]:
        """Where each channel saturates below the white level; ``None`` where nothing shows."""
        if self._saturation is None:
            self._saturation = tuple(
                saturation(self._counts[channel], self.black[channel], self.limit_dn, *self._of(channel, chosen))
                for channel, chosen in enumerate(self._unclipped)
            )
        return self._saturation

    @property
    def correlation(self) -> tuple[float, float]:
        """Correlation of neighbours of one colour in the differences, and its standard error: 0 in honest frames."""
        chosen = self._usable
        variance = self._sums[chosen, 1] / self._sums[chosen, 0]
        neighbours, products = self._sums[chosen, 4], self._sums[chosen, 5]
        total = float(neighbours.sum())
        if not total or not (variance > 0).all():
            return math.nan, math.nan
        return float((products / variance).sum()) / total, total**-0.5

    @property
    def _unclipped(self) -> Mask:
        whole, clipped, _ = np.moveaxis(self._segments, 2, 0)
        unclipped: Mask = (self._sums[:, :, 0] > 0) & (clipped <= CLIPPED_SHARE * (whole + clipped))
        return unclipped

    @property
    def _usable(self) -> Mask:
        usable = self._unclipped
        for channel, found in enumerate(self.saturation):
            if found is not None:
                chosen = usable[channel].copy()
                signal, _, _, spread = self._of(channel, chosen)
                usable[channel, chosen] = found.is_below(signal, spread)
        return usable

    def _of(self, channel: int, chosen: Mask) -> tuple[Values, ...]:
        """Return signal, variance, degrees of freedom, and variance of single frames of some levels of a channel."""
        freedom, variance, mean, spread = self._sums[channel, chosen, :4].T
        return mean / freedom, variance / freedom, freedom, spread / freedom

    def points(self, channel: int) -> tuple[Values, Values, Values]:
        """Return signal (DN over black), variance (DN^2) and degrees of freedom of a channel's usable levels."""
        signal, variance, freedom, _ = self._of(channel, self._usable[channel])
        return signal, variance, freedom

    def scatter(self, channel: int) -> tuple[Values, Counts]:
        """Return how the variances of a channel's usable levels scatter, and the segments that show it.

        The mean square deviation of the segments' own variances from their level's, times their degrees of freedom,
        DN^4.
        """
        chosen = self._usable[channel]
        segments = self._segments[channel, chosen, 0]
        freedom, variance, squares = self._sums[channel, chosen][:, [0, 1, 6]].T
        return (squares - variance**2 / freedom) / np.maximum(segments - 1, 1), segments


def photon_transfer(flats: FlatPairs) -> PhotonTransfer:
    """Estimate K by weighted least squares of the temporal variance over the mean (equation "photon-transfer").

    Per segment of a row and channel, ``s^2 = Var(A - r B) / (1 + r^2)`` with r the segment's own ratio of A to B, black
    level subtracted. Fixed pattern, PRNU and shading cancel, however unequal the light was. Shot noise of both frames
    and what is independent of light add up to ``(1 + r^2) (K mean + Var(N_o))`` with
    ``mean = (A + r^2 B) / (1 + r^2)``, for any r. Segments pool by level: so shading inside a frame gives levels, and
    drift, row noise and flicker between the frames of a pair do not enter.

    The weights are ``1 / Var(s^2)``, ``Var(s^2) = (2 sigma^4 + K^3 mean / 2) / nu`` with nu degrees of freedom and
    sigma^2 from the fitted line, repeated until it stays; the second term is the fourth cumulant of shot noise. The
    standard errors allow for that of the read noise too, as the scatter of the segments' own variances shows it.

    Levels at and near saturation are left out, wherever it lies (:class:`Saturation`).

    Raises
    ------
    DatasetError
        If a channel has fewer than two usable levels, or the slope is not positive.
    """
    if flats.frames == 0:
        raise DatasetError("no flat frames were given: take pairs of equal flats at several exposures")
    lines = tuple(
        _weighted_line(*flats.points(channel), *flats.scatter(channel), channel) for channel in range(flats.channels)
    )
    correlation, error = flats.correlation
    return replace(
        join_lines(lines, flats.frames, flats.left_out),
        edges=flats.edges,
        correlation=correlation,
        correlation_error=error,
        saturation=flats.saturation,
    )


def _weighted_line(
    signal: Values, variance: Values, freedom: Values, scatter: Values, segments: Counts, channel: int
) -> PhotonTransferLine:
    if len(signal) < 2 or not np.ptp(signal) > 0:
        raise DatasetError(
            f"channel {channel} has {counted(len(signal), 'usable level')} and a line needs two: the flats are "
            "saturated, clipped or all of one brightness. Take pairs at four exposures or more, from a tenth to nine "
            "tenths of the range"
        )
    spread = np.maximum(variance, 1e-12)
    expected2 = 2 * spread**2
    gain = intercept = math.nan
    for _ in range(50):
        before = gain
        weight = freedom / expected2
        gain, intercept, _ = straight_line(signal, variance, weight, 1 / weight)
        expected = np.maximum(gain * signal + intercept, 0.05 * spread)
        expected2 = 2 * expected**2 + 0.5 * max(gain, 0.0) ** 3 * np.maximum(signal, 0.0)
        if abs(gain - before) <= 1e-10 * abs(gain):
            break
    if not gain > 0:
        raise DatasetError(
            f"the variance of channel {channel} does not grow with its signal (slope {gain:.3g}): these are not pairs "
            "of flats at different exposures, or the camera has filtered them"
        )
    # Heavy tails of the read noise scatter more. They are left out of the weights: a level whose variance came out high
    # by a few pixels would have less weight for it, and the line a bias.
    known = np.maximum(segments - 1, 1e-9) / expected2**2
    error2 = (expected2 + max(float(np.average(scatter - expected2, weights=known)), 0.0)) / freedom
    gain, intercept, covariance = straight_line(signal, variance, weight, error2)
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


def straight_line(x: Values, y: Values, weight: Values, error2: Values) -> tuple[float, float, tuple[float, float]]:
    """Return slope and intercept with these weights, and the variances of both if y has these."""
    total = float(weight.sum())
    centre = float(weight @ x) / total
    deviation = x - centre
    of_slope = weight * deviation / float(weight @ deviation**2)
    of_intercept = weight / total - centre * of_slope
    slope, intercept = float(of_slope @ y), float(of_intercept @ y)
    return slope, intercept, (float(of_slope**2 @ error2), float(of_intercept**2 @ error2))


def join_lines(lines: tuple[PhotonTransferLine, ...], frames: int, left_out: float) -> PhotonTransfer:
    """Return K of all channels together."""
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
