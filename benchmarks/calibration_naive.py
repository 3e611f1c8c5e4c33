"""Calibration the straightforward way: whole-array operations of numpy and scipy, on frames in memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Mosaic = NDArray[np.uint16]

_SITES = tuple((slice(y, None, 2), slice(x, None, 2)) for y in range(2) for x in range(2))


def spatial_gain(flats: Sequence[Mosaic], black_dn: float, side: int | None = None) -> float:
    """Return K as published: the slope of each flat's variance over its median, mean of the four sites of Bayer.

    ``side`` takes the middle of the frame alone, where shading is least.
    """
    slopes = []
    for site in _SITES:
        planes = [_middle(flat, side)[site] for flat in flats]
        medians = [float(np.median(plane)) - black_dn for plane in planes]
        variances = [float(plane.var(dtype=np.float64)) for plane in planes]
        slopes.append(np.polyfit(medians, variances, 1)[0])
    return float(np.mean(slopes))


def _middle(mosaic: Mosaic, side: int | None) -> Mosaic:
    if side is None:
        return mosaic
    top, left = ((length - side) // 2 for length in mosaic.shape)
    return mosaic[top : top + side, left : left + side]


def row_sigma(frames: Sequence[Mosaic]) -> float:
    """Return sigma_row as the standard deviation of the frames' row means, nothing taken off."""
    return float(np.mean([frame.mean(axis=1).std() for frame in frames]))


def tukey_lambda(frames: Sequence[Mosaic], pixels: int, generator: np.random.Generator) -> tuple[float, float]:
    """Return lambda and sigma_TL by scipy on some pixels of the first frame less the mean of all of them."""
    mean = np.zeros(frames[0].shape)
    for frame in frames:
        mean += frame
    return _of_some(frames[0] - mean / len(frames), pixels, generator)


def tukey_lambda_of_one(frame: Mosaic, pixels: int, generator: np.random.Generator) -> tuple[float, float]:
    """Return lambda and sigma_TL by scipy on some pixels of one frame, as published: hot pixels take part."""
    return _of_some(frame.astype(np.float64), pixels, generator)


def _of_some(residual: NDArray[np.float64], pixels: int, generator: np.random.Generator) -> tuple[float, float]:
    """Take off what channels and rows share, and fit some of the pixels."""
    for site in _SITES:
        residual[site] -= residual[site].mean()
    residual -= residual.mean(axis=1, keepdims=True)
    return ppcc(generator.choice(residual.ravel(), pixels, replace=True))


def ppcc(values: NDArray[Any]) -> tuple[float, float]:
    """Return lambda and sigma_TL by scipy's probability plot on the values as they are."""
    shape = float(stats.ppcc_max(values, brack=(-0.3, 0.3), dist="tukeylambda"))
    _, (slope, _, _) = stats.probplot(values, sparams=(shape,), dist="tukeylambda")
    return shape, float(slope)
