"""Compiled random numbers of the noise model: a counter-based generator, and the draws.

A word is 64 random bits, a function of two stream keys and a counter alone. The stream keys come from (key, image,
component), the counter is the pixel's index in its image (or the mosaic row), so no result depends on threads, tiles
or batches. The loops run over strips that stay in the L1 cache. Every operation is an IEEE one in a fixed order (no
fast-math, no fused multiply-add), so the bits are the same on any machine; only Poisson means beyond the tables use
the C library's log and lgamma, to accept or reject.

Draws, and how exact they are:

- Poisson: alias tables with probabilities within 2^-32, the remainder of the mean, below 1/32, by
  inversion in float64 with 32-bit numbers; from :data:`TABLE_LIMIT` on transformed rejection in float64.
- Tukey lambda: 64-bit uniforms, one bit for the sign and 63 for the tail, never 0 or 1. So the tail reaches to
  probabilities of 2^-65, and both tails are alike. The quantile is float32 arithmetic for lambda from -1 to 2:
  absolute error below 5e-7 within 0.5 of the median; beyond, relative error below 1e-6 + 1e-7 abs(lambda ln v),
  v being the tail's probability.
- Gaussian: Box-Muller with 40 bits for the radius, which ends at 7.54 standard deviations (the tail beyond has 5e-14),
  and 24 bits for the angle. Float32 arithmetic: absolute error below 3e-6, or 1e-7 over the radius if that is more
  (for one draw in 2000).
- Uniform: 24 bits, symmetric around 0.

Alias tables for exact Poisson draws: a sum of independent Poisson variables is Poisson with the sum of the means. So a
mean below :data:`TABLE_LIMIT` is split into a multiple of 8, a multiple of 1/32 below 8, and a remainder below 1/32.
The first two have an alias table each; the remainder is drawn by inversion. A table is asked with one 32-bit number:
its high bits choose a column, the rest is compared with the column's threshold. The distribution function is rounded to
a multiple of 2^-32 and then met exactly, because a column holds a whole number of the 2^32 possible numbers. So every
probability is within 2^-32 of the Poisson one, and values whose whole tail is below 2^-33 are never drawn (for a mean
of 1600, those beyond 6.3 standard deviations). An entry is 8 bytes: threshold (32 bits), value from the threshold on
(16), value below it (16).
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import helper

if TYPE_CHECKING:
    from numpy.typing import NDArray

LAMBDA_FLOOR = 1e-20
"""Smaller shape parameters count as this one, whose quantile is the logistic one to the last bit."""

POWER_TERMS = 10
"""Coefficients of the polynomial for (1 - v)^lambda on [0, 1/2]."""

STRIP = 512
"""Pixels that are drawn at a time."""

STRIDE = STRIP + 16
"""Between strips in one array: were it a power of two, the processor would take one's address for another's."""

HIGH, LOW, NUMBER, DITHER, DIGITS, COARSE, FINE = (np.uint64(STRIDE * place) for place in range(7))
"""Where strips of whole numbers begin in the array that holds them all; of numpy's type, as components are."""

MEAN, REST, VALUE, OFFSET, NOISE, TAIL = (np.uint64(STRIDE * place) for place in range(6))
"""Where strips of float32 do: places known to the compiler tell it that strips of one array do not overlap."""

FINE_ENTRY, MARKS, STREAMS = (np.uint64(STRIDE * place) for place in range(1, 4))
"""Where 64-bit strips do after the entries of the coarse tables: a byte of marks a pixel, and the streams' keys."""

SHOT, SHOT_REST, SHOT_LARGE, READ, ROW = (np.uint64(number) for number in range(5))
"""Components that have their own stream; of numpy's type, since kernels are compiled again for each Python number."""

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


_F = np.float32
_U4 = np.uint32
_U8 = np.uint64

# The odd constants of the SplitMix64 generator.
_WEYL = _U8(0x9E3779B97F4A7C15)
_MIX_1 = _U8(0xBF58476D1CE4E5B9)
_MIX_2 = _U8(0x94D049BB133111EB)
_S12, _S27, _S30, _S31, _S32 = _U8(12), _U8(27), _U8(30), _U8(31), _U8(32)
_ZERO_8, _ONE_8, _THREE_8, _EIGHT_8, _SIXTY_FOUR_8 = _U8(0), _U8(1), _U8(3), _U8(8), _U8(64)

# Layout of the tables.
_FINE_COUNT_BITS = _U4((COARSE_STEP * FINE_STEPS).bit_length() - 1)
_FINE_MASK = _U4(COARSE_STEP * FINE_STEPS - 1)
_FINE_BITS = _U4(FINE_BITS)
_FINE_SHIFT = _U4(32 - FINE_BITS)
_FINE_LOW = _U4((1 << (32 - FINE_BITS)) - 1)
_WIDER_1, _WIDER_2, _WIDER_3 = (_U4(first) for first in WIDER_FROM)
_BITS_0, _BITS_1, _BITS_2, _BITS_3 = (_U4(COARSE_BITS + more) for more in range(4))
_SHIFT_0, _SHIFT_1, _SHIFT_2, _SHIFT_3 = (_U4(32 - COARSE_BITS - more) for more in range(4))
_START_1 = WIDER_FROM[0] << COARSE_BITS
_START_2 = _START_1 + ((WIDER_FROM[1] - WIDER_FROM[0]) << (COARSE_BITS + 1))
_START_3 = _START_2 + ((WIDER_FROM[2] - WIDER_FROM[1]) << (COARSE_BITS + 2))
# Coarse table c starts at (c << bits) minus the one of these that belongs to its width.
_BACK_1 = _U4((WIDER_FROM[0] << (COARSE_BITS + 1)) - _START_1)
_BACK_2 = _U4((WIDER_FROM[1] << (COARSE_BITS + 2)) - _START_2)
_BACK_3 = _U4((WIDER_FROM[2] << (COARSE_BITS + 3)) - _START_3)
_LOW_16 = _U4(0xFFFF)
_SHIFT_16 = _U4(16)
_LOW_0, _LOW_1, _LOW_2, _LOW_3 = (_U4((1 << (32 - COARSE_BITS - more)) - 1) for more in range(4))
_SIGN = _U4(0x80000000)
_SIGN_OFF = _U4(0x7FFFFFFF)

_ZERO, _HALF, _ONE, _TWO = _F(0), _F(0.5), _F(1), _F(2)
_LIMIT = _F(TABLE_LIMIT)
_STEPS = _F(FINE_STEPS)
_STEP = _F(1 / FINE_STEPS)
_TO_24 = _F(2.0**-24)
_TO_32 = _F(2.0**-32)
_TO_40 = _F(2.0**-40)
_TO_64 = _F(2.0**-64)
_FROM_32 = _F(2.0**32)
_QUARTER = _F(0.25)

# ln: exponent and mantissa in [sqrt(1/2), sqrt(2)), then 2 artanh((m - 1) / (m + 1)), error of the fit 2.4e-10.
_ROOT_HALF = np.int32(0x3F3504F3)
_MANTISSA = np.int32(0x7FFFFF)
_SHIFT_23 = np.int32(23)
_LN2 = _F(math.log(2))
_LN_0, _LN_1, _LN_2, _LN_3 = _F(2), _F(0.66666816), _F(0.39974752), _F(0.29926655)

# exp(x) - 1 = 2^n (exp(r) - 1) + 2^n - 1; the polynomial is (exp(r) - 1) / r for abs(r) <= ln(2) / 2, error 1.1e-8.
_LOG2_E = _F(1 / math.log(2))
_LN2_HIGH = _F(0.693359375)  # 10 bits, so that n times it is exact
_LN2_LOW = _F(math.log(2) - 0.693359375)
_ROUNDER = _F(1.5 * 2**23)  # adding and subtracting it rounds to an integer
_EXPONENT_BIAS = np.int32(127)
_EXP_0, _EXP_1, _EXP_2 = _F(1), _F(0.50000001), _F(0.16666505)
_EXP_3, _EXP_4, _EXP_5 = _F(0.04166624), _F(0.00836919), _F(0.00139486)
_EXP_LOWEST = _F(-80)  # exp(x) - 1 is -1 long before

# sin(2 pi q) / q in q^2 for abs(q) <= 1/4, error 2.7e-8.
_SIN_0, _SIN_1, _SIN_2 = _F(6.28318528), _F(-41.34168072), _F(81.60248511)
_SIN_3, _SIN_4 = _F(-76.58139641), _F(39.76161703)


@helper
def _mix(z: Any, second: Any) -> Any:
    """SplitMix64's output function, with a second key between its two multiplications (0: as it is published).

    The second key makes each stream another function, where plain SplitMix64 has one cycle that streams could share.
    """
    z = ((z ^ (z >> _S30)) * _MIX_1) ^ second
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@helper
def open_streams(key: Any, image: Any, entries: NDArray[np.uint64]) -> None:
    """Write the two keys of each component's stream."""
    of_image = _mix(_mix(key + _WEYL, _ZERO_8) + image * _WEYL, _ZERO_8)
    for component in range(ROW + _ONE_8):
        z = _mix(of_image + (component + _ONE_8) * _WEYL, _ZERO_8)
        entries[STREAMS + component + component] = z
        entries[STREAMS + component + component + _ONE_8] = _mix(z + _WEYL, _ZERO_8)


@helper
def words(
    size: Any, integers: NDArray[np.uint32], place: Any, entries: NDArray[np.uint64], of: Any, first: Any
) -> None:
    """Write consecutive words of a stream, in halves, high then low: what follows is then 32-bit vector code."""
    second = entries[STREAMS + of + of + _ONE_8]
    state = entries[STREAMS + of + of] + first * _WEYL
    for j in range(size):
        word = _mix(state, second)
        integers[place + j] = word >> _S32
        integers[place + LOW + j] = word
        state += _WEYL


@helper
def _ln(x: Any) -> Any:
    """Return ln(x) of a positive, normal float32; relative error 1.5e-7, or 6e-8 absolute if that is more."""
    bits = _F(x).view(np.int32) - _ROOT_HALF
    exponent = _F(np.int32(bits >> _SHIFT_23))
    mantissa = np.int32((bits & _MANTISSA) + _ROOT_HALF).view(np.float32)
    s = (mantissa - _ONE) / (mantissa + _ONE)
    z = s * s
    return exponent * _LN2 + s * (_LN_0 + z * (_LN_1 + z * (_LN_2 + z * _LN_3)))


@helper
def tukey_lambda_draws(
    size: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], shape: Any, power: NDArray[np.float32],
    image: int,
) -> None:  # fmt: skip
    """Write the Tukey-lambda draw of each word: the quantile of v = its low 63 bits, or the mirrored one.

    With t = ln(v / (1 - v)), Q(v) = (v^l - (1 - v)^l) / l = (1 - v)^l (exp(l t) - 1) / l, which cancels nowhere.
    ``shape`` is l, ``power`` each image's polynomial for (1 - v)^l. Short loops, which the compiler vectorises; one
    long one it does not.
    """
    inverse = _ONE / shape
    for j in range(size):
        v = _F(_U4(integers[HIGH + j] & _SIGN_OFF)) * _TO_32 + (_F(integers[LOW + j]) + _HALF) * _TO_64
        floats[TAIL + j] = v
        floats[NOISE + j] = v / (_ONE - v)
    for j in range(size):
        floats[NOISE + j] = _ln(floats[NOISE + j])
    for j in range(size):
        x = shape * floats[NOISE + j]
        x = x if x > _EXP_LOWEST else _EXP_LOWEST  # noqa: FURB136 # max() is one more function to compile
        n = (x * _LOG2_E + _ROUNDER) - _ROUNDER
        r = (x - n * _LN2_HIGH) - n * _LN2_LOW
        p = _EXP_0 + r * (_EXP_1 + r * (_EXP_2 + r * (_EXP_3 + r * (_EXP_4 + r * _EXP_5))))
        two_n = np.int32((np.int32(n) + _EXPONENT_BIAS) << _SHIFT_23).view(np.float32)
        floats[NOISE + j] = two_n * ((r * inverse) * p) + (two_n - _ONE) * inverse
    for j in range(size):
        v = floats[TAIL + j]
        p = power[image, POWER_TERMS - 1]
        for term in range(POWER_TERMS - 2, -1, -1):
            p = power[image, term] + v * p
        q = floats[NOISE + j] * p
        floats[NOISE + j] = q if integers[HIGH + j] < _SIGN else -q


@helper
def gaussian_draws(size: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], place: Any) -> None:
    """Write the standard normal draw of each word (Box-Muller; the high 40 bits give the radius)."""
    for j in range(size):
        low = integers[LOW + j]
        u = _F(integers[HIGH + j]) * _TO_32 + (_F(_U4(low >> _U4(24))) + _HALF) * _TO_40
        angle = (_F(np.int32(low & _U4(0xFFFFFF)) - np.int32(0x800000)) + _HALF) * _TO_24  # in turns, (-1/2, 1/2)
        q = (angle if angle > _ZERO else -angle) - _QUARTER
        z = q * q
        sine = q * (_SIN_0 + z * (_SIN_1 + z * (_SIN_2 + z * (_SIN_3 + z * _SIN_4))))
        floats[place + j] = math.sqrt(-_TWO * _ln(u)) * sine


@helper
def find_columns(size: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], marks: NDArray[np.uint8]) -> Any:
    """Split the means into steps and rest, and write the index of each pixel's column in the coarse and fine tables.

    Return how many means are beyond the tables (or NaN), taken as 0. The pixels whose rest may give an event are
    marked: P(at least one) = 1 - exp(-r) < r.
    """
    beyond = _U4(0)
    for j in range(size):
        mean = floats[MEAN + j]
        inside = mean < _LIMIT
        mean = mean if inside else _ZERO
        beyond = _U4(beyond + _U4(not inside))  # of 64 bits, the loop would be half as wide
        steps = np.int32(mean * _STEPS)
        rest = mean - _F(steps) * _STEP
        floats[REST + j] = rest
        marks[j] = integers[NUMBER + j] < _U4(np.int32(rest * _FROM_32))
        digits = _U4(steps)
        integers[DIGITS + j] = digits
        index = _U4(digits >> _FINE_COUNT_BITS)
        number = integers[HIGH + j]
        place = _U4(_U4(index << _BITS_0) + _U4(number >> _SHIFT_0))
        place = _U4(_U4(_U4(index << _BITS_1) + _U4(number >> _SHIFT_1)) - _BACK_1) if index >= _WIDER_1 else place
        place = _U4(_U4(_U4(index << _BITS_2) + _U4(number >> _SHIFT_2)) - _BACK_2) if index >= _WIDER_2 else place
        place = _U4(_U4(_U4(index << _BITS_3) + _U4(number >> _SHIFT_3)) - _BACK_3) if index >= _WIDER_3 else place
        integers[COARSE + j] = place
        integers[FINE + j] = _U4(_U4(digits & _FINE_MASK) << _FINE_BITS) + _U4(integers[LOW + j] >> _FINE_SHIFT)
    return beyond


@helper
def choose(
    size: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], entries: NDArray[np.uint64],
    coarse_table: NDArray[np.uint64], fine_table: NDArray[np.uint64],
) -> None:  # fmt: skip
    """Look up each pixel's entries in both tables; write its number of events, the sum of the values that they give."""
    for j in range(size):  # only this is not vector code
        entries[j] = coarse_table[integers[COARSE + j]]
        entries[FINE_ENTRY + j] = fine_table[integers[FINE + j]]
    for j in range(size):
        index = _U4(integers[DIGITS + j] >> _FINE_COUNT_BITS)
        below = _LOW_0
        below = _LOW_1 if index >= _WIDER_1 else below
        below = _LOW_2 if index >= _WIDER_2 else below
        below = _LOW_3 if index >= _WIDER_3 else below
        entry = _U4(entries[j])
        value = entry if _U4(integers[HIGH + j] & below) < _U4(entries[j] >> _S32) else _U4(entry >> _SHIFT_16)
        entry = _U4(entries[FINE_ENTRY + j])
        more = (
            entry
            if _U4(integers[LOW + j] & _FINE_LOW) < _U4(entries[FINE_ENTRY + j] >> _S32)
            else _U4(entry >> _SHIFT_16)
        )
        floats[VALUE + j] = _F(np.int32(_U4(_U4(value & _LOW_16) + _U4(more & _LOW_16))))


@helper
def add_rest(
    size: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], marks: NDArray[np.uint8],
    entries: NDArray[np.uint64],
) -> None:  # fmt: skip
    """Add the rest's events at the marked pixels: as many as there are k >= 1 with u < P(at least k).

    Marks are looked at by eights; beyond the strip's end they are of an earlier strip, and change what nothing reads.
    """
    for block in range(_ZERO_8, size, _EIGHT_8):
        if entries[MARKS + (block >> _THREE_8)] == _ZERO_8:
            continue
        for j in range(block, block + _EIGHT_8):
            if marks[j] == 0:
                continue
            r = np.float64(floats[REST + j])
            u = np.float64(integers[NUMBER + j]) * 2.0**-32
            tail = 1.0
            for term in range(6, 1, -1):
                tail = 1.0 - r / term * tail
            tail *= r
            probability = 1.0 - tail
            k = 0
            while u < tail:
                k += 1
                probability *= r / k
                tail -= probability
            floats[VALUE + j] += _F(k)


@helper
def add_large(size: Any, floats: NDArray[np.float32], entries: NDArray[np.uint64], pixel: Any) -> None:
    """Draw where the mean is beyond the tables: Hörmann's transformed rejection with squeeze (PTRS, 1993).

    Infinity and NaN stay. 32 attempts stand ready for each pixel; each fails with probability 0.13 at most.
    """
    second = entries[STREAMS + SHOT_LARGE + SHOT_LARGE + _ONE_8]
    for j in range(size):
        mean = np.float64(floats[MEAN + j])
        if mean < TABLE_LIMIT:
            continue
        floats[VALUE + j] = mean
        b = 0.931 + 2.53 * math.sqrt(mean)
        a = 0.02483 * b - 0.059
        state = entries[STREAMS + SHOT_LARGE + SHOT_LARGE] + (pixel + j) * _SIXTY_FOUR_8 * _WEYL
        for _ in range(32 if mean < math.inf else 0):
            u = (np.float64(_mix(state, second) >> _S12) + 0.5) * 2.0**-52 - 0.5
            v = (np.float64(_mix(state + _WEYL, second) >> _S12) + 0.5) * 2.0**-52
            state += _WEYL + _WEYL
            us = 0.5 - abs(u)
            k = np.floor((2.0 * a / us + b) * u + mean + 0.43)  # math.floor is an int64, which ends at 9e18
            if not (us >= 0.07 and v <= 0.9277 - 3.6224 / (b - 2.0)):
                if k < 0 or (us < 0.013 and v > us):
                    continue
                bound = math.log(v * (1.1239 + 1.1328 / (b - 3.4)) / (a / (us * us) + b))
                if not bound <= k * math.log(mean) - mean - math.lgamma(k + 1.0):
                    continue
            floats[VALUE + j] = k
            break


@helper
def add_uniform(size: Any, integers: NDArray[np.uint32], floats: NDArray[np.float32], width: Any) -> None:
    """Add U(-1/2, 1/2) times a width, from the high 24 bits."""
    for j in range(size):
        number = np.int32(_U4(integers[DITHER + j] >> _U4(8))) - np.int32(0x800000)
        floats[VALUE + j] += (_F(number) + _HALF) * _TO_24 * width


# --- alias tables -----------------------------------------------------------------------------------------------------


@cache
def poisson_tables() -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return all coarse and all fine tables, each family one after the other in one read-only array.

    Two threads that ask at the same time may both build them; they get equal ones.
    """
    top = COARSE_STEP * COARSE_COUNT
    log_factorial = np.concatenate(([0.0], np.cumsum(np.log(np.arange(1.0, 2 * top)))))
    coarse = [_tabulate(log_factorial, float(COARSE_STEP * index), coarse_bits(index)) for index in range(COARSE_COUNT)]
    fine = [_tabulate(log_factorial, index / FINE_STEPS, FINE_BITS) for index in range(FINE_COUNT)]
    tables = np.concatenate(coarse), np.concatenate(fine)
    for table in tables:
        table.setflags(write=False)
    return tables


def _tabulate(log_factorial: NDArray[np.float64], mean: float, bits: int) -> NDArray[np.uint64]:
    """Return the alias table of Poisson(mean) with 2^bits columns."""
    first, weights = _weigh_poisson(log_factorial, mean, 1 << bits)
    threshold, other = _build_alias(weights)
    value = (first + np.arange(weights.size)).astype(np.uint64)
    entry = np.left_shift(threshold.astype(np.uint64), np.uint64(32), dtype=np.uint64)
    entry |= np.left_shift((first + other).astype(np.uint64), np.uint64(16), dtype=np.uint64)
    entry |= value
    return entry


def _weigh_poisson(log_factorial: NDArray[np.float64], mean: float, columns: int) -> tuple[int, NDArray[np.int64]]:
    """Weigh the values of Poisson(mean): the first with a weight, and weights from there on, integers of sum 2^32."""
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


def _build_alias(weights: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Build an alias table from weights: each column's threshold, and the column that fills it up from there.

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
