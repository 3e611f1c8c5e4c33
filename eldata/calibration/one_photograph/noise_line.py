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
channel, and the scene's brightness does, too, so that one line through all of them would lean. Errors come from leaving
out one part of the frame after another, since what a scene leaves in the highest frequencies is not the same all over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.core.photon_transfer import straight_line
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Mask, Values


WINDOW = 8
_VERTICAL, _HORIZONTAL = np.mgrid[:WINDOW, :WINDOW]
_HIGHEST = (_VERTICAL >= WINDOW // 2) & (_HORIZONTAL >= WINDOW // 2)
_MIDDLE = ~_HIGHEST & (_HORIZONTAL > 0)
_GROUPS, _FEWEST_IN_GROUP = 32, 16
_FEWEST_WINDOWS = 4 * _FEWEST_IN_GROUP
_GROUPS_OF_CHANNEL, _FEWEST_OF_CHANNEL = 12, 8
_PARTS = 4, 6  # of the frame, down and across, that are left out in turn
_LOWEST = 0.1  # share of a group's windows that the first line is taken from
_SMOOTH_WITHIN = 2.0  # standard deviations
_ROUNDS, _SETTLED = 12, 2e-3
# A group of windows with more pixels at black or white than this is left out whole: what is left of it would be the
# windows whose noise happened to be small. Cut there (3.1 standard deviations), a variance is 0.3 % too small.
_CLIPPED_SHARE = 1e-3
_TEXTURED = 4.0  # windows up to this excess of the middle frequencies tell how much of it the highest have
_BY_CHANCE = 1e-4


@dataclass(frozen=True, slots=True)
class NoiseLine:
    """Variance of the noise over the signal.

    Attributes
    ----------
    slope, slope_error
        Variance per unit of signal, and its standard error. Of a frame in DN the slope is the gain K, DN per
        photoelectron.
    offset, offset_error
        Variance without light, of read noise and rounding, without row noise. Of bright frames it may come out
        below 0, within its error.
    windows
        How many windows were smooth.
    smooth_share
        Their share among those that are not clipped.
    least_variance
        The smallest variance of a group of windows, above 0.
    channel_slopes, channel_slope_errors
        The slope of each channel by itself, and its error; NaN where a channel has too few windows.
    channels_differ
        Whether the channels' slopes differ by more than chance; their scatter is in ``slope_error`` then.
    """

    slope: float
    slope_error: float
    offset: float
    offset_error: float
    windows: int
    smooth_share: float
    least_variance: float
    channel_slopes: tuple[float, ...]
    channel_slope_errors: tuple[float, ...]
    channels_differ: bool


def noise_line(packed: Values, usable: Mask | None = None) -> NoiseLine:
    """Estimate the line from a frame itself, whose noise is independent from pixel to pixel.

    What the smooth windows still have of the scene is taken off: how the highest frequencies follow the middle ones in
    windows with texture, applied to what the smooth ones show of it. Errors are those of the parts of the frame, left
    out in turn, or of the groups' scatter around the line, or of the chi^2 law, whichever is most, and as much as was
    taken off. Texture as fine as the pixels of a channel, all over the bright parts, cannot be told from noise.

    Parameters
    ----------
    packed
        (C, h, w), black subtracted and negative values kept, in any unit.
    usable
        (C, h, w) False where a pixel is at black or white; windows with such pixels are left out.

    Raises
    ------
    ArgumentError
        If the arrays do not have these shapes or the values are not finite.
    DatasetError
        If the frame is too small, shows no noise, has no smooth windows, or neighbouring pixels share their noise.
    """
    if packed.ndim != 3 or not np.issubdtype(packed.dtype, np.floating):
        raise ArgumentError(f"a packed frame is (C, h, w) in floating numbers; found {packed.dtype} {packed.shape}")
    if usable is not None and usable.shape != packed.shape:
        raise ArgumentError(f"usable has the frame's shape {packed.shape}; found {usable.shape}")
    if not np.all(np.isfinite(packed)):
        raise ArgumentError("a packed frame has finite values; found NaN or infinity")
    windows = _Windows.of(packed, usable)
    found = windows.sound
    if np.count_nonzero(found) < _FEWEST_WINDOWS:
        raise DatasetError(
            f"a frame of {packed.shape} shows too little of its noise: {np.count_nonzero(found)} windows of {WINDOW} x "
            f"{WINDOW} pixels of a channel that are neither at black nor at white, where {_FEWEST_WINDOWS} are needed"
        )
    line = windows.first_line()
    within = _SMOOTH_WITHIN * math.sqrt(2 / (np.count_nonzero(_MIDDLE) * len(packed)))
    for _ in range(_ROUNDS):
        excess = windows.excess(line)
        smooth = windows.sound & (excess < within)
        _check_found(smooth, windows.sound)
        before, line = line, windows.fitted(smooth, line)
        if line.is_near(before):
            break
    excess = windows.excess(line)
    smooth = windows.sound & (excess < within)
    _check_found(smooth, windows.sound)
    _check_white(float(excess[smooth].mean()), within, smooth, windows.sound)
    texture = windows.texture(line, excess, within)
    return _with_channels(windows, smooth, line, texture)


@dataclass(frozen=True, slots=True)
class _Line:
    slope: float
    offset: float
    least: float  # variance of the darkest group, which bounds what the line says
    slope_error: float = math.inf
    offset_error: float = math.inf

    def variance(self, signal: Values) -> Values:
        # A line fitted to bright parts alone may cross 0 before black.
        return np.asarray(np.maximum(self.offset + max(self.slope, 0.0) * signal, self.least / 4))

    def is_near(self, other: _Line) -> bool:
        return all(
            abs(mine - its) <= _SETTLED * abs(mine)
            for mine, its in ((self.slope, other.slope), (self.offset, other.offset))
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Of each window, (C, rows, columns): mean, brightness of its neighbours, and mean squares of two frequencies."""

    mean: Values
    beside: Values
    highest: Values
    middle: Values
    sound: Mask

    @classmethod
    def of(cls, packed: Values, usable: Mask | None) -> _Windows:
        from scipy.fft import dctn

        channels, rows, columns = len(packed), packed.shape[1] // WINDOW, packed.shape[2] // WINDOW
        if rows < 2 or not columns:
            raise DatasetError(f"a frame of {packed.shape} is too small to show its noise")

        def cut(channel: NDArray[Any]) -> NDArray[Any]:
            whole = channel[: rows * WINDOW, : columns * WINDOW]
            return whole.reshape(rows, WINDOW, columns, WINDOW).swapaxes(1, 2)

        mean, highest, middle = (np.empty((channels, rows, columns)) for _ in range(3))
        for index, channel in enumerate(packed):
            squares = dctn(cut(channel.astype(np.float64)), axes=(-2, -1), norm="ortho")
            mean[index] = squares[..., 0, 0] / WINDOW
            np.square(squares, out=squares)
            highest[index] = squares[..., _HIGHEST].mean(axis=-1)
            middle[index] = squares[..., _MIDDLE].mean(axis=-1)
        above, below = mean[:, [1, *range(rows - 1)]], mean[:, [*range(1, rows), rows - 2]]
        windows = cls(mean, (above + below) / 2, highest, middle, np.ones(mean.shape, dtype=np.bool_))
        if usable is None:
            return windows
        lost = np.stack([(~cut(channel)).sum(axis=(-2, -1)) for channel in usable])
        sound = lost == 0
        for group in windows.groups(windows.sound, mean):
            if lost.ravel()[group].mean() > _CLIPPED_SHARE * WINDOW**2:
                sound.ravel()[group] = False
        return cls(windows.mean, windows.beside, highest, middle, sound)

    def groups(
        self, chosen: Mask, brightness: Values, most: int = _GROUPS, fewest: int = _FEWEST_IN_GROUP
    ) -> list[NDArray[np.intp]]:
        """Return the chosen windows' flat indices in groups of like brightness."""
        places = np.flatnonzero(chosen)
        places = places[np.argsort(brightness.ravel()[places], kind="stable")]
        return np.array_split(places, max(1, min(most, len(places) // fewest)))

    def excess(self, line: _Line) -> Values:
        """Return how much more the middle frequencies hold at each place, all channels together, as a share."""
        share = (self.middle / line.variance(self.mean)).mean(axis=0) - 1
        return np.asarray(np.broadcast_to(share, self.mean.shape))

    def first_line(self) -> _Line:
        """Return a line through the lowest tenths of each group, which texture reaches last."""
        from scipy.stats import chi2

        count = np.count_nonzero(_HIGHEST)
        groups = self.groups(self.sound, self.beside)
        mean = np.array([self.mean.ravel()[group].mean() for group in groups])
        lowest = np.array([np.quantile(self.highest.ravel()[group], _LOWEST) for group in groups])
        variance = lowest * count / chi2.ppf(_LOWEST, count)
        if not variance.max() > 0:
            raise DatasetError("the frame shows no noise; is it a raw frame as the camera wrote it?")
        floor = max(float(variance.min()), 1e-3 * float(variance.max()))
        scatter = np.maximum(variance, floor) ** 2
        slope, offset, _ = straight_line(mean, variance, 1 / scatter, scatter)
        return _Line(slope, offset, floor)

    def fitted(self, chosen: Mask, line: _Line, values: Values | None = None) -> _Line:
        """Return the line through the groups' means of the highest frequencies, or of other values with its weights."""
        groups = _Groups.of(self, chosen, self.highest if values is None else values)
        found, square = groups.fitted(line)
        wider = math.sqrt(max(square, 1.0))
        return replace(found, slope_error=wider * found.slope_error, offset_error=wider * found.offset_error)

    def fitted_by_parts(self, chosen: Mask, line: _Line, values: Values) -> _Line:
        """Return the line with errors that are at least those of leaving out one part of the frame after another."""
        found, groups = self.fitted(chosen, line, values), _Groups.of(self, chosen, values)
        parts = [part for part in range(groups.counts.shape[1]) if groups.counts[:, part].any()]
        if len(parts) < 2:
            return found
        without = [groups.without(part).fitted(line)[0] for part in parts]
        slopes, offsets = np.array([(one.slope, one.offset) for one in without]).T
        times = math.sqrt(len(parts) - 1)
        return replace(
            found,
            slope_error=max(found.slope_error, times * float(slopes.std())),
            offset_error=max(found.offset_error, times * float(offsets.std())),
        )

    def texture(self, line: _Line, excess: Values, within: float) -> Values:
        """Return what the highest frequencies of each window have of the scene, as its middle ones let expect.

        Windows were chosen by their excess, so that without any texture its mean lies below 0.
        """
        from scipy.stats import norm

        textured = self.sound & (excess > within) & (excess < _TEXTURED)
        share = 1.0  # as much as the middle ones: the most that a scene through a lens has
        if np.count_nonzero(textured) >= _FEWEST_WINDOWS:
            rest = self.highest[textured] / line.variance(self.mean[textured]) - 1
            share = float(rest @ excess[textured] / (excess[textured] @ excess[textured]))
        chance = -within / _SMOOTH_WITHIN * float(norm.pdf(_SMOOTH_WITHIN) / norm.cdf(_SMOOTH_WITHIN))
        return np.asarray(share * (excess - chance) * line.variance(self.mean))


@dataclass(frozen=True, slots=True, eq=False)
class _Groups:
    """Groups of like brightness by the channel whose offset they have, and of each what each part of the frame holds.

    ``counts``, ``signals`` and ``values`` are (groups, parts): numbers of windows, and sums over them.
    """

    channel: NDArray[np.intp]
    counts: Values
    signals: Values
    values: Values

    @classmethod
    def of(cls, windows: _Windows, chosen: Mask, values: Values) -> _Groups:
        down, across = _PARTS
        _, rows, columns = chosen.shape
        part = (np.arange(rows) * down // rows)[:, None] * across + np.arange(columns) * across // columns
        parts = np.broadcast_to(part, chosen.shape).ravel()
        by_channel = chosen.reshape(len(chosen), -1).sum(axis=1)
        # Too few windows for a slope in each channel that has some: one offset for all.
        together = bool((by_channel[by_channel > 0] < 2 * _FEWEST_OF_CHANNEL).all())
        found: list[tuple[int, Any]] = [(0, one) for one in windows.groups(chosen, windows.beside) if together]
        for channel in range(0 if together else len(chosen)):
            if chosen[channel].any():
                groups = windows.groups(_alone(chosen, channel), windows.beside, _GROUPS_OF_CHANNEL, _FEWEST_OF_CHANNEL)
                found += [(channel, one) for one in groups]

        def summed(weights: Values | None) -> Values:
            sums = [
                np.bincount(parts[one], None if weights is None else weights.ravel()[one], down * across)
                for _, one in found
            ]
            return np.array(sums, dtype=np.float64)

        channels = np.array([channel for channel, _ in found])
        return cls(channels, summed(None), summed(windows.mean), summed(values))

    def without(self, part: int) -> _Groups:
        """Return the groups without one part of the frame."""
        counts, signals, values = (np.delete(each, part, axis=1) for each in (self.counts, self.signals, self.values))
        kept = counts.any(axis=1)
        return _Groups(self.channel[kept], counts[kept], signals[kept], values[kept])

    def fitted(self, line: _Line) -> tuple[_Line, float]:
        """Return the line with a slope of all groups and the mean offset, and chi^2 per degree of freedom.

        Weights are as another line says: a group's own value would pull it down.
        """
        windows = self.counts.sum(axis=1)
        mean, found = self.signals.sum(axis=1) / windows, self.values.sum(axis=1) / windows
        # Of the mean of n windows' 16 squares.
        scatter = line.variance(mean) ** 2 * 2 / (np.count_nonzero(_HIGHEST) * windows)
        channel = np.unique(self.channel, return_inverse=True)[1]
        weight = 1 / scatter
        of_channel = np.bincount(channel, weight)
        middle = (np.bincount(channel, weight * mean) / of_channel)[channel]
        level = (np.bincount(channel, weight * found) / of_channel)[channel]
        total = float(weight.sum())
        spread = float(weight @ (mean - middle) ** 2)
        floor = max(float(found.min()), 1e-3 * float(found.max()))
        if np.all(np.bincount(channel) < 2) or not spread > 0:
            return _Line(0.0, float(weight @ found) / total, floor), 1.0
        slope = float(weight @ ((mean - middle) * found)) / spread
        at = float(weight @ mean) / total
        offset = float(weight @ found) / total - slope * at
        square = float(weight @ (found - level - slope * (mean - middle)) ** 2)
        errors = 1 / math.sqrt(spread), math.sqrt(1 / total + at**2 / spread)
        return _Line(slope, offset, floor, *errors), square / max(len(mean) - len(of_channel) - 1, 1)


def _alone(chosen: Mask, channel: int) -> Mask:
    """Return the windows of one channel that are chosen."""
    alone = np.zeros_like(chosen)
    alone[channel] = chosen[channel]
    return alone


def _check_found(smooth: Mask, sound: Mask) -> None:
    """Refuse a frame that has too few smooth windows."""
    count = np.count_nonzero(smooth)
    if count < _FEWEST_WINDOWS:
        raise DatasetError(
            f"the noise cannot be told from the scene: {count} of {np.count_nonzero(sound)} windows of {WINDOW} x "
            f"{WINDOW} pixels have as little of the middle frequencies as of the highest ones, as noise alone has, "
            f"where {_FEWEST_WINDOWS} are needed. Either no part of the scene is smooth, or neighbouring pixels share "
            "their noise, as after noise reduction or resizing in the camera. Photograph a plain surface out of focus; "
            "if that is refused too, the raw file is filtered"
        )


def _check_white(mean: float, within: float, smooth: Mask, sound: Mask) -> None:
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
            f"{np.count_nonzero(sound)} windows of {WINDOW} x {WINDOW} pixels hold {mean:.0%} more at middle than at "
            "the highest frequencies, as after noise reduction or resizing in the camera, or no part of the scene is "
            "smooth. Photograph a plain surface out of focus; if that is refused too, the raw file is filtered"
        )
    if mean < -within * (1 / 8 + 4 / (_SMOOTH_WITHIN * math.sqrt(places))):
        raise DatasetError(
            f"the highest frequencies hold {-mean:.0%} more than the middle ones: the file was sharpened or compressed "
            "with loss, or its pixels alternate in a pattern, and its noise cannot be measured"
        )


def _with_channels(windows: _Windows, smooth: Mask, settled: _Line, scene: Values) -> NoiseLine:
    """Return the result: the line of all channels without what is of the scene, held against each channel's own."""
    from scipy.stats import chi2

    texture = windows.fitted(smooth, settled, scene)
    line = windows.fitted_by_parts(smooth, settled, windows.highest - scene)
    slopes, errors = [], []
    for index in range(len(smooth)):
        alone = _alone(smooth, index)
        enough = np.count_nonzero(alone) >= _FEWEST_WINDOWS
        own = windows.fitted(alone, line) if enough else _Line(math.nan, math.nan, 0.0)
        usable = math.isfinite(own.slope_error)
        slopes.append(own.slope if usable else math.nan)
        errors.append(own.slope_error if usable else math.nan)
    known = [(slope, error) for slope, error in zip(slopes, errors, strict=True) if math.isfinite(error)]
    differ, scatter = False, 0.0
    if len(known) > 1:
        own_slopes, own_errors = np.array(known).T
        mean = np.average(own_slopes, weights=own_errors**-2)
        square = float((((own_slopes - mean) / own_errors) ** 2).sum())
        differ = square > float(chi2.isf(_BY_CHANCE, len(known) - 1))
        scatter = float(own_slopes.std(ddof=1)) / math.sqrt(len(known)) if differ else 0.0
    return NoiseLine(
        slope=line.slope,
        slope_error=math.hypot(line.slope_error, texture.slope, scatter),
        offset=line.offset,
        offset_error=math.hypot(line.offset_error, texture.offset),
        windows=int(np.count_nonzero(smooth)),
        smooth_share=float(np.count_nonzero(smooth) / np.count_nonzero(windows.sound)),
        least_variance=line.least,
        channel_slopes=tuple(slopes),
        channel_slope_errors=tuple(errors),
        channels_differ=differ,
    )
