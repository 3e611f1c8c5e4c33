"""The transformation and its exact unbiased inverse, against simulated Poisson-Gaussian values."""

from __future__ import annotations

import numpy as np
import pytest

from eldata.baselines.classical import SignalNoise, stabilised, unstabilised

VALUES = 400_000


@pytest.mark.parametrize("sigma", [0.3, 1.5, 20.0])
@pytest.mark.parametrize("gain", [0.01, 1.0])
@pytest.mark.parametrize("counts", [0.3, 2.0, 20.0, 190.0, 300.0])
def test_the_mean_of_stabilised_values_leads_back(gain: float, sigma: float, counts: float) -> None:
    """400,000 values: their mean has a standard error of s / 632, which d y / d f = f / 2 turns into counts."""
    generator = np.random.default_rng(17)
    line = SignalNoise(slope=gain, offset=(gain * sigma) ** 2)
    values = gain * (generator.poisson(counts, VALUES) + sigma * generator.standard_normal(VALUES))
    seen = stabilised(values, line)
    if counts > 10 or sigma > 10:
        assert seen.std() == pytest.approx(1.0, abs=0.01)
    error = float(seen.std() / np.sqrt(VALUES) * seen.mean() / 2)
    back = float(unstabilised(np.array([seen.mean()]), line)[0]) / gain
    assert abs(back - counts) < 4.5 * error + 2e-3


def test_plain_inversion_would_be_too_dark() -> None:
    """At 1 electron, the algebraic inverse of the mean is off by a quarter of an electron; this one is not."""
    generator = np.random.default_rng(1)
    line = SignalNoise(1.0, 0.25)
    seen = stabilised(generator.poisson(1.0, VALUES) + 0.5 * generator.standard_normal(VALUES), line).mean()
    assert (seen / 2) ** 2 - 3 / 8 - 0.25 < 0.85
    assert unstabilised(np.array([seen]), line)[0] == pytest.approx(1.0, abs=0.01)


def test_without_shot_noise_it_is_a_division() -> None:
    line = SignalNoise(0.0, 0.04)
    values = np.array([-0.1, 0.0, 0.7])
    assert stabilised(values, line) == pytest.approx(values / 0.2)
    assert unstabilised(stabilised(values, line), line) == pytest.approx(values)
