"""What two frames taken alike say of the noise: the numbers that a noise model's frames and a camera's are compared in.

Of two frames of one scene, the difference has what changes from frame to frame, and the product what stays: the first
knows nothing of the fixed pattern, the mean of the second knows nothing of the noise. Every number is one of a pair.
Pairs that share no frame are independent, whatever rows, columns and fixed pattern do within a frame: from pair to pair
a number scatters as it does, and no count of independent pixels is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.core._frames import channels_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Plane = NDArray[np.float32]

_REACH = 8  # standard deviations, at which values end: no single outlier decides anything
_LEAST_SPREAD_DN = 0.5  # quantiles of whole DN can agree
_BLOCK = (
    32  # pixels a side, whose means are the shading: whole periods of every CFA but X-Trans and nona, where it is 36
)
_AROUND = 16  # sites on each side, over which light is smoothed
# Cycles per line between which the spectrum's bands lie.
_LOW, _HIGH = 1 / 64, 1 / 8
_FEWEST_LINES = 4  # frequencies in the lowest band: one alone scatters by all of itself
_NOTHING = 1e-12  # DN^2: in decibels, as a power of 0 would be, of a model without noise
LAGS = ((0, 1), (0, 2), (1, 0), (2, 0), (1, 1), (2, 2))


@dataclass(frozen=True, slots=True, eq=False)
class FrameScale:
    """The levels and spreads that all frames are measured by: held-out frames give them, for both sides alike.

    Attributes
    ----------
    pattern
        The CFA's period, of channel numbers.
    level_dn
        (H, W) int32: each channel's median, whole DN.
    spread_dn, sigma_dn
        Half the distance of the 16th and the 84th percentile: of a frame's values over their channel's level, and of
        the difference of two frames over the square root of 2.
    """

    pattern: NDArray[np.int64]
    level_dn: NDArray[np.int32] = field(repr=False)
    spread_dn: float
    sigma_dn: float

    @classmethod
    def of(cls, first: NDArray[np.uint16], second: NDArray[np.uint16], pattern: NDArray[np.int64]) -> FrameScale:
        """Measure two frames."""
        channel = _channel(pattern, first.shape)
        levels = [int(np.median(first[channel == index])) for index in range(channels_of(pattern))]
        level = np.array(levels, dtype=np.int32)[channel]
        difference = np.subtract(first, second, dtype=np.int32)
        return cls(pattern, level, _half_width(first - level), _half_width(difference) / 2**0.5)

    @property
    def reach_dn(self) -> int:
        """How far from their channel's level values count."""
        return int(np.ceil(_REACH * self.spread_dn))

    @property
    def difference_reach_dn(self) -> int:
        """How far from 0 differences of two frames count."""
        return int(np.ceil(_REACH * 2**0.5 * self.sigma_dn))


@dataclass(frozen=True, slots=True, eq=False)
class PairFigures:
    """The numbers of one pair.

    Attributes
    ----------
    numbers
        By name.
    values, differences
        Counts of both frames' values over their channel's level, and of their differences, by whole DN from one end of
        the scale's reach to the other.
    row_power_dn2, column_power_dn2
        Periodograms of the row and the column means of the difference over the square root of 2; empty for flats.
    mean_dn
        (H, W) float32: mean of both frames, less their channels' means.
    sizes_dn
        (H, W) float32: the sizes of the differences, less their mean, over it.
    """

    numbers: dict[str, float]
    values: NDArray[np.int64] = field(repr=False)
    differences: NDArray[np.int64] = field(repr=False)
    row_power_dn2: NDArray[np.float64] = field(repr=False)
    column_power_dn2: NDArray[np.float64] = field(repr=False)
    mean_dn: Plane = field(repr=False)
    sizes_dn: Plane = field(repr=False)


def dark_pair(first: NDArray[np.uint16], second: NDArray[np.uint16], scale: FrameScale) -> PairFigures:
    """Measure two bias frames, (H, W) in DN, of the shape of the scale's."""
    whole = [_within(frame - scale.level_dn, scale.reach_dn) for frame in (first, second)]
    steps = _within(np.subtract(first, second, dtype=np.int32), scale.difference_reach_dn)
    (a, of_a), (b, of_b) = (_less_channels(values, scale.pattern) for values in whole)
    change, _ = _less_channels(steps, scale.pattern)
    change /= np.float32(2**0.5)
    variance = (_mean(a * a) + _mean(b * b)) / 2
    levels = scale.level_dn[: len(scale.pattern), : len(scale.pattern)]
    level_of = {int(channel): float(level) for channel, level in zip(scale.pattern.flat, levels.flat, strict=True)}
    numbers = {f"level {index}": level_of[index] + (of_a[index] + of_b[index]) / 2 for index in range(len(of_a))}
    numbers |= {
        "drift": abs(_mean(whole[0]) - _mean(whole[1])),
        "frame sigma": variance**0.5,
        "frame skewness": (_mean(a**3) + _mean(b**3)) / 2 / variance**1.5 if variance else 0.0,
        "sigma": _mean(change * change) ** 0.5,
    }
    lines, row_power, column_power = _lines(change, len(scale.pattern))
    numbers |= lines | _neighbours(change)
    numbers |= {
        "pattern": _mean(a * b),
        "pattern columns": _shared(a.mean(axis=0, dtype=np.float64), b.mean(axis=0, dtype=np.float64)),
        "pattern rows": _shared(a.mean(axis=1, dtype=np.float64), b.mean(axis=1, dtype=np.float64)),
        "pattern shading": _shared(*(_blocks(plane, len(scale.pattern)) for plane in (a, b))),
        "hot": float(np.mean(np.logical_and(*(np.abs(values) == scale.reach_dn for values in whole)))),
    }
    sizes = np.abs(change)
    size = np.float32(_mean(sizes))
    return PairFigures(
        numbers=numbers,
        values=_counts(whole[0], scale.reach_dn) + _counts(whole[1], scale.reach_dn),
        differences=_counts(steps, scale.difference_reach_dn),
        row_power_dn2=row_power,
        column_power_dn2=column_power,
        mean_dn=mean_of(a, b),
        sizes_dn=np.subtract(sizes / size, 1, dtype=np.float32) if size else np.zeros_like(sizes),
    )


@dataclass(frozen=True, slots=True, eq=False)
class FlatScale:
    """As :class:`FrameScale`, of flats of one exposure: the level of each channel in the dark, and the noise's spread.

    ``dark_dn`` is (H, W) float32: black level and colour bias, DN.
    """

    pattern: NDArray[np.int64]
    dark_dn: Plane = field(repr=False)
    sigma_dn: float

    @classmethod
    def of(
        cls, first: NDArray[np.uint16], second: NDArray[np.uint16], dark_dn: Plane, pattern: NDArray[np.int64]
    ) -> FlatScale:
        """Measure two flats."""
        return cls(pattern, dark_dn, _half_width(_scaled_difference(first, second, dark_dn)) / 2**0.5)

    @property
    def difference_reach_dn(self) -> int:
        """How far from 0 differences of two frames count."""
        return int(np.ceil(_REACH * 2**0.5 * self.sigma_dn))


def flat_pair(first: NDArray[np.uint16], second: NDArray[np.uint16], scale: FlatScale) -> PairFigures:
    """Measure two flats; the second is scaled to the first, whose light may differ a little."""
    steps = _within(
        np.rint(_scaled_difference(first, second, scale.dark_dn)).astype(np.int32), scale.difference_reach_dn
    )
    change, _ = _less_channels(steps, scale.pattern)
    change /= np.float32(2**0.5)
    signal = _mean(first - scale.dark_dn)
    mean = mean_of(first, second)
    light = smoothed(mean, scale.sigma_dn, scale.pattern)
    residuals = [_within(frame - light, 4 * scale.difference_reach_dn) for frame in (first, second)]
    (a, _), (b, _) = (_less_channels(values, scale.pattern) for values in residuals)
    variance = _mean(change * change)
    lines, row_power, column_power = _lines(change, len(scale.pattern))
    sizes = np.abs(change)
    return PairFigures(
        numbers={
            "transfer": variance / signal if signal > 0 else 0.0,
            "row halves": lines["row halves"],
            "pattern": _mean(a * b) / signal**2 if signal > 0 else 0.0,
        },
        values=np.zeros(0, dtype=np.int64),
        differences=_counts(steps, scale.difference_reach_dn),
        row_power_dn2=row_power,
        column_power_dn2=column_power,
        mean_dn=mean,
        sizes_dn=sizes,
    )


def mean_of(first: NDArray[Any], second: NDArray[Any]) -> Plane:
    """Return the mean of two frames, float32."""
    total: Plane = np.add(first, second, dtype=np.float32)
    total *= np.float32(0.5)
    return total


def smoothed(plane: Plane, sigma_dn: float, pattern: NDArray[np.int64]) -> Plane:
    """Return a plane whose every site of the CFA is the mean of the sites alike around it, 33 a side.

    Values further than four ``sigma_dn`` from a first such mean count as so far, or hot pixels would make the light
    around them brighter. Beyond its edges the plane goes on as straight as it ends: light falls off there.
    """
    from scipy.ndimage import uniform_filter

    def mean(values: Plane) -> Plane:
        wider = np.pad(values, _AROUND, mode="reflect", reflect_type="odd")
        inner = slice(_AROUND, -_AROUND)
        found: Plane = uniform_filter(wider, 2 * _AROUND + 1)[inner, inner]
        return found

    result = np.empty_like(plane)
    period = len(pattern)
    for row in range(period):
        for column in range(period):
            site = slice(row, None, period), slice(column, None, period)
            first = mean(plane[site])
            result[site] = mean(first + np.clip(plane[site] - first, -4 * sigma_dn, 4 * sigma_dn))
    return result


def same_sizes(first: PairFigures, second: PairFigures) -> float:
    """Return the covariance of the sizes that a pixel's differences have in two pairs, over the squared mean size.

    Where all pixels have the same noise it is 0, whatever the noise's distribution; otherwise the squared coefficient
    of variation of the pixels' noise: pixels that jump between two levels, or noise that differs from pixel to pixel.
    """
    return _mean(first.sizes_dn * second.sizes_dn)


def same_pattern(pair: PairFigures, pattern_dn: Plane) -> float:
    """Return the energy, DN^2, that a pair's mean shares with a mean of other frames."""
    return _mean(pair.mean_dn * pattern_dn)


def distance(counts: NDArray[np.int64], reference: NDArray[np.float64]) -> float:
    """Return the Kolmogorov-Smirnov distance of a histogram from the shares of another."""
    return float(np.abs(np.cumsum(counts) / max(int(counts.sum()), 1) - np.cumsum(reference)).max())


def tail_share(counts: NDArray[np.int64], threshold_dn: int, side: int) -> float:
    """Return the share beyond a threshold (values of that many DN and more): -1 below, 1 above, 0 on both sides."""
    middle = len(counts) // 2
    below = int(counts[: middle - threshold_dn + 1].sum()) if side <= 0 else 0
    above = int(counts[middle + threshold_dn :].sum()) if side >= 0 else 0
    return (below + above) / max(int(counts.sum()), 1)


def tail_threshold(shares: NDArray[np.float64], wanted: float, side: int) -> int:
    """Return the least threshold in DN beyond which there is at most so large a share."""
    middle = len(shares) // 2
    below, above = shares[middle::-1], shares[middle:]
    folded = (below if side <= 0 else 0) + (above if side >= 0 else 0)
    beyond = np.cumsum(np.asarray(folded)[::-1])[::-1]
    few = np.flatnonzero(beyond <= wanted)
    return int(few[0]) if few.size else middle


# --- parts --------------------------------------------------------------------------------------------------------


def _channel(pattern: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    repeats = -(-shape[0] // len(pattern)), -(-shape[1] // len(pattern))
    return np.tile(pattern, repeats)[: shape[0], : shape[1]]


def _scaled_difference(first: NDArray[np.uint16], second: NDArray[np.uint16], dark_dn: Plane) -> Plane:
    one, two = first - dark_dn, second - dark_dn
    sums = float(one.sum(dtype=np.float64)), float(two.sum(dtype=np.float64))
    difference: Plane = one - np.float32(sums[0] / sums[1] if sums[1] > 0 else 1.0) * two
    return difference


def _half_width(values: NDArray[Any]) -> float:
    low, high = np.quantile(values[:, ::3] if values.size > 1 << 18 else values, (0.159, 0.841))
    return max(float(high - low) / 2, _LEAST_SPREAD_DN)


def _within(values: NDArray[Any], reach: float) -> NDArray[Any]:
    return np.clip(values, -reach, reach, out=values)


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean(dtype=np.float64))


def _counts(values: NDArray[np.int32], reach: int) -> NDArray[np.int64]:
    return np.bincount((values + reach).ravel(), minlength=2 * reach + 1)


def _shared(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    return float(np.mean((first - first.mean()) * (second - second.mean())))


def _less_channels(values: NDArray[Any], pattern: NDArray[np.int64]) -> tuple[Plane, NDArray[np.float64]]:
    """Return values less their channel's mean, and those means."""
    period, channels = len(pattern), channels_of(pattern)
    sums, counts = np.zeros(channels), np.zeros(channels)
    for (y, x), channel in np.ndenumerate(pattern):
        site = values[y::period, x::period]
        sums[channel] += site.sum(dtype=np.float64)
        counts[channel] += site.size
    means = sums / counts
    plane = values.astype(np.float32)
    for (y, x), channel in np.ndenumerate(pattern):
        plane[y::period, x::period] -= np.float32(means[channel])
    return plane, means


def _lines(change: Plane, period: int) -> tuple[dict[str, float], NDArray[np.float64], NDArray[np.float64]]:
    """Return what rows and columns share, and the periodograms of their means.

    Bands of the spectra are in decibels: a band's power scatters in proportion to itself, and the more, the fewer its
    frequencies. As a logarithm it scatters alike on both sides, however different they are.
    """
    height, width = change.shape
    down, across = height // 2 // period * period, width // 2 // period * period
    colours = np.arange(width) % period < period / 2
    rows, columns = change.mean(axis=1, dtype=np.float64), change.mean(axis=0, dtype=np.float64)
    halves = [part.mean(axis=1, dtype=np.float64) for part in (change[:, :across], change[:, across:])]
    by_colour = [part.mean(axis=1, dtype=np.float64) for part in (change[:, colours], change[:, ~colours])]
    upright = [part.mean(axis=0, dtype=np.float64) for part in (change[:down], change[down:])]
    numbers = {
        "row halves": _shared(*halves),
        "row colours": _shared(*by_colour),
        "column halves": _shared(*upright),
    }
    of_rows, of_columns = (np.abs(np.fft.rfft(line)) ** 2 / len(line) for line in (rows, columns))
    for name, of_lines, lines in (("row", of_rows, height), ("column", of_columns, width)):
        low, high = max(int(_LOW * lines), _FEWEST_LINES) + 1, int(_HIGH * lines) + 1
        bands = {"low": of_lines[1:low], "middle": of_lines[low:high], "high": of_lines[high:]}
        numbers |= {
            f"{name} {band}": 10 * math.log10(max(float(values.mean()), _NOTHING)) for band, values in bands.items()
        }
    return numbers, of_rows, of_columns


def _neighbours(change: Plane) -> dict[str, float]:
    """Return correlations of neighbours, without what a whole row or column has in common."""
    own = change - change.mean(axis=1, keepdims=True)
    own -= own.mean(axis=0, keepdims=True)
    variance = _mean(own * own)
    height, width = own.shape
    return {
        f"lag {down} {across}": _mean(own[down:, across:] * own[: height - down, : width - across]) / variance
        if variance
        else 0.0
        for down, across in LAGS
    }


def _blocks(plane: Plane, period: int) -> NDArray[np.float64]:
    """Return the means of blocks."""
    side = -(-_BLOCK // period) * period
    down, across = plane.shape[0] // side, plane.shape[1] // side
    blocks = plane[: down * side, : across * side].reshape(down, side, across, side)
    means: NDArray[np.float64] = blocks.mean(axis=(1, 3), dtype=np.float64)
    return means
