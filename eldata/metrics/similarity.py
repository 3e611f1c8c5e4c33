"""Structural similarity, with the windows that papers use."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias, get_args, overload

import numpy as np

from eldata.base.arrays import is_tensor
from eldata.errors import check_choice
from eldata.metrics._images import check_data_range, check_pair, check_tensors, check_threads, totals
from eldata.metrics._kernels import (
    AREA,
    GAUSSIAN_WINDOW,
    RADIUS,
    WEIGHTS,
    WINDOW,
    error_and_similarity,
    gaussian_error_and_similarity,
)
from eldata.metrics.registry import Covariance, SsimWindow

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.metrics._images import Array, Band, Block, Image, Pair

# What happens to a prediction's values as they are read: clamped to [first, second], multiplied by the third, clamped
# to [fourth, fifth].
Treatment: TypeAlias = tuple[float, float, float, float, float]
AS_IT_IS: Treatment = (-math.inf, math.inf, 1.0, -math.inf, math.inf)

_K1 = 0.01
_K2 = 0.03


def treated(values: Array, treatment: Treatment) -> NDArray[np.float64]:
    """Clamp, multiply and clamp values, in float64."""
    low, high, factor, final_low, final_high = treatment
    return np.clip(np.clip(values.astype(np.float64), low, high) * factor, final_low, final_high)


@overload
def ssim(
    prediction: Array, reference: Image, *, data_range: float = 1.0, window: SsimWindow = "uniform-7",
    covariance: Covariance = "sample", threads: int | None = None,
) -> float: ...  # fmt: skip
@overload
def ssim(
    prediction: torch.Tensor, reference: torch.Tensor, *, data_range: float = 1.0, window: SsimWindow = "uniform-7",
    covariance: Covariance = "sample", threads: int | None = None,
) -> torch.Tensor: ...  # fmt: skip
def ssim(
    prediction: Image, reference: Image, *, data_range: float = 1.0, window: SsimWindow = "uniform-7",
    covariance: Covariance = "sample", threads: int | None = None,
) -> float | torch.Tensor:  # fmt: skip
    """Compute the mean structural similarity.

    The index of Wang et al. (IEEE TIP 2004) with K1 = 0.01 and K2 = 0.03; by default as scikit-image has it. The
    arithmetic is float64, whatever the images' dtype. Nothing is clipped. Tensors are compared where they lie, and
    gradients flow through, for use as a loss: ``1 - ssim(...).mean()``.

    Parameters
    ----------
    prediction, reference
        One image each, (C, h, w) or (h, w), of the same shape: float16, bfloat16, float32 or float64, numpy
        array or torch tensor. Of tensors also batches, (N, C, h, w).
    data_range
        The difference between the largest and the smallest possible value.
    window
        ``"uniform-7"``, which alone tensors have: uniform, 7 x 7, averaged over the windows that lie inside the image
        and over the channels.
        ``"gaussian-11"``: 11 x 11 with standard deviation 1.5, otherwise the same, as in the paper and its code
        (BasicSR, LED). ``"gaussian-11-volume"``: MATLAB's ``ssim(A, ref)`` with default arguments on a colour image,
        which takes it for a volume: 11 x 11 x 11 with standard deviation 1.5, one window for each value, the image
        continued beyond its edges and its first and last channel by their own values.
    covariance
        ``"sample"``: unbiased by N / (N - 1) with N the window's entries, scikit-image's default; ``"population"``: as
        in the paper and in MATLAB.
    threads
        Number of threads, by default one per CPU; the result is the same to the bit for any number. Tensors take
        torch's own.

    Returns
    -------
    float or torch.Tensor
        At most 1, which identical images reach exactly, of a batch a value for each image; NaN if either image holds
        NaN. Of tensors a float64 tensor, equal to the arrays' within 1e-9.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers or is smaller than the window, the shapes differ,
        ``data_range`` is not positive, or ``window`` or ``covariance`` is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.metrics import ssim
    >>> generator = np.random.default_rng(0)
    >>> reference = generator.uniform(0, 1, (4, 64, 64))
    >>> ssim(reference, reference)
    1.0
    >>> round(ssim(reference + generator.normal(0, 0.1, reference.shape), reference), 3)
    0.942
    """
    check_threads(threads)
    check_data_range(data_range)
    check_windowing(window, covariance)
    if is_tensor(prediction):
        check_choice("window of tensors", window, ("uniform-7",))
        pair = check_tensors(prediction, reference, smallest=WINDOW, data_range=data_range)
        scale = AREA / (AREA - 1) if covariance == "sample" else 1.0
        if pair[0].ndim == 3:
            return _ssim_of_tensors(*pair, data_range, scale)
        import torch

        return torch.stack([_ssim_of_tensors(*images, data_range, scale) for images in zip(*pair, strict=True)])
    images = check_pair(prediction, reference, smallest=window_side(window), data_range=data_range)
    return error_and_ssim(images, data_range, AS_IT_IS, threads, window=window, covariance=covariance)[1]


def _ssim_of_tensors(p: torch.Tensor, g: torch.Tensor, data_range: float, scale: float) -> torch.Tensor:
    """Compute the SSIM of one image (C, h, w), as :func:`~eldata.metrics._kernels.error_and_similarity` does."""
    from torch.nn.functional import avg_pool2d

    s, d = p + g, p - g
    s_mean, d_mean, s_square, d_square = (avg_pool2d(values, WINDOW, 1) for values in (s, d, s * s, d * d))
    luminance, d_squared = s_mean * s_mean + 2 * (_K1 * data_range) ** 2, d_mean * d_mean
    variance_s = scale * (s_square - s_mean * s_mean) + 2 * (_K2 * data_range) ** 2
    variance_d = scale * (d_square - d_squared)
    similarity = (luminance - d_squared) * (variance_s - variance_d)
    return (similarity / ((luminance + d_squared) * (variance_s + variance_d))).mean()


def check_windowing(window: str, covariance: str) -> None:
    """Raise :class:`ArgumentError` if the window or the covariance is unknown."""
    check_choice("window", window, get_args(SsimWindow))
    check_choice("covariance", covariance, get_args(Covariance))


def window_side(window: SsimWindow) -> int:
    """Side of a window: the least height and width of an image."""
    return WINDOW if window == "uniform-7" else GAUSSIAN_WINDOW


def error_and_ssim(
    images: Pair,
    data_range: float,
    treatment: Treatment,
    threads: int | None,
    *,
    window: SsimWindow = "uniform-7",
    covariance: Covariance = "sample",
) -> tuple[float, float]:
    """Compute the mean squared error and the SSIM of a prediction treated this way."""
    c1 = (_K1 * data_range) ** 2
    c2 = (_K2 * data_range) ** 2
    if window == "gaussian-11-volume":
        return _score_volume(images, c1, c2, treatment, covariance, threads)
    side = window_side(window)
    entries = side * side
    degrees = entries - 1 if covariance == "sample" else entries

    def work(band: Band) -> tuple[float, float]:
        p, g = images.blocks(band)
        if window == "uniform-7":
            return error_and_similarity(p, g, band.owned, treatment, c1, c2, float(degrees))
        of_one, scale = np.ones((1, 1)), entries / degrees
        return gaussian_error_and_similarity(p[None], g[None], band.owned, treatment, of_one, c1, c2, scale)

    error, similarity = totals(images.over_bands(work, threads, side))
    channels, height, width = images.prediction.shape
    windows = channels * (height - side + 1) * (width - side + 1)
    return error / images.prediction.size, similarity / windows


# --- colour as a volume -----------------------------------------------------------------------------------------------


def _weigh_channels(channels: int) -> NDArray[np.float64]:
    """Weigh the channels in a window around each channel, with the outer channels repeated outwards."""
    mixing = np.zeros((channels, channels))
    for channel in range(channels):
        for offset in range(-RADIUS, RADIUS + 1):
            mixing[channel, min(max(channel + offset, 0), channels - 1)] += WEIGHTS[abs(offset)]
    return mixing


def _score_volume(
    images: Pair, c1: float, c2: float, treatment: Treatment, covariance: Covariance, threads: int | None
) -> tuple[float, float]:
    """Compute mean squared error and SSIM with a Gaussian window that also spans the channels."""
    channels, height, _ = images.prediction.shape
    mixing = _weigh_channels(channels)
    entries = GAUSSIAN_WINDOW**3
    scale = entries / (entries - 1) if covariance == "sample" else 1.0

    def block(image: NDArray[np.floating], rows: tuple[int, int]) -> Block:
        """Take some rows of all channels, continued beyond the image's edges."""
        wanted = np.arange(rows[0] - RADIUS, rows[1] + RADIUS).clip(0, height - 1)
        inner = image[:, wanted].astype(images.dtype, copy=False)
        result = np.pad(inner, ((0, 0), (0, 0), (RADIUS, RADIUS)), mode="edge")
        result.flags.writeable = False
        return result

    def work(rows: tuple[int, int]) -> tuple[float, float]:
        prediction, reference = block(images.prediction, rows), block(images.reference, rows)
        similarity = gaussian_error_and_similarity(prediction, reference, 0, treatment, mixing, c1, c2, scale)[1]
        inside = np.s_[:, RADIUS:-RADIUS, RADIUS:-RADIUS]
        return float(np.square(treated(prediction[inside], treatment) - reference[inside]).sum()), similarity

    error, similarity = totals(images.over_row_bands(work, threads))
    return error / images.prediction.size, similarity / images.prediction.size
