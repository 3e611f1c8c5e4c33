"""Peak signal-to-noise ratio."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.metrics._images import check_data_range, check_threads, pair, total
from eldata.metrics._kernels import squared_error

if TYPE_CHECKING:
    from eldata.metrics._images import Band, Image


def psnr(prediction: Image, reference: Image, *, data_range: float = 1.0, threads: int | None = None) -> float:
    """Return the peak signal-to-noise ratio, ``10 log10(data_range^2 / MSE)``.

    The mean squared error is that of all channels together. Nothing is clipped.

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
        Decibels; ``inf`` for identical images, NaN if either image holds NaN.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers, the shapes differ, or ``data_range`` is not
        positive.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.metrics import psnr
    >>> reference = np.full((4, 64, 64), 0.5)
    >>> round(psnr(reference + 0.01, reference), 6)
    40.0
    """
    check_threads(threads)
    check_data_range(data_range)
    images = pair(prediction, reference)

    def work(band: Band) -> float:
        return squared_error(*images.blocks(band))

    error = total(images.over_bands(work, threads))
    return decibels(error / images.prediction.size, data_range)


def decibels(mean_squared_error: float, data_range: float) -> float:
    """Return the PSNR of a mean squared error."""
    if mean_squared_error == 0.0:
        return math.inf
    return 20.0 * math.log10(data_range) - 10.0 * math.log10(mean_squared_error)
