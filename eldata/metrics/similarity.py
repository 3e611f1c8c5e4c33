"""Structural similarity."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.metrics._images import check_data_range, check_threads, pair, total
from eldata.metrics._kernels import WINDOW, error_and_similarity

if TYPE_CHECKING:
    from eldata.metrics._images import Band, Image, Pair

_K1 = 0.01
_K2 = 0.03


def ssim(prediction: Image, reference: Image, *, data_range: float = 1.0, threads: int | None = None) -> float:
    """Return the mean structural similarity.

    The index of Wang et al. (IEEE TIP 2004) with scikit-image's defaults: a uniform 7 x 7 window, sample
    covariance, K1 = 0.01 and K2 = 0.03, averaged over the windows that lie inside of the image and over the
    channels. The arithmetic is float64, whatever the images' dtype. Nothing is clipped.

    Parameters
    ----------
    prediction, reference
        One image each, (C, h, w) or (h, w), of the same shape: float16, bfloat16, float32 or float64, numpy
        array or torch tensor. Tensors on another device are copied to the host.
    data_range
        The difference between the largest and the smallest possible value.
    threads
        Number of threads, by default one per CPU; the result is the same to the bit for any number.

    Returns
    -------
    float
        At most 1, which identical images reach exactly; NaN if either image holds NaN.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers or is smaller than 7 x 7, the shapes differ,
        or ``data_range`` is not positive.
    """
    check_threads(threads)
    check_data_range(data_range)
    images = pair(prediction, reference, smallest=WINDOW)
    return error_and_ssim(images, data_range, (-math.inf, math.inf), 1.0, threads)[1]


def error_and_ssim(
    images: Pair, data_range: float, limits: tuple[float, float], factor: float, threads: int | None
) -> tuple[float, float]:
    """Return the mean squared error and the SSIM of ``clip(factor * clip(p, *limits), *limits)``."""
    low, high = limits
    c1 = (_K1 * data_range) ** 2
    c2 = (_K2 * data_range) ** 2

    def work(band: Band) -> tuple[float, float]:
        return error_and_similarity(*images.blocks(band), band.owned, low, high, factor, c1, c2)

    sums = images.over_bands(work, threads, WINDOW)
    channels, height, width = images.prediction.shape
    windows = channels * (height - WINDOW + 1) * (width - WINDOW + 1)
    error = total(part for part, _ in sums) / images.prediction.size
    return error, total(part for _, part in sums) / windows
