"""Compiled loops of components C, W, T, F and S: what rows, columns and pixels of a sensor have of their own.

Words come from the counter-based generator of :mod:`eldata.noise._random_kernels`, in streams that no other component
has. What belongs to a sensor (which pixels are telegraph pixels, each pixel's response) is a function of the sensor's
key and the pixel's place on it alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel
from eldata.noise._random_kernels import STRIP, gaussian_draw, gaussian_draws, stream, word_of, words

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Streams; those of the other components end at 4.
COLUMNS, BANDS, WAVES, _STATES, _PLACES, _RESPONSE = range(8, 14)

_MARGIN = 64  # packed pixels that a place may lie before the first one that packing keeps
_PLACE_BITS = 24

_U4 = np.uint32
_U8 = np.uint64
_S32 = _U8(32)


@kernel
def line_normals(key: Any, image: Any, component: int, out: NDArray[np.float32]) -> None:
    """Write a standard normal draw for each line of an image."""
    first, second = stream(key, image, component)
    for line in range(out.size):
        word = word_of(first, second, _U8(line))
        out[line] = gaussian_draw(_U4(word >> _S32), _U4(word))


@kernel
def uniform_of(key: Any, image: Any, component: int, counter: int) -> float:
    """Return a number of [0, 1)."""
    first, second = stream(key, image, component)
    return float(word_of(first, second, _U8(counter)) >> _U8(11)) * 2.0**-53


@kernel
def _counter(channel: int, row: int, column: int) -> Any:
    """Return the counter of a packed pixel of the sensor."""
    y, x = _U8(row + _MARGIN), _U8(column + _MARGIN)
    return (((_U8(channel) << _U8(_PLACE_BITS)) + y) << _U8(_PLACE_BITS)) + x


@kernel
def respond_rows(
    clean: NDArray[np.float32],
    out: NDArray[np.float32],
    first_row: int,
    last_row: int,
    prnu: Any,
    sensor: Any,
    channel: int,
    place: tuple[int, int],
) -> None:
    """Write the light times each pixel's response, never below 0, of some rows of a packed channel."""
    first, second = stream(sensor, _U8(0), _RESPONSE)
    high, low = np.empty(STRIP, np.uint32), np.empty(STRIP, np.uint32)
    normal = np.empty(STRIP, np.float32)
    for row in range(first_row, last_row):
        for start in range(0, clean.shape[1], STRIP):
            size = min(STRIP, clean.shape[1] - start)
            words(high[:size], low[:size], first, second, _counter(channel, place[0] + row, place[1] + start))
            gaussian_draws(high[:size], low[:size], normal[:size])
            for j in range(size):
                response = np.float32(1) + prnu * normal[j]
                out[row, start + j] = clean[row, start + j] * (response if response > 0 else np.float32(0))


@kernel
def offset_rows(
    out: NDArray[np.float32],
    first_row: int,
    last_row: int,
    rows_dn: NDArray[np.float32],
    columns_dn: NDArray[np.float32],
    under: Any,
    telegraph: tuple[float, float, Any],
    sensor: Any,
    channel: int,
    place: tuple[int, int],
    key: Any,
    image: Any,
) -> None:
    """Write what rows, columns and telegraph pixels add, DN, in some rows of a packed channel.

    ``rows_dn`` and ``columns_dn`` are of the mosaic, and empty where the component is off; ``under`` (PackedRows) says
    which of them a packed pixel has. A telegraph pixel, (share, duty, amplitude), is at its upper level with the chance
    ``duty``; its mean stays.
    """
    row_table, column_table, period = under.table[channel], under.across[channel], under.period
    share, duty, amplitude = telegraph
    sub = row_table.shape[0]
    places_1, places_2 = stream(sensor, _U8(0), _PLACES)
    states_1, states_2 = stream(key, image, _STATES)
    chosen = _U8(share * 2.0**32)
    upper, lower = amplitude * np.float32(1.0 - duty), -amplitude * np.float32(duty)
    at_upper = _U8(duty * 2.0**32)
    for row in range(first_row, last_row):
        y, cell = row % sub, row // sub
        for x in range(sub):
            of_row = rows_dn[cell * period + row_table[y, x]] if rows_dn.size > 0 else np.float32(0)
            for j in range(x, out.shape[1], sub):
                out[row, j] = of_row
            if columns_dn.size > 0:
                for j in range(x, out.shape[1], sub):
                    out[row, j] += columns_dn[(j // sub) * period + column_table[y, x]]
        if share > 0:
            first, state = _counter(channel, place[0] + row, place[1]), _counter(channel, row, 0)
            for j in range(out.shape[1]):
                if (word_of(places_1, places_2, first + _U8(j)) >> _S32) < chosen:
                    is_upper = (word_of(states_1, states_2, state + _U8(j)) >> _S32) < at_upper
                    out[row, j] += upper if is_upper else lower


@kernel
def fill_line(
    slope: NDArray[np.float32],
    offset: NDArray[np.float32],
    iso: np.float32,
    levels: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write ``slope * iso + offset + level``; ``levels`` (period, W) are those of the rows of one period of the CFA."""
    for y in range(out.shape[0]):
        k, b, level, row = slope[y], offset[y], levels[y % levels.shape[0]], out[y]
        for x in range(out.shape[1]):
            row[x] = k[x] * iso + b[x] + level[x]
