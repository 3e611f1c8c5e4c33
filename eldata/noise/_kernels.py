"""The compiled engine of the noise model: from draws to a record, and the loops that take it, band of rows by band.

The random numbers, and what makes results independent of threads and batches, are :mod:`eldata.noise._random_kernels`.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import helper, in_threads, kernel
from eldata.noise._random_kernels import (
    HIGH,
    LAMBDA_FLOOR,
    MARKS,
    MEAN,
    NOISE,
    NUMBER,
    OFFSET,
    POWER_TERMS,
    READ,
    ROW,
    SHOT,
    SHOT_REST,
    STREAMS,
    STRIDE,
    STRIP,
    TAIL,
    VALUE,
    add_large,
    add_rest,
    add_uniform,
    choose,
    find_columns,
    gaussian_draws,
    open_streams,
    poisson_tables,
    tukey_lambda_draws,
    words,
)
from eldata.noise.components import COMPONENTS, packed_rows
from eldata.noise.parameters import Adc, NoiseDraw, NoiseParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


BITS = {name: 1 << place for place, name in enumerate(COMPONENTS)}
"""The components, as the kernel takes their sum."""
P, P_STAR, G, G_STAR, B, R, U = BITS.values()

FIGURES = np.dtype(
    [
        ("gain_dn_per_e", np.float32),  # 1 without shot noise
        ("tukey_lambda", np.float32),
        ("sigma_tl_dn", np.float32),
        ("sigma_gauss_dn", np.float32),
        ("sigma_row_dn", np.float32),
        ("quantisation_step_dn", np.float32),
        ("bias_dn", np.float32),  # colour bias of the channel
        ("events", np.float32),  # photoelectrons (DN without shot noise) for a clean value of 1
        ("scale", np.float32),  # normalised output for one DN
        ("black", np.float32),  # DN, of the converter, as the next
        ("white", np.float32),
        ("low", np.float32),
        ("high", np.float32),
    ]
)
"""The figures of one packed channel of one image."""
PARAMETERS = [name for name in FIGURES.names or () if name in NoiseParameters.__slots__]
"""The figures that are fields of :class:`~eldata.noise.parameters.NoiseParameters`."""

_U8 = np.uint64
_ONE = _U8(1)
_ZERO = np.float32(0)

_PIECE = 1 << 16  # pixels in a band of rows: a fraction of a millisecond


def expose_compiled(
    clean: NDArray[np.float32], draws: Sequence[NoiseDraw], components: Sequence[str], *,
    keys: Sequence[int], adc: Adc | None = None, limits: tuple[float, float] = (-math.inf, math.inf),
    dark: NDArray[np.float32] | None = None, threads: int | None = None, out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:  # fmt: skip
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
    figures = _collect_figures(draws, channels, has_shot_noise=not {"P", "P*"}.isdisjoint(components))
    figures["black"], figures["white"] = (0.0, math.inf) if adc is None else (adc.black_level_dn, adc.white_level_dn)
    figures["low"], figures["high"] = limits
    lambdas = figures["tukey_lambda"][:, 0].tolist()
    powers = [_fit_powers(tuple(lambdas[first : first + under])) for first in range(0, images, under)]
    planes, size = images * channels, rows * columns
    dark = np.empty((planes, 0), np.float32) if dark is None else dark.reshape(planes, size)  # None is compiled again
    flat_clean, flat_out = clean.reshape(planes, size), result.reshape(planes, size)
    flat_clean.flags.writeable = dark.flags.writeable = False  # always, or the other kind is compiled again
    record = (
        *(flat_clean, flat_out, sum(BITS[name] for name in components), adc is not None),
        *(figures, np.concatenate(powers), dark, *poisson_tables(), table, period),
        *(np.repeat(np.array(keys, np.uint64), under), np.tile(np.arange(under, dtype=np.uint64), len(keys))),
    )
    if size < _PIECE:
        whole = max(1, _PIECE // size)
        pieces = [(first, min(first + whole, planes), 0, rows) for first in range(0, planes, whole)]
    else:
        band = max(1, _PIECE // columns)
        pieces = [
            (plane, plane + 1, row, min(row + band, rows)) for plane in range(planes) for row in range(0, rows, band)
        ]

    def fill_piece(piece: tuple[int, int, int, int]) -> None:
        """Add noise to one piece: its first and last plane and row."""
        entries = np.zeros(4 * STRIDE, np.uint64)
        marks = entries[MARKS:STREAMS].view(np.uint8)  # one memory seen in two ways, which takes seconds to compile
        room = marks, entries, np.zeros(7 * STRIDE, np.uint32), np.zeros(6 * STRIDE, np.float32)
        add_noise(*record, *room, channels, columns, *piece)

    in_threads(fill_piece, pieces, threads)
    return result


@cache
def prepare() -> None:
    """Compile or load the engine in this process, before workers begin that would wait for it."""
    draw = NoiseDraw(NoiseParameters(1.0, 0.1, 1.0, 1.0, 1.0), ratio=1.0, range_dn=1.0)
    expose_compiled(np.zeros((1, 4, 1, 1), np.float32), [draw], tuple(COMPONENTS), keys=[0])


def _collect_figures(draws: Sequence[NoiseDraw], channels: int, *, has_shot_noise: bool) -> NDArray[np.void]:
    """Collect the figures of each packed channel of each image, (N, C)."""
    figures = np.empty((len(draws), channels), FIGURES)
    for name in PARAMETERS:
        figures[name] = np.array([getattr(draw.parameters, name) for draw in draws])[:, None]
    figures["tukey_lambda"][np.abs(figures["tukey_lambda"]) < LAMBDA_FLOOR] = LAMBDA_FLOOR
    ratio, range_dn, gain = np.array([(draw.ratio, draw.range_dn, draw.parameters.gain_dn_per_e) for draw in draws]).T
    if not has_shot_noise:
        figures["gain_dn_per_e"], gain = 1.0, np.ones(len(draws))
    figures["events"], figures["scale"] = (range_dn / (ratio * gain))[:, None], (ratio / range_dn)[:, None]
    figures["bias_dn"] = [draw.parameters.channel_bias_dn(channels) for draw in draws]
    return figures


@lru_cache(maxsize=1024)  # a profile has few shape parameters
def _fit_powers(shapes: tuple[float, ...]) -> NDArray[np.float32]:
    """Fit the coefficients for all images of a batch; their last bits depend on how many there are."""
    return power_coefficients(np.array(shapes, np.float32))


def power_coefficients(shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fit, for each l, the coefficients of a polynomial for (1 - v)^l, 0 <= v <= 1/2.

    It interpolates at Chebyshev nodes: relative error below 1e-7 for l from -1 to 2, 1e-8 for abs(l) <= 0.3.
    """
    count = POWER_TERMS
    nodes = 0.25 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = (1.0 - nodes[:, None]) ** shape.astype(np.float64)
    return np.ascontiguousarray(np.linalg.solve(np.vander(nodes, increasing=True), values).T, dtype=np.float32)


@helper
def _expect_events(
    size: Any, clean: NDArray[np.float32], plane: int, begin: Any, events: Any, floats: NDArray[np.float32]
) -> None:
    """Write the mean number of events; below 0 counts as 0, NaN stays."""
    for j in range(size):
        mean = clean[plane, begin + j] * events
        floats[MEAN + j] = _ZERO if mean < _ZERO else mean


@helper
def _add_spread(size: Any, floats: NDArray[np.float32]) -> None:
    """Turn standard normal draws into the normal limit of Poisson draws: mean + sqrt(mean) times a draw."""
    for j in range(size):
        floats[VALUE + j] = floats[MEAN + j] + math.sqrt(floats[MEAN + j]) * floats[VALUE + j]


@helper
def _lay_offset(
    count: Any, width: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], entries: NDArray[np.uint64],
    bias: Any, sigma_row: Any, table: NDArray[np.int64], period: int, channel: int, row: int,
) -> None:  # fmt: skip
    """Write colour bias and row noise of ``count`` parts of rows, DN: a draw for each mosaic row under them, 1 or 2."""
    sub = table.shape[1]
    if sigma_row > _ZERO:
        for draw in range(count * _U8(sub)):
            y = row + np.int64(draw) // sub
            mosaic_row = y // sub * period + table[channel, y % sub, np.int64(draw) % sub]
            words(_ONE, integers, HIGH + draw, entries, ROW, _U8(mosaic_row))
        gaussian_draws(count * _U8(sub), integers, floats, TAIL)
    for y in range(count):
        even, odd = bias, bias
        if sigma_row > _ZERO:
            even = bias + sigma_row * floats[TAIL + y * _U8(sub)]
            odd = bias + sigma_row * floats[TAIL + y * _U8(sub) + _U8(sub - 1)]
        for j in range(width):
            floats[OFFSET + y * width + j] = odd if j & _ONE else even


@helper
def _add_dark(size: Any, floats: NDArray[np.float32], dark: NDArray[np.float32], plane: int, begin: Any) -> None:
    """Add a dark frame, in DN, to the offset."""
    for j in range(size):
        floats[OFFSET + j] += dark[plane, begin + j]


@helper
def _compose(size: Any, floats: NDArray[np.float32], gain: Any, sigma: Any) -> None:
    """Turn events into DN and add the read noise and the offset."""
    for j in range(size):
        floats[VALUE + j] = (floats[VALUE + j] * gain + sigma * floats[NOISE + j]) + floats[OFFSET + j]


@helper
def _digitise(size: Any, floats: NDArray[np.float32], black: Any, white: Any, step: Any) -> None:
    """Round to the converter's steps and to whole DN, black level included, and limit to its range."""
    for j in range(size):
        code = np.rint(np.rint((floats[VALUE + j] + black) / step) * step)
        code = _ZERO if code < _ZERO else code
        code = white if code > white else code
        floats[VALUE + j] = code - black


@helper
def _normalise(
    size: Any, floats: NDArray[np.float32], out: NDArray[np.float32], plane: int, begin: Any, scale: Any, low: Any,
    high: Any,
) -> None:  # fmt: skip
    """Normalise DN by ``scale``, and limit to ``low`` and ``high``."""
    for j in range(size):
        normalised = floats[VALUE + j] * scale
        normalised = low if normalised < low else normalised
        out[plane, begin + j] = high if normalised > high else normalised


@kernel
def add_noise(
    clean: NDArray[np.float32], out: NDArray[np.float32], components: int, converts: bool, figures: NDArray[np.void],
    power: NDArray[np.float32], dark: NDArray[np.float32], coarse_table: NDArray[np.uint64],
    fine_table: NDArray[np.uint64], table: NDArray[np.int64], period: int, keys: NDArray[np.uint64],
    places: NDArray[np.uint64], marks: NDArray[np.uint8], entries: NDArray[np.uint64], integers: NDArray[np.uint32],
    floats: NDArray[np.float32], channels: int, columns: int, first: int, last: int, first_row: int, last_row: int,
) -> None:  # fmt: skip
    """Fill rows ``first_row`` to ``last_row`` of the planes ``first`` to ``last``: all images' channels, one by one.

    One call for many small images: a call from Python costs as much as the noise of a thousand pixels.

    ``clean``, ``out`` (N C, h w); ``components`` the sum of their :data:`BITS`; ``converts`` says whether one rounds;
    ``figures`` (N, C) of :data:`FIGURES`; ``power`` (N, :data:`POWER_TERMS`) the polynomials for (1 - v)^lambda;
    ``dark`` (N C, h w) dark frames above black, DN, of no pixels where there are none; the tables of Poisson draws;
    the mosaic's rows under packed ones (packed_rows) and their period; ``keys`` (N,) each image's key, ``places`` (N,)
    its number under that key. The rest of the arrays is room for strips, zero at first.
    """
    # Whole rows lie side by side: a strip takes as many as it has room for, or short rows would fill no vector.
    together = STRIP // (columns + (columns == 1)) if columns < STRIP else 1  # a row may need two draws
    for plane in range(first, last):
        image, channel = plane // channels, plane % channels
        figure = figures[image, channel]
        open_streams(keys[image], places[image], entries)
        bias = figure.bias_dn if components & B else _ZERO
        sigma_row = figure.sigma_row_dn if components & R else _ZERO

        for start in range(0, columns, STRIP):
            width = _U8(STRIP if start + STRIP < columns else columns - start)
            for row in range(first_row, last_row, together):
                count = together if together < last_row - row else last_row - row
                begin, size = _U8(row * columns + start), _U8(count) * width
                pixel = _U8(channel * clean.shape[1]) + begin
                _expect_events(size, clean, plane, begin, figure.events, floats)
                if components & (P_STAR | U):
                    words(size, integers, NUMBER, entries, SHOT_REST, pixel)
                if components & (P_STAR | P):
                    words(size, integers, HIGH, entries, SHOT, pixel)
                if components & P_STAR:
                    beyond = find_columns(size, integers, floats, marks)
                    choose(size, integers, floats, entries, coarse_table, fine_table)
                    add_rest(size, integers, floats, marks, entries)
                    if beyond > 0:
                        add_large(size, floats, entries, pixel)
                elif components & P:
                    gaussian_draws(size, integers, floats, VALUE)
                    _add_spread(size, floats)
                else:
                    for j in range(size):
                        floats[VALUE + j] = floats[MEAN + j]

                _lay_offset(_U8(count), width, integers, floats, entries, bias, sigma_row, table, period, channel, row)
                if dark.shape[1] > 0:
                    _add_dark(size, floats, dark, plane, begin)

                sigma = -_ZERO  # times the room's zeros: adding -0 leaves everything as it is
                if components & (G | G_STAR):
                    words(size, integers, HIGH, entries, READ, pixel)
                    if components & G:
                        sigma = figure.sigma_gauss_dn
                        gaussian_draws(size, integers, floats, NOISE)
                    else:
                        sigma = figure.sigma_tl_dn
                        tukey_lambda_draws(size, integers, floats, figure.tukey_lambda, power, image)
                _compose(size, floats, figure.gain_dn_per_e, sigma)
                if components & U:
                    add_uniform(size, integers, floats, figure.quantisation_step_dn)
                if converts:
                    _digitise(size, floats, figure.black, figure.white, figure.quantisation_step_dn)
                _normalise(size, floats, out, plane, begin, figure.scale, figure.low, figure.high)


@kernel
def fill_line(
    slope: NDArray[np.float32], offset: NDArray[np.float32], iso: np.float32, levels: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write ``slope * iso + offset + level``, a dark shading; ``levels`` (period, W) are of one period of the CFA."""
    for y in range(out.shape[0]):
        k, b, level, row = slope[y], offset[y], levels[y % levels.shape[0]], out[y]
        for x in range(out.shape[1]):
            row[x] = k[x] * iso + b[x] + level[x]
