"""What stays from bias frame to bias frame: hot and stuck pixels, dark-signal non-uniformity, shading.

The first pass over the bias frames. Its result tells the others which pixels to leave out, and holds the exact sum of
the frames, from which the second pass (row noise, read noise) takes each pixel's deviation from its own mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.calibration._frames import FrameSums
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from eldata.raw.cfa import Cfa

MINIMUM_FRAMES = 4
"""Bias frames that the calibration needs; ten or more are advised."""

_MOST_FRAMES = 65_536  # their sum fits 32 bits
_CLIPPED_SHARE = 0.01  # of pixels that reach 0
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
    shading_dn: NDArray[np.float64] = field(repr=False)


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
    threshold_dn
        Distance from the local level that makes a defect, per channel.
    level_dn
        Mean of the sound pixels, per channel.
    temporal_variance_dn2
        Mean variance over time of the sound pixels, per channel; with row noise and quantisation.
    shading_error_dn
        Noise of an entry of the summary's shading, per channel.
    summary
        Defects, non-uniformity and shading.
    """

    pattern: NDArray[np.int64] = field(repr=False)
    frames: int
    total_dn: NDArray[np.uint32] = field(repr=False)
    defects: NDArray[np.bool_] = field(repr=False)
    threshold_dn: tuple[float, ...]
    level_dn: tuple[float, ...]
    temporal_variance_dn2: tuple[float, ...]
    shading_error_dn: tuple[float, ...]
    summary: PatternSummary

    @property
    def mean_dn(self) -> NDArray[np.float32]:
        """The mean frame, (H, W)."""
        return (self.total_dn / self.frames).astype(np.float32)


class BiasStack(FrameSums):
    """Accumulates bias frames for :func:`fixed_pattern`: the memory of eight mosaics, for any number of frames.

    Parameters
    ----------
    cfa
        The CFA of pixel (0, 0).
    """

    def __init__(self, cfa: Cfa) -> None:
        super().__init__(cfa)

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a bias frame."""
        from eldata.calibration._kernels import add_to_stack

        if self.frames >= _MOST_FRAMES:
            raise ArgumentError(f"a stack takes {_MOST_FRAMES} frames at most")
        shape = self._check(mosaic).shape
        if self.frames == 1:
            self.total = np.zeros(shape, dtype=np.uint32)
            self.squares = np.zeros(shape, dtype=np.int64)
            self.lowest = np.full(shape, 65535, dtype=np.uint16)
            self.highest = np.zeros(shape, dtype=np.uint16)
        add_to_stack(mosaic, self.total, self.squares, self.lowest, self.highest)


def fixed_pattern(stack: BiasStack, *, threshold: float = 6.0) -> FixedPattern:
    """Find the defects and measure the fixed pattern.

    A pixel is a defect if its trimmed mean over time (its lowest and highest value left out, so that one extreme draw
    of heavy-tailed read noise is not taken for a hot pixel) lies more than ``threshold`` robust standard deviations
    (1.4826 times the median absolute deviation) off the median of its neighbourhood, or if it never changes although
    the noise should move it.

    Dark-signal non-uniformity: ``DSNU^2 = Var(mean frame) - sigma_t^2 / n`` inside blocks, with sigma_t^2 the mean
    variance over time (EMVA 1288's correction for n frames).

    Raises
    ------
    ArgumentError
        If the threshold is not positive.
    DatasetError
        If there are too few frames, black is clipped, or nearly all pixels never change.
    """
    if not threshold > 0:
        raise ArgumentError(f"the threshold is a positive number of standard deviations; found {threshold}")
    if stack.frames < MINIMUM_FRAMES:
        raise DatasetError(
            f"{stack.frames} bias frame(s) are not enough to tell what stays from what changes: "
            f"{MINIMUM_FRAMES} are needed, ten or more advised, all at one ISO"
        )
    pattern, channels, frames = stack.pattern, stack.channels, stack.frames
    total, squares, lowest, highest = stack.total, stack.squares, stack.lowest, stack.highest

    stuck = _stuck(stack)
    off_level = np.zeros(total.shape, dtype=np.bool_)

    def limit(channel: int) -> float:
        """Mark the channel's pixels that are off their neighbourhood's level, and return what counts as off."""
        distances = []
        for site in _sites(pattern, channel):
            trimmed = (total[site] - lowest[site] - highest[site].astype(np.uint32)).astype(np.float32) / (frames - 2)
            distances.append((site, trimmed - _local_median(trimmed)))
        spread = 1.4826 * float(np.median(np.concatenate([np.abs(distance).ravel() for _, distance in distances])))
        far = threshold * max(spread, 1 / frames)
        for site, distance in distances:
            off_level[site] = np.abs(distance) > far
        return far

    limits = [limit(channel) for channel in range(channels)]
    defects = off_level | stuck

    def measure(channel: int) -> _Channel:
        temporal = count = 0.0
        blocks: list[tuple[NDArray[np.float64], ...]] = []
        for site in _sites(pattern, channel):
            sound = ~defects[site]
            exact = frames * squares[site] - total[site].astype(np.int64) ** 2
            temporal += float(exact[sound].sum()) / (frames * (frames - 1))
            count += float(sound.sum())
            blocks.append(_block_moments(total[site] / frames, sound))
        if count < 2:
            raise DatasetError(f"channel {channel} has no sound pixel left: raise the threshold ({threshold:g})")
        variance = temporal / count
        pixels = sum(block[0] for block in blocks)
        level = sum(block[0] * block[1] for block in blocks) / np.maximum(pixels, 1)
        mean = float((level * pixels).sum() / np.sum(pixels))
        dsnu, dsnu_error = _non_uniformity(blocks, variance / frames)
        shading = np.where(pixels > 0, level - mean, 0.0)
        return _Channel(variance, mean, dsnu, dsnu_error, shading, max(float(np.median(pixels)), 1.0))

    measured = [measure(channel) for channel in range(channels)]
    return FixedPattern(
        pattern=pattern,
        frames=frames,
        total_dn=total,
        defects=defects,
        threshold_dn=tuple(limits),
        level_dn=tuple(one.level for one in measured),
        temporal_variance_dn2=tuple(one.variance for one in measured),
        shading_error_dn=tuple(math.sqrt((one.variance / frames + one.dsnu**2) / one.block_pixels) for one in measured),
        summary=PatternSummary(
            defects=int(defects.sum()),
            off_level=int(off_level.sum()),
            stuck=int(stuck.sum()),
            pixels=defects.size,
            dsnu_dn=tuple(one.dsnu for one in measured),
            dsnu_error_dn=tuple(one.dsnu_error for one in measured),
            shading_dn=np.stack([one.shading for one in measured]),
        ),
    )


@dataclass(frozen=True, slots=True)
class _Channel:
    """What one channel's sound pixels show; ``block_pixels`` is how many pixels a block of the shading has."""

    variance: float
    level: float
    dsnu: float
    dsnu_error: float
    shading: NDArray[np.float64]
    block_pixels: float


Site = tuple[slice, slice]


def _sites(pattern: NDArray[np.int64], channel: int) -> Iterator[Site]:
    period = len(pattern)
    for y, x in np.argwhere(pattern == channel):
        yield slice(y, None, period), slice(x, None, period)


def _stuck(stack: BiasStack) -> NDArray[np.bool_]:
    """Return the pixels that never change, if the noise of the others makes that improbable."""
    lowest, highest, frames = stack.lowest, stack.highest, stack.frames
    constant = lowest == highest
    share = float(constant.mean())
    if float((lowest == 0).mean() - (highest == 0).mean()) > _CLIPPED_SHARE:
        raise DatasetError(
            "black is clipped: many pixels are 0 in some frame and above in another, so that neither mean nor noise "
            "is known; calibrate raw files whose black level lies above 0, and never subtract it before"
        )
    if share > 0.99:
        raise DatasetError(
            "nearly all pixels have the same value in every frame: the frames are copies of one another, or black is "
            "clipped; calibrate raw files whose black level lies above 0"
        )
    exact = frames * stack.squares[::7, ::5] - stack.total[::7, ::5].astype(np.int64) ** 2
    sigma = math.sqrt(float(np.median(exact)) / (frames * (frames - 1)) / 0.9)
    # All n values alike: below (1 / (sigma sqrt(2 pi)))^(n - 1) / sqrt(n) for Gaussian noise of sigma > 1/2 DN.
    chance = (1 / (sigma * math.sqrt(2 * math.pi))) ** (frames - 1) / math.sqrt(frames) if sigma > 0.5 else 1.0
    return constant if chance < 1e-4 else np.zeros_like(constant)


def _blocked(plane: NDArray[Any], beyond: Literal["symmetric", "constant"]) -> NDArray[Any]:
    """Return a plane as (rows, columns, pixels) of blocks; beyond its edges it is mirrored or 0."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % _BLOCK), (0, -width % _BLOCK)), mode=beyond)
    rows, columns = padded.shape[0] // _BLOCK, padded.shape[1] // _BLOCK
    return padded.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2).reshape(rows, columns, -1)


def _local_median(plane: NDArray[Any]) -> NDArray[Any]:
    median = np.median(_blocked(plane, "symmetric"), axis=2)
    full: NDArray[Any] = np.repeat(np.repeat(median, _BLOCK, axis=0), _BLOCK, axis=1)
    return full[: plane.shape[0], : plane.shape[1]]


def _block_moments(
    mean: NDArray[np.float64], sound: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return count, mean and sum of squared deviations of the sound pixels of each block."""
    values, use = _blocked(mean, "constant"), _blocked(sound.astype(np.float64), "constant")
    count = use.sum(axis=2)
    level = (values * use).sum(axis=2) / np.maximum(count, 1)
    return count, level, ((values - level[..., None]) ** 2 * use).sum(axis=2)


def _non_uniformity(blocks: list[tuple[NDArray[np.float64], ...]], noise: float) -> tuple[float, float]:
    """Return the pooled DSNU and its standard error, from the scatter of the blocks' variances."""
    freedom = np.concatenate([np.maximum(block[0] - 1, 0).ravel() for block in blocks])
    squares = np.concatenate([block[2].ravel() for block in blocks])
    excess = float(squares.sum() / freedom.sum()) - noise
    deviations = squares - freedom * (excess + noise)
    used = int(np.count_nonzero(freedom))
    error = math.sqrt(float(np.square(deviations).sum()) * used / max(used - 1, 1)) / float(freedom.sum())
    if excess <= 0:
        return 0.0, math.sqrt(error)
    return math.sqrt(excess), min(error / (2 * math.sqrt(excess)), math.sqrt(error))
