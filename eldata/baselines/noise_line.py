"""How the noise of one photograph grows with its light: ``variance = offset + slope * signal``.

In windows of 8 x 8 pixels of each channel, the 16 highest frequencies of the discrete cosine transform (both of 4 and
more) hold the noise and next to nothing of the scene; the 40 middle ones show whether the window is smooth. The noise
is white and the frequencies independent, so that choosing windows by the middle ones does not bias the highest. A
window is smooth if its middle frequencies, of all channels together, have the variance that the line says, within two
standard deviations of the chi^2 law: line and windows are found in turns. The rows' own offsets are in neither: they
have no horizontal frequency. Choosing blocks by lower and measuring at higher frequencies is N. N. Ponomarenko's idea
(M. Colom and A. Buades, "Analysis and Extension of the Ponomarenko et al. Method", IPOL 3, 2013).

Brightness groups come from the windows above and below, whose noise is independent: sorted by its own noisy mean, a
dark frame's slope would come out too small. Within a group, mean and variance are averages over many windows.

The channels share the slope, and each has an offset of its own: black levels that are a DN off differ from channel to
channel, and the scene's brightness does, too, so that one line through all of them would lean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.flats import straight_line
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from eldata.calibration.sums import Mask, Values


WINDOW = 8
_VERTICAL, _HORIZONTAL = np.mgrid[:WINDOW, :WINDOW]
_HIGHEST = (_VERTICAL >= WINDOW // 2) & (_HORIZONTAL >= WINDOW // 2)
_MIDDLE = ~_HIGHEST & (_HORIZONTAL > 0)
_GROUPS, _FEWEST_IN_GROUP = 32, 16
_FEWEST_WINDOWS = 4 * _FEWEST_IN_GROUP
_GROUPS_OF_CHANNEL, _FEWEST_OF_CHANNEL = 12, 8
_LOWEST = 0.1  # share of a group's windows that the first line is taken from
_SMOOTH_WITHIN = 2.0  # standard deviations
_ROUNDS, _SETTLED = 12, 2e-3
_TEXTURED = 4.0  # windows up to this excess of the middle frequencies tell how much of it the highest have


@dataclass(frozen=True, slots=True)
class NoiseLine:
    """Variance of the noise over the signal.

    Attributes
    ----------
    slope
        Variance per unit of signal.
    offset
        Variance without light, of read noise and rounding, without row noise. Of bright frames it may come out
        below 0.
    least_variance
        The smallest variance of a group of windows, above 0, which bounds what the line says.
    """

    slope: float
    offset: float
    least_variance: float

    def variance(self, signal: Values) -> Values:
        """Compute the variance at some signals."""
        # A line fitted to bright parts alone may cross 0 before black.
        return np.asarray(np.maximum(self.offset + max(self.slope, 0.0) * signal, self.least_variance / 4))


def noise_line(packed: Values | Iterable[Values]) -> NoiseLine:
    """Estimate the line from a frame itself, whose noise is independent from pixel to pixel.

    What the smooth windows still have of the scene is taken off: how the highest frequencies follow the middle ones in
    windows with texture, applied to what the smooth ones show of it. Texture as fine as the pixels of a channel, all
    over the bright parts, cannot be told from noise.

    Parameters
    ----------
    packed
        (C, h, w), black subtracted and negative values kept, in any unit; or, for less memory, bands of its rows from
        top to bottom, each but the last of a multiple of 8 rows.

    Raises
    ------
    ArgumentError
        If the array does not have this shape or the values are not finite.
    DatasetError
        If the frame is too small, shows no noise, has no smooth windows, or neighbouring pixels share their noise.
    """
    windows = _Windows.of([packed] if isinstance(packed, np.ndarray) else packed)
    if windows.mean.size < _FEWEST_WINDOWS:
        raise DatasetError(
            f"the frame shows too little of its noise: {windows.mean.size} windows of {WINDOW} x {WINDOW} pixels of a "
            f"channel, where {_FEWEST_WINDOWS} are needed"
        )
    line = windows.first_line()
    within = _SMOOTH_WITHIN * math.sqrt(2 / (np.count_nonzero(_MIDDLE) * len(windows.mean)))
    for _ in range(_ROUNDS):
        excess = windows.excess(line)
        smooth = excess < within
        _check_found(smooth)
        before, line = line, windows.fit(smooth, line, windows.highest)
        changes = ((line.slope, before.slope), (line.offset, before.offset))
        if all(abs(now - then) <= _SETTLED * abs(now) for now, then in changes):
            break
    excess = windows.excess(line)
    smooth = excess < within
    _check_found(smooth)
    _check_white(float(excess[smooth].mean()), within, smooth)
    return windows.fit(smooth, line, windows.highest - windows.texture(line, excess, within))


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Of each window, (C, rows, columns): mean, brightness of its neighbours, and mean squares of two frequencies."""

    mean: Values
    beside: Values
    highest: Values
    middle: Values

    @classmethod
    def of(cls, bands: Iterable[Values]) -> _Windows:
        """Measure the windows of a packed frame, given in bands of its rows."""
        measured = zip(*map(_measure_windows, bands), strict=True)
        mean, highest, middle = (np.concatenate(parts, axis=1) for parts in measured)
        rows = mean.shape[1]
        if rows < 2 or not mean.shape[2]:
            raise DatasetError(f"a frame of {rows} x {mean.shape[2]} windows is too small to show its noise")
        above, below = mean[:, [1, *range(rows - 1)]], mean[:, [*range(1, rows), rows - 2]]
        return cls(mean, (above + below) / 2, highest, middle)

    def groups(self, chosen: Mask, most: int = _GROUPS, fewest: int = _FEWEST_IN_GROUP) -> list[NDArray[np.intp]]:
        """Return the chosen windows' flat indices in groups of like brightness."""
        places = np.flatnonzero(chosen)
        places = places[np.argsort(self.beside.ravel()[places], kind="stable")]
        return np.array_split(places, max(1, min(most, len(places) // fewest)))

    def excess(self, line: NoiseLine) -> Values:
        """Return the excess of the middle frequencies over the line at each place, as a share, over all channels."""
        share = (self.middle / line.variance(self.mean)).mean(axis=0) - 1
        return np.asarray(np.broadcast_to(share, self.mean.shape))

    def first_line(self) -> NoiseLine:
        """Fit a line through the lowest tenths of each group, which texture reaches last."""
        from scipy.stats import chi2

        count = np.count_nonzero(_HIGHEST)
        groups = self.groups(np.ones(self.mean.shape, np.bool_))
        mean = np.array([self.mean.ravel()[group].mean() for group in groups])
        lowest = np.array([np.quantile(self.highest.ravel()[group], _LOWEST) for group in groups])
        variance = lowest * count / chi2.ppf(_LOWEST, count)
        if not variance.max() > 0:
            raise DatasetError("the frame shows no noise; is it a raw frame as the camera wrote it?")
        floor = max(float(variance.min()), 1e-3 * float(variance.max()))
        scatter = np.maximum(variance, floor) ** 2
        slope, offset, _ = straight_line(mean, variance, 1 / scatter, scatter)
        return NoiseLine(slope, offset, floor)

    def fit(self, chosen: Mask, line: NoiseLine, values: Values) -> NoiseLine:
        """Return the line through the groups' means of some values: a slope of all groups and the mean offset.

        Weights are as another line says: a group's own value would pull it down.
        """
        by_channel = chosen.reshape(len(chosen), -1).sum(axis=1)
        # Too few windows for a slope in each channel that has some: one offset for all.
        together = bool((by_channel[by_channel > 0] < 2 * _FEWEST_OF_CHANNEL).all())
        groups: list[tuple[int, NDArray[np.intp]]] = [(0, group) for group in self.groups(chosen) if together]
        for number in range(0 if together else len(chosen)):
            alone = np.zeros_like(chosen)
            alone[number] = chosen[number]
            if alone.any():
                groups += [(number, group) for group in self.groups(alone, _GROUPS_OF_CHANNEL, _FEWEST_OF_CHANNEL)]
        windows = np.array([len(group) for _, group in groups])
        mean, variance = (
            np.array([array.ravel()[group].mean() for _, group in groups]) for array in (self.mean, values)
        )
        # Of the mean of n windows' 16 squares.
        weight = 1 / (line.variance(mean) ** 2 * 2 / (np.count_nonzero(_HIGHEST) * windows))
        channel = np.unique([number for number, _ in groups], return_inverse=True)[1]
        middle = (np.bincount(channel, weight * mean) / np.bincount(channel, weight))[channel]
        total, spread = float(weight.sum()), float(weight @ (mean - middle) ** 2)
        least = max(float(variance.min()), 1e-3 * float(variance.max()))
        if np.all(np.bincount(channel) < 2) or not spread > 0:
            return NoiseLine(0.0, float(weight @ variance) / total, least)
        slope = float(weight @ ((mean - middle) * variance)) / spread
        return NoiseLine(slope, float(weight @ variance) / total - slope * float(weight @ mean) / total, least)

    def texture(self, line: NoiseLine, excess: Values, within: float) -> Values:
        """Estimate the scene's part in the highest frequencies of each window from its middle frequencies.

        Windows were chosen by their excess, so that without any texture its mean lies below 0.
        """
        from scipy.stats import norm

        textured = (excess > within) & (excess < _TEXTURED)
        share = 1.0  # as much as the middle ones: the most that a scene through a lens has
        if np.count_nonzero(textured) >= _FEWEST_WINDOWS:
            rest = self.highest[textured] / line.variance(self.mean[textured]) - 1
            share = float(rest @ excess[textured] / (excess[textured] @ excess[textured]))
        chance = -within / _SMOOTH_WITHIN * float(norm.pdf(_SMOOTH_WITHIN) / norm.cdf(_SMOOTH_WITHIN))
        return np.asarray(share * (excess - chance) * line.variance(self.mean))


def _measure_windows(packed: Values) -> tuple[Values, Values, Values]:
    """Measure the windows of a band, (C, rows, columns): mean, and mean squares of highest and middle frequencies."""
    from scipy.fft import dctn

    if packed.ndim != 3 or not np.issubdtype(packed.dtype, np.floating):
        raise ArgumentError(f"a packed frame is (C, h, w) in floating numbers; found {packed.dtype} {packed.shape}")
    if not np.all(np.isfinite(packed)):
        raise ArgumentError("a packed frame has finite values; found NaN or infinity")
    channels, rows, columns = len(packed), packed.shape[1] // WINDOW, packed.shape[2] // WINDOW
    mean, highest, middle = (np.empty((channels, rows, columns)) for _ in range(3))
    for index, channel in enumerate(packed):
        whole = channel[: rows * WINDOW, : columns * WINDOW].astype(np.float64)
        windows = whole.reshape(rows, WINDOW, columns, WINDOW).swapaxes(1, 2)
        squares = dctn(windows, axes=(-2, -1), norm="ortho")
        mean[index] = squares[..., 0, 0] / WINDOW
        np.square(squares, out=squares)
        highest[index] = squares[..., _HIGHEST].mean(axis=-1)
        middle[index] = squares[..., _MIDDLE].mean(axis=-1)
    return mean, highest, middle


def _check_found(smooth: Mask) -> None:
    """Refuse a frame that has too few smooth windows."""
    count = np.count_nonzero(smooth)
    if count < _FEWEST_WINDOWS:
        raise DatasetError(
            f"the noise cannot be told from the scene: {count} of {smooth.size} windows of {WINDOW} x "
            f"{WINDOW} pixels have as little of the middle frequencies as of the highest ones, as noise alone has, "
            f"where {_FEWEST_WINDOWS} are needed. Either no part of the scene is smooth, or neighbouring pixels share "
            "their noise, as after noise reduction or resizing in the camera. Photograph a plain surface out of focus; "
            "if that is refused too, the raw file is filtered"
        )


def _check_white(mean: float, within: float, smooth: Mask) -> None:
    """Refuse a frame whose smooth windows have a mean excess of the middle frequencies that noise alone has not.

    Of white noise it lies around 0. Where noise is smoothed, the middle frequencies of all windows hold more than the
    highest, and those below the limit crowd there: spread evenly between 0 and the limit, as the edge of a scene
    without smooth windows may be, their mean is half of the limit. Sharpened noise lies below 0: the limit is two
    standard deviations of a place's windows, and four of the mean's are left for chance.
    """
    places = np.count_nonzero(smooth.any(axis=0))
    if mean > within / 2:
        raise DatasetError(
            f"neighbouring pixels share their noise: even the smoothest {np.count_nonzero(smooth)} of "
            f"{smooth.size} windows of {WINDOW} x {WINDOW} pixels hold {mean:.0%} more at middle than at "
            "the highest frequencies, as after noise reduction or resizing in the camera, or no part of the scene is "
            "smooth. Photograph a plain surface out of focus; if that is refused too, the raw file is filtered"
        )
    if mean < -within * (1 / 8 + 4 / (_SMOOTH_WITHIN * math.sqrt(places))):
        raise DatasetError(
            f"the highest frequencies hold {-mean:.0%} more than the middle ones: the file was sharpened or compressed "
            "with loss, or its pixels alternate in a pattern, and its noise cannot be measured"
        )
