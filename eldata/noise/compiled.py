"""The compiled CPU engine of the noise model, as one function on arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.compiled import in_threads
from eldata.noise import _kernels
from eldata.noise._tables import poisson_tables
from eldata.noise.packed_rows import packed_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.exposures import Exposures

_PIECE = 1 << 16  # pixels in a band of rows: a fraction of a millisecond

_SHOT = {"none": _kernels.NONE, "gaussian": _kernels.GAUSSIAN, "poisson": _kernels.POISSON}
_READ = {"none": _kernels.NONE, "gaussian": _kernels.GAUSSIAN, "tukey-lambda": _kernels.TUKEY_LAMBDA}
# By whether U(-1/2, 1/2) is added, and whether a converter rounds.
_QUANTISATION = {
    (False, False): _kernels.NONE,
    (True, False): _kernels.UNIFORM,
    (False, True): _kernels.ADC,
    (True, True): _kernels.DITHERED_ADC,
}
_NO_FRAME = np.empty((0, 0), np.uint16)


def expose_compiled(
    clean: NDArray[np.float32], exposures: Exposures, *, key: int, first_image: int = 0, threads: int | None = None
) -> NDArray[np.float32]:
    """Return noisy exposures of clean packed images.

    The random numbers of a pixel depend on ``key``, its image's index, its place in the image and the component alone:
    neither on the number of threads nor on how images are put into batches (see ``first_image``), and one component
    does not change when another one is switched off.

    Parameters
    ----------
    clean
        (N, C, h, w) float32, C-contiguous, normalised. Values below 0 count as no light; NaN gives NaN.
    exposures
        Of these N images.
    key
        0 to 2^64 - 1.
    first_image
        Index of the first image: a batch of N images gives the same as two halves with 0 and N / 2.
    threads
        Default: one per CPU.

    Returns
    -------
    ndarray
        (N, C, h, w) float32.
    """
    images, channels, rows, columns = clean.shape
    result = np.empty_like(clean)
    if clean.size == 0:
        return result
    parts, adc, rows_under = exposures.components, exposures.adc, packed_rows(channels)
    quantisation = _QUANTISATION[parts.quantisation or exposures.dithers, adc is not None]
    modes = _SHOT[parts.shot], _READ[parts.read], quantisation
    gain = exposures.gain_dn_per_e if parts.shot != "none" else np.ones(images)
    shape = exposures.tukey_lambda
    exponent = np.where(np.abs(shape) < _kernels.LAMBDA_FLOOR, _kernels.LAMBDA_FLOOR, shape).astype(np.float32)
    power = _power_coefficients(exponent)
    coarse, fine = poisson_tables()

    def settings(image: int, channel: int) -> _kernels.Settings:
        numbers = (
            exposures.range_dn / (exposures.ratio[image] * gain[image]),
            gain[image],
            exponent[image],
            exposures.sigma_read_dn[image],
            exposures.sigma_row_dn[image],
            exposures.bias_dn[image, channel],
            0.0 if adc is None else adc.black_level_dn,
            math.inf if adc is None else adc.white_level_dn,
            exposures.ratio[image] / exposures.range_dn,
            *exposures.limits,
        )
        return _kernels.Settings(*modes, *(np.float32(number) for number in numbers))

    def work(piece: tuple[int, int, int, int]) -> None:
        image, channel, first_row, last_row = piece
        _kernels.add_noise_rows(
            clean[image, channel],
            result[image, channel],
            _NO_FRAME if exposures.dark is None else exposures.dark.dn[image, channel],
            first_row,
            last_row,
            each[image][channel],
            power[image],
            coarse,
            fine,
            rows_under.table[channel],
            rows_under.period,
            np.uint64(key),
            np.uint64(first_image + image),
            np.uint64(channel * rows * columns),
        )

    each = [[settings(image, channel) for channel in range(channels)] for image in range(images)]
    band = max(1, _PIECE // columns)
    pieces = [
        (image, channel, first, min(first + band, rows))
        for image in range(images)
        for channel in range(channels)
        for first in range(0, rows, band)
    ]
    in_threads(work, pieces, threads)
    return result


def _power_coefficients(shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return, for each l, the coefficients of a polynomial for (1 - v)^l, 0 <= v <= 1/2.

    It interpolates at Chebyshev nodes: relative error below 1e-7 for l from -1 to 2, 1e-8 for abs(l) <= 0.3.
    """
    count = _kernels.POWER_TERMS
    nodes = 0.25 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = (1.0 - nodes[:, None]) ** shape.astype(np.float64)
    return np.ascontiguousarray(np.linalg.solve(np.vander(nodes, increasing=True), values).T, dtype=np.float32)
