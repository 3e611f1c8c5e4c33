"""The compiled CPU engine of the noise model, as one function on arrays."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import in_threads
from eldata.noise import _kernels
from eldata.noise._tables import poisson_tables
from eldata.noise.packed_rows import packed_rows
from eldata.noise.structured import offsets_dn, with_response

if TYPE_CHECKING:
    from collections.abc import Sequence

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
_NO_FRAMES = np.empty((0, 1, 0, 0), np.uint16)
_NO_PLANES = np.empty((0, 1, 0, 0), np.float32)


def expose_compiled(
    clean: NDArray[np.float32],
    exposures: Exposures,
    *,
    key: int | Sequence[int],
    first_image: int = 0,
    threads: int | None = None,
    out: NDArray[np.float32] | None = None,
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
        0 to 2^64 - 1; or several, each for as many images in turn, which are what they are by themselves.
    first_image
        Index of a key's first image: a batch of N images gives the same as two halves with 0 and N / 2.
    threads
        Default: one per CPU.
    out
        Where to write, as ``clean``, and not its memory.

    Returns
    -------
    ndarray
        (N, C, h, w) float32.
    """
    images, channels, rows, columns = clean.shape
    result = np.empty_like(clean) if out is None else out
    if clean.size == 0:
        return result
    parts, adc, dark, rows_under = exposures.components, exposures.adc, exposures.dark, packed_rows(channels)
    quantisation = _QUANTISATION[parts.quantisation or exposures.dithers, adc is not None]
    gain = exposures.gain_dn_per_e if parts.shot != "none" else np.ones(images)
    shape = exposures.tukey_lambda
    exponent = np.where(np.abs(shape) < _kernels.LAMBDA_FLOOR, _kernels.LAMBDA_FLOOR, shape).astype(np.float32)
    keys = np.array([key] if isinstance(key, int) else key, np.uint64)
    under = images // len(keys)
    streams = np.repeat(keys, under), np.tile(np.arange(first_image, first_image + under, dtype=np.uint64), len(keys))
    taken = None if dark is None else dark.shading_dn
    if exposures.shading_dn is not None:  # added, so taken off below 0
        taken = np.broadcast_to(np.negative(exposures.shading_dn), clean.shape)
    if parts.prnu:
        clean = with_response(clean, exposures, threads)
    added = None
    if parts.column or parts.banding or parts.telegraph:
        added = offsets_dn(clean.shape, exposures, *streams, threads=threads)
    numbers = np.empty((images, channels, 11))
    each: tuple[Any, ...] = (
        exposures.range_dn / (exposures.ratio * gain),
        gain,
        exponent,
        exposures.sigma_read_dn,
        exposures.sigma_row_dn,
        exposures.bias_dn,
        0.0 if adc is None else adc.black_level_dn,
        math.inf if adc is None else adc.white_level_dn,
        exposures.ratio / exposures.range_dn,
        *exposures.limits,
    )
    for place, values in enumerate(each):
        numbers[:, :, place] = values[:, None] if np.ndim(values) == 1 else values
    arguments = (
        clean,
        result,
        _NO_FRAMES if dark is None else dark.dn,
        _NO_PLANES if taken is None else taken,
        _NO_PLANES if added is None else added,
        np.empty((0, 0), np.uint16),
        np.empty((0, 0), np.float32),
        np.ones(images, np.float32) if dark is None or dark.scale is None else dark.scale.astype(np.float32),
        (_SHOT[parts.shot], _READ[parts.read], quantisation),
        numbers.astype(np.float32),
        np.concatenate([_powers(tuple(some)) for some in exponent.reshape(len(keys), under).tolist()]),
        *poisson_tables(),
        np.ascontiguousarray(rows_under.table),
        rows_under.period,
        *streams,
    )
    planes, size = images * channels, rows * columns
    if size < _PIECE:
        whole = max(1, _PIECE // size)
        pieces = [(first, min(first + whole, planes), 0, rows) for first in range(0, planes, whole)]
    else:
        band = max(1, _PIECE // columns)
        pieces = [(one, one + 1, row, min(row + band, rows)) for one in range(planes) for row in range(0, rows, band)]
    in_threads(lambda piece: _kernels.add_noise(*arguments, *piece), pieces, threads)
    return result


@lru_cache(maxsize=1024)  # a profile has few shape parameters
def _powers(shapes: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the coefficients of a key's images; their last bits depend on how many are solved for at once."""
    return _power_coefficients(np.array(shapes, np.float32))


def _power_coefficients(shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return, for each l, the coefficients of a polynomial for (1 - v)^l, 0 <= v <= 1/2.

    It interpolates at Chebyshev nodes: relative error below 1e-7 for l from -1 to 2, 1e-8 for abs(l) <= 0.3.
    """
    count = _kernels.POWER_TERMS
    nodes = 0.25 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = (1.0 - nodes[:, None]) ** shape.astype(np.float64)
    return np.ascontiguousarray(np.linalg.solve(np.vander(nodes, increasing=True), values).T, dtype=np.float32)
