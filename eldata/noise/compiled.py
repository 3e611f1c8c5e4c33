"""The compiled CPU engine of the noise model, as functions on arrays.

Components C, W, T and F are arrays beside an image: what multiplies each pixel's light, and what is added in DN. Both
engines take them from here, so that a sensor has the same pixels on every device.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import in_threads
from eldata.noise import _kernels, _structure_kernels
from eldata.noise._random_kernels import LAMBDA_FLOOR, POWER_TERMS
from eldata.noise._tables import poisson_tables
from eldata.noise.mosaic import packed_rows

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.noise.exposures import Exposures
    from eldata.noise.structure import RowSpectrum

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
_NO_LINES = np.empty(0, np.float32)


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
    if exposures.components.prnu:
        clean = with_response(clean, exposures, threads)
    draw = _draw_of(clean.shape, exposures, *streams, under, threads)
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
    threads: int | None,
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
    taken, added = None if dark is None else dark.shading_dn, None
    if exposures.shading_dn is not None:  # added, so taken off below 0
        taken = np.broadcast_to(np.negative(exposures.shading_dn), shape)
    if parts.column or parts.banding or parts.telegraph:
        added = offsets_dn(shape, exposures, keys, places, threads=threads)
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
        added=no_plane if added is None else added,
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


# --- components C, W, T and F ---------------------------------------------------------------------------------------


def with_response(clean: NDArray[np.float32], exposures: Exposures, threads: int | None = None) -> NDArray[np.float32]:
    """Return clean packed images (N, C, h, w) as a sensor with PRNU responds to their light."""
    out = np.empty_like(clean)

    def work(piece: tuple[int, int, int, int]) -> None:
        image, channel, first, last = piece
        prnu = np.float32(exposures.structure[image].prnu or 0.0)
        planes = clean[image, channel], out[image, channel]
        sensor = np.uint64(exposures.sensor_seed)
        _structure_kernels.respond_rows(*planes, first, last, prnu, sensor, channel, exposures.place)

    in_threads(work, list(_pieces(clean.shape)), threads)
    return out


def offsets_dn(
    shape: tuple[int, int, int, int],
    exposures: Exposures,
    keys: NDArray[np.uint64],
    places: NDArray[np.uint64],
    *,
    threads: int | None = None,
) -> NDArray[np.float32]:
    """Return what rows, columns and telegraph pixels add to packed images (N, C, h, w), DN.

    Parameters
    ----------
    shape
        Of the images.
    exposures
        Components and figures.
    keys, places
        Of each image: its key, and its number under that key.
    threads
        As of :func:`expose_compiled`.
    """
    _, channels, height, width = shape
    out = np.empty(shape, np.float32)
    under, parts = packed_rows(channels), exposures.components
    rows, columns = (-(-side // under.sub) * under.period for side in (height, width))
    lines: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
    for number, structure in enumerate(exposures.structure):
        stream = keys[number], places[number]
        of_rows = of_columns = _NO_LINES
        if parts.banding and structure.row_spectrum is not None:
            of_rows = banded_rows(structure.row_spectrum, rows, *stream)
        if parts.column and structure.sigma_column_dn is not None:
            of_columns = np.empty(columns, np.float32)
            _structure_kernels.line_normals(*stream, _structure_kernels.COLUMNS, of_columns)
            of_columns *= np.float32(structure.sigma_column_dn)
        lines.append((of_rows, of_columns))

    def work(piece: tuple[int, int, int, int]) -> None:
        image, channel, first, last = piece
        telegraph = exposures.structure[image].telegraph if parts.telegraph else None
        jumps = (0.0, 0.5, 0.0) if telegraph is None else (telegraph.share, telegraph.duty, telegraph.amplitude_dn)
        _structure_kernels.offset_rows(
            out[image, channel],
            first,
            last,
            *lines[image],
            under,
            (*jumps[:2], np.float32(jumps[2])),
            np.uint64(exposures.sensor_seed),
            channel,
            exposures.place,
            keys[image],
            places[image],
        )

    in_threads(work, list(_pieces(shape)), threads)
    return out


def banded_rows(spectrum: RowSpectrum, rows: int, key: np.uint64, image: np.uint64) -> NDArray[np.float32]:
    """Return the offsets of mosaic rows whose power spectrum is given, DN.

    White noise is filtered over a circle of rows that is longer than the image by the longest wave that the spectrum
    knows, so that the first and the last row know nothing of each other.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    longest = int(np.ceil(1 / spectrum.edges_per_row[0]))
    circle = next_fast_len(rows + longest, real=True)
    white = np.empty(circle, np.float32)
    _structure_kernels.line_normals(key, image, _structure_kernels.BANDS, white)
    power = spectrum.power_at(np.arange(circle // 2 + 1) / circle)
    offsets = irfft(rfft(white.astype(np.float64)) * np.sqrt(power), circle)[:rows]
    for number, wave in enumerate(spectrum.waves):
        phase = _structure_kernels.uniform_of(key, image, _structure_kernels.WAVES, number)
        offsets += wave.amplitude_dn * np.sin(2 * np.pi * (wave.frequency_per_row * np.arange(rows) + phase))
    result: NDArray[np.float32] = offsets.astype(np.float32)
    return result


def _pieces(shape: tuple[int, ...]) -> Iterator[tuple[int, int, int, int]]:
    """Yield image, channel and a band of rows of it."""
    images, channels, rows, columns = shape
    band = max(1, _PIECE // max(columns, 1))
    for image in range(images):
        for channel in range(channels):
            for first in range(0, rows, band):
                yield image, channel, first, min(first + band, rows)
