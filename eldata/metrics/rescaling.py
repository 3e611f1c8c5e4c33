"""ELD's illuminance correction: the one factor that brings a prediction to its reference's brightness."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, overload

import numpy as np

from eldata.base.arguments import is_tensor
from eldata.metrics._images import check_threads, host_array, pair, totals
from eldata.metrics._kernels import products

if TYPE_CHECKING:
    import torch

    from eldata.metrics._images import Array, Band, Image, Pair


def rescale_factor(prediction: Image, reference: Image, *, threads: int | None = None) -> float:
    """Return the factor by which ELD's evaluation multiplies a prediction before it is scored.

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
    check_threads(threads)
    return factor_of(pair(prediction, reference), threads)


def factor_of(
    images: Pair,
    threads: int | None,
    *,
    limits: tuple[float, float] = (0.0, 1.0),
    masked: float | None = 1.0,
) -> float:
    """Return :func:`rescale_factor` of a pair that has been checked, or a variant of it.

    ``limits`` clamp the prediction; entries where the reference is exactly ``masked`` do not count.
    """
    low, high = limits
    left_out = math.nan if masked is None else masked  # nothing equals NaN

    def work(band: Band) -> tuple[float, float]:
        return products(*images.blocks(band), low, high, left_out)

    pg, pp = totals(images.over_bands(work, threads))
    return pg / pp if pp != 0.0 else 1.0


@overload
def rescale(prediction: Array, reference: Image) -> Array: ...
@overload
def rescale(prediction: torch.Tensor, reference: Image) -> torch.Tensor: ...
def rescale(prediction: Image, reference: Image) -> Image:
    """Return the prediction as ELD's evaluation scores it: ``clip(alpha * clip(p, 0, 1), 0, 1)``.

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
        clamped = np.clip(source[row].astype(np.float64), 0.0, 1.0)
        clamped *= factor
        result[row] = np.clip(clamped, 0.0, 1.0)
    if not is_tensor(prediction):
        return result
    import torch

    tensor: torch.Tensor = prediction  # type: ignore[assignment]
    return torch.from_numpy(result).to(device=tensor.device, dtype=tensor.dtype)
