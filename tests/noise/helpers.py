"""What the tests of the noise model share: the closed forms, written from the paper, and both engines in DN.

Tolerances are standard errors: of the mean and of the variance of n pixels that lie in a number of mosaic rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats

from eldata.noise import Adc, NoiseDraw, NoiseModel, NoiseParameters, parse_components
from eldata.noise.components import expose
from eldata.noise.on_device import expose_on_device

RANGE_DN = 15871.0
RATIO = 130.0

PARAMETERS = NoiseParameters(
    gain_dn_per_e=0.8,
    tukey_lambda=-0.11,
    sigma_tl_dn=1.3,
    sigma_gauss_dn=2.1,
    sigma_row_dn=0.9,
    colour_bias_dn=(1.5, -0.75, 0.5, -2.0),
)

# Photoelectrons: none, few, as many as the tables reach, more.
SIGNALS_E = np.array([0.0, 0.02, 0.7, 3.0, 25.0, 130.0, 500.0])

LAMBDAS = (-0.45, -0.2, -0.05, -1e-9, 0.0, 1e-4, 0.0571429, 0.1428571, 0.5, 1.0, 2.0)

# 11 shapes or fewer, about ten tests of this kind: false alarms at about 1e-4 in all, if the seeds were not fixed.
LEAST_P_VALUE = 1e-6


def moments_of_tukey_lambda(shape: float) -> tuple[float, float]:
    """Variance and excess kurtosis at scale 1, scipy's."""
    distribution: Any = stats.tukeylambda
    variance, excess = distribution.stats(shape, moments="vk")
    return float(variance), float(excess)


@dataclass(frozen=True)
class Law:
    """Mean and cumulants of D in DN at one signal: of what each pixel draws for itself, and of its row's draw."""

    mean: float
    variance: float
    fourth_cumulant: float
    row_variance: float

    @classmethod
    def of(cls, spec: str, parameters: NoiseParameters, signal_e: float, bias_dn: float = 0.0) -> Law:
        names = set(spec.split("+"))
        gain = parameters.gain_dn_per_e
        variance = fourth = 0.0
        if names & {"P", "P*"}:
            variance += gain**2 * signal_e
        if "P*" in names:
            fourth += gain**4 * signal_e
        if "G" in names:
            variance += parameters.sigma_gauss_dn**2
        if "G*" in names:
            spread, excess = moments_of_tukey_lambda(parameters.tukey_lambda)
            variance += parameters.sigma_tl_dn**2 * spread
            fourth += (parameters.sigma_tl_dn**2 * spread) ** 2 * excess
        if "U" in names:
            variance += parameters.quantisation_step_dn**2 / 12
            fourth -= parameters.quantisation_step_dn**4 / 120
        return cls(
            mean=gain * signal_e + (bias_dn if "B" in names else 0.0),
            variance=variance,
            fourth_cumulant=fourth,
            row_variance=parameters.sigma_row_dn**2 if "R" in names else 0.0,
        )

    def mean_error(self, pixels: int, rows: int) -> float:
        return math.sqrt(self.variance / pixels + self.row_variance / rows)

    def variance_error(self, pixels: int, rows: int) -> float:
        """Standard error of the mean square around the known mean."""
        own = self.fourth_cumulant + 2 * self.variance**2 + 4 * self.variance * self.row_variance
        return math.sqrt(own / pixels + 2 * self.row_variance**2 / rows)


def clean_of(signal_e: NDArray[np.float64], shape: tuple[int, ...], parameters: NoiseParameters) -> NDArray[np.float32]:
    """Flat clean images (N, C, h, w), one a signal in photoelectrons."""
    value = signal_e * parameters.gain_dn_per_e * RATIO / RANGE_DN
    return np.broadcast_to(value[:, None, None, None], (len(signal_e), *shape)).astype(np.float32)


def compiled_dn(
    spec: str, clean: NDArray[np.float32], parameters: NoiseParameters, seed: int = 0, adc: Adc | None = None
) -> NDArray[np.float64]:
    """D in DN above black, of the compiled engine."""
    noisy = NoiseModel(spec, adc=adc)(
        clean, parameters=parameters, ratio=RATIO, range_dn=RANGE_DN, generator=np.random.default_rng(seed)
    )
    return noisy.astype(np.float64) * (RANGE_DN / RATIO)


def plain_dn(spec: str, clean: NDArray[np.float32], parameters: NoiseParameters, seed: int = 0) -> NDArray[np.float64]:
    """D in DN above black, of the definitions in numpy."""
    generator = np.random.default_rng(seed)
    images = [expose(one, spec, parameters, ratio=RATIO, range_dn=RANGE_DN, generator=generator) for one in clean]
    return np.stack(images) * (RANGE_DN / RATIO)


def device_dn(
    spec: str, clean: NDArray[np.float32], parameters: NoiseParameters, seed: int = 0, adc: Adc | None = None,
    device: str = "cpu",
) -> NDArray[np.float64]:  # fmt: skip
    """D in DN above black, of the engine for other devices."""
    draws, generator = [NoiseDraw(parameters, RATIO, RANGE_DN)] * len(clean), torch.Generator(device).manual_seed(seed)
    noisy = expose_on_device(torch.from_numpy(clean).to(device), draws, parse_components(spec), generator, adc=adc)
    dn: NDArray[np.float64] = noisy.cpu().numpy().astype(np.float64) * (RANGE_DN / RATIO)
    return dn


CUDA = torch.cuda.is_available()
ENGINES = [
    pytest.param(compiled_dn, id="compiled"),
    pytest.param(device_dn, id="torch"),
    pytest.param(partial(device_dn, device="cuda"), id="cuda", marks=pytest.mark.skipif(not CUDA, reason="no GPU")),
]


def poisson_p_value(counts: NDArray[np.floating[Any]], mean: float) -> float:
    """The chi-square test of whole numbers against Poisson(mean), cells of an expectation of 20 or more."""
    whole = np.rint(counts).astype(np.int64)
    # Float32 steps at hundreds of DN.
    np.testing.assert_allclose(counts, whole, atol=1e-3)
    highest = int(stats.poisson.isf(1e-12, mean)) + 2
    assert whole.min() >= 0
    assert whole.max() <= highest
    expected = stats.poisson.pmf(np.arange(highest + 1), mean) * counts.size
    observed = np.bincount(whole.ravel(), minlength=highest + 1)
    inside = np.flatnonzero(expected >= 20)
    first, last = int(inside[0]), int(inside[-1])
    cells = [slice(None, first + 1), *(slice(k, k + 1) for k in range(first + 1, last)), slice(last, None)]
    seen = np.array([observed[cell].sum() for cell in cells], dtype=np.float64)
    wanted = np.array([expected[cell].sum() for cell in cells])
    return float(stats.chisquare(seen, wanted * (seen.sum() / wanted.sum())).pvalue)
