"""What two frames taken alike say of the noise: the numbers that a noise model's frames and a camera's are compared in.

Of two frames of one scene, the difference has what changes from frame to frame, and the product what stays: the first
knows nothing of the fixed pattern, the mean of the second knows nothing of the noise. Every number is one of a pair.
Pairs that share no frame are independent, whatever rows, columns and fixed pattern do within a frame: from pair to pair
a number scatters as it does, and no count of independent pixels is needed.

A number is named where it is measured, by the check, the symbol and the unit that tables give it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from eldata.calibration.acceptance.verdicts import CHANNELS
from eldata.calibration.audit.frames import FrameFigures, problem_of
from eldata.calibration.core._frames import by_pixel, channels_of, sites
from eldata.calibration.frames import FrameReader
from eldata.calibration.reproduction import compared_piece

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Mosaic, Plane, Values
    from eldata.datasets.calibration_frames import FlatPair
    from eldata.manifest.verify_report import Problem
    from eldata.records import FrameRecord


Name = tuple[str, str, str]

# What is measured against the model's reference, once that is known; flats have no check of their own name.
FRAME_KS: Final[Name] = ("one frame", "distance of values (KS)", "1")
KS: Final[Name] = ("difference of two", "distance of values (KS)", "1")
FLAT_KS: Final[Name] = ("flats", "distance of values (KS)", "1")
SAME_PATTERN: Final[Name] = ("fixed pattern", "energy in common with the model's", "DN^2")
HOT: Final[Name] = ("fixed pattern", "share of hot pixels", "1")

_REACH = 8  # standard deviations, at which values end: no single outlier decides anything
_LEAST_SPREAD_DN = 0.5  # quantiles of whole DN can agree
_BLOCK = 32  # pixels a side, whose means are the shading: whole periods of every CFA but X-Trans and nona: there 36
_AROUND = 16  # sites on each side, over which light is smoothed
# Cycles per line between which the spectrum's bands lie.
_LOW, _HIGH = 1 / 64, 1 / 8
_FEWEST_LINES = 4  # frequencies in the lowest band: one alone scatters by all of itself
_NOTHING = 1e-12  # DN^2: in decibels, as a power of 0 would be, of a model without noise
_LAGS = ((0, 1), (0, 2), (1, 0), (2, 0), (1, 1), (2, 2))


@dataclass(frozen=True, slots=True, eq=False)
class PairScale:
    """The levels and spreads that all frames are measured by: held-out frames give them, for both sides alike.

    Attributes
    ----------
    pattern
        The CFA's period, of channel numbers.
    level_dn
        (H, W): of bias frames each channel's median, int32; of flats that of no light, black and colour bias, float32.
    sigma_dn, spread_dn
        Half the distance of the 16th and the 84th percentile: of the difference of two frames over the square root of
        2, and of a bias frame's values over their channel's level.
    """

    pattern: Counts
    level_dn: NDArray[Any] = field(repr=False)
    sigma_dn: float
    spread_dn: float = 0.0

    @classmethod
    def of_bias(cls, first: Mosaic, second: Mosaic, pattern: Counts) -> PairScale:
        """Measure two bias frames."""
        channels = range(channels_of(pattern))
        channel = by_pixel(np.array(channels), pattern, first.shape)
        medians = np.array([int(np.median(first[channel == index])) for index in channels], dtype=np.int32)
        level = by_pixel(medians, pattern, first.shape)
        difference = np.subtract(first, second, dtype=np.int32)
        return cls(pattern, level, _half_width(difference) / 2**0.5, _half_width(first - level))

    @classmethod
    def of_flats(cls, first: Mosaic, second: Mosaic, dark_dn: Plane, pattern: Counts) -> PairScale:
        """Measure two flats of one exposure, with the level of no light."""
        return cls(pattern, dark_dn, _half_width(_scaled_difference(first, second, dark_dn)) / 2**0.5)

    @property
    def reach_dn(self) -> int:
        """How far from their channel's level values count."""
        return int(np.ceil(_REACH * self.spread_dn))

    @property
    def difference_reach_dn(self) -> int:
        """How far from 0 differences of two frames count."""
        return int(np.ceil(_REACH * 2**0.5 * self.sigma_dn))


@dataclass(slots=True, eq=False)
class PairFigures:
    """The numbers of one pair.

    Attributes
    ----------
    numbers
        By name, in the order of the tables; nan for what only the model's reference tells.
    values, differences
        Counts of both frames' values over their channel's level (not of flats), and of their differences, by whole DN
        from one end of the scale's reach to the other.
    row_power_dn2, column_power_dn2
        Periodograms of the row and the column means of the difference over the square root of 2.
    mean_dn
        (H, W) float32: mean of both frames, less their channels' means.
    sizes_dn
        (H, W) float32: the sizes of the differences, less their mean, over it.
    """

    numbers: dict[Name, float]
    differences: Counts = field(repr=False)
    row_power_dn2: Values = field(repr=False)
    column_power_dn2: Values = field(repr=False)
    mean_dn: Plane = field(repr=False)
    sizes_dn: Plane = field(repr=False)
    values: Counts = field(repr=False, default_factory=lambda: np.zeros(0, dtype=np.int64))


def level_names(channels: int) -> list[Name]:
    """Return the names of the channels' levels."""
    return [("level", f"mean of {name}", "DN") for name in (CHANNELS if channels == len(CHANNELS) else "RGB")]


def dark_pair(first: Mosaic, second: Mosaic, scale: PairScale) -> PairFigures:
    """Measure two bias frames, (H, W) in DN, of the shape of the scale's."""
    pattern, period = scale.pattern, len(scale.pattern)
    whole = [_within(frame - scale.level_dn, scale.reach_dn) for frame in (first, second)]
    steps = _within(np.subtract(first, second, dtype=np.int32), scale.difference_reach_dn)
    (a, of_a), (b, of_b) = (_less_channels(values, pattern) for values in whole)
    change, _ = _less_channels(steps, pattern)
    change /= np.float32(2**0.5)
    variance = (_mean(a * a) + _mean(b * b)) / 2
    levels = scale.level_dn[:period, :period]
    level_of = {int(channel): float(level) for channel, level in zip(pattern.flat, levels.flat, strict=True)}
    numbers = {
        name: level_of[index] + (of_a[index] + of_b[index]) / 2 for index, name in enumerate(level_names(len(of_a)))
    }
    lines, row_power, column_power = _lines(change, period)
    in_blocks = (_blocks(plane, period) for plane in (a, b))
    numbers |= {
        ("level", "from frame to frame", "DN"): abs(_mean(whole[0]) - _mean(whole[1])),
        ("one frame", "standard deviation", "DN"): variance**0.5,
        ("one frame", "skewness", "1"): (_mean(a**3) + _mean(b**3)) / 2 / variance**1.5 if variance else 0.0,
        FRAME_KS: math.nan,
        ("difference of two", "standard deviation", "DN"): _mean(change * change) ** 0.5,
        KS: math.nan,
        **lines,
        **_neighbours(change),
        ("fixed pattern", "energy", "DN^2"): _mean(a * b),
        ("fixed pattern", "energy of columns", "DN^2"): _shared(*(f.mean(axis=0, dtype=np.float64) for f in (a, b))),
        ("fixed pattern", "energy of rows", "DN^2"): _shared(*(f.mean(axis=1, dtype=np.float64) for f in (a, b))),
        ("fixed pattern", "energy of shading", "DN^2"): _shared(*in_blocks),
        SAME_PATTERN: math.nan,
        HOT: float(np.mean(np.logical_and(*(np.abs(values) == scale.reach_dn for values in whole)))),
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


def flat_pair(first: Mosaic, second: Mosaic, scale: PairScale) -> PairFigures:
    """Measure two flats; the second is scaled to the first, whose light may differ a little."""
    reach = scale.difference_reach_dn
    steps = _within(np.rint(_scaled_difference(first, second, scale.level_dn)).astype(np.int32), reach)
    change, _ = _less_channels(steps, scale.pattern)
    change /= np.float32(2**0.5)
    signal = _mean(first - scale.level_dn)
    mean = mean_of(first, second)
    light = smoothed(mean, scale.sigma_dn, scale.pattern)
    residuals = [_within(frame - light, 4 * reach) for frame in (first, second)]
    (a, _), (b, _) = (_less_channels(values, scale.pattern) for values in residuals)
    variance = _mean(change * change)
    lines, row_power, column_power = _lines(change, len(scale.pattern))
    return PairFigures(
        numbers={
            ("flats", "variance over mean", "DN"): variance / signal if signal > 0 else 0.0,
            FLAT_KS: math.nan,
            ("flats", "shared by halves of a row", "DN^2"): lines[_ROW_HALVES],
            ("flats", "fixed pattern over signal^2", "1"): _mean(a * b) / signal**2 if signal > 0 else 0.0,
        },
        differences=_counts(steps, reach),
        row_power_dn2=row_power,
        column_power_dn2=column_power,
        mean_dn=mean,
        sizes_dn=np.abs(change),
    )


def mean_of(first: NDArray[Any], second: NDArray[Any]) -> Plane:
    """Return the mean of two frames, float32."""
    total: Plane = np.add(first, second, dtype=np.float32)
    total *= np.float32(0.5)
    return total


def smoothed(plane: Plane, sigma_dn: float, pattern: Counts) -> Plane:
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
    for site, _ in sites(pattern):
        first = mean(plane[site])
        result[site] = mean(first + np.clip(plane[site] - first, -4 * sigma_dn, 4 * sigma_dn))
    return result


def shared_energy(first: Plane, second: Plane) -> float:
    """Return the mean product of two planes: of the means of two sets of frames, the energy that they share, DN^2.

    Of the sizes of a pixel's differences in two pairs it is their covariance over the squared mean size. Where all
    pixels have the same noise that is 0, whatever the noise's distribution; otherwise the squared coefficient of
    variation of the pixels' noise: pixels that jump between two levels, or noise that differs from pixel to pixel.
    """
    return _mean(first * second)


def distance(counts: Counts, reference: Values) -> float:
    """Return the Kolmogorov-Smirnov distance of a histogram from the shares of another."""
    return float(np.abs(np.cumsum(counts) / max(int(counts.sum()), 1) - np.cumsum(reference)).max())


def tail_share(counts: Counts, threshold_dn: int, side: int) -> float:
    """Return the share beyond a threshold (values of that many DN and more): -1 below, 1 above, 0 on both sides."""
    middle = len(counts) // 2
    below = int(counts[: middle - threshold_dn + 1].sum()) if side <= 0 else 0
    above = int(counts[middle + threshold_dn :].sum()) if side >= 0 else 0
    return (below + above) / max(int(counts.sum()), 1)


def tail_threshold(shares: Values, wanted: float, side: int) -> int:
    """Return the least threshold in DN beyond which there is at most so large a share."""
    middle = len(shares) // 2
    below, above = shares[middle::-1], shares[middle:]
    folded = (below if side <= 0 else 0) + (above if side >= 0 else 0)
    beyond = np.cumsum(np.asarray(folded)[::-1])[::-1]
    few = np.flatnonzero(beyond <= wanted)
    return int(few[0]) if few.size else middle


# --- the camera's ---------------------------------------------------------------------------------------------------


class HeldOutFrames(FrameReader):
    """Reads the frames of one ISO, a pair at a time and no copies, and collects what is wrong with them."""

    def bias_pairs(self, records: Sequence[FrameRecord]) -> Iterator[tuple[Mosaic, Mosaic]]:
        """Yield pairs of pieces of bias frames that share no frame."""
        first: Mosaic | None = None
        for record, frame in self.read_new(records):
            self.problems += clipped_black(record, frame.mosaic)
            self.figures.append(FrameFigures.of(record, frame.mosaic))
            piece = self.cut(frame.mosaic)
            del frame  # before the next one is decoded
            if first is None:
                first = piece
            else:
                yield first, piece
                first = None

    def flats(self, pair: FlatPair) -> tuple[Mosaic, Mosaic] | None:
        """Return a pair of whole flats."""
        found = [frame.mosaic for _, frame in self.read_new((pair.first, pair.second))]
        return (found[0], found[1]) if len(found) == 2 else None

    def cut(self, mosaic: Mosaic) -> Mosaic:
        """Return a copy of the piece that is compared."""
        return compared_piece(mosaic, len(self.sensor.cfa))


# --- parts --------------------------------------------------------------------------------------------------------


def _scaled_difference(first: Mosaic, second: Mosaic, dark_dn: Plane) -> Plane:
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


def _counts(values: NDArray[np.int32], reach: int) -> Counts:
    return np.bincount((values + reach).ravel(), minlength=2 * reach + 1)


def _shared(first: Values, second: Values) -> float:
    return float(np.mean((first - first.mean()) * (second - second.mean())))


def _less_channels(values: NDArray[Any], pattern: Counts) -> tuple[Plane, Values]:
    """Return values less their channel's mean, and those means."""
    sums, counts = np.zeros((2, channels_of(pattern)))
    for site, channel in sites(pattern):
        sums[channel] += values[site].sum(dtype=np.float64)
        counts[channel] += values[site].size
    means = sums / counts
    plane = values.astype(np.float32)
    for site, channel in sites(pattern):
        plane[site] -= np.float32(means[channel])
    return plane, means


_ROW_HALVES: Final[Name] = ("rows", "shared by left and right half", "DN^2")


def _lines(change: Plane, period: int) -> tuple[dict[Name, float], Values, Values]:
    """Return what rows and columns share, and the periodograms of their means.

    Bands of the spectra are in decibels: a band's power scatters in proportion to itself, and the more, the fewer its
    frequencies. As a logarithm it scatters alike on both sides, however different they are.
    """
    height, width = change.shape
    down, across = height // 2 // period * period, width // 2 // period * period
    colours = np.arange(width) % period < period / 2

    def shared(axis: int, *parts: Plane) -> float:
        return _shared(*(part.mean(axis=axis, dtype=np.float64) for part in parts))

    def spectrum(check: str, axis: int) -> tuple[dict[Name, float], Values]:
        line = change.mean(axis=1 - axis, dtype=np.float64)
        power = np.abs(np.fft.rfft(line)) ** 2 / len(line)
        low, high = max(int(_LOW * len(line)), _FEWEST_LINES) + 1, int(_HIGH * len(line)) + 1
        bands = {"low": power[1:low], "middle": power[low:high], "high": power[high:]}
        return {
            (check, f"spectrum, {band} frequencies", "dB"): 10 * math.log10(max(float(values.mean()), _NOTHING))
            for band, values in bands.items()
        }, power

    (of_rows, row_power), (of_columns, column_power) = spectrum("rows", 0), spectrum("columns", 1)
    numbers = {
        _ROW_HALVES: shared(1, change[:, :across], change[:, across:]),
        ("rows", "shared by their colours", "DN^2"): shared(1, change[:, colours], change[:, ~colours]),
        **of_rows,
        ("columns", "shared by upper and lower half", "DN^2"): shared(0, change[:down], change[down:]),
        **of_columns,
    }
    return numbers, row_power, column_power


def _neighbours(change: Plane) -> dict[Name, float]:
    """Return correlations of neighbours, without what a whole row or column has in common."""
    own = change - change.mean(axis=1, keepdims=True)
    own -= own.mean(axis=0, keepdims=True)
    variance = _mean(own * own)
    height, width = own.shape
    return {
        ("neighbours", f"correlation {down} down, {across} across", "1"): _mean(
            own[down:, across:] * own[: height - down, : width - across]
        )
        / variance
        if variance
        else 0.0
        for down, across in _LAGS
    }


def _blocks(plane: Plane, period: int) -> Values:
    """Return the means of blocks."""
    side = -(-_BLOCK // period) * period
    down, across = plane.shape[0] // side, plane.shape[1] // side
    blocks = plane[: down * side, : across * side].reshape(down, side, across, side)
    means: Values = blocks.mean(axis=(1, 3), dtype=np.float64)
    return means


_CLIPPED_SHARE = 0.01  # of pixels at 0 DN


def clipped_black(record: FrameRecord, mosaic: Mosaic) -> list[Problem]:
    """Return a problem if more than 1 % of a bias frame's pixels are 0, where whole noise is needed."""
    share = (mosaic.size - int(np.count_nonzero(mosaic))) / mosaic.size
    if share <= _CLIPPED_SHARE:
        return []
    return [
        problem_of(
            record,
            "black",
            "noise on both sides of a black level above 0",
            f"{share:.0%} of the pixels at 0 DN",
            "black is clipped in this file, and half of the noise cannot be compared: use raw files that keep the "
            "black level; a calibration takes these",
        )
    ]
