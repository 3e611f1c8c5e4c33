"""Components C, W, T and F as arrays beside an image: what multiplies each pixel's light, and what is added in DN.

Both engines take them from here, so that a sensor has the same pixels on every device.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.base.compiled import in_threads
from eldata.noise import _structure_kernels as kernels
from eldata.noise.packed_rows import packed_rows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from eldata.noise.exposures import Exposures
    from eldata.noise.structure import RowSpectrum

_PIECE = 1 << 16  # pixels in a band of rows, as of the engine
_NO_LINES = np.empty(0, np.float32)


def with_response(clean: NDArray[np.float32], exposures: Exposures, threads: int | None = None) -> NDArray[np.float32]:
    """Return clean packed images (N, C, h, w) as a sensor with PRNU responds to their light."""
    out = np.empty_like(clean)
    top, left = exposures.place

    def work(piece: tuple[int, int, int, int]) -> None:
        image, channel, first, last = piece
        prnu = np.float32(exposures.structure[image].prnu or 0.0)
        planes = clean[image, channel], out[image, channel]
        kernels.respond_rows(*planes, first, last, prnu, np.uint64(exposures.sensor_seed), channel, top, left)

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
        As of :func:`eldata.noise.compiled.expose_compiled`.
    """
    _, channels, height, width = shape
    out = np.empty(shape, np.float32)
    under, parts, (top, left) = packed_rows(channels), exposures.components, exposures.place
    rows, columns = (-(-side // under.sub) * under.period for side in (height, width))
    lines: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
    for number, structure in enumerate(exposures.structure):
        stream = keys[number], places[number]
        of_rows = of_columns = _NO_LINES
        if parts.banding and structure.row_spectrum is not None:
            of_rows = banded_rows(structure.row_spectrum, rows, *stream)
        if parts.column and structure.sigma_column_dn is not None:
            of_columns = np.empty(columns, np.float32)
            kernels.line_normals(*stream, kernels.COLUMNS, of_columns)
            of_columns *= np.float32(structure.sigma_column_dn)
        lines.append((of_rows, of_columns))

    def work(piece: tuple[int, int, int, int]) -> None:
        image, channel, first, last = piece
        telegraph = exposures.structure[image].telegraph if parts.telegraph else None
        share, duty, amplitude = (
            (0.0, 0.5, 0.0) if telegraph is None else (telegraph.share, telegraph.duty, telegraph.amplitude_dn)
        )
        kernels.offset_rows(
            out[image, channel],
            first,
            last,
            *lines[image],
            under.table[channel],
            under.across[channel],
            under.period,
            share,
            duty,
            np.float32(amplitude),
            np.uint64(exposures.sensor_seed),
            channel,
            top,
            left,
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
    kernels.line_normals(key, image, kernels.BANDS, white)
    power = spectrum.power_at(np.arange(circle // 2 + 1) / circle)
    offsets = irfft(rfft(white.astype(np.float64)) * np.sqrt(power), circle)[:rows]
    for number, wave in enumerate(spectrum.waves):
        phase = kernels.uniform_of(key, image, kernels.WAVES, number)
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
