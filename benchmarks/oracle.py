"""Scores by scikit-image with everything in float64, and how far others are off them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PSNR_TOLERANCE_DB = 1e-9
_SSIM_TOLERANCE = 1e-7


def deviations(
    prediction: NDArray[np.float32],
    reference: NDArray[np.float32],
    ours: tuple[float, float],
    published: tuple[float, float],
) -> str:
    """Assert that our PSNR (dB) and SSIM are the oracle's; say how far off those and the published ones are."""
    exact = _scores(prediction, reference)
    psnr, ssim = (abs(a - b) for a, b in zip(ours, exact, strict=True))
    assert psnr <= _PSNR_TOLERANCE_DB, f"PSNR is {psnr} dB off the oracle's"
    assert ssim <= _SSIM_TOLERANCE, f"SSIM is {ssim} off the oracle's"
    published_psnr, published_ssim = (abs(a - b) for a, b in zip(published, exact, strict=True))
    return f"off float64 by {psnr:.1g} dB, {ssim:.1g}; published by {published_psnr:.1g} dB, {published_ssim:.1g}"


def _scores(prediction: NDArray[np.float32], reference: NDArray[np.float32]) -> tuple[float, float]:
    truth = reference.astype(np.float64)
    clamped = np.clip(prediction.astype(np.float64), 0, 1)
    unsaturated = reference != 1
    p, g = clamped[unsaturated], truth[unsaturated]
    corrected = np.clip(np.dot(p, g) / np.dot(p, p) * clamped, 0, 1)
    return (
        float(peak_signal_noise_ratio(truth, corrected, data_range=1)),  # type: ignore[no-untyped-call]
        float(structural_similarity(truth, corrected, channel_axis=0, data_range=1)),  # type: ignore[no-untyped-call]
    )
