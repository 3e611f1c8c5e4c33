"""What stays from bias frame to bias frame: hot and stuck pixels, dark-signal non-uniformity, shading.

The first pass over the bias frames. Its result tells the others which pixels to leave out, and holds the exact sum of
the frames, from which the second pass (row noise, read noise) takes each pixel's deviation from its own mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.sums import Counts, FrameSums, Mask, Mosaic, Values, sites
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


MINIMUM_FRAMES, ADVISED_FRAMES = 4, 10
"""Bias frames that the calibration needs, and that are advised."""

_SQUARED_PIXELS = 1 << 22  # of a frame with more, a seventh tells the variance over time: every
_STEP = 7  # seventh period of its rows
_THRESHOLD = 6.0  # robust standard deviations off its neighbourhood: a defect
_CLIPPED_SHARE = 0.01  # of pixels that reach the floor
_REACHING_SHARE, _PILE = 1e-4, 40  # of pixels, and how many at least, that end at a floor
_EXPECTED_BELOW, _BELOW = 30, 0.02  # pixels that would lie below it, and the share of them that may
_OUTER = (0.9, 1.645), (0.99, 2.576)  # shares of normal values, and how many standard deviations they lie within
_LEAST_REACH = 2.0  # standard deviations below its mean that a residual must be able to go
_BLOCK = 16  # periods of the CFA a side, for the local level


@dataclass(frozen=True, slots=True)
class PatternSummary:
    """What stays from bias frame to bias frame, in numbers.

    Attributes
    ----------
    defects, off_level, stuck
        Pixels that were left out; those off their neighbourhood's level; those that never change (a pixel may be both).
    pixels
        Of a frame.
    dsnu_dn, dsnu_error_dn
        Dark-signal non-uniformity, per channel: the standard deviation of the sound pixels' fixed levels around their
        local level, and its standard error; 0 where the frames' own noise explains all of it.
    shading_dn
        (channels, rows, columns): level of blocks of 16 x 16 CFA periods over the channel's mean.
    """

    defects: int
    off_level: int
    stuck: int
    pixels: int
    dsnu_dn: tuple[float, ...]
    dsnu_error_dn: tuple[float, ...]
    shading_dn: Values = field(repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class FixedPattern:
    """What the mean of the bias frames shows.

    Attributes
    ----------
    pattern
        The CFA's period, channel indices.
    frames
        Number of frames.
    total_dn
        (H, W) exact sum of the frames.
    defects
        (H, W) True where a pixel is hot, cold or stuck.
    level_dn
        Mean of the sound pixels, per channel.
    temporal_variance_dn2
        Mean variance over time of the sound pixels, per channel; with row noise and quantisation. Of large frames, of
        those in a seventh of the rows.
    floor_dn
        The value at which recorded values end below though the noise goes on, by :func:`find_floor`; ``None``: none.
    summary
        Defects, non-uniformity and shading.
    """

    pattern: Counts = field(repr=False)
    frames: int
    total_dn: NDArray[np.uint32] = field(repr=False)
    defects: Mask = field(repr=False)
    level_dn: tuple[float, ...]
    temporal_variance_dn2: tuple[float, ...]
    floor_dn: int | None
    summary: PatternSummary

    @property
    def clips_at_black(self) -> bool:
        """Whether the noise reaches the floor, where values end, so that residuals do not show it.

        A residual is (1 - 1/n) of its own value less what the other frames put in, within five standard deviations.
        """
        if self.floor_dn is None:
            return False
        own, sigma = 1 - 1 / self.frames, math.sqrt(max(self.temporal_variance_dn2))
        reach = own * (min(self.level_dn) - self.floor_dn) - 5 * math.sqrt(own * (1 - own)) * sigma
        return reach < _LEAST_REACH * sigma


class BiasStack(FrameSums):
    """Bias frames summed up for :func:`fixed_pattern`, in the memory of four mosaics.

    Parameters
    ----------
    cfa
        The CFA of pixel (0, 0).
    """

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        shape = self._check(mosaic).shape
        if self.frames == 1:
            self.total = np.zeros(shape, dtype=np.uint32)
            self.lowest = np.full(shape, 65535, dtype=np.uint16)
            self.highest = np.zeros(shape, dtype=np.uint16)
            step = _STEP if mosaic.size > _SQUARED_PIXELS else 1
            self.squared_rows = np.flatnonzero(np.arange(shape[0]) // len(self.pattern) % step == 0)
            self.squares = np.zeros((len(self.squared_rows), shape[1]), dtype=np.int64)
        self.total += mosaic
        np.minimum(self.lowest, mosaic, out=self.lowest)
        np.maximum(self.highest, mosaic, out=self.highest)
        wide = mosaic[self.squared_rows].astype(np.int64)
        self.squares += np.multiply(wide, wide, out=wide)

    @property
    def scatter(self) -> Counts:
        """Each pixel's variance over time, times n (n - 1), in ``squared_rows``, which have the frame's own CFA."""
        total = self.total[self.squared_rows].astype(np.int64)
        np.multiply(total, total, out=total)
        np.subtract(self.frames * self.squares, total, out=total)
        return total


def fixed_pattern(stack: BiasStack) -> FixedPattern:
    """Find the defects and measure the fixed pattern.

    A pixel is a defect if its trimmed mean over time (its lowest and highest value left out, so that one extreme draw
    of heavy-tailed read noise is not taken for a hot pixel) lies more than six robust standard deviations
    (1.4826 times the median absolute deviation) off the median of its neighbourhood, or if it never changes although
    the noise should move it.

    Dark-signal non-uniformity: ``DSNU^2 = Var(mean frame) - sigma_t^2 / n`` inside blocks, with sigma_t^2 the mean
    variance over time (EMVA 1288's correction for n frames).

    Raises
    ------
    DatasetError
        If there are too few frames, or nearly all pixels never change.
    """
    if stack.frames < MINIMUM_FRAMES:
        raise too_few_frames(stack.frames)
    pattern, channels, frames = stack.pattern, stack.channels, stack.frames
    sites_of = [[site for site, of in sites(pattern) if of == channel] for channel in range(channels)]
    total, lowest, highest = stack.total, stack.lowest, stack.highest

    scatter, floor = stack.scatter, find_floor(stack)
    is_cut = floor is not None and float((lowest <= floor).mean()) > _CLIPPED_SHARE
    defects = _find_stuck(stack, scatter, floor or 0)
    stuck = int(defects.sum())

    def mark_off_level(channel: int) -> int:
        """Mark the channel's pixels that are off their neighbourhood's level, and count them."""
        distances = []
        for site in sites_of[channel]:
            trimmed = total[site].astype(np.int32)
            trimmed -= lowest[site]
            trimmed -= highest[site]
            distances.append(_measure_distance(trimmed))
        per_dn = 2 * (frames - 2)
        every = np.concatenate([distance.ravel() for distance in distances])
        spread = 1.4826 * float(np.median(every, overwrite_input=True)) / per_dn
        # Near a floor, and between coarse steps, half of the pixels or more may lie within less than the noise.
        if is_cut or spread == 0:
            spread = max(spread, *(float(np.quantile(every, share)) / per_dn / size for share, size in _OUTER))
        far = _THRESHOLD * max(spread, 1 / frames) * per_dn
        for site, distance in zip(sites_of[channel], distances, strict=True):
            defects[site] |= distance > far
        return sum(int((distance > far).sum()) for distance in distances)

    off_level = sum(map(mark_off_level, range(channels)))
    defect_rows = defects[stack.squared_rows]

    # One grid for all sites: of a frame whose size is not a multiple of a block's, some may have none in the last row.
    side = _BLOCK * len(pattern)
    grid = tuple(-(-length // side) for length in defects.shape)

    def measure(channel: int) -> tuple[Any, ...]:
        """Return variance over time, level, non-uniformity and its error, and shading."""
        blocks: list[tuple[NDArray[Any], ...]] = []
        added, squared, counted = 0, 0.0, 0
        for site in sites_of[channel]:
            exact = scatter[site][~defect_rows[site]]
            added, counted = added + int(exact.sum()), counted + exact.size
            squared += float(np.square(exact, dtype=np.float64).sum())
            count, means, squares = _block_moments(total[site], ~defects[site], grid)
            blocks.append((count, means / frames, squares / frames**2))
        if counted < 2:
            raise DatasetError(f"channel {channel} has no sound pixel left")
        freedom = frames * (frames - 1)
        variance = added / freedom / counted
        variance_error = math.sqrt(max(squared / counted - (added / counted) ** 2, 0.0) / counted) / freedom
        pixels = np.asarray(sum(block[0] for block in blocks))
        level = sum(block[0] * block[1] for block in blocks) / np.maximum(pixels, 1)
        mean = float((level * pixels).sum() / np.sum(pixels))
        dsnu, dsnu_error = _non_uniformity(blocks, variance / frames, variance_error / frames)
        shading = np.where(pixels > 0, level - mean, 0.0)
        for of_edge, counts in ((shading, pixels), (shading.T, pixels.T)):
            if len(of_edge) > 1 and not counts[-1].any():  # a last row or column without a pixel
                of_edge[-1] = of_edge[-2]
        return variance, mean, dsnu, dsnu_error, shading

    variances, levels, dsnu, dsnu_error, shading = zip(*map(measure, range(channels)), strict=True)
    return FixedPattern(
        pattern=pattern,
        frames=frames,
        total_dn=total,
        defects=defects,
        level_dn=levels,
        temporal_variance_dn2=variances,
        floor_dn=floor,
        summary=PatternSummary(
            defects=int(defects.sum()),
            off_level=off_level,
            stuck=stuck,
            pixels=defects.size,
            dsnu_dn=dsnu,
            dsnu_error_dn=dsnu_error,
            shading_dn=np.stack(shading),
        ),
    )


def too_few_frames(number: int, reasons: Sequence[str] = ()) -> DatasetError:
    """Return the error for so many bias frames."""
    return DatasetError(
        f"{counted(number, 'bias frame')}, and {MINIMUM_FRAMES} are needed, {ADVISED_FRAMES} or more advised: "
        "take them with the lens capped, at the shortest exposure" + "".join(f"; {reason}" for reason in reasons)
    )


def find_floor(stack: BiasStack) -> int | None:
    """Return the value at which recorded values end below though the noise goes on; ``None`` if there is none.

    The tail of the pixels' lowest values falls off by ever larger factors, as three values show; at a floor it ends
    with none below, but some broken pixels, where that leaves dozens. Noise that ends alike above is as narrow as that.
    """
    lowest, highest = (np.bincount(each[stack.squared_rows].ravel()) for each in (stack.lowest, stack.highest))
    return _find_cut(lowest) if _find_cut(highest[::-1]) is None else None


def _find_cut(counts: Counts) -> int | None:
    """Return the value at which counts by value begin, if they are cut off there."""
    below = np.cumsum(counts)
    place = int(np.searchsorted(below, max(_PILE, _REACHING_SHARE * float(below[-1]))))
    if place >= len(counts):
        return None
    first, second, third = (*counts[place:][counts[place:] > 0][:3].tolist(), 0.5, 0.5)[:3]
    expected = min(first, first * (first / second) ** 2 * third / second)
    return place if expected >= _EXPECTED_BELOW and below[place] - first <= _BELOW * expected else None


def _measure_distance(values: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return twice the distance from the median of blocks; it overwrites the values.

    Blocks over an edge are filled up as in a mirror.
    """
    height, width = values.shape
    over = -height % _BLOCK, -width % _BLOCK
    padded = np.pad(values, ((0, over[0]), (0, over[1])), mode="symmetric") if any(over) else values
    blocks = padded.reshape(len(padded) // _BLOCK, _BLOCK, -1, _BLOCK).swapaxes(1, 2)
    ordered, half = blocks.copy(order="C").reshape(*blocks.shape[:2], -1), _BLOCK**2 // 2
    ordered.partition(half, axis=2)
    twice = ordered[..., half] + ordered[..., :half].max(axis=2)
    blocks *= 2
    blocks -= twice[..., None, None]
    np.abs(blocks, out=blocks)
    return padded[:height, :width]


def _block_moments(total: NDArray[np.uint32], sound: Mask, grid: tuple[int, ...]) -> tuple[Counts, Values, Values]:
    """Return count, mean and sum of squared deviations of the sound pixels of each block of one site of the CFA."""
    count, means, squares = np.zeros(grid, dtype=np.int64), np.zeros(grid), np.zeros(grid)
    columns = np.arange(0, total.shape[1], _BLOCK)
    for place, top in enumerate(range(0, len(total), _BLOCK)):  # a band at a time, for the memory
        band, used = total[top : top + _BLOCK], sound[top : top + _BLOCK]

        def sum_by_block(values: NDArray[Any], used: Mask = used) -> NDArray[Any]:
            """Sum the used values of a band over each block of columns."""
            return np.asarray(np.add.reduceat(values.sum(axis=0, where=used), columns))

        there = slice(len(columns))
        count[place, there] = sum_by_block(used)
        means[place, there] = sum_by_block(band) / np.maximum(count[place, there], 1)
        squares[place, there] = sum_by_block((band - np.repeat(means[place], _BLOCK)[: band.shape[1]]) ** 2)
    return count, means, squares


def _find_stuck(stack: BiasStack, scatter: Counts, floor: int) -> Mask:
    """Return the pixels that never change, if the noise of the others makes that improbable."""
    lowest, highest, frames = stack.lowest, stack.highest, stack.frames
    constant = lowest == highest
    share = float(constant.mean())
    if share > 0.99:
        raise DatasetError(
            f"{share:.2%} of the pixels have one value in every frame, {float(np.median(lowest)):g} DN most often: "
            "there is no noise to be measured"
        )
    middle = float(np.median(scatter[::7, ::5]))
    sigma = math.sqrt(middle / (frames * (frames - 1)) / 0.9)
    # All n values alike: below (1 / (sigma sqrt(2 pi)))^(n - 1) / sqrt(n) for Gaussian noise of sigma > 1/2 DN.
    chance = (1 / (sigma * math.sqrt(2 * math.pi))) ** (frames - 1) / math.sqrt(frames) if sigma > 0.5 else 1.0
    # What lies at the floor throughout may be noise below it.
    return constant & (highest > floor) if chance < 1e-4 else np.zeros_like(constant)


def _non_uniformity(blocks: list[tuple[NDArray[Any], ...]], noise: float, noise_error: float) -> tuple[float, float]:
    """Return the pooled DSNU and its standard error: of the blocks' variances, by their scatter, and of the noise."""
    freedom = np.concatenate([np.maximum(block[0] - 1, 0).ravel() for block in blocks])
    squares = np.concatenate([block[2].ravel() for block in blocks])
    excess = float(squares.sum() / freedom.sum()) - noise
    deviations = squares - freedom * (excess + noise)
    used = int(np.count_nonzero(freedom))
    of_blocks = math.sqrt(float(np.square(deviations).sum()) * used / max(used - 1, 1)) / float(freedom.sum())
    error = math.hypot(of_blocks, noise_error)
    if excess <= 0:
        return 0.0, math.sqrt(error)
    return math.sqrt(excess), min(error / (2 * math.sqrt(excess)), math.sqrt(error))
