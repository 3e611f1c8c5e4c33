"""What every estimator checks of its frames, and how it counts channels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.cfa import packed_channels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import Cfa


def pattern_of(cfa: Cfa) -> NDArray[np.int64]:
    """Return the CFA's smallest period as an array of channel indices; an ArgumentError if it is unsupported."""
    packed_channels(cfa)
    return np.asarray(cfa, dtype=np.int64)


def channels_of(pattern: NDArray[np.int64]) -> int:
    """Return the number of channels: 4 for Bayer (R, G1, B, G2), 3 for X-Trans."""
    return int(pattern.max()) + 1


def checked_mosaic(mosaic: NDArray[Any], shape: tuple[int, int] | None, period: int) -> NDArray[np.uint16]:
    """Return the mosaic if it is a frame in DN of the shape of those before, or of any sufficient one."""
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


def checked_black_level(black_level_dn: Sequence[float], channels: int) -> NDArray[np.float64]:
    """Return the black levels, one per CFA channel."""
    black = np.asarray(black_level_dn, dtype=np.float64)
    if black.shape != (channels,) or not np.all(np.isfinite(black)):
        raise ArgumentError(f"expected {channels} finite black levels, one per CFA channel; found {black_level_dn}")
    return black


def checked_defects(defects: NDArray[np.bool_] | None, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask of defects, or an empty one of that shape."""
    if defects is None:
        return np.zeros(shape, dtype=np.bool_)
    if defects.dtype != np.bool_ or defects.shape != shape:
        raise ArgumentError(
            f"the mask of defects is boolean and of the frames' shape {shape}; found {defects.dtype} {defects.shape}"
        )
    return defects


def pixels_per_row(defects: NDArray[np.bool_], pattern: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many sound pixels each row has in each channel, (H, C)."""
    height, period = defects.shape[0], len(pattern)
    counts = np.zeros((height, channels_of(pattern)), dtype=np.int64)
    for y in range(period):
        for x in range(period):
            plane = defects[y::period, x::period]
            counts[y::period, pattern[y, x]] += plane.shape[1] - plane.sum(axis=1)
    return counts


def classes_of_rows(pattern: NDArray[np.int64]) -> int:
    """Return how many degrees of freedom channel means take from row means: the rank of the rows' composition."""
    composition = np.stack([np.bincount(row, minlength=channels_of(pattern)) for row in pattern])
    return int(np.linalg.matrix_rank(composition))
