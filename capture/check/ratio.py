"""Ratios of brightness and of exposure, and other changes, from block means of two frames.

Of frames of equal exposure, medians of ratios, one channel at a time. Of a noisy frame over its reference a line,
``mean_noisy = offset_c + mean_reference / ratio`` over all strips of 4 x 16 packed pixels that are not clipped, with an
offset per channel, since the black level of a noisy frame may be off by some DN (colour bias), which at a ratio of 200
is a good part of its signal. Weighted least squares with Huber's weights: the scatter as a function of the level comes
from the residuals themselves, so no noise model is needed, and hot pixels count little. The standard error allows for
any correlation within rows (row noise): clusters of one cell's height, sandwich estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.result import SIGMAS, Estimate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.check.frames import Cells

    Array = NDArray[np.float64]

BLOCK: Final = 4  # cells along each side: 16 x 16 packed pixels
LEAST_BLOCKS: Final = 12
WELL_EXPOSED: Final = (0.02, 0.9)  # of the range over black

TO_SIGMA: Final = 1.4826  # of a median absolute deviation, for normal errors
OF_MEDIAN: Final = 1.2533  # standard error of a median over that of a mean
STRIP: Final = (1, 4)  # cells

_SMALL_BLOCK: Final = 2  # cells along each side: 8 x 8 packed pixels
# A shift of 0.2 pixels, which is let pass, changes a block of 16 pixels with an edge by less than half of this.
_CHANGE: Final = 0.05
_CHANGE_SIGMAS: Final = 8
_ROUNDS: Final = 4
_HUBER: Final = 2.5  # standard deviations
_LEVELS: Final = 12  # bins of the scatter
_LEAST_STRIPS: Final = 100
# Of pixels at 0 DN: black is clipped, and means of dark parts are no longer those of the light.
_ZERO_SHARE: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class RatioFit:
    """The line through a noisy frame over its reference.

    Attributes
    ----------
    slope
        Signal of the noisy frame over the reference's, with its standard error.
    offset_dn
        Of each channel, DN.
    black
        What the frame's black is off its stated level, DN: the mean of the channels' offsets from the line, or from one
        of the expected slope, whichever is nearer to 0. The first alone takes a frame that moved or is out of focus for
        one of another black, the second one in another light.
    match
        Share of the variance of the scene in the noisy frame that the reference explains, noise left out: 1 for the
        same scene.
    """

    slope: Estimate
    offset_dn: tuple[float, ...]
    black: Estimate
    match: Estimate

    @property
    def ratio(self) -> Estimate | None:
        """The exposure ratio; ``None`` if the signal is not above five of its standard errors."""
        slope, error = self.slope.value, self.slope.standard_error
        return Estimate(1 / slope, error / slope**2) if slope > SIGMAS * error else None


def measure_brightness(first: Cells, second: Cells) -> tuple[Estimate | None, ...]:
    """Measure the brightness of ``second`` over ``first``, one estimate per packed channel.

    The median of ``mean_2 / mean_1`` over blocks that are well exposed and not clipped in both frames. Medians forgive
    what moved or glints in a part of the picture. The standard error is that of a median, from the blocks' own scatter.
    ``None`` for a channel with too few such blocks.
    """
    of_first, unclipped_first = first.pooled(BLOCK, BLOCK)
    of_second, unclipped_second = second.pooled(BLOCK, BLOCK)
    low, high = (share * first.range_dn for share in WELL_EXPOSED)
    # The mean of both decides, and the limits for each stand apart from it: a limit on one alone would favour errors
    # of one sign there.
    middle = (of_first + of_second) / 2
    usable = unclipped_first & unclipped_second & (middle >= low) & (middle <= high) & (of_first > 0) & (of_second > 0)
    estimates: list[Estimate | None] = []
    for mean_1, mean_2, chosen in zip(of_first, of_second, usable, strict=True):
        count = int(chosen.sum())
        if count < LEAST_BLOCKS:
            estimates.append(None)
            continue
        ratios = mean_2[chosen].astype(np.float64) / mean_1[chosen]
        middle_ratio = float(np.median(ratios))
        scatter = TO_SIGMA * float(np.median(np.abs(ratios - middle_ratio)))
        estimates.append(Estimate(middle_ratio, OF_MEDIAN * scatter / count**0.5))
    return tuple(estimates)


def measure_brightest(cells: Cells) -> float | None:
    """Return the 99th percentile of the green blocks over black, as a share of the range; ``None`` without a block."""
    mean, _ = cells.pooled(BLOCK, BLOCK)
    if not mean.size:
        return None
    return float(np.quantile(mean[cells.greens], 0.99)) / cells.range_dn


def fit_ratio(reference: Cells, noisy: Cells, expected: float | None = None) -> RatioFit | None:
    """Fit the line; ``None`` if too little is well exposed, or the noisy frame's black is clipped.

    ``expected``: the exposure ratio that is stated.
    """
    (light, unclipped_x), (dark, unclipped_y) = (cells.pooled(*STRIP) for cells in (reference, noisy))
    x, y, usable = light.astype(np.float64), dark.astype(np.float64), unclipped_x & unclipped_y
    if int(usable.sum()) < _LEAST_STRIPS or noisy.zero_share > _ZERO_SHARE:
        return None
    level = _bin_levels(x, usable)
    weight = usable.astype(np.float64)
    sigma = np.ones_like(x)
    for _ in range(_ROUNDS):
        slope, offset, about_x = _fit_line(x, y, weight)
        residual = y - offset[:, None, None] - slope * x
        sigma = _measure_scatter(residual, level, usable)[level]
        distance = np.abs(residual) / sigma
        weight = np.where(usable, np.minimum(1, _HUBER / np.maximum(distance, 1e-9)) / sigma**2, 0)
    by_row = (weight * about_x * residual).sum(axis=(0, 2)) / float((weight * about_x**2).sum())
    share = weight / np.maximum(weight.sum(axis=(1, 2), keepdims=True), 1e-300) / len(weight)
    mean_x = float((share * x).sum())
    black = _make_estimate(float(offset.mean()), (share * residual).sum(axis=(0, 2)) - mean_x * by_row)
    if expected is not None:
        left = share * (y - x / expected)
        value = float(left.sum())
        stated = _make_estimate(value, (left - share * value).sum(axis=(0, 2)))
        nearer = min(black, stated, key=lambda estimate: abs(estimate.value))
        black = nearer if black.value * value > 0 else Estimate(0.0)
    match = _measure_match(slope, x, residual, usable)
    return RatioFit(_make_estimate(slope, by_row), tuple(map(float, offset)), black, match)


def _make_estimate(value: float, by_row: Array) -> Estimate:
    """Return an estimate with the error that its rows' shares in it, each a cluster, give."""
    rows = len(by_row)
    return Estimate(value, float(np.sqrt(rows / max(1, rows - 1) * np.sum(by_row**2))))


def measure_change(first: Cells, second: Cells, brightness: float, offset_dn: Sequence[float] | None = None) -> float:
    """Compute the share of the picture that changed differently from the whole: something moved.

    Blocks of 8 x 8 packed pixels whose green changed by more than a twentieth and by more than eight robust standard
    deviations of blocks as bright, of those that are well exposed in the first frame, beside another such block: one
    alone is a hot pixel, or chance.

    Parameters
    ----------
    brightness
        Brightness of the second frame over the first.
    offset_dn
        Offset of the second frame in each channel; by default none.
    """
    of_first, unclipped_first = first.pooled(_SMALL_BLOCK, _SMALL_BLOCK)
    of_second, unclipped_second = second.pooled(_SMALL_BLOCK, _SMALL_BLOCK)
    greens = first.greens
    offset = np.zeros(len(of_second)) if offset_dn is None else np.asarray(offset_dn)
    before = of_first[greens].mean(axis=0).astype(np.float64)
    after = (of_second - offset[:, None, None])[greens].mean(axis=0)
    low, high = (share * first.range_dn for share in WELL_EXPOSED)
    usable = np.all((unclipped_first & unclipped_second)[greens], axis=0) & (before >= low) & (before <= high)
    if int(usable.sum()) < LEAST_BLOCKS:
        return 0.0
    change = np.where(usable, after / brightness / np.where(usable, before, 1) - 1, 0)
    level = _bin_levels(before, usable)
    least = np.maximum(_CHANGE, _CHANGE_SIGMAS * _measure_scatter(change, level, usable)[level])
    changed = np.abs(change) > least
    beside = np.pad(changed, 1)
    beside = beside[:-2, 1:-1] | beside[2:, 1:-1] | beside[1:-1, :-2] | beside[1:-1, 2:]
    return float(np.mean((changed & beside)[usable]))


def _bin_levels(values: Array, usable: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the level of each strip, of twelve with as many usable strips each."""
    edges = np.quantile(values[usable], np.linspace(0, 1, _LEVELS + 1)[1:-1])
    return np.searchsorted(edges, values)


def _fit_line(x: Array, y: Array, weight: Array) -> tuple[float, Array, Array]:
    """Return slope, offsets of the channels, and x less the channels' weighted means."""
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-300)
    mean_x = (weight * x).sum(axis=(1, 2)) / total
    mean_y = (weight * y).sum(axis=(1, 2)) / total
    about_x = x - mean_x[:, None, None]
    spread = float((weight * about_x**2).sum())
    slope = float((weight * about_x * (y - mean_y[:, None, None])).sum()) / spread if spread > 0 else 0.0
    return slope, mean_y - slope * mean_x, about_x


def _measure_scatter(residual: Array, level: NDArray[np.intp], usable: NDArray[np.bool_]) -> Array:
    """Return the robust standard deviation of the residuals at each level."""
    whole = TO_SIGMA * float(np.median(np.abs(residual[usable])))
    floor = max(whole / 100, 1e-6)
    scatter = np.full(_LEVELS, max(whole, floor))
    for index in range(_LEVELS):
        chosen = residual[usable & (level == index)]
        if len(chosen) >= 2 * _LEVELS:
            scatter[index] = max(TO_SIGMA * float(np.median(np.abs(chosen - np.median(chosen)))), floor)
    return scatter


def _measure_match(slope: float, x: Array, residual: Array, usable: NDArray[np.bool_]) -> Estimate:
    """Return the share of the scene's variance that the line explains.

    Noise differs from row to row, a scene that is not in the reference does not: of the residuals' variance, what half
    the variance of differences between rows does not explain is such a scene.
    """
    pairs = usable[:, 1:] & usable[:, :-1]
    if not pairs.any():
        return Estimate(float("nan"), float("inf"))
    limit = 10 * TO_SIGMA * float(np.median(np.abs(residual[usable])))
    limited = np.clip(residual, -limit, limit)  # hot pixels
    products = (limited[:, 1:] * limited[:, :-1])[pairs]
    unexplained = max(0.0, float(products.mean()))
    about_mean = [
        channel[chosen] - channel[chosen].mean() for channel, chosen in zip(x, usable, strict=True) if chosen.any()
    ]
    explained = max(slope, 0.0) ** 2 * float(np.concatenate(about_mean).var())
    total = explained + unexplained
    if total <= 0:
        return Estimate(float("nan"), float("inf"))
    error = float(products.std()) / len(products) ** 0.5
    return Estimate(explained / total, error * explained / total**2 if explained else error / total)
