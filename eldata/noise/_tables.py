"""Alias tables for exact Poisson draws.

A sum of independent Poisson variables is Poisson with the sum of the means. So a mean below :data:`TABLE_LIMIT`
is split into a multiple of 8, a multiple of 1/32 below 8, and a remainder below 1/32. The first two have an
alias table each; the remainder is drawn by inversion (``_kernels.py``).

A table is asked with one 32-bit number: its high bits choose a column, the rest is compared with the column's
threshold. The distribution function is rounded to a multiple of 2^-32 and then met exactly, because a column
holds a whole number of the 2^32 possible numbers. So every probability is within 2^-32 of the Poisson one, and
values whose whole tail is below 2^-33 are never drawn (for a mean of 1600, those beyond 6.3 standard deviations).

An entry is 8 bytes: threshold (32 bits), value from the threshold on (16), value below it (16).
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

COARSE_STEP = 8
"""Step of the means of the coarse tables, in events."""

FINE_STEPS = 32
"""Fine tables for each event: their means are multiples of 1 / FINE_STEPS."""

COARSE_COUNT = 208
FINE_COUNT = COARSE_STEP * FINE_STEPS

TABLE_LIMIT = COARSE_STEP * COARSE_COUNT
"""Means from here on have no table."""

FINE_BITS = 5
COARSE_BITS = 6
"""A fine table has 2^5 columns, the first coarse tables have 2^6; the later ones 2^7, 2^8 and 2^9."""

WIDER_FROM = (4, 13, 52)
"""The coarse tables from which on there are 2^7, 2^8 and 2^9 columns: as many as the values with a weight need."""

_UNITS = 1 << 32


def coarse_bits(index: int) -> int:
    """Return log2 of the number of columns of coarse table ``index``."""
    return COARSE_BITS + sum(index >= first for first in WIDER_FROM)


@functools.cache
def poisson_tables() -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return all coarse and all fine tables, each family one after the other in one read-only array.

    Two threads that ask at the same time may both build them; they get equal ones.
    """
    top = COARSE_STEP * COARSE_COUNT
    log_factorial = np.concatenate(([0.0], np.cumsum(np.log(np.arange(1.0, 2 * top)))))
    coarse = [_table(log_factorial, float(COARSE_STEP * index), coarse_bits(index)) for index in range(COARSE_COUNT)]
    fine = [_table(log_factorial, index / FINE_STEPS, FINE_BITS) for index in range(FINE_COUNT)]
    tables = np.concatenate(coarse), np.concatenate(fine)
    for table in tables:
        table.setflags(write=False)
    return tables


def _table(log_factorial: NDArray[np.float64], mean: float, bits: int) -> NDArray[np.uint64]:
    """Return the alias table of Poisson(mean) with 2^bits columns."""
    first, weights = _weights(log_factorial, mean, 1 << bits)
    threshold, other = _alias(weights)
    value = (first + np.arange(weights.size)).astype(np.uint64)
    entry = np.left_shift(threshold.astype(np.uint64), np.uint64(32), dtype=np.uint64)
    entry |= np.left_shift((first + other).astype(np.uint64), np.uint64(16), dtype=np.uint64)
    entry |= value
    return entry


def _weights(log_factorial: NDArray[np.float64], mean: float, columns: int) -> tuple[int, NDArray[np.int64]]:
    """Return the first value with a weight, and the weights from there on: integers that add up to 2^32."""
    if mean == 0:
        return 0, np.array([_UNITS] + [0] * (columns - 1))
    reach = 8 * mean**0.5 + 32  # far beyond the last value with a weight
    start = max(0, int(mean - reach))
    values = np.arange(start, int(mean + reach))
    probability = np.exp(values * np.log(mean) - mean - log_factorial[values])
    cumulative = np.rint(np.minimum(np.cumsum(probability), 1.0) * _UNITS).astype(np.int64)
    cumulative[-1] = _UNITS
    first = int(np.searchsorted(cumulative, 1))
    cumulative = cumulative[first : first + columns]
    cumulative[-1] = _UNITS
    weights = np.zeros(columns, np.int64)
    weights[: cumulative.size] = np.diff(cumulative, prepend=0)
    return start + first, weights


def _alias(weights: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each column's threshold and the column that fills it up from there.

    The columns are filled in one sweep: each light column is topped up by the current heavy one; a heavy column
    that has become light itself is topped up by the next heavy one. Who tops up whom follows from the running
    sums of what the light ones lack and the heavy ones have too much.
    """
    columns = weights.size
    height = _UNITS // columns
    light = np.flatnonzero(weights < height)
    heavy = np.flatnonzero(weights >= height)
    threshold = np.full(columns, height)
    other = np.arange(columns)
    if light.size == 0:
        return threshold, other
    lacking = np.cumsum(height - weights[light])
    spare = np.cumsum(weights[heavy] - height)
    threshold[light] = weights[light]
    already = np.concatenate(([0], lacking[:-1]))
    other[light] = heavy[np.searchsorted(spare, already, side="right")]
    overdrawn = lacking[np.minimum(np.searchsorted(lacking, spare), light.size - 1)] - spare
    topped = np.flatnonzero(overdrawn > 0)
    threshold[heavy[topped]] = height - overdrawn[topped]
    other[heavy[topped]] = heavy[topped + 1]
    return threshold, other
