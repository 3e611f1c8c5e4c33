"""The compiled CPU engine of the noise model, as functions on arrays."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import in_threads
from eldata.noise import _kernels
from eldata.noise._random_kernels import LAMBDA_FLOOR, POWER_TERMS
from eldata.noise._tables import poisson_tables
from eldata.noise.mosaic import packed_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.noise.exposures import Exposures

_PIECE = 1 << 16  # pixels in a band of rows: a fraction of a millisecond

_SHOT = {"none": _kernels.NONE, "gaussian": _kernels.GAUSSIAN, "poisson": _kernels.POISSON}
_READ = {"none": _kernels.NONE, "gaussian": _kernels.GAUSSIAN, "tukey-lambda": _kernels.TUKEY_LAMBDA}
# By whether U over one step is added, and whether a converter rounds.
_QUANTISATION = {
    (False, False): _kernels.NONE,
    (True, False): _kernels.UNIFORM,
    (False, True): _kernels.ADC,
    (True, True): _kernels.DITHERED_ADC,
}


def expose_compiled(
    clean: NDArray[np.float32],
    exposures: Exposures,
    *,
    key: int | Sequence[int],
    threads: int | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Return noisy exposures of clean packed images.

    The random numbers of a pixel depend on ``key``, its image's index, its place in the image and the component alone:
    not on the number of threads, and one component does not change when another one is switched off.

    Parameters
    ----------
    clean
        (N, C, h, w) float32, C-contiguous, normalised. Values below 0 count as no light; NaN gives NaN.
    exposures
        Of these N images.
    key
        0 to 2^64 - 1; or several, each for as many images in turn, which are what they are by themselves.
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
    keys = np.array([key] if isinstance(key, int) else key, np.uint64)
    under = images // len(keys)
    streams = np.repeat(keys, under), np.tile(np.arange(under, dtype=np.uint64), len(keys))
    draw = _draw_of(clean.shape, exposures, *streams, under)
    planes, size = images * channels, rows * columns
    if size < _PIECE:
        whole = max(1, _PIECE // size)
        pieces = [(first, min(first + whole, planes), 0, rows) for first in range(0, planes, whole)]
    else:
        band = max(1, _PIECE // columns)
        pieces = [(one, one + 1, row, min(row + band, rows)) for one in range(planes) for row in range(0, rows, band)]
    in_threads(lambda piece: _kernels.add_noise(clean, result, draw, *piece), pieces, threads)
    return result


def _draw_of(
    shape: tuple[int, int, int, int],
    exposures: Exposures,
    keys: NDArray[np.uint64],
    places: NDArray[np.uint64],
    under_key: int,
) -> Any:
    """Return the record that the kernel takes of exposures of images (N, C, h, w), as many ``under_key``."""
    images, channels, _, _ = shape
    parts, adc, dark = exposures.components, exposures.adc, exposures.dark
    gain = exposures.gain_dn_per_e if parts.shot != "none" else np.ones(images)
    lambdas = np.where(np.abs(exposures.tukey_lambda) < LAMBDA_FLOOR, LAMBDA_FLOOR, exposures.tukey_lambda)
    exponent = lambdas.astype(np.float32)
    figures = np.empty((images, channels), _kernels.FIGURES)
    of_image: dict[str, NDArray[np.float64]] = {
        "events": exposures.range_dn / (exposures.ratio * gain),
        "gain": gain,
        "shape": lambdas,
        "sigma_read": exposures.sigma_read_dn,
        "sigma_row": exposures.sigma_row_dn,
        "step": exposures.step_dn,
        "scale": exposures.ratio / exposures.range_dn,
    }
    for name, values in of_image.items():
        figures[name] = values[:, None]
    figures["bias"] = exposures.bias_dn
    figures["black"], figures["white"] = (0.0, math.inf) if adc is None else (adc.black_level_dn, adc.white_level_dn)
    figures["low"], figures["high"] = exposures.limits
    taken = None if dark is None else dark.shading_dn
    no_plane = np.empty((images, channels, 0, 0), np.float32)  # None would be another type, and compiled again
    return _kernels.Draw(
        shot=_SHOT[parts.shot],
        read=_READ[parts.read],
        quantisation=_QUANTISATION[parts.quantisation or exposures.dithers, adc is not None],
        figures=figures,
        power=np.concatenate([_powers(tuple(some)) for some in exponent.reshape(-1, under_key).tolist()]),
        dark=no_plane.astype(np.uint16) if dark is None else dark.dn,
        taken=no_plane if taken is None else taken,
        dark_scale=np.ones(images, np.float32) if dark is None or dark.scale is None else dark.scale.astype(np.float32),
        tables=poisson_tables(),
        under=packed_rows(channels),
        keys=keys,
        places=places,
    )


@lru_cache(maxsize=1024)  # a profile has few shape parameters
def _powers(shapes: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the coefficients of a key's images; their last bits depend on how many are solved for at once."""
    return _power_coefficients(np.array(shapes, np.float32))


def _power_coefficients(shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return, for each l, the coefficients of a polynomial for (1 - v)^l, 0 <= v <= 1/2.

    It interpolates at Chebyshev nodes: relative error below 1e-7 for l from -1 to 2, 1e-8 for abs(l) <= 0.3.
    """
    count = POWER_TERMS
    nodes = 0.25 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = (1.0 - nodes[:, None]) ** shape.astype(np.float64)
    return np.ascontiguousarray(np.linalg.solve(np.vander(nodes, increasing=True), values).T, dtype=np.float32)
