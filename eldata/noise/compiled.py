"""The compiled CPU engine of the noise model: from draws to the record that the kernels take."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.compiled import in_threads
from eldata.noise import _kernels
from eldata.noise._random_kernels import LAMBDA_FLOOR, POWER_TERMS, poisson_tables
from eldata.noise.mosaic import packed_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.noise.parameters import Adc, NoiseDraw

_PIECE = 1 << 16  # pixels in a band of rows: a fraction of a millisecond


def expose_compiled(
    clean: NDArray[np.float32],
    draws: Sequence[NoiseDraw],
    components: Sequence[str],
    *,
    keys: Sequence[int],
    adc: Adc | None = None,
    limits: tuple[float, float] = (-math.inf, math.inf),
    dark: NDArray[np.float32] | None = None,
    threads: int | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Add noise to clean packed images.

    The random numbers of a pixel depend on the key, its image's index under it, its place in the image and the
    component alone: not on the number of threads, and one component does not change when another one is switched off.

    Parameters
    ----------
    clean
        (N, C, h, w) float32, C-contiguous, normalised. Values below 0 count as no light; NaN gives NaN.
    draws
        One for each image.
    components
        Names of :data:`~eldata.noise.components.COMPONENTS`.
    keys
        0 to 2^64 - 1, each for as many images in turn, which are what they are by themselves.
    adc
        The converter that rounds.
    limits
        Of the result.
    dark
        (N, C, h, w) float32: dark frames above black, DN; ``None``: there are none.
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
    under = images // len(keys)
    table, period = packed_rows(channels)
    figures = _figures(draws, channels, has_shot_noise=not {"P", "P*"}.isdisjoint(components))
    figures["black"], figures["white"] = (0.0, math.inf) if adc is None else (adc.black_level_dn, adc.white_level_dn)
    figures["low"], figures["high"] = limits
    lambdas = figures["tukey_lambda"][:, 0].tolist()
    record = _kernels.Draw(
        components=sum(_kernels.BITS[name] for name in components),
        converts=adc is not None,
        figures=figures,
        power=np.concatenate([_powers(tuple(lambdas[first : first + under])) for first in range(0, images, under)]),
        dark=np.empty((images, channels, 0, 0), np.float32) if dark is None else dark,  # None is compiled again
        tables=poisson_tables(),
        row_table=table,
        row_period=period,
        keys=np.repeat(np.array(keys, np.uint64), under),
        places=np.tile(np.arange(under, dtype=np.uint64), len(keys)),
    )
    planes, size = images * channels, rows * columns
    if size < _PIECE:
        whole = max(1, _PIECE // size)
        pieces = [(first, min(first + whole, planes), 0, rows) for first in range(0, planes, whole)]
    else:
        band = max(1, _PIECE // columns)
        pieces = [
            (plane, plane + 1, row, min(row + band, rows)) for plane in range(planes) for row in range(0, rows, band)
        ]
    in_threads(lambda piece: _kernels.add_noise(clean, result, record, *piece), pieces, threads)
    return result


def _figures(draws: Sequence[NoiseDraw], channels: int, *, has_shot_noise: bool) -> NDArray[np.void]:
    """Collect what is drawn for each packed channel of each image, (N, C)."""
    figures = np.empty((len(draws), channels), _kernels.FIGURES)
    for name in _kernels.PARAMETERS:
        figures[name] = np.array([getattr(draw.parameters, name) for draw in draws])[:, None]
    figures["tukey_lambda"][np.abs(figures["tukey_lambda"]) < LAMBDA_FLOOR] = LAMBDA_FLOOR
    ratio, range_dn, gain = np.array([(draw.ratio, draw.range_dn, draw.parameters.gain_dn_per_e) for draw in draws]).T
    if not has_shot_noise:
        figures["gain_dn_per_e"], gain = 1.0, np.ones(len(draws))
    figures["events"], figures["scale"] = (range_dn / (ratio * gain))[:, None], (ratio / range_dn)[:, None]
    figures["bias_dn"] = [draw.parameters.channel_bias_dn(channels) for draw in draws]
    return figures


@lru_cache(maxsize=1024)  # a profile has few shape parameters
def _powers(shapes: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the coefficients of a key's images; their last bits depend on how many are solved for at once."""
    return power_coefficients(np.array(shapes, np.float32))


def power_coefficients(shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fit, for each l, the coefficients of a polynomial for (1 - v)^l, 0 <= v <= 1/2.

    It interpolates at Chebyshev nodes: relative error below 1e-7 for l from -1 to 2, 1e-8 for abs(l) <= 0.3.
    """
    count = POWER_TERMS
    nodes = 0.25 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = (1.0 - nodes[:, None]) ** shape.astype(np.float64)
    return np.ascontiguousarray(np.linalg.solve(np.vander(nodes, increasing=True), values).T, dtype=np.float32)
