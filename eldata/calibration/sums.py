"""What sums over frames share: the CFA, what they ask of frames, and compiled loops over one frame.

The loops sum integers: exact, and the same in any order of frames. ``residual`` below is ``n x - sum over frames of
x``: n times the deviation from the pixel's own mean, an integer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from eldata.base.compiled import kernel
from eldata.errors import ArgumentError
from eldata.raw.levels import packed_channels

if TYPE_CHECKING:
    from eldata.raw.levels import Cfa

Mosaic: TypeAlias = NDArray[np.uint16]
Plane: TypeAlias = NDArray[np.float32]
Values: TypeAlias = NDArray[np.floating[Any]]
Counts: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
Site: TypeAlias = tuple[slice, slice]

_GROUPS = 64


def pattern_of(cfa: Cfa) -> Counts:
    """Return the CFA's smallest period as an array of channel indices; an ArgumentError if it is unsupported."""
    packed_channels(cfa)
    return np.asarray(cfa, dtype=np.int64)


def channels_of(pattern: Counts) -> int:
    """Return the number of channels: 4 for Bayer (R, G1, B, G2), 3 for X-Trans."""
    return int(pattern.max()) + 1


def sites(pattern: Counts) -> list[tuple[Site, int]]:
    """Return the rows and columns of each site of the CFA, and its channel."""
    period = len(pattern)
    return [((slice(y, None, period), slice(x, None, period)), int(of)) for (y, x), of in np.ndenumerate(pattern)]


def by_pixel(values: NDArray[Any], pattern: Counts, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array of that shape in which each pixel has its channel's entry of ``values``."""
    repeats = -(-shape[0] // len(pattern)), -(-shape[1] // len(pattern))
    return np.asarray(np.tile(values[pattern], repeats)[: shape[0], : shape[1]])


def checked_mosaic(mosaic: NDArray[Any], shape: tuple[int, int] | None, period: int) -> Mosaic:
    """Return the mosaic if it is a frame in DN, of the shape of the frames before or else large enough."""
    if mosaic.dtype != np.uint16 or mosaic.ndim != 2 or min(mosaic.shape) < 2 * period:
        raise ArgumentError(
            f"a mosaic is (H, W) of raw values as decoded, uint16, of two periods of its CFA or more; found "
            f"{mosaic.dtype} {mosaic.shape}"
        )
    if shape is not None and mosaic.shape != shape:
        raise ArgumentError(
            f"the frames before were {shape} pixels and this one is {mosaic.shape}; calibrate frames of one camera, "
            "one orientation and one ISO together"
        )
    return mosaic


class FrameSums:
    """What every sum of whole frames begins with: the CFA, which pixels are left out, and what it asks of frames.

    Parameters
    ----------
    cfa
        The CFA of pixel (0, 0).
    defects
        (H, W) True where a pixel is not to be used.
    """

    def __init__(self, cfa: Cfa, defects: Mask | None = None) -> None:
        self.pattern = pattern_of(cfa)
        self.channels = channels_of(self.pattern)
        self.frames = 0
        self._defects = defects
        self._shape: tuple[int, int] | None = None

    def _check(self, mosaic: Mosaic) -> Mask:
        """Refuse a frame that is unlike those before, count it, and return the mask of defects."""
        height, width = checked_mosaic(mosaic, self._shape, len(self.pattern)).shape
        self._shape = height, width
        if self._defects is None:
            self._defects = np.zeros(self._shape, dtype=np.bool_)
        self.frames += 1
        return self._defects


def sums_by_row(values: NDArray[Any], pattern: Counts) -> Counts:
    """Return the sum of each row in each channel, (H, C), of integers or truth values."""
    sums = np.zeros((len(values), channels_of(pattern)), dtype=np.int64)
    for (rows, columns), channel in sites(pattern):
        sums[rows, channel] += values[rows, columns].sum(axis=1, dtype=np.int64)
    return sums


def levels_and_lines(sums: NDArray[Any], pixels: Counts) -> tuple[Values, Values]:
    """Compute the mean of each channel, and of each line less the means of its channels."""
    level = sums.sum(axis=0) / np.maximum(pixels.sum(axis=0), 1)
    return level, (sums - pixels * level).sum(axis=1) / np.maximum(pixels.sum(axis=1), 1)


def groups_of_rows(height: int) -> Counts:
    """Return the group of each row, by pairs of rows as the kernels have it; scatter between groups gives errors."""
    return np.arange(height) // 2 % max(1, min(_GROUPS, height // 4))


# --- compiled loops ---------------------------------------------------------------------------------------------------


@kernel
def channel_histograms(mosaic: Mosaic, defects: Mask, pattern: Counts, counts: Counts) -> None:
    """Count the sound pixels by group of rows, channel and value in ``counts``; its last value takes all beyond."""
    period = pattern.shape[0]
    groups, last = counts.shape[0], counts.shape[2] - 1
    for row in range(mosaic.shape[0]):
        group = (row // 2) % groups
        for phase in range(period):
            channel = pattern[row % period, phase]
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = np.int64(mosaic[row, column])
                    counts[group, channel, min(last, value)] += 1


@kernel
def residual_sums(
    mosaic: Mosaic, total: NDArray[np.uint32], defects: Mask, frames: int, pattern: Counts,
    row_sums: Counts, row_squares: Counts, column_sums: Counts,
) -> None:  # fmt: skip
    """Add the residuals by (row, channel) and by (column, channel), and their squares by row."""
    period = pattern.shape[0]
    for row in range(mosaic.shape[0]):
        squares: Any = 0
        for phase in range(period):
            channel = pattern[row % period, phase]
            sums: Any = 0
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = frames * np.int64(mosaic[row, column]) - np.int64(total[row, column])
                    sums += value
                    squares += value * value
                    column_sums[column, channel] += value
            row_sums[row, channel] += sums
        row_squares[row] += squares


@kernel
def residual_histogram(
    mosaic: Mosaic, total: NDArray[np.uint32], defects: Mask, frames: int, offsets: Counts, step: int, counts: Counts
) -> None:
    """Count the residuals less ``offsets`` (row, column phase) in cells of an odd ``step``, by group of rows.

    Cell j of ``counts`` (group, cells) is centred on (j - cells // 2) step; the first and last take all beyond.
    """
    period = offsets.shape[1]
    groups, last = counts.shape[0], counts.shape[1] - 1
    start = (counts.shape[1] // 2) * step + step // 2
    for row in range(mosaic.shape[0]):
        group = (row // 2) % groups
        for phase in range(period):
            shift = start - offsets[row, phase]
            for column in range(phase, mosaic.shape[1], period):
                if not defects[row, column]:
                    value = frames * np.int64(mosaic[row, column]) - np.int64(total[row, column]) + shift
                    place = value // step if value > 0 else 0
                    counts[group, min(last, place)] += 1


@kernel
def segment_sums(
    first: Mosaic, second: Mosaic, defects: Mask, pattern: Counts, channel: int,
    floor: int, limit: float, size: int, sums: Counts,
) -> None:  # fmt: skip
    """Add up the sound pixels a and b of two flats, of a channel, by segments of so many columns of a row.

    ``sums`` (13, rows, segments) gets how many pixels there are, and of these clipped; sums of a, b, a^2, b^2, a b; and
    of neighbours with a' and b' before a and b: how many, sums of a + a', b + b', a a', b b', a b' + b a'.
    """
    period = pattern.shape[0]
    for row in range(first.shape[0]):
        for phase in range(period):
            if pattern[row % period, phase] != channel:
                continue
            for place in range(sums.shape[2]):
                zero: Any = (0, 0, 0, 0, 0, 0, 0)
                n, clipped, a_sum, b_sum, aa, bb, ab = zero
                neighbours, a_two, b_two, aa_two, bb_two, ab_two, a_before = zero
                b_before = a_before
                is_beside = False
                for column in range(place * size + phase, (place + 1) * size, period):
                    if defects[row, column]:
                        is_beside = False
                        continue
                    a, b = np.int64(first[row, column]), np.int64(second[row, column])
                    n += 1
                    clipped += np.int64(a <= floor or b <= floor or a >= limit or b >= limit)
                    a_sum += a
                    b_sum += b
                    aa += a * a
                    bb += b * b
                    ab += a * b
                    if is_beside:
                        neighbours += 1
                        a_two += a + a_before
                        b_two += b + b_before
                        aa_two += a * a_before
                        bb_two += b * b_before
                        ab_two += a * b_before + b * a_before
                    a_before, b_before, is_beside = a, b, True
                of_segment = (n, clipped, a_sum, b_sum, aa, bb, ab, neighbours, a_two, b_two, aa_two, bb_two, ab_two)
                for index in range(13):
                    sums[index, row, place] += of_segment[index]


@kernel
def standardise(
    first: Mosaic, second: Mosaic, defects: Mask, pattern: Counts, scale: Plane, limit: int, out: NDArray[np.int16]
) -> None:
    """Write ``first - second``, less its means by row and channel, times ``scale`` (channel), within +-``limit``.

    Defects become 0. The rows start with the pattern's first.
    """
    period = pattern.shape[0]
    height, width = first.shape
    sums, counts = np.zeros((2, scale.size), dtype=np.int64)
    values = np.zeros(width, dtype=np.int64)
    means, factors = np.zeros((2, width), dtype=np.float32)
    edge, half = np.float32(limit), np.float32(0.5)
    for row in range(height):
        sums[:] = 0
        counts[:] = 0
        for column in range(width):
            value = np.int64(first[row, column]) - np.int64(second[row, column])
            values[column] = 0 if defects[row, column] else value
        for phase in range(period):
            added: Any = 0
            count: Any = 0
            for column in range(phase, width, period):
                added += values[column]
                count += not defects[row, column]
            sums[pattern[row % period, phase]] += added
            counts[pattern[row % period, phase]] += count
        for phase in range(period):
            channel = pattern[row % period, phase]
            means[phase::period] = sums[channel] / max(counts[channel], 1)
            factors[phase::period] = scale[channel]
        for column in range(width):
            scaled = max(min((np.float32(values[column]) - means[column]) * factors[column], edge), -edge)
            out[row, column] = np.int16(0) if defects[row, column] else np.int16(np.floor(scaled + half))


@kernel
def lag_products(band: NDArray[np.int16], lags: Counts, sums: Counts) -> None:
    """Add, for each lag (rows, columns), the products of all pixels of the band that lie so far apart."""
    height, width = band.shape
    for index in range(lags.shape[0]):
        down, across = lags[index]
        first, last = max(0, -across), width - max(0, across)
        for row in range(height - down):
            here = band[row, first:last]
            there = band[row + down, first + across : last + across]
            added = np.int64(0)
            for column in range(here.size):
                added += np.int32(here[column]) * np.int32(there[column])
            sums[index] += added
