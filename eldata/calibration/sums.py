"""What every sum over frames checks of them, how it counts channels, and what annotations call its arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from eldata.errors import ArgumentError
from eldata.raw.cfa import packed_channels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.raw.cfa import Cfa

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
    plane: NDArray[Any] = np.tile(values[pattern], repeats)[: shape[0], : shape[1]]
    return plane


def checked_mosaic(mosaic: NDArray[Any], shape: tuple[int, int] | None, period: int) -> Mosaic:
    """Return the mosaic if it is a frame in DN, of the shape of the frames before or else large enough."""
    if mosaic.dtype != np.uint16:
        raise ArgumentError(
            f"a mosaic in DN is uint16; found {mosaic.dtype}. Give the raw values as decoded: with the black level, "
            "neither scaled nor clipped"
        )
    if mosaic.ndim != 2 or min(mosaic.shape) < 2 * period:
        raise ArgumentError(
            f"a mosaic is (H, W), of two periods of its CFA or more ({2 * period} x {2 * period}); found shape "
            f"{mosaic.shape}"
        )
    if shape is not None and mosaic.shape != shape:
        raise ArgumentError(
            f"the frames before were {shape[0]} x {shape[1]} pixels and this one is {mosaic.shape[0]} x "
            f"{mosaic.shape[1]}; calibrate frames of one camera, one orientation and one ISO together"
        )
    return mosaic


def checked_black_level(black_level_dn: Sequence[float], channels: int) -> Values:
    """Return the black levels, one per CFA channel."""
    black = np.asarray(black_level_dn, dtype=np.float64)
    if black.shape != (channels,) or not np.all(np.isfinite(black)):
        raise ArgumentError(f"expected {channels} finite black levels, one per CFA channel; found {black_level_dn}")
    return black


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
        if self._defects.dtype != np.bool_ or self._defects.shape != self._shape:
            raise ArgumentError(
                f"the mask of defects is boolean and of the frames' shape {self._shape}; found {self._defects.dtype} "
                f"{self._defects.shape}"
            )
        self.frames += 1
        return self._defects


def sums_by_row(values: NDArray[Any], pattern: Counts) -> Counts:
    """Return the sum of each row in each channel, (H, C), of integers or truth values."""
    sums = np.zeros((len(values), channels_of(pattern)), dtype=np.int64)
    for (rows, columns), channel in sites(pattern):
        sums[rows, channel] += values[rows, columns].sum(axis=1, dtype=np.int64)
    return sums


def levels_and_lines(sums: NDArray[Any], pixels: Counts) -> tuple[Values, Values]:
    """Return each channel's mean in the frame, and that of each line over its channels, each less its own."""
    level = sums.sum(axis=0) / np.maximum(pixels.sum(axis=0), 1)
    return level, (sums - pixels * level).sum(axis=1) / np.maximum(pixels.sum(axis=1), 1)


def groups_of_rows(height: int) -> Counts:
    """Return the group of each row, by pairs of rows as the kernels have it; scatter between groups gives errors."""
    return np.arange(height) // 2 % max(1, min(_GROUPS, height // 4))
