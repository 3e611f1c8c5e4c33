"""Noise of one's own: what is called with what, what it may return, and the examples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from eldata.datasets import Arrays, SyntheticPairs
from eldata.errors import ArgumentError
from eldata.noise import NoiseDraw, NoiseModel, NoiseParameters
from eldata.noise.model import made_exposure
from tests.cases import in_one_test

CLEAN = np.full((4, 6, 8), 0.25, np.float32)
DRAW = NoiseDraw(NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0), 100.0, 15871.0)


def brighter(clean: Any, *, parameters: Any, ratio: float, range_dn: float, generator: np.random.Generator) -> Any:
    """Twice the light and 1 % of noise, from all that it is told."""
    clean *= 2
    return clean + generator.normal(0, 0.01, clean.shape) + 0 * (parameters.gain_dn_per_e + ratio + range_dn)


class Scaled:
    """An object, as a torch module is."""

    def __init__(self, by: float) -> None:
        self.by = by

    def __call__(self, clean: Any, **_: Any) -> Any:
        return torch.from_numpy(clean) * self.by

    def __repr__(self) -> str:
        return f"Scaled({self.by})"


class Adapted:
    """Calls a network of somebody else's, which draws from torch's own generator, as docs/noise.md shows."""

    def __init__(self, network: torch.nn.Module) -> None:
        self.network = network

    def __call__(self, clean: Any, *, ratio: float, generator: np.random.Generator, **_: Any) -> Any:
        with torch.inference_mode(), torch.random.fork_rng([]):
            torch.manual_seed(int(generator.integers(2**63 - 1)))
            image = torch.from_numpy(clean).reshape(-1, *clean.shape[-3:])
            return (self.network(image / ratio) * ratio).reshape(clean.shape).numpy()


class Network(torch.nn.Module):
    """Stands for a flow, a GAN or a diffusion model: clean packed images (N, C, h, w) in, noisy ones out."""

    def forward(self, clean: torch.Tensor) -> torch.Tensor:
        return clean + 0.01 * torch.randn(clean.shape)


MAKER = Adapted(Network())


def pairs(model: Any, **options: Any) -> SyntheticPairs:
    source = Arrays(np.full((1, 4, 64, 64), 0.3, np.float32), range_dn=15871.0)
    return SyntheticPairs(source, "SonyA7S2", model=model, **{"crop": 32, "crops_per_frame": 4} | options)


def test_a_function_makes_the_noise() -> None:
    """4096 pixels of 1 % noise around twice the light: mean and deviation within 5 standard errors."""
    item = pairs(brighter)[1]
    noise = item["input"].double().numpy() - 0.6
    assert abs(noise.mean()) < 5 * 0.01 / 64
    assert abs(noise.std() / 0.01 - 1) < 5 / np.sqrt(2 * 4096)
    assert torch.equal(item["target"], torch.full((4, 32, 32), 0.3))  # what it wrote to was its own
    assert torch.equal(item["input"], pairs(brighter)[1]["input"])
    assert not torch.equal(item["input"], pairs(brighter)[2]["input"])
    assert item["input"].dtype == torch.float32


def test_an_object_and_the_clip_of_the_dataset() -> None:
    """A tensor of the CPU is as good as an array; the dataset clips as it does for our own model."""
    for by, clip, value in ((5.0, "both", 1.0), (5.0, "none", 1.5), (-1.0, "upper", -0.3), (-1.0, "both", 0.0)):
        item = pairs(Scaled(by), clip=clip)[0]
        np.testing.assert_allclose(item["input"].numpy(), value, rtol=1e-6)
    assert "Scaled(2.0), clip='upper'" in repr(pairs(Scaled(2.0), clip="upper"))
    assert "brighter, clip='both'" in repr(pairs(brighter))


@in_one_test(
    "model, words",
    [
        ("G+P", r"give NoiseModel\('G\+P'\)"),
        (5, "must be a NoiseModel, or an object to be called as .*; found 5"),
        (NoiseModel, "must be a NoiseModel, .*; found <class"),
        (lambda clean: clean, "cannot be called .* unexpected keyword"),
        (lambda clean, iso, **_: clean * iso, "cannot be called .* missing .*: 'iso'"),
    ],
)
def test_what_cannot_make_noise_is_refused_before_the_first_item(model: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pairs(model)


@in_one_test(
    "result, words",
    [
        (CLEAN[0], r"<lambda> returned float32 of shape \(6, 8\); expected .*, \(4, 6, 8\)"),
        (CLEAN.astype(np.uint16), "returned uint16 of shape"),
        (None, "returned NoneType; expected"),
    ],
)
def test_what_is_not_an_exposure(result: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        made_exposure(lambda *_, **__: result, CLEAN, DRAW, np.random.default_rng(0))


def test_a_network_of_somebody_elses() -> None:
    before = torch.random.get_rng_state()
    items = [pairs(MAKER, ratio=1.0)[index]["input"] for index in (0, 1, 0)]
    assert torch.equal(before, torch.random.get_rng_state())  # which the dataset's user may draw from, too
    assert torch.equal(items[0], items[2])
    assert not torch.equal(items[0], items[1])
    noise = items[0].double() - 0.3
    assert abs(float(noise.std()) / 0.01 - 1) < 5 / np.sqrt(2 * 4096)
