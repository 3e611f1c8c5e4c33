"""A small classical denoiser, so that the demo has something to beat: sliding-window DCT thresholding.

Each packed channel of the amplified input is cut into overlapping 8x8 windows; DCT coefficients below a threshold go
to zero, and the windows are averaged back (G. Yu and G. Sapiro, "DCT image denoising", IPOL 2011). The noise grows
with the signal, so its variance is first fitted to the image as a + b * mean, from the highest frequencies of the
windows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.fft import dctn, idctn

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SIZE = 8
_STEP = 2
_THRESHOLD = 2.7

# Orthonormal, from R, G1, B, G2: brightness and three differences. Noise stays white, colour gathers in one channel.
_DECORRELATE = np.array(
    [
        [0.5, 0.5, 0.5, 0.5],
        [0.5, -0.5, 0.5, -0.5],
        [0.5**0.5, 0, -(0.5**0.5), 0],
        [0, 0.5**0.5, 0, -(0.5**0.5)],
    ]
)


def denoise(packed: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Return a denoised copy of an amplified Bayer image, (4, h, w), normalised, negative values kept."""
    channels = np.tensordot(_DECORRELATE, packed.astype(np.float32), axes=1).astype(np.float32)
    padded = np.pad(channels, ((0, 0), (_SIZE, _SIZE), (_SIZE, _SIZE)), mode="reflect")
    # Brightness decides the noise of all four: they are sums of the same pixels.
    brightness, variance = _window_statistics(padded[0])
    sigma = np.sqrt(_fitted_variance(brightness, variance))
    result = np.stack([_threshold(channel, sigma) for channel in padded])
    result = result[:, _SIZE:-_SIZE, _SIZE:-_SIZE]
    return np.tensordot(_DECORRELATE.T, result, axes=1).astype(np.float32)


def _windows(channel: NDArray[np.float32]) -> NDArray[np.float32]:
    view = np.lib.stride_tricks.sliding_window_view(channel, (_SIZE, _SIZE))
    return np.ascontiguousarray(view[::_STEP, ::_STEP])


def _window_statistics(channel: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return mean and noise variance of each window; the variance from the quarter of highest frequencies."""
    coefficients = dctn(_windows(channel), axes=(-2, -1), norm="ortho")
    high = coefficients[..., _SIZE // 2 :, _SIZE // 2 :]
    # The median of squares is robust against edges; 0.4549 is that of a squared standard normal.
    variance = np.median(high.reshape(*high.shape[:2], -1) ** 2, axis=-1) / np.float32(0.4549)
    return coefficients[..., 0, 0] / np.float32(_SIZE), variance


def _fitted_variance(mean: NDArray[np.float32], variance: NDArray[np.float32]) -> NDArray[np.float32]:
    order = np.argsort(mean, axis=None)
    groups = [group for group in np.array_split(order, 32) if group.size]
    x = np.array([np.median(mean.flat[group]) for group in groups])
    y = np.array([np.median(variance.flat[group]) for group in groups])
    # Weighted least squares of y = a + b x; each group's scatter is in proportion to its variance.
    weight = 1 / np.maximum(y, 1e-12) ** 2
    x_mean, y_mean = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = np.average((x - x_mean) ** 2, weights=weight)
    slope = np.average((x - x_mean) * (y - y_mean), weights=weight) / spread if spread > 0 else 0.0
    floor = max(float(y.min()) / 2, 1e-12)
    fitted: NDArray[np.float32] = np.maximum(y_mean + slope * (mean - x_mean), floor).astype(np.float32)
    return fitted


def _threshold(channel: NDArray[np.float32], sigma: NDArray[np.float32]) -> NDArray[np.float32]:
    coefficients = dctn(_windows(channel), axes=(-2, -1), norm="ortho")
    keep = np.abs(coefficients) > _THRESHOLD * sigma[..., None, None]
    keep[..., 0, 0] = True
    coefficients *= keep
    # Windows with fewer kept coefficients are smoother, so they weigh more.
    weight = (1.0 / keep.sum(axis=(-2, -1))).astype(np.float32)
    estimate = idctn(coefficients, axes=(-2, -1), norm="ortho") * weight[..., None, None]
    total = np.zeros(channel.shape, np.float32)
    weights = np.full(channel.shape, 1e-12, np.float32)
    rows, columns = weight.shape
    for y in range(_SIZE):
        for x in range(_SIZE):
            place = (slice(y, y + _STEP * rows, _STEP), slice(x, x + _STEP * columns, _STEP))
            total[place] += estimate[..., y, x]
            weights[place] += weight
    return total / weights
