"""The compiled engine against scipy.stats, closed forms and its promises.

Keys are fixed, so nothing here is flaky; a new key would fail each statistical test with a probability of about
ALPHA, and there are about 150 of them.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from eldata.base.compiled import kernel
from eldata.datasets import Arrays, SyntheticPairs
from eldata.noise import NoiseDraw, NoiseParameters, _kernels, _random_kernels, parse_components
from eldata.noise._kernels import expose_compiled
from tests.noise.helpers import moments_of_tukey_lambda, poisson_p_value

ALPHA = 1e-5
SIGMAS = float(stats.norm.isf(ALPHA / 2))  # 4.42

FULL = "P*+G*+B+R+U"
PARTS = ("P*", "P", "G*", "G", "U")
PARAMETERS = NoiseParameters(1.0, -0.1, 1.7, 1.7, 0.6, (0.3, -0.2, 0.1, 0.0))


def noisy(
    clean: NDArray[np.float32], spec: str, *draws: NoiseDraw, key: int = 1, threads: int = 2,
    parameters: NoiseParameters = PARAMETERS,
) -> NDArray[np.float32]:  # fmt: skip
    """Draw by one key, in DN where no draws are given."""
    each = draws or [NoiseDraw(parameters, 1.0, 1.0)] * len(clean)
    return expose_compiled(clean, each, parse_components(spec), keys=[key], threads=threads)


def flat(value: float, shape: tuple[int, int, int, int] = (1, 4, 512, 512)) -> NDArray[np.float32]:
    return np.full(shape, value, dtype=np.float32)


def gradient(shape: tuple[int, int, int, int], top: float = 60.0) -> NDArray[np.float32]:
    return np.linspace(-0.05 * top, top, math.prod(shape), dtype=np.float32).reshape(shape)


# Poisson


@pytest.mark.parametrize(
    "mean", [0, 1e-4, 0.01, 0.3, 1, 2.3, 5, 15.99, 16, 63.7, 160, 499.5, 1600, 1663.99, 1664, 5000]
)
def test_poisson_counts_fit_scipy(mean: float) -> None:
    """Chi-square over 2^22 draws."""
    mean = float(np.float32(mean))
    counts = noisy(flat(mean, (4, 4, 512, 512)), "P*", key=int(1000 * mean) + 7).astype(np.float64).ravel()
    if mean == 0:
        assert not counts.any()
    else:
        assert poisson_p_value(counts, mean) > ALPHA


@pytest.mark.parametrize("family", ["coarse", "fine"])
def test_alias_tables_hold_poisson_probabilities_within_one_unit(family: str) -> None:
    """Each table, read back exactly, is within 1.01 units of 2^-32 of scipy's probabilities everywhere."""
    table = _random_kernels.poisson_tables()[0 if family == "coarse" else 1]
    count = _random_kernels.COARSE_COUNT if family == "coarse" else _random_kernels.FINE_COUNT
    start = 0
    for index in range(count):
        bits = _random_kernels.coarse_bits(index) if family == "coarse" else _random_kernels.FINE_BITS
        mean = index * _random_kernels.COARSE_STEP if family == "coarse" else index / _random_kernels.FINE_STEPS
        part = table[start : start + (1 << bits)]
        start += part.size
        threshold = (part >> np.uint64(32)).astype(np.int64)
        beyond, below = ((part >> np.uint64(shift) & np.uint64(0xFFFF)).astype(np.int64) for shift in (16, 0))
        weights = np.zeros(2100, dtype=np.int64)
        np.add.at(weights, below, threshold)
        np.add.at(weights, beyond, (1 << 32 - bits) - threshold)
        assert weights.sum() == 1 << 32
        assert np.abs(weights - 2.0**32 * stats.poisson.pmf(np.arange(2100), mean)).max() < 1.01
    assert start == table.size


# Tukey lambda


@pytest.mark.parametrize("shape", [-0.3, -0.14, -0.05, -1e-7, 0, 1e-7, 0.05, 0.14, 0.5, 1, 2])
def test_tukey_lambda_distribution(shape: float) -> None:
    """Kolmogorov-Smirnov at 4095 quantiles with 2^22 draws, the variance where the fourth moment exists, and tails."""
    key = int(abs(shape) * 1e8) + 3
    parameters = replace(PARAMETERS, tukey_lambda=shape, sigma_tl_dn=1.0)
    out = noisy(flat(0, (4, 4, 512, 512)), "G*", parameters=parameters, key=key).ravel()
    out.sort()
    grid = np.arange(1, 4096) / 4096
    # scipy's quantile cancels for lambda = 1e-7; the logistic one differs by a relative 1e-6 there
    quantiles = stats.logistic.ppf(grid) if abs(shape) < 1e-5 else stats.tukeylambda.ppf(grid, shape)
    empirical = np.searchsorted(out, quantiles.astype(np.float32)) / out.size
    assert np.abs(empirical - grid).max() < math.sqrt(-math.log(ALPHA / 2) / 2 / out.size)
    if shape > -0.2:
        variance, excess = moments_of_tukey_lambda(shape if abs(shape) > 1e-5 else 0)
        allowed = SIGMAS * variance * math.sqrt((excess + 2) / out.size)
        assert abs(out.astype(np.float64).var() - variance) < allowed
    if abs(shape) > 1e-5:
        check_tails(out, lambda tail: stats.tukeylambda.ppf(tail, shape))


@pytest.mark.parametrize("shape", [-1, -0.5, -0.3, -0.14, -0.05, -1e-3, 0, 1e-3, 0.05, 0.14, 0.3, 0.5, 1, 1.5, 2])
def test_tukey_lambda_quantile_is_accurate_over_all_words(shape: float) -> None:
    """Random and extreme words against scipy's float64 quantile: the bounds that the kernels' docstring states."""
    words = _extreme_words()
    v = ((words & np.uint64((1 << 63) - 1)).astype(np.float64) + 0.5) * 2.0**-64
    exact_shape = float(np.float32(shape))
    lower = _quantile(v, exact_shape)
    expected = np.where(words < np.uint64(1 << 63), lower, -lower)
    drawn = _tukey_lambda(words, shape).astype(np.float64)
    error = np.abs(drawn - expected)
    near = np.abs(expected) < 0.5
    assert error[near].max() < 5e-7
    relative = error / np.maximum(np.abs(expected), 1e-300)
    allowed = 1e-6 + 1e-7 * np.abs(exact_shape * np.log(v))
    assert (near | (relative < allowed)).all()


def _extreme_words() -> NDArray[np.uint64]:
    random = np.random.default_rng(0)
    uniform = random.integers(0, 1 << 64, 100_000, dtype=np.uint64)
    tail = random.integers(0, 1 << 63, 100_000, dtype=np.uint64) >> random.integers(0, 64, 100_000).astype(np.uint64)
    special = [0, 1, (1 << 32) - 1, 1 << 32, (1 << 63) - 1]
    words = np.concatenate((uniform, tail, np.array(special, dtype=np.uint64)))  # 0: the tail's end, at 2^-65
    return np.concatenate((words, words ^ np.uint64(1 << 63)))


def _quantile(v: NDArray[np.float64], shape: float) -> NDArray[np.float64]:
    """Return the quantile of small probabilities: scipy's, or the definition where that is the more exact one."""
    if shape == 0:
        return np.asarray(np.log(v) - np.log1p(-v))
    return np.asarray(stats.tukeylambda.ppf(v, shape))


def _tukey_lambda(words: NDArray[np.uint64], shape: float) -> NDArray[np.float32]:
    """Ask the kernel for the draws of given words."""
    floor = _random_kernels.LAMBDA_FLOOR
    exponent = np.array([shape if abs(shape) > floor else floor], dtype=np.float32)
    power = _kernels.power_coefficients(exponent)
    return _draw_by_strips(_random_kernels.tukey_lambda_draws, words, exponent[0], power, 0)


def _draw_by_strips(draw: Any, words: NDArray[np.uint64], *options: object) -> NDArray[np.float32]:
    """Run a helper over words, as many at a time as its room takes."""
    compiled: Any = kernel(draw.py_func)
    integers, floats = (np.zeros((7, _random_kernels.STRIDE), kind) for kind in (np.uint32, np.float32))
    draws = []
    for strip in np.split(words, range(_random_kernels.STRIP, words.size, _random_kernels.STRIP)):
        integers[0, : strip.size], integers[1, : strip.size] = strip >> np.uint64(32), strip
        compiled(np.uint64(strip.size), integers.ravel(), floats.ravel(), *options)
        draws.append(floats[_random_kernels.NOISE // _random_kernels.STRIDE, : strip.size].copy())
    return np.concatenate(draws)


def check_tails(draws: NDArray[Any], quantile: Callable[[float], Any]) -> None:
    """Counts beyond the quantiles of 1e-5 and 1e-6 on either side are Poisson."""
    for tail in (1e-5, 1e-6):
        for count in (np.count_nonzero(draws < quantile(tail)), np.count_nonzero(draws > -quantile(tail))):
            assert stats.poisson.cdf(count, tail * draws.size) > ALPHA
            assert stats.poisson.sf(count - 1, tail * draws.size) > ALPHA


# Gaussian, uniform


@pytest.mark.parametrize("part", ["G", "P", "R"])
def test_gaussian_distribution(part: str) -> None:
    """Kolmogorov-Smirnov with 2^22 draws (rows: 2^20), and counts beyond the quantiles of 1e-5 and 1e-6."""
    two = replace(PARAMETERS, sigma_row_dn=2.0, sigma_gauss_dn=2.0)
    if part == "R":
        out = noisy(flat(0, (4, 4, 1 << 17, 1)), "R", parameters=two, key=21)[:, ::2] / np.float32(2.0)
    elif part == "G":
        out = noisy(flat(0, (4, 4, 512, 512)), "G", parameters=two, key=22) / np.float32(2.0)
    else:
        out = (noisy(flat(16, (4, 4, 512, 512)), "P", key=23) - np.float32(16)) / np.float32(4)
    z = out.ravel().astype(np.float64)
    assert stats.kstest(z, stats.norm.cdf, method="asymp").pvalue > ALPHA
    assert abs((z**2).mean() - 1) < SIGMAS * math.sqrt(2 / z.size)
    assert abs((z**4).mean() - 3) < SIGMAS * math.sqrt(96 / z.size)
    check_tails(z, stats.norm.ppf)


def test_gaussian_arithmetic_is_accurate_and_reaches_seven_sigma() -> None:
    words = _extreme_words()
    drawn = _draw_by_strips(_random_kernels.gaussian_draws, words, _random_kernels.NOISE)
    u = ((words >> np.uint64(24)).astype(np.float64) + 0.5) * 2.0**-40
    angle = ((words & np.uint64(0xFFFFFF)).astype(np.float64) + 0.5) * 2.0**-24
    radius = np.sqrt(-2 * np.log(u))
    assert (np.abs(drawn - radius * np.cos(2 * np.pi * angle)) < np.maximum(3e-6, 1e-7 / radius)).all()
    assert 7.4 < np.abs(drawn).max() < 7.6


def test_uniform_quantisation() -> None:
    """Kolmogorov-Smirnov with 2^22 draws; strictly between -1/2 and 1/2."""
    out = noisy(flat(0, (4, 4, 512, 512)), "U", key=31).ravel().astype(np.float64)
    assert -0.5 < out.min() < out.max() < 0.5
    assert stats.kstest(out, stats.uniform(-0.5, 1).cdf, method="asymp").pvalue > ALPHA


# Independence


def _correlation(a: NDArray[Any], b: NDArray[Any]) -> float:
    a, b = (x.ravel().astype(np.float64) for x in (a, b))
    return float(np.corrcoef(a, b)[0, 1])


@pytest.mark.parametrize("part", PARTS)
def test_neighbours_are_uncorrelated(part: str) -> None:
    """Values and squares, at lags of columns and rows, across channels, images and keys: about 2^19 pairs each."""
    clean = flat(3.3, (2, 4, 256, 256))
    out, other_key = (noisy(clean, part, key=key).astype(np.float64) for key in (41, 42))
    mean = out.mean()
    squares = [np.minimum((x - mean) ** 2, 30.0) for x in (out, other_key)]
    for a, b in ((out, other_key), squares):
        pairs = [(a[..., lag:], a[..., :-lag]) for lag in (1, 2, 3, 8, 128)]
        pairs += [(a[..., lag:, :], a[..., :-lag, :]) for lag in (1, 2, 128)]
        pairs += [(a[:, :-1], a[:, 1:]), (a[:, :2], a[:, 2:]), (a[:1], a[1:]), (a, b)]
        pairs += [(a[..., 1:, 1:], a[..., :-1, :-1])]
        for x, y in pairs:
            assert abs(_correlation(x, y)) < SIGMAS / math.sqrt(x.size)


def test_components_are_uncorrelated() -> None:
    """Each alone with one key: 2^21 pairs, values and squares. Exempt: two kinds of one component, which share bits."""
    alone = {name: noisy(flat(3.3, (2, 4, 512, 512)), name, key=51).astype(np.float64) for name in PARTS}
    for (name, a), (other, b) in itertools.combinations(alone.items(), 2):
        if name[0] == other[0]:
            continue
        assert abs(_correlation(a, b)) < SIGMAS / math.sqrt(a.size)
        squares = [np.minimum((x - x.mean()) ** 2, 30.0) for x in (a, b)]
        assert abs(_correlation(*squares)) < SIGMAS / math.sqrt(a.size)


def test_the_model_is_the_sum_of_its_components() -> None:
    """Switching a component changes no other one: the full model is the sum of each alone, to float32 rounding."""
    clean = gradient((2, 4, 64, 96))
    means = np.maximum(clean, 0)
    total = means.astype(np.float64)
    for name in FULL.split("+"):
        total += noisy(clean, name, key=61).astype(np.float64) - means
    np.testing.assert_allclose(noisy(clean, FULL, key=61), total, atol=1e-4)


# Reproducibility


def test_bits_do_not_depend_on_threads_bands_or_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    clean = gradient((6, 4, 96, 530), 2500.0)
    expected = noisy(clean, FULL, key=2**64 - 1, threads=1)
    for threads in (2, 4):
        np.testing.assert_array_equal(noisy(clean, FULL, key=2**64 - 1, threads=threads), expected)
    for cut in (1, 2, 5):
        np.testing.assert_array_equal(noisy(clean[:cut].copy(), FULL, key=2**64 - 1), expected[:cut])
    monkeypatch.setattr(_kernels, "_PIECE", 7 * 530)
    np.testing.assert_array_equal(noisy(clean, FULL, key=2**64 - 1), expected)
    narrow, wide = (noisy(flat(0, (1, 9, 2000, columns)), "R") for columns in (1, 2))  # X-Trans: two draws a row
    np.testing.assert_array_equal(narrow, wide[..., :1])


def test_the_stream_is_frozen() -> None:
    """The bits of one draw of every kind, the same on any machine."""
    digest = hashlib.sha256()
    for spec in (FULL, "P+G+B+R+U"):
        digest.update(noisy(gradient((2, 4, 8, 600), 1600.0), spec, key=2026).astype("<f4").tobytes())
    assert digest.hexdigest()[:16] == "7b05bc1223dc25c5"


def test_a_dataset_is_made_with_its_engine_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or each worker would compile it: all components, for the types that items have."""
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(_kernels, "add_noise", Mock(side_effect=lambda *given: calls.append(given)))
    _kernels.prepare.cache_clear()
    source = Arrays(np.full((1, 4, 32, 32), 0.25, np.float32), range_dn=15871)
    pairs = SyntheticPairs(source, "SonyA7S2", crop=8)
    assert [call[2] for call in calls] == [sum(_kernels.BITS.values())]
    assert pairs[0] is not None
    first, item = ([numba.typeof(value) for value in call] for call in calls)  # type: ignore[no-untyped-call]
    assert first == item
    _kernels.prepare.cache_clear()
