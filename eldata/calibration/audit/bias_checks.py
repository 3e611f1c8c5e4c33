"""Which assumptions about the bias frames do not hold: light in them, noise that neighbours share, coarse values.

The frames are taken two by two: the half of a pair's squared difference is the noise's variance whatever the fixed
pattern. The chance that a check speaks of frames without its fault is below one in 100,000, so that a camera of a dozen
ISOs does not meet one; thresholds follow from that and from the number of blocks, pixels and frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.audit.neighbours import LIMIT, UNITS, Neighbours
from eldata.calibration.core._kernels import channel_histograms, standardise
from eldata.calibration.core._tukey_lambda import Ripple
from eldata.calibration.core.findings import CHANCE, COARSE, CORRELATED, LIGHT
from eldata.calibration.core.read_noise import read_noise
from eldata.calibration.core.single_frame import TILE
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from eldata.calibration.audit.neighbours import NeighbourStatistics
    from eldata.calibration.core._frames import Counts, Mask, Mosaic, Values
    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.findings import Figure, Finding
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import ColourBias, RowNoise

BLOCK = 48
"""Pixels a side of the blocks by whose scatter errors are told: whole periods of every CFA."""

_CLIP = 4 * UNITS  # of the differences whose squares are summed: heavy tails then do no harm
_MOST_PIXELS = 1 << 22  # of a frame; of larger ones evenly spread bands of rows are looked at
_LOW_SHARE = 0.05  # of the blocks, the darkest: taken for those without light
_MOST_OF_BIAS_DN = 0.5  # that light may add to the colour bias; in loud noise this share of its standard deviation
_MOST_OF_BIAS = 0.2
_OF_LIGHTER_TAILS = 2.0  # what is added to the noise makes its tails lighter: sigma_TL goes up by so much of sigma_G's
_MOST_RIPPLE = 0.02  # of the variance

_CENTRAL = (0.05, 0.95)
_FEW = 30  # occurrences per code, below which a gap may be chance
_WIDE = 4  # times the most frequent gap
_UNEVEN = 1.02  # DN
_COARSEST = 64  # DN: the largest step that is looked for
_STRAY = 1e-3  # of these: pixels that the camera has made up
_FEWEST_CHANGED = 1000


@dataclass(frozen=True, slots=True, eq=False)
class BiasStatistics:
    """What pairs of bias frames show, by block of 48 x 48 pixels.

    A block counts twice: with the level of every second period of its columns and the variance of the others, and the
    other way round. So a pixel that is both brighter and noisier than the others, by telegraph noise or dark current of
    its own, does not tie the two.

    Attributes
    ----------
    sigma_dn
        Standard deviation of the noise of a frame, with rounding.
    level_dn
        (2, rows, columns): mean of one half of the block over its channels' means.
    variance
        (2, rows, columns): of the other half's noise over time, clipped at four standard deviations; the mean one
        counts as 1.
    neighbours
        How the noise depends on that of the neighbours.
    codes
        (channels, 65536) sound pixels by value.
    """

    sigma_dn: float
    level_dn: Values = field(repr=False)
    variance: Values = field(repr=False)
    neighbours: NeighbourStatistics
    codes: Counts = field(repr=False)


class BiasAudit:
    """Accumulates :class:`BiasStatistics` of the bias frames that made a fixed pattern.

    The memory is a copy of every second frame, of 4 megapixels at most.

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
        if height < TILE or width < TILE:
            raise DatasetError(f"the audit needs frames of {TILE} x {TILE} pixels or more; found {height} x {width}")
        self._fixed, rows = fixed, height // BLOCK
        self._width = width // BLOCK * BLOCK
        step = max(1, math.ceil(rows * BLOCK * width / _MOST_PIXELS))
        self._bands = [slice(place * BLOCK, (place + 1) * BLOCK) for place in range(0, rows, step)]
        sigma = np.sqrt(np.maximum(fixed.temporal_variance_dn2, 1e-6))
        self._sigma_dn = math.sqrt(float(np.mean(sigma**2)))
        self._scale = (UNITS / (math.sqrt(2) * sigma)).astype(np.float32)
        self._halves = [np.arange(self._width) // len(fixed.pattern) % 2 == half for half in (0, 1)]
        self._first: Mosaic | None = None
        self._squares = np.zeros((2, len(self._bands), self._width // BLOCK))
        self._pairs = 0
        self._neighbours = Neighbours(fixed.pattern)
        self._codes = np.zeros((len(fixed.level_dn), 65536), dtype=np.int64)

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        for rows in self._bands:
            channel_histograms(mosaic[rows], self._fixed.defects[rows], self._fixed.pattern, self._codes[None])
        if self._first is None:
            self._first = np.stack([mosaic[rows] for rows in self._bands])
            return
        for index, rows in enumerate(self._bands):
            band = np.empty(self._first[index].shape, dtype=np.int16)
            defects, pattern = self._fixed.defects[rows], self._fixed.pattern
            standardise(self._first[index], mosaic[rows], defects, pattern, self._scale, LIMIT, band)
            self._neighbours.add(band)
            values = np.clip(band[:, : self._width], -_CLIP, _CLIP).astype(np.int32)
            values *= values
            for half, chosen in enumerate(self._halves):
                self._squares[half, index] += _by_block(values * ~chosen)
        self._first = None
        self._pairs += 1

    def statistics(self) -> BiasStatistics:
        """Return what was found."""
        fixed, width, period = self._fixed, self._width, len(self._fixed.pattern)
        own = np.array(fixed.level_dn)[np.tile(fixed.pattern, (BLOCK // period, width // period))]
        levels, pixels = np.zeros((2, *self._squares.shape))
        for index, rows in enumerate(self._bands):
            sound = ~fixed.defects[rows, :width]
            above = np.where(sound, fixed.total_dn[rows, :width] / fixed.frames - own, 0.0)
            for half, chosen in enumerate(self._halves):
                levels[half, index] = _by_block(above * chosen) / np.maximum(_by_block(sound & chosen), 1)
                pixels[half, index] = np.maximum(_by_block(sound & ~chosen), 1)
        variance = self._squares / (self._pairs * pixels) / UNITS**2
        return BiasStatistics(self._sigma_dn, levels, variance, self._neighbours.statistics(), self._codes)


def _by_block(band: NDArray[Any]) -> NDArray[Any]:
    """Return the sums over each block of columns of a band."""
    sums: NDArray[Any] = band.reshape(len(band), -1, BLOCK).sum(axis=(0, 2))
    return sums


@dataclass(frozen=True, eq=False)
class BiasSeen:
    """What the checks of bias frames are told.

    Attributes
    ----------
    statistics
        What :class:`BiasAudit` has summed up.
    bias, rows, read
        The figures from the same frames, with their errors: a finding that matters less is a remark.
    step_dn
        By how many DN the values step: what :func:`code_step` says, or of uneven steps :func:`mean_step`.
    """

    statistics: BiasStatistics
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise
    step_dn: float = 1.0

    @cached_property
    def ripple(self) -> Ripple:
        """What rounding does to the noise."""
        return Ripple.of(self.read.tukey_lambda, self.read.sigma_tl_dn / self.step_dn)

    def of_read_noise(self, share: float) -> dict[Figure, tuple[float, float]]:
        """Return by which share its figures may be off, with the smallest relative error among them."""
        read = self.read
        of_scales = read.sigma_tl_error_dn / read.sigma_tl_dn, read.sigma_gauss_error_dn / read.sigma_gauss_dn
        error = min(read.tukey_lambda_error, *of_scales)
        return {"shape": (share, error), "read noise": (share, error)}


def bias_findings(seen: BiasSeen) -> tuple[Finding, ...]:
    """Return what the bias frames' noise says against what the estimates take for granted."""
    return tuple(finding for check in (light, correlated, coarse_values) for finding in check(seen))


def light(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if the variance of blocks grows with their level, as that of light and dark current does.

    Shading without light has no such slope. Least squares over the blocks; their variances are means of thousands of
    squares clipped at four standard deviations, so that the slope over its standard error follows Student's t. A smooth
    shading (of second order) would hide a faint light, so the slope is also taken with one allowed for: two tests.
    """
    from scipy.special import stdtrit

    statistics = seen.statistics
    level, variance = statistics.level_dn, statistics.variance.ravel()
    _, rows, columns = level.shape
    _, y, x = np.meshgrid((0, 1), np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    flat = np.ones((level.size, 1))
    smooth = np.stack([part.ravel() for part in (np.ones_like(x), x, y, x * y, x**2, y**2)], axis=1)
    slopes = (_slope(level.ravel(), variance, beside, seen.ripple) for beside in (flat, smooth))
    statistic, slope, over_dark = max(slopes, key=lambda one: one[0])
    threshold = float(stdtrit(level.size - 7, 1 - CHANCE / 2))
    if statistic <= threshold:
        return
    share = 0.5 * slope * over_dark
    text = (
        f"light or dark current in the bias frames: where they are brighter, their noise is larger "
        f"({slope * statistics.sigma_dn**2:.2g} DN^2 for each DN), which adds {share:.1%} or more to the read noise; "
        "cap the lens, cover the viewfinder, and take them in the dark at the shortest exposure"
    )
    yield from LIGHT.judged(statistic, threshold, text, seen.of_read_noise(share))
    of_bias = LIGHT.seen(statistic, threshold, text)
    if over_dark > max(_MOST_OF_BIAS_DN, _MOST_OF_BIAS * statistics.sigma_dn):
        yield of_bias.of("withheld", ("colour bias",), over_dark)
    elif over_dark > min(seen.bias.standard_error_dn):
        yield of_bias.of("wider", ("colour bias",), over_dark)


def _slope(level: Values, variance: Values, beside: Values, ripple: Ripple) -> tuple[float, float, float]:
    """Return t of the slope of variance over level, the slope, and the mean level over the darkest blocks'.

    A variance that ripples with the level by r, from rounding, has a slope over the level in standard deviations of r /
    2 at most.
    """
    own, noise = (values - beside @ np.linalg.lstsq(beside, values, rcond=None)[0] for values in (level, variance))
    spread = float(own @ own)
    slope = float(own @ noise) / spread
    left = noise - slope * own
    error = math.sqrt(float(left @ left) / (level.size - beside.shape[1] - 1) / spread)
    by_rounding = ripple.variance / 2 / math.sqrt(spread / level.size)
    return (slope - by_rounding) / error, slope, float(own.mean() - np.quantile(own, _LOW_SHARE))


def correlated(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if neighbouring pixels share noise in the bias frames.

    Beside what a filter takes from the pixels, the mean of a row's pixels scatters by more, or less, than that of as
    many independent ones, which the row noise is measured against.
    """
    near, rows = seen.statistics.neighbours, seen.rows
    statistic, threshold = _largest(near, seen.ripple)
    if statistic <= threshold:
        return
    share = abs(math.sqrt(1 + 2 * _sum_of(near)) - 1)
    line = rows.rows
    of_pixels = 2 * _sum_of(near, near.lags[:, 0] == 0) * rows.pixel_variance_dn2 / len(rows.columns.fixed_dn)
    of_rows = math.hypot(share, of_pixels / (2 * max(line.variance_dn2, 1e-12)))
    error = line.sigma_error_dn / max(line.sigma_dn, 1e-12)
    shares = {**seen.of_read_noise(share), "row noise": (of_rows, error)}
    largest = near.correlation[np.abs(near.correlation).argmax()]
    text = (
        f"neighbouring pixels share noise in the bias frames (correlation {largest:.3f}): the camera or a converter "
        "has filtered these files, or the sensor mixes neighbours; use files without noise reduction and resampling"
    )
    yield from CORRELATED.judged(statistic, threshold, text, shares)


def _largest(near: NeighbourStatistics, ripple: Ripple) -> tuple[float, float]:
    """Return the largest of the correlations, and of their two sums along the axes, over its error; and the limit.

    The error needs no assumption on the distribution, and sums of so many products are normal. Where row noise moves
    neighbours of one level over the steps of the values together, they share a mean that ripples by r, and so a
    correlation of r^2 / 4 at most.
    """
    from scipy.special import ndtri

    axes = (near.correlation[_at(near, (0, size)) | _at(near, (size, 0))].sum() / math.sqrt(2) for size in (1, 2))
    tests = (np.abs(np.array([*near.correlation, *axes])) - ripple.mean**2 / 4) / near.error
    return float(tests.max()), -float(ndtri(CHANCE / 2 / tests.size))


def _at(near: NeighbourStatistics, lag: tuple[int, int]) -> Mask:
    found: Mask = (near.lags == lag).all(axis=1)
    return found


def _sum_of(near: NeighbourStatistics, chosen: Mask | bool = True) -> float:
    """Return the sum of the correlations that are seen, one of each two opposite directions, above -1/2.

    A filter whose weights add up to 1 leaves ``1 / (1 + 2 sum)`` of the variance of independent noise.
    """
    seen = (np.abs(near.correlation) > 3 * near.error) & chosen
    return max(float(near.correlation[seen].sum()), -0.49)


def mean_step(codes: Counts) -> float:
    """Return by how many DN the values of frames step in the mean over the pixels, in the channel where that is most.

    1 of a plain converter. Lossy compression by a curve, multiplication after the conversion and fewer bits than the
    file has room for leave out values between others. Wider gaps lie between two levels.

    Parameters
    ----------
    codes
        (channels, values) pixels by value.
    """
    worst = 1.0
    for counts in codes:
        below = np.cumsum(counts)
        low, high = (int(np.searchsorted(below, share * int(below[-1]))) for share in _CENTRAL)
        if int(counts[low : high + 1].sum()) < _FEW * (high + 1 - low):
            continue  # too few of each to tell a gap from chance
        used = np.flatnonzero(counts > _STRAY * int(counts.max()))
        used = used[max(0, np.searchsorted(used, low) - 1) : np.searchsorted(used, high, "right") + 1]
        gaps, pixels = np.diff(used), counts[used[1:]] + counts[used[:-1]]
        if gaps.size:
            near = gaps <= _WIDE * gaps[np.argmax(pixels)]
            worst = max(worst, float(np.average(gaps[near], weights=pixels[near])))
    return worst


def code_step(codes: Counts) -> int:
    """Return by how many DN the values of frames step: 1, or 4 where 12 bits are stored as 14; 0 if that is not known.

    The greatest common divisor of the distances from each channel's most frequent value, of all but one in a thousand
    of the pixels that have another; of fewer than a thousand such pixels it is not known.

    Parameters
    ----------
    codes
        (channels, values) pixels by value.
    """
    away = np.zeros(codes.shape[1], dtype=np.int64)
    for counts in codes:
        usual = int(counts.argmax())
        away[1 : usual + 1] += counts[:usual][::-1]
        away[1 : len(counts) - usual] += counts[usual + 1 :]
    changed = int(away.sum())
    if changed < _FEWEST_CHANGED:
        return 0
    return next(step for step in range(_COARSEST, 0, -1) if away[::step].sum() >= (1 - _STRAY) * changed)


def coarse_values(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if the values step by more than a DN: by some DN everywhere, or unevenly.

    Rounding to steps of s adds ``(s^2 - 1) / 12`` more to the variance than the model's rounding to whole DN.
    """
    step = seen.step_dn
    if step <= _UNEVEN:
        return
    added = (step**2 - 1) / 12
    text = (
        f"the bias frames' values step by {step:.3g} DN"
        + (
            ": fewer bits than the file has room for, or multiplied after conversion"
            if step.is_integer()
            else " in the mean, unevenly: multiplied after conversion, or compressed with loss"
        )
        + f"; rounding adds {added:.2g} DN^2 more than the model's; use a raw mode with all bits, or leave this ISO out"
    )
    share = _OF_LIGHTER_TAILS * (1 - math.sqrt(max(1 - added / max(seen.read.sigma_gauss_dn, 1e-12) ** 2, 0.0)))
    shares = seen.of_read_noise(share)
    if not step.is_integer():  # the mean does not follow the level evenly
        line = seen.rows.rows
        shares["row noise"] = (share / _OF_LIGHTER_TAILS, line.sigma_error_dn / max(line.sigma_dn, 1e-12))
    yield from COARSE.judged(step, _UNEVEN, text, shares)


def read_noise_in_steps(residuals: ResidualHistogram, step: int) -> ReadNoise | None:
    """Estimate the read noise beside rounding to a step of several DN, uniform over it, in place of that to whole DN.

    ``None`` for a step of 1 DN, or where rounding depends on the noise: where the noise that is found would ripple by a
    fiftieth of its variance from one step to the next.
    """
    if step <= 1:
        return None
    found = read_noise(replace(residuals, rounding_dn=float(step), level_waves=np.zeros(1, complex)))
    ripple = Ripple.of(found.tukey_lambda, found.sigma_tl_dn / step)
    return found if found.converged and ripple.variance < _MOST_RIPPLE else None
