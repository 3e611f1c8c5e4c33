"""PSNR of one image, and with rescaling and SSIM under the rules of a protocol, in two passes over the images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args, overload

import numpy as np

from eldata.base.arrays import is_tensor
from eldata.errors import ArgumentError, check_choice
from eldata.metrics._images import check_data_range, check_pair, check_tensors, check_threads, host_array, total, totals
from eldata.metrics._kernels import products, squared_error
from eldata.metrics.registry import Covariance, PredictionClamp, Rescaling, Rounding, SsimWindow
from eldata.metrics.similarity import AS_IT_IS, Treatment, check_windowing, error_and_ssim, treated, window_side

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.metrics._images import Array, Band, Image, Pair


@dataclass(frozen=True, slots=True)
class ScoringRules:
    """What decides the scores of a prediction and a reference, both normalised. The defaults are ELD's as published.

    Attributes
    ----------
    rescaling
        ``scalar``: the prediction is multiplied by the one factor that minimises its squared error,
        ``<p, g> / <p, p>`` where the reference is not exactly 1; ``none``: it is scored as it is.
    prediction_clamp
        When the prediction is clamped to [0, 1]: ``both``, before and after the factor, ``before`` it alone (the factor
        is found on the clamped prediction in either case), or ``none``, never.
    rounding
        ``8-bit``: prediction and reference are rounded to the nearest 1/255 before they are compared;
        ``8-bit-truncated``: rounded down; ``none``: not rounded.
    mse_offset
        Added to the mean squared error before PSNR's logarithm.
    ssim_window, ssim_covariance
        As :func:`eldata.metrics.ssim` has them.
    data_range
        Range of PSNR and SSIM: 1, or 255 of 8-bit codes.
    """

    rescaling: Rescaling = "scalar"
    prediction_clamp: PredictionClamp = "both"
    rounding: Rounding = "none"
    mse_offset: float = 0.0
    ssim_window: SsimWindow = "uniform-7"
    ssim_covariance: Covariance = "sample"
    data_range: float = 1.0

    def check(self) -> None:
        """Raise :class:`ArgumentError` if a field has an invalid value."""
        check_choice("rescaling", self.rescaling, get_args(Rescaling))
        check_choice("prediction_clamp", self.prediction_clamp, get_args(PredictionClamp))
        check_choice("rounding", self.rounding, get_args(Rounding))
        check_windowing(self.ssim_window, self.ssim_covariance)
        check_data_range(self.data_range)
        if not (self.mse_offset >= 0 and math.isfinite(self.mse_offset)):
            raise ArgumentError(f"mse_offset must be finite and not negative; found {self.mse_offset}")

    def treatment(self, factor: float) -> Treatment:
        """Make the treatment of a prediction's values from the factor."""
        before = (-math.inf, math.inf) if self.prediction_clamp == "none" else (0.0, 1.0)
        after = (0.0, 1.0) if self.prediction_clamp == "both" else (-math.inf, math.inf)
        return (*before, factor, *after)


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


@overload
def psnr(prediction: Array, reference: Image, *, data_range: float = 1.0, threads: int | None = None) -> float: ...
@overload
def psnr(
    prediction: torch.Tensor, reference: torch.Tensor, *, data_range: float = 1.0, threads: int | None = None
) -> torch.Tensor: ...
def psnr(
    prediction: Image, reference: Image, *, data_range: float = 1.0, threads: int | None = None
) -> float | torch.Tensor:
    """Compute the peak signal-to-noise ratio, ``10 log10(data_range^2 / MSE)``.

    The mean squared error is taken over all channels together. Nothing is clipped. Tensors are compared where they
    lie, in float64, and gradients flow through, for use as a loss.

    Parameters
    ----------
    prediction, reference
        One image each, (C, h, w) or (h, w), of the same shape: float16, bfloat16, float32 or float64, numpy
        array or torch tensor. Of tensors also batches, (N, C, h, w).
    data_range
        The difference between the largest and the smallest possible value.
    threads
        Number of threads, by default one per CPU; the result is the same to the bit for any number. Tensors take
        torch's own.

    Returns
    -------
    float or torch.Tensor
        Decibels, of a batch a value for each image; ``inf`` for identical images, whose gradient is NaN, and NaN if
        either image holds NaN. Of tensors a float64 tensor, equal to the arrays' within 1e-9 dB.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers, the shapes differ, or ``data_range`` is not
        positive, or less than half of what the reference reaches.

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
    if is_tensor(prediction):
        p, g = check_tensors(prediction, reference, data_range=data_range)
        return 20.0 * math.log10(data_range) - 10.0 * (p - g).square().mean((-3, -2, -1)).log10()
    images = check_pair(prediction, reference, data_range=data_range)

    def work(band: Band) -> float:
        return squared_error(*images.blocks(band))

    error = total(images.over_bands(work, threads))
    return decibels(error / images.prediction.size, data_range)


def decibels(mean_squared_error: float, data_range: float) -> float:
    """Convert a mean squared error to PSNR."""
    if mean_squared_error == 0.0:
        return math.inf
    return 20.0 * math.log10(data_range) - 10.0 * math.log10(mean_squared_error)


def score(
    prediction: Image,
    reference: Image,
    *,
    rescaling: Rescaling,
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

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.metrics import score
    >>> generator = np.random.default_rng(0)
    >>> reference = generator.uniform(0, 0.9, (4, 64, 64))
    >>> result = score(0.5 * (reference + generator.normal(0, 0.05, reference.shape)), reference, rescaling="scalar")
    >>> round(result.psnr_db, 2), round(result.rescale, 2)
    (26.21, 1.98)
    """
    return score_by(prediction, reference, ScoringRules(rescaling=rescaling), threads=threads)


def score_by(
    prediction: Image,
    reference: Image,
    rules: ScoringRules,
    *,
    factor: float | None = None,
    threads: int | None = None,
) -> Score:
    """Score one prediction by given rules; :func:`score` does so by ELD's rules.

    Parameters
    ----------
    prediction, reference, threads
        As for :func:`score`.
    rules
        What decides the scores.
    factor
        The factor by which ``rules`` rescales this prediction, if it is known already (:func:`factor_by`).

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers or is smaller than the window of SSIM, the shapes differ,
        or a rule is unknown.
    """
    rules.check()
    check_threads(threads)
    images = check_pair(prediction, reference, smallest=window_side(rules.ssim_window), data_range=rules.data_range)
    if factor is None:
        factor = _find_factor(images, rules, threads)
    treatment, data_range = rules.treatment(factor), rules.data_range
    if rules.rounding != "none":
        images, data_range = _round_images(images, rules, treatment), 255.0 * rules.data_range
        treatment = AS_IT_IS
    error, similarity = error_and_ssim(
        images, data_range, treatment, threads, window=rules.ssim_window, covariance=rules.ssim_covariance
    )
    error /= (data_range / rules.data_range) ** 2
    return Score(decibels(error + rules.mse_offset, rules.data_range), similarity, factor)


def factor_by(prediction: Image, reference: Image, rules: ScoringRules, *, threads: int | None = None) -> float:
    """Find the factor by which ``rules`` rescales a prediction; 1.0 if they do not.

    Raises
    ------
    ArgumentError
        As :func:`score_by`.
    """
    rules.check()
    check_threads(threads)
    return _find_factor(check_pair(prediction, reference, data_range=rules.data_range), rules, threads)


def _find_factor(images: Pair, rules: ScoringRules, threads: int | None) -> float:
    """Find the factor of least squared error, <p, g> / <p, p>; 1.0 if the rules rescale nothing."""
    if rules.rescaling == "none":
        return 1.0
    low, high = rules.treatment(1.0)[:2]

    def work(band: Band) -> tuple[float, float]:
        return products(*images.blocks(band), low, high)

    pg, pp = totals(images.over_bands(work, threads))
    return pg / pp if pp != 0.0 else 1.0


def as_compared(prediction: Image, reference: Image, rules: ScoringRules, factor: float) -> tuple[Array, Array]:
    """Treat the prediction, and round both images where rules say so: as :func:`score_by` compares them.

    Parameters
    ----------
    prediction, reference, rules, factor
        As for :func:`score_by`.

    Returns
    -------
    (ndarray, ndarray)
        (C, h, w) each, on the scale of the images; float32 where they are rounded, else float64.

    Raises
    ------
    ArgumentError
        As :func:`score_by`.
    """
    rules.check()
    images, treatment = check_pair(prediction, reference), rules.treatment(factor)
    if rules.rounding == "none":
        return treated(images.prediction, treatment), images.reference.astype(np.float64)
    codes = _round_images(images, rules, treatment)
    return codes.prediction / np.float32(255), codes.reference / np.float32(255)


def _round_images(images: Pair, rules: ScoringRules, treatment: Treatment) -> Pair:
    """Round both images to 8-bit codes, which float32 holds exactly."""
    half = 0.5 if rules.rounding == "8-bit" else 0.0

    def round_image(image: Array, treatment: Treatment) -> NDArray[np.float32]:
        """Treat an image, then round it to 8-bit codes."""
        result = np.empty(image.shape, np.float32)
        for channel, plane in enumerate(image):
            result[channel] = np.clip(np.floor(255.0 * treated(plane, treatment) + half), 0.0, 255.0)
        return result

    return check_pair(round_image(images.prediction, treatment), round_image(images.reference, AS_IT_IS))


# --- ELD's illuminance correction: the one factor that brings a prediction to its reference's brightness --------------


def rescale_factor(prediction: Image, reference: Image, *, threads: int | None = None) -> float:
    """Compute the factor by which ELD's evaluation multiplies a prediction before it is scored.

    With the prediction p clamped to [0, 1] and the reference g, it is ``<p, g> / <p, p>`` over the entries
    where g is not exactly 1 (saturated): the least-squares factor. This is the illuminance correction of the
    code released with the ELD paper (Wei et al., CVPR 2020), with float64 sums.

    Parameters
    ----------
    prediction, reference
        One image each, (C, h, w) or (h, w), of the same shape: float16, bfloat16, float32 or float64, numpy
        array or torch tensor. Tensors on another device are copied to the host.
    threads
        Number of threads, by default one per CPU; the result is the same to the bit for any number.

    Returns
    -------
    float
        The factor. 1.0 if ``<p, p>`` is zero: the prediction is all dark or the reference fully saturated.
        NaN if an entry that counts is NaN in either image.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers, or the shapes differ.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.metrics import rescale_factor
    >>> reference = np.full((4, 64, 64), 0.5)
    >>> rescale_factor(reference / 4, reference)
    4.0
    """
    return factor_by(prediction, reference, ScoringRules(), threads=threads)


@overload
def rescale(prediction: Array, reference: Image) -> Array: ...
@overload
def rescale(prediction: torch.Tensor, reference: Image) -> torch.Tensor: ...
def rescale(prediction: Image, reference: Image) -> Image:
    """Rescale the prediction as ELD's evaluation scores it: ``clip(alpha * clip(p, 0, 1), 0, 1)``.

    ``alpha`` is :func:`rescale_factor`. The arithmetic is float64 on the host.

    Parameters
    ----------
    prediction, reference
        As for :func:`rescale_factor`.

    Returns
    -------
    numpy.ndarray or torch.Tensor
        A new image, of the same kind as the prediction: numpy or torch, dtype, device and shape. A tensor is
        detached: no gradient flows through it.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers, or the shapes differ.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.metrics import psnr, rescale
    >>> reference = np.linspace(0, 0.9, 4096).reshape(1, 64, 64)
    >>> round(psnr(0.5 * reference, reference), 2)
    11.71
    >>> np.allclose(rescale(0.5 * reference, reference), reference)
    True
    """
    factor = rescale_factor(prediction, reference)
    source = host_array(prediction, "the prediction")
    result = np.empty(source.shape, source.dtype)
    for row in np.ndindex(source.shape[:-2]):  # per channel: the float64 intermediates are 8 bytes per pixel
        result[row] = treated(source[row], (0.0, 1.0, factor, 0.0, 1.0))
    if not is_tensor(prediction):
        return result
    import torch

    tensor: torch.Tensor = prediction  # type: ignore[assignment]
    return torch.from_numpy(result).to(device=tensor.device, dtype=tensor.dtype)
