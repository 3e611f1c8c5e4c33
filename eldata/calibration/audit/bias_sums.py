"""What the audit sees in bias frames: from pairs of them, in which everything that stays cancels exactly.

The frames are taken two by two. The half of a pair's squared difference is the noise's variance whatever the fixed
pattern, and two pairs know nothing of each other: if all pixels have the same noise, the size of a pixel's difference
in one pair says nothing about that in another, and nothing about the pixel's level in the other frames. Both hold
exactly, for noise of any distribution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.audit.neighbours import UNITS, Neighbours, standardised, variance_and_level
from eldata.calibration.core._frames import channels_of, sites
from eldata.calibration.core.single_frame import TILE
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.audit.neighbours import NeighbourStatistics
    from eldata.calibration.core._frames import Counts, Mosaic, Values
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import ColourBias, RowNoise

BLOCK = 48
"""Pixels a side of the blocks by whose scatter errors are told: whole periods of every CFA."""

_LIMIT = 8 * UNITS - 1
_CLIP = 4 * UNITS  # of the differences whose squares are summed: heavy tails then do no harm
_MOST_PIXELS = 1 << 22  # of a frame; of larger ones evenly spread bands of rows are looked at
_LEVEL_UNITS = 16  # of a pixel's level, to a spread
_MOST_PAIRS = 63  # their sizes fit a byte a pixel


def spread_bands(shape: tuple[int, ...], most: int) -> list[slice]:
    """Return bands of 48 rows, whole periods of the CFA, evenly spread over a frame."""
    rows, width = shape[0] // BLOCK, shape[1]
    step = max(1, math.ceil(rows * BLOCK * width / most))
    return [slice(place * BLOCK, (place + 1) * BLOCK) for place in range(0, rows, step)]


@dataclass(frozen=True, slots=True, eq=False)
class BiasStatistics:
    """What pairs of bias frames show, by block of 48 x 48 pixels; the noise's variance counts as 1.

    Attributes
    ----------
    pairs
        Of frames.
    sigma_dn
        Standard deviation of the noise of a frame, with rounding.
    level_dn
        (rows, columns): mean of the block over its channels' means.
    variance
        (rows, columns): of the noise over time, clipped at four standard deviations.
    level_score, level_freedom
        (rows, columns): sums of deviation of level times deviation of variance, and of squared deviations of level, of
        the pixels of a block from its mean. The level is that in the other frames, over ``spread_dn``.
    lower_score, lower_freedom
        (rows, columns): the same of those pixels whose level is below the mean.
    bend_score
        (rows, columns): sums of squared deviation of level times deviation of variance, less what the noise in the
        levels of noisier pixels gives: the third joint cumulant of level, level and variance. Where many pixels have a
        dark signal it is small beside ``level_score``; where few have one it is large.
    pixels
        (rows, columns): sound pixels.
    spread_dn
        Standard deviation of the pixels' levels.
    dsnu_dn
        The part of it that stays.
    unlikeness
        (rows, columns): covariance between the sizes that a pixel's differences have in two pairs, over the squared
        mean size. Where pixels differ in noise, it is the squared coefficient of variation of that noise.
    sizes
        Number of differences by size, in steps.
    totals
        (256,) number of pixels by the sum of the sizes over all pairs.
    neighbours
        How the noise depends on that of the neighbours.
    """

    pairs: int
    sigma_dn: float
    level_dn: Values = field(repr=False)
    variance: Values = field(repr=False)
    level_score: Values = field(repr=False)
    level_freedom: Values = field(repr=False)
    lower_score: Values = field(repr=False)
    lower_freedom: Values = field(repr=False)
    bend_score: Values = field(repr=False)
    pixels: Values = field(repr=False)
    spread_dn: float
    dsnu_dn: float
    unlikeness: Values = field(repr=False)
    sizes: Counts = field(repr=False)
    totals: Counts = field(repr=False)
    neighbours: NeighbourStatistics


class BiasAudit:
    """Accumulates :class:`BiasStatistics` of the bias frames that made a fixed pattern.

    The memory is a copy of every second frame and a byte a pixel, of 4 megapixels at most.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.

    Raises
    ------
    DatasetError
        If the frames are smaller than 256 x 256 pixels.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        height, width = fixed.total_dn.shape
        self._columns = width // BLOCK
        if height < TILE or width < TILE:
            raise DatasetError(f"the audit needs frames of {TILE} x {TILE} pixels or more; found {height} x {width}")
        self._fixed = fixed
        self._bands = spread_bands(fixed.total_dn.shape, _MOST_PIXELS)
        self._pairs = min(fixed.frames // 2, _MOST_PAIRS)
        self._step = math.ceil((_LIMIT + 1) / (255 // self._pairs + 1))
        sigma = np.sqrt(np.maximum(fixed.temporal_variance_dn2, 1e-6))
        self._sigma_dn = math.sqrt(float(np.mean(sigma**2)))
        self._of_difference = (UNITS / (math.sqrt(2) * sigma)).astype(np.float32)
        self._of_frame = (UNITS / (math.sqrt(fixed.frames * (fixed.frames - 1)) * sigma)).astype(np.float32)
        spread = np.hypot(sigma / math.sqrt(fixed.frames - 2), fixed.summary.dsnu_dn)
        self._spread_dn = float(spread.mean())
        channels = np.tile(fixed.pattern, self._columns * BLOCK // len(fixed.pattern))
        self._level_scale = (_LEVEL_UNITS / ((fixed.frames - 2) * spread)).astype(np.float32)[channels]
        measured = [self._levels(rows) for rows in self._bands]
        self._level_dn = np.stack([levels for levels, _ in measured])
        self._pixels = np.stack([pixels for _, pixels in measured])
        self._added = 0
        self._first: Mosaic | None = None
        blocks = len(self._bands), self._columns
        self._sums = np.zeros((9, *blocks))
        self._sizes = np.zeros(_LIMIT // self._step + 1, dtype=np.int64)
        self._totals = np.zeros((len(self._bands), BLOCK, width), dtype=np.uint8)
        self._neighbours = Neighbours(fixed.pattern)

    def _levels(self, rows: slice) -> tuple[Values, Values]:
        """Return the mean of the sound pixels of a band by block and channel, and by block how many they are."""
        fixed, width = self._fixed, self._columns * BLOCK
        sound = ~fixed.defects[rows, :width]
        total = fixed.total_dn[rows, :width] * sound
        sums, counts = np.zeros((2, self._columns, channels_of(fixed.pattern)))
        for site, channel in sites(fixed.pattern):
            for added, values in ((sums, total), (counts, sound)):
                added[:, channel] += values[site].sum(axis=0, dtype=np.int64).reshape(self._columns, -1).sum(axis=1)
        return sums / np.maximum(counts, 1) / fixed.frames, counts.sum(axis=1)

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        self._added += 1
        if self._added > 2 * self._pairs:
            return
        if self._first is None:
            self._first = np.stack([mosaic[rows] for rows in self._bands])
            return
        for index, rows in enumerate(self._bands):
            self._add_band(index, rows, self._first[index], mosaic[rows])
        self._first = None

    def _add_band(self, index: int, rows: slice, first: Mosaic, second: Mosaic) -> None:
        fixed, frames = self._fixed, self._fixed.frames
        total, defects, pattern = fixed.total_dn[rows], fixed.defects[rows], fixed.pattern
        band = np.empty(total.shape, dtype=np.int16)
        for frame in (first, second):
            standardised(frames, frame, total, defects, pattern, self._of_frame, _LIMIT, band)
            self._neighbours.add_frame(band)
        standardised(1, first, second, defects, pattern, self._of_difference, _LIMIT, band)
        self._neighbours.add_difference(band)

        phases = np.arange(self._columns * BLOCK) % len(pattern)
        by_column = np.repeat((frames - 2) * self._level_dn[index], BLOCK, axis=0)  # (columns, channels)
        level = by_column[np.arange(len(phases)), pattern[:, phases]].astype(np.float32)
        sums = np.zeros((self._columns, 10), dtype=np.int64)
        variance_and_level(band, total, first, second, defects, level, self._level_scale, BLOCK, _CLIP, sums)
        squares, levels, levels_squared, products, bends, *of_lower = sums.T.astype(np.float64)
        pixels = np.maximum(self._pixels[index], 1)
        mean = levels / pixels
        whole = (
            squares,
            products - mean * squares,
            levels_squared - mean * levels,
            bends - 2 * mean * products + (2 * mean**2 - levels_squared / pixels) * squares,
        )
        pixels, squares, levels, levels_squared, products = np.maximum(of_lower[0], 1), *of_lower[1:]
        lower = products - levels * squares / pixels, levels_squared - levels**2 / pixels

        sizes = (np.abs(band) // self._step).astype(np.uint8)
        self._totals[index] += sizes
        self._sizes += np.bincount(sizes.ravel(), minlength=self._sizes.size)
        of_blocks = _by_block(sizes, self._columns), _by_block(np.square(sizes, dtype=np.int64), self._columns)
        self._sums[:, index] += (*whole, *lower, *of_blocks, of_blocks[0].astype(np.float64) ** 2)

    def statistics(self) -> BiasStatistics:
        """Return what was found."""
        fixed, pairs = self._fixed, self._pairs
        # By band: numpy counts in copies of eight bytes a pixel.
        totals = np.zeros(256, dtype=np.int64)
        for of_band, rows in zip(self._totals, self._bands, strict=True):
            totals += np.bincount(of_band[~fixed.defects[rows]], minlength=256)
        pixels = np.maximum(self._pixels, 2)
        # Defects have no size, and so add to no sum; only to the count of size 0.
        sizes = self._sizes.copy()
        sizes[0] -= pairs * sum(np.count_nonzero(fixed.defects[rows]) for rows in self._bands)
        squares, score, freedom, bend, lower_score, lower_freedom, size_sums, size_squares, products = self._sums
        of_totals = np.stack([_by_block(np.square(band, dtype=np.int64), self._columns) for band in self._totals])
        # Products of sizes in two different pairs: of the same pixel, and of any two pixels of the block.
        same = of_totals - size_squares
        both = size_sums**2 - products
        covariance = (same / pixels - (both - same) / (pixels * (pixels - 1))) / (pairs * (pairs - 1))
        # A size stands for a step, whose middle lies half of one above it.
        mean = float(sizes @ np.arange(sizes.size) / sizes.sum()) + 0.5
        # The variance varies by four times as much as the size squared. A level has that of n - 2 frames' mean.
        of_noise = 4 * covariance / mean**2 * pixels * pairs * self._sigma_dn**2
        of_noise /= (fixed.frames - 2) * self._spread_dn**2
        return BiasStatistics(
            pairs=pairs,
            sigma_dn=self._sigma_dn,
            level_dn=(self._level_dn - np.array(fixed.level_dn)).mean(axis=2),
            variance=squares / (pairs * pixels) / UNITS**2,
            level_score=score / UNITS**2 / _LEVEL_UNITS,
            level_freedom=freedom / _LEVEL_UNITS**2,
            lower_score=lower_score / UNITS**2 / _LEVEL_UNITS,
            lower_freedom=lower_freedom / _LEVEL_UNITS**2,
            bend_score=bend / UNITS**2 / _LEVEL_UNITS**2 - of_noise,
            pixels=np.maximum(self._pixels, 1),
            spread_dn=self._spread_dn,
            dsnu_dn=float(np.mean(fixed.summary.dsnu_dn)),
            unlikeness=covariance / mean**2,
            sizes=sizes,
            totals=totals,
            neighbours=self._neighbours.statistics(),
        )


def _by_block(band: NDArray[Any], blocks: int) -> Counts:
    """Return the sums over each block of columns of a band."""
    sums: Counts = band[:, : blocks * BLOCK].reshape(len(band), blocks, BLOCK).sum(axis=(0, 2), dtype=np.int64)
    return sums


# --- rounding and steps -----------------------------------------------------------------------------------------------

GAPS = 0.02
"""Share of DN values that never occur, from which on it is told."""

_CENTRAL = (0.05, 0.95)
_FEW = 30  # occurrences per code, below which a gap may be chance
_COARSEST = 64  # DN: the largest step that is looked for
_STRAY = 1e-3  # of the differences: pixels that the camera has made up
_LEAST_SIGMA_STEPS = 0.1  # below, all is lost in rounding
_MANY_STEPS = 5  # above, a ripple is below one in a million


def missing_codes(mosaic: Mosaic, pattern: Counts) -> float:
    """Return the largest share, of any CFA site, of DN values that never occur though their neighbours do.

    A plain converter gives 0. Lossy compression by a curve leaves gaps in bright frames; multiplication after the
    conversion (the highest ISOs of some cameras, white balance) leaves them everywhere.
    """
    worst = 0.0
    period = len(pattern)
    for row in range(min(period, 2)):
        for column in range(min(period, 2)):
            counts = np.bincount(mosaic[row :: 2 * period, column::period].ravel())
            below = np.cumsum(counts)
            low, high = (int(np.searchsorted(below, share * int(below[-1]))) for share in _CENTRAL)
            inner = counts[low : high + 1]
            if inner.size < 8 or int(inner.sum()) < _FEW * inner.size:
                continue  # too few values, or too few of each, to tell a gap from chance
            worst = max(worst, float(np.count_nonzero(inner == 0)) / inner.size)
    return worst


def code_step(mosaic: Mosaic, pattern: Counts) -> int:
    """Return by how many DN the values of a bias frame step: 1, or 4 where 12 bits are stored as 14.

    Pixels of one column and CFA site, one period apart, differ by noise; all but one in a thousand of the differences
    are multiples of the step. Where fewer than a thousand differ, it is not known, and 1.
    """
    period = 2 * len(pattern)
    step = max(1, mosaic.shape[0] * mosaic.shape[1] // 2_000_000)
    block = mosaic[:, : mosaic.shape[1] // step].astype(np.int32)
    counts = np.bincount(np.abs(block[period:] - block[:-period]).ravel())
    counts[0] = 0
    changed = int(counts.sum())
    if changed < 1000:
        return 1
    multiples = (int(counts[::size].sum()) for size in range(_COARSEST, 0, -1))
    return next(
        size for size, kept in zip(range(_COARSEST, 0, -1), multiples, strict=True) if kept >= (1 - _STRAY) * changed
    )


@dataclass(frozen=True, slots=True)
class Ripple:
    """What rounding does to noise: how far its figures ripple as the mean goes from one step of the values to the next.

    Peak to peak: ``mean`` (of the values less the true one, in their standard deviations), ``variance`` and ``size``
    (the mean distance of two values) as shares of their means, and ``skewness``. They fall off exponentially with the
    noise: at 1 DN all are below a thousandth.
    """

    mean: float
    variance: float
    size: float
    skewness: float

    @classmethod
    def of(cls, shape: float, sigma_steps: float) -> Ripple:
        """Work it out for a Tukey-lambda distribution of this shape, and scale in steps of the values."""
        from eldata.calibration.core._tukey_lambda import smoothed_tails

        if not sigma_steps > _LEAST_SIGMA_STEPS:
            return cls(math.inf, math.inf, math.inf, math.inf)
        if sigma_steps > _MANY_STEPS:
            return cls(0.0, 0.0, 0.0, 0.0)
        values = np.arange(-math.ceil(20 + 30 * sigma_steps), math.ceil(20 + 30 * sigma_steps) + 1)
        figures = []
        for mean in np.arange(16) / 16:
            edges = np.append(values - 0.5, values[-1] + 0.5) - mean
            chances = -np.diff(smoothed_tails(edges, shape, sigma_steps, np.zeros(1), np.ones(1)))
            level = float(chances @ values)
            variance = float(chances @ (values - level) ** 2)
            distances = np.abs(np.arange(2 * values[0], 2 * values[-1] + 1))
            cubes = np.clip((values - level) / math.sqrt(max(variance, 1e-12)), -8, 8) ** 3
            figures.append(
                (level - mean, variance, float(np.convolve(chances, chances[::-1]) @ distances), float(chances @ cubes))
            )
        table = np.array(figures)
        typical, ripple = table.mean(axis=0), np.ptp(table, axis=0)
        mean, variance, size = ripple[:3] / (math.sqrt(typical[1]), typical[1], typical[2])
        return cls(float(mean), float(variance), float(size), float(ripple[3]))


@dataclass(frozen=True, eq=False)
class BiasSeen:
    """What the checks of bias frames are told.

    Attributes
    ----------
    statistics
        What :class:`~eldata.calibration.audit.bias_sums.BiasAudit` has summed up.
    bias, rows, read
        The figures from the same frames, with their errors: a finding that matters less is a remark.
    step, gaps
        What :func:`code_step` and :func:`missing_codes` say of a frame.
    is_clipped
        Whether values end at 0. The clip makes noise smaller where the level is lower, and goes for one side alone, so
        that neither tells of light, unlike pixels or lopsided noise.
    gain_dn_per_e
        K, if it is known: dark current makes the variance grow by it with each DN, and two levels by what they like.
    """

    statistics: BiasStatistics
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise
    step: int = 1
    gaps: float = 0.0
    is_clipped: bool = False
    gain_dn_per_e: float | None = None

    @cached_property
    def ripple(self) -> Ripple:
        """What rounding does to the noise."""
        return Ripple.of(self.read.tukey_lambda, self.read.sigma_tl_dn / self.step_dn)

    @property
    def step_dn(self) -> float:
        """How far recorded values lie apart in the mean."""
        return self.step if self.step > 1 else 1 / (1 - self.gaps)

    @property
    def read_error(self) -> float:
        """The smallest relative error among the figures of the read noise."""
        read = self.read
        of_scales = read.sigma_tl_error_dn / read.sigma_tl_dn, read.sigma_gauss_error_dn / read.sigma_gauss_dn
        return min(read.tukey_lambda_error, *of_scales)
