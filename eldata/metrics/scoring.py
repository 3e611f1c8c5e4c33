"""The published ELD protocol: rescaling, PSNR and SSIM in two passes over the images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from eldata.errors import ArgumentError
from eldata.metrics._images import check_threads, pair
from eldata.metrics._kernels import WINDOW
from eldata.metrics.rescaling import factor_of
from eldata.metrics.signal_to_noise import decibels
from eldata.metrics.similarity import error_and_ssim

if TYPE_CHECKING:
    from eldata.metrics._images import Image


@dataclass(frozen=True, slots=True)
class Score:
    """The numbers of one image.

    Attributes
    ----------
    psnr_db
        PSNR in decibels.
    ssim
        Mean structural similarity.
    rescale
        The factor that the prediction was multiplied by; 1.0 without rescaling.
    """

    psnr_db: float
    ssim: float
    rescale: float


def score(
    prediction: Image,
    reference: Image,
    *,
    rescaling: Literal["none", "scalar"],
    threads: int | None = None,
) -> Score:
    """Score one prediction as the evaluation released with the ELD paper does.

    The prediction p is taken as ``clip(alpha * clip(p, 0, 1), 0, 1)`` and compared with the reference by
    PSNR and SSIM on data range 1. It is formed in float64 as it is read, never stored, so it may differ from
    ``psnr(rescale(p, g), g)`` by the rounding of :func:`rescale` to the prediction's dtype.

    Parameters
    ----------
    prediction, reference
        One image each, (C, h, w) or (h, w), of the same shape: float16, bfloat16, float32 or float64, numpy
        array or torch tensor. Tensors on another device are copied to the host.
    rescaling
        ``"scalar"``: alpha is :func:`rescale_factor`, as published for ELD. ``"none"``: alpha is 1.
    threads
        Number of threads, by default one per CPU; the result is the same to the bit for any number.

    Returns
    -------
    Score
        PSNR, SSIM and alpha. PSNR and SSIM are NaN if either image holds NaN.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers or is smaller than 7 x 7, the shapes differ,
        or ``rescaling`` is neither of the two.
    """
    if rescaling not in {"none", "scalar"}:
        raise ArgumentError(f'rescaling must be "none" or "scalar", not {rescaling!r}')
    check_threads(threads)
    images = pair(prediction, reference, smallest=WINDOW)
    factor = factor_of(images, threads) if rescaling == "scalar" else 1.0
    error, similarity = error_and_ssim(images, 1.0, (0.0, 1.0), factor, threads)
    return Score(decibels(error, 1.0), similarity, factor)
