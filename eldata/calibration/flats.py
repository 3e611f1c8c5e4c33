"""System gain K from flat-field frames: the slope of the photon transfer line ``Var(D) = K (K I) + Var(N_o)``.

Sources: Wei et al., TPAMI 2021, section 3.2.1, equations 9 to 11; EMVA 1288 release 4.0 Linear, its photon transfer
method. The variance is temporal, half that of the difference of two equal flats, so that everything that stays (fixed
pattern, PRNU, shading) cancels. The paper's own way, the variance inside of single frames over their median, takes PRNU
and shading, which grow with the square of the signal, for shot noise.

The intercept is free and never used as read noise: it also holds row noise, quantisation and black-level errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.sums import Counts, FrameSums, Mask, Mosaic, Values, channel_histograms, segment_sums
from eldata.errors import ArgumentError, DatasetError
from eldata.raw.levels import BAYER_CHANNELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.raw.levels import Cfa

SEGMENT = 96
"""Mosaic columns of a piece of a row: whole periods of Bayer and of X-Trans."""

_ROWS = 240  # of a pair at a time, likewise
_FEWEST_PIXELS = 8  # of a segment
_MEDIANS, _FEWEST_SEGMENTS = 4, 30  # groups of a pair's segments, and what a group has
MARGIN = 0.02  # of the range from black to white: pixels so near to white count as saturated
# A segment of n pixels, whose mean is SNR times its noise, knows the ratio of its two frames to sqrt(2 / n) / SNR. The
# ratio's error adds 1 / (n SNR^2) of the variance: below 1e-4 from an SNR of 20 on. What a wrong ratio would leave of a
# fixed pattern of share p is (p SNR d)^2 of it, with d the error of the whole frames' ratio: below 4e-4 up to there, at
# p = 2 % and d = 5 %.
_BRIGHT = 20.0
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
    correlation, correlation_error
        Of neighbours of one colour in the differences of pairs, and its standard error; 0 in honest frames.
    medians
        By channel: signal, variance and its relative error as medians (:meth:`FlatPairs.medians`).
    """

    gain_dn_per_e: float
    gain_error: float
    agreement_chi2_per_dof: float
    channels: tuple[PhotonTransferLine, ...]
    frames: int
    left_out: float
    correlation: float
    correlation_error: float
    medians: tuple[Values, ...] = field(repr=False)


class FlatPairs(FrameSums):
    """Pairs of equal flat frames, of any number of levels, summed up for :func:`photon_transfer`.

    Parameters
    ----------
    cfa, black_level_dn, white_level_dn
        As in :class:`eldata.records.Sensor`; measured levels are better than recorded ones.
    defects
        (H, W) True where a pixel is not to be used.
    floor_dn
        Up to which value a pixel counts as clipped.

    Attributes
    ----------
    limit_dn
        From which value on a pixel counts as saturated.
    counts
        (channels, 65536) sound pixels by value.
    """

    def __init__(
        self, cfa: Cfa, black_level_dn: Sequence[float], white_level_dn: float, *, defects: Mask | None = None,
        floor_dn: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(cfa, defects)
        self.floor_dn = floor_dn
        self.black = np.asarray(black_level_dn, dtype=np.float64)
        self.limit_dn = float(white_level_dn - MARGIN * (white_level_dn - self.black.max()))
        self._level_dn = (self.limit_dn - float(self.black.min())) / _LEVELS
        self._segments = np.zeros((self.channels, _LEVELS, 2), dtype=np.int64)
        self._sums = np.zeros((self.channels, _LEVELS, 6))
        self._medians: list[list[tuple[float, float, float]]] = [[] for _ in self.black]
        self.counts = np.zeros((self.channels, 65536), dtype=np.int64)

    def add(self, first: Mosaic, second: Mosaic) -> None:
        """Add two frames of the same scene, exposure and ISO; use each frame in one pair only.

        The light may change between the two, at once or from row to row: each segment of a row is scaled by its own
        ratio, so that what stays in the pixels cancels. Where the picture moves, its edges do not.
        """
        self._check(first)
        defects = self._check(second)
        if first.shape[1] < SEGMENT:
            raise ArgumentError(f"flat frames must be {SEGMENT} pixels wide or more; found {first.shape[1]}")
        for frame in (first, second):
            channel_histograms(frame, defects, self.pattern, self.counts[None])
        ratios, every = self._measure_ratios(first, second, defects), np.arange(_LEVELS)
        for channel in range(self.channels):
            medians = []
            for top in range(0, len(first), _ROWS):
                rows = slice(top, top + _ROWS)
                signal, clipped, figures = self._measure(first[rows], second[rows], defects[rows], channel, ratios)
                level = np.clip((signal / self._level_dn).astype(np.int64), 0, _LEVELS - 1)
                np.add.at(self._segments[channel], (level, clipped.astype(np.int64)), 1)
                places, sums = np.append(every, level[~clipped]), self._sums[channel]
                for index, added in enumerate(figures):
                    # One after another onto what there is, so that the sums do not depend on the cut into pieces.
                    sums[:, index] = np.bincount(places, np.append(sums[:, index], added))
                medians.append(figures[:3])
            self._medians[channel] += _pool_medians(*np.concatenate(medians, axis=1))

    def _measure(
        self, first: Mosaic, second: Mosaic, defects: Mask, channel: int, ratios: Values
    ) -> tuple[Values, Mask, Values]:
        """Return level, whether it is clipped, and figures of a channel's segments in some rows.

        A segment is ``SEGMENT`` columns of one row in one channel; its level is its mean over black. The figures,
        (6, unclipped segments), are degrees of freedom; times these, with r the ratio of A to B, Var(A - r B) /
        (1 + r^2) and the mean that goes with it; neighbours of one colour, and the products of their differences;
        degrees of freedom times the square of the variance. A segment whose mean is many times its noise has its own
        ratio.
        """
        sums = np.zeros((13, len(first), first.shape[1] // SEGMENT), dtype=np.int64)
        segment_sums(first, second, defects, self.pattern, channel, self.floor_dn, self.limit_dn, SEGMENT, sums)
        rows = np.arange(len(first)) % len(self.pattern)
        n, clipped, a_sum, b_sum, aa, bb, ab, neighbours, a_two, b_two, aa_two, bb_two, ab_two = sums[
            :, (self.pattern == channel).any(axis=1)[rows]
        ]
        with np.errstate(divide="ignore", invalid="ignore"):  # not a number where a segment has no sound pixel
            mean_a, mean_b = a_sum / n - self.black[channel], b_sum / n - self.black[channel]
            freedom = n - 1
            a_square, b_square, product = aa - a_sum * (a_sum / n), bb - b_sum * (b_sum / n), ab - a_sum * (b_sum / n)
            plain = (a_square + b_square - 2 * product) / (2 * freedom)
            is_bright = (np.minimum(mean_a, mean_b) > 0) & (mean_a * mean_b > _BRIGHT * _BRIGHT * plain)
            r = np.where(is_bright, mean_a / mean_b, ratios[channel])
            scale = 1 + r * r
            variance = (a_square - 2 * r * product + r * r * b_square) / scale
            centre = (a_sum - r * b_sum) / n
            together = (
                aa_two - r * ab_two + r * r * bb_two - centre * (a_two - r * b_two) + neighbours * centre * centre
            )
            # About their own mean, independent values have a covariance of -1/n of their variance.
            products = together / scale + neighbours * variance / (freedom * n)
            mean = freedom * (mean_a + r * r * mean_b) / scale
            figures = (freedom, variance, mean, neighbours, products, variance * variance / freedom)
        enough = n >= _FEWEST_PIXELS
        whole = enough & (clipped == 0)
        return 0.5 * (mean_a + mean_b)[enough], (clipped > 0)[enough], np.stack([one[whole] for one in figures])

    def _measure_ratios(self, first: Mosaic, second: Mosaic, defects: Mask) -> Values:
        """Return the ratio of light between the two frames, by channel; 1 where it is not well known."""
        period = len(self.pattern)
        ratios = np.ones(self.channels)
        for channel in range(self.channels):
            pairs = []
            for y, x in np.argwhere(self.pattern == channel):
                site = slice(y, None, period * max(1, len(first) // (64 * period))), slice(x, None, period)
                a, b = first[site].astype(np.int64), second[site].astype(np.int64)
                is_whole = (np.minimum(a, b) > self.floor_dn) & (np.maximum(a, b) < self.limit_dn)
                pairs.append(np.stack([a, b])[:, is_whole & ~defects[site]])
            a, b = np.concatenate(pairs, axis=1)
            if len(a) < 2:
                continue
            light = (a.mean() - self.black[channel], b.mean() - self.black[channel])
            if min(light) > 0 and (a - b).std() < 0.01 * min(light) * math.sqrt(len(a)):
                ratios[channel] = light[0] / light[1]
        return ratios

    @property
    def left_out(self) -> float:
        """Share of the measurements in levels that are left out as saturated, clipped segments included."""
        total = int(self._segments.sum())
        return 1 - float(self._segments[self._usable_levels, 0].sum()) / total if total else 0.0

    @property
    def correlation(self) -> tuple[float, float]:
        """Correlation of neighbours of one colour in the differences, and its standard error: 0 in honest frames."""
        chosen = self._usable_levels
        variance = self._sums[chosen, 1] / self._sums[chosen, 0]
        neighbours, products = self._sums[chosen, 3], self._sums[chosen, 4]
        total = float(neighbours.sum())
        if not total or not (variance > 0).all():
            return math.nan, math.nan
        return float((products / variance).sum()) / total, total**-0.5

    @property
    def _usable_levels(self) -> Mask:
        """Mask of the levels, by channel, that have measurements, few of them clipped."""
        whole, clipped = np.moveaxis(self._segments, 2, 0)
        return np.asarray((self._sums[:, :, 0] > 0) & (clipped <= CLIPPED_SHARE * (whole + clipped)))

    def points(self, channel: int) -> tuple[Values, Values, Values]:
        """Return signal (DN over black), variance (DN^2) and degrees of freedom of a channel's usable levels."""
        freedom, variance, mean = self._sums[channel, self._usable_levels[channel], :3].T
        return mean / freedom, variance / freedom, freedom

    def scatter(self, channel: int) -> tuple[Values, Counts]:
        """Return the scatter of the variances of a channel's usable levels, and the segments that show it.

        The mean square deviation of the segments' own variances from their level's, times their degrees of freedom,
        DN^4.
        """
        chosen = self._usable_levels[channel]
        segments = self._segments[channel, chosen, 0]
        freedom, variance, squares = self._sums[channel, chosen][:, [0, 1, 5]].T
        return (squares - variance**2 / freedom) / np.maximum(segments - 1, 1), segments

    def medians(self, channel: int) -> Values:
        """Return (3, points) median signal, variance, and the relative error of that, of segments of one brightness.

        Of each pair, at usable levels: what lies in less than half of the segments, as edges that move, is not in them.
        """
        points = np.array(self._medians[channel]).reshape(-1, 3).T
        level = np.clip((points[0] / self._level_dn).astype(np.int64), 0, _LEVELS - 1)
        return points[:, self._usable_levels[channel, level]]


def _pool_medians(freedom: Values, variance: Values, signal: Values) -> list[tuple[float, float, float]]:
    """Return medians of signal and variance, and the relative error of that, of groups of segments of one brightness.

    The median of a variance with n degrees of freedom lies lower than its mean by (1 - 2 / 9n)^3 (Wilson and Hilferty),
    and scatters by sqrt(pi / 2) of it.
    """
    signal, variance = signal / freedom, variance / freedom
    points = []
    for group in np.array_split(np.argsort(signal, kind="stable"), _MEDIANS):
        if group.size >= _FEWEST_SEGMENTS:
            n = float(np.median(freedom[group]))
            middle = float(np.median(variance[group])) / (1 - 2 / (9 * n)) ** 3
            points.append((float(np.median(signal[group])), middle, math.sqrt(math.pi / n / group.size)))
    return points


def channel_names(count: int) -> tuple[str, ...]:
    """Name the channels of a CFA of so many."""
    return BAYER_CHANNELS if count == len(BAYER_CHANNELS) else ("R", "G", "B")


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

    Levels at and near the recorded white level are left out.

    Raises
    ------
    DatasetError
        If a channel has fewer than two usable levels, or the slope is not positive.
    """
    if flats.frames == 0:
        raise DatasetError("no flat frames were given: take pairs of equal flats at several exposures")
    lines = tuple(
        _weighted_line(*flats.points(channel), *flats.scatter(channel), name)
        for channel, name in enumerate(channel_names(flats.channels))
    )
    correlation, error = flats.correlation
    # One slope with an intercept per channel is the inverse-variance mean of the channels' slopes.
    gains = np.array([line.gain_dn_per_e for line in lines])
    weights = np.array([line.gain_error for line in lines]) ** -2.0
    gain = float(weights @ gains / weights.sum())
    return PhotonTransfer(
        gain_dn_per_e=gain,
        gain_error=float(weights.sum() ** -0.5),
        agreement_chi2_per_dof=float(weights @ (gains - gain) ** 2) / (len(lines) - 1),
        channels=lines,
        frames=flats.frames,
        left_out=flats.left_out,
        correlation=correlation,
        correlation_error=error,
        medians=tuple(map(flats.medians, range(flats.channels))),
    )


def _weighted_line(
    signal: Values, variance: Values, freedom: Values, scatter: Values, segments: Counts, channel: str
) -> PhotonTransferLine:
    """Fit the line of one channel, weighted as :func:`photon_transfer` says."""
    if len(signal) < 2 or not np.ptp(signal) > 0:
        raise DatasetError(
            f"{channel} has {counted(len(signal), 'usable level')} and a line needs two: the flats are "
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
            f"the variance of {channel} does not grow with its signal (slope {gain:.3g}): take pairs at four "
            "exposures or more, from a tenth to nine tenths of the range"
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
