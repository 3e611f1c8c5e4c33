from __future__ import annotations

import numpy as np
import pytest

from eldata.baselines.classical import SignalNoise, noise_of_image, noise_of_parameters
from eldata.demo.scenes import scene_radiance
from eldata.errors import DatasetError
from eldata.noise.parameters import NoiseParameters

SIZE = (512, 768)


@pytest.mark.parametrize(("gain", "sigma"), [(0.002, 0.01), (0.01, 0.05), (0.0, 0.02)])
@pytest.mark.parametrize(("number", "within"), [(1, 0.15), (2, 0.3)])
def test_the_line_of_a_scene_is_that_of_its_noise(gain: float, sigma: float, number: int, within: float) -> None:
    """Scene 2 has fine texture in all bright parts. By chance, 5 of 100: a group's quantile of 192 windows has 4 %."""
    generator = np.random.default_rng(3)
    scene = scene_radiance(number, *SIZE)[1]
    signal = np.stack([scene[y::2, x::2] for y in (0, 1) for x in (0, 1)]) / scene.max()
    shot = gain * generator.poisson(signal / gain) if gain else signal
    line = noise_of_image((shot + sigma * generator.standard_normal(signal.shape)).astype(np.float32))
    for level in (0.02, 0.1, 0.5):
        assert line.variance(np.array(level)) == pytest.approx(gain * level + sigma**2, rel=within)


def test_the_line_of_figures() -> None:
    """ISO 1600 of a camera with K = 2 DN/e-, at a ratio of 100: variance in electrons, then amplified."""
    parameters = NoiseParameters(2.0, 0.0, 2.0, 4.0, 3.0)
    line = noise_of_parameters(parameters, ratio=100.0, range_dn=15000.0)
    electrons = 30.0
    signal = electrons * 2.0 * 100 / 15000
    expected = (electrons * 2.0**2 + 4.0**2 + 3.0**2 + 1 / 12) * (100 / 15000) ** 2
    assert line.variance(np.array(signal)) == pytest.approx(expected)
    assert line.variance(np.array(-1.0)) == line.offset


def test_what_shows_no_noise() -> None:
    with pytest.raises(DatasetError, match="shows no noise"):
        noise_of_image(np.full((4, 128, 128), 0.2, np.float32))
    with pytest.raises(DatasetError, match=r"too little of its noise: 16 windows .*, where 64 are needed"):
        noise_of_image(np.zeros((4, 16, 16), np.float32))
    assert SignalNoise(0.1, 0.2).variance(np.array([1.0])) == pytest.approx(0.3)
