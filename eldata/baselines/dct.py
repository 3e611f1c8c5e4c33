"""Sliding-window DCT thresholding (G. Yu and G. Sapiro, "DCT image denoising", IPOL 2011).

Each channel is cut into overlapping 8x8 windows; DCT coefficients below a threshold go to zero, and the windows are
averaged back. The threshold follows the noise of the window's brightness.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.fft import dct, dctn, idctn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.baselines.signal_noise import SignalNoise

    Values = NDArray[np.floating[Any]]

_SIZE = 8
_STEP = 2
_THRESHOLD = 2.7

# Orthonormal, from R, G1, B, G2: brightness and three differences.
_BAYER = np.array(
    [
        [0.5, 0.5, 0.5, 0.5],
        [0.5, -0.5, 0.5, -0.5],
        [0.5**0.5, 0, -(0.5**0.5), 0],
        [0, 0.5**0.5, 0, -(0.5**0.5)],
    ]
)


def decorrelation(channels: int) -> Values:
    """Return an orthonormal matrix whose first row is brightness: white noise stays white."""
    if channels == len(_BAYER):
        return _BAYER
    return np.asarray(dct(np.eye(channels), axis=0, norm="ortho"))


def dct_thresholded(image: Values, line: SignalNoise) -> NDArray[np.float32]:
    """Return a denoised copy.

    Parameters
    ----------
    image
        (C, h, w), normalised and amplified, negative values kept.
    line
        Of its noise.
    """
    matrix = decorrelation(len(image))
    channels = np.tensordot(matrix, image.astype(np.float32), axes=1).astype(np.float32)
    padded = np.pad(channels, ((0, 0), (_SIZE, _SIZE), (_SIZE, _SIZE)), mode="reflect")
    # Brightness decides the noise of all channels: they are sums of the same pixels.
    brightness = _windows(padded[0]).mean(axis=(-2, -1)) / np.float32(len(image) ** 0.5)
    sigma = np.sqrt(line.variance(brightness)).astype(np.float32)
    result = np.stack([_threshold(channel, sigma) for channel in padded])
    result = result[:, _SIZE:-_SIZE, _SIZE:-_SIZE]
    return np.tensordot(matrix.T, result, axes=1).astype(np.float32)


def _windows(channel: NDArray[np.float32]) -> NDArray[np.float32]:
    view = np.lib.stride_tricks.sliding_window_view(channel, (_SIZE, _SIZE))
    return np.ascontiguousarray(view[::_STEP, ::_STEP])


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
