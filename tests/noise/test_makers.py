"""Noise of one's own: what is called with what, what it may return, and the example of the documents."""

from __future__ import annotations

import functools
import pickle
import re
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.datasets import ArrayClips, Arrays, SyntheticClips, SyntheticPairs
from eldata.errors import ArgumentError
from eldata.noise import NoiseMaker, NoiseModel, NoiseParameters
from eldata.noise.makers import check_noise_maker, made_exposure, maker_name

CLEAN = np.full((4, 6, 8), 0.25, np.float32)
DOCUMENT = Path(__file__).parents[2] / "docs" / "noise.md"


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


def test_a_clip_of_frames_is_made_at_once() -> None:
    shapes = []

    def made(clean: Any, **options: Any) -> Any:
        shapes.append(clean.shape)
        return clean

    source = ArrayClips([np.full((5, 4, 16, 16), 0.3, np.float32)], range_dn=1000.0)
    item = SyntheticClips(source, "SonyA7S2", model=made, frames=3, crop=8)[0]
    assert shapes == [(3, 4, 8, 8)]
    assert torch.equal(item["input"], item["target"])


def test_our_own_model_is_one() -> None:
    maker: NoiseMaker = NoiseModel()
    check_noise_maker(maker)
    check_noise_maker(functools.partial(brighter))
    check_noise_maker(max)  # whose arguments are not stated


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("G+P", r"model='G\+P' is a text; give NoiseModel\('G\+P'\)"),
        (5, r"model must be a NoiseModel, or an object to be called as model\(clean, parameters=\.\.\., .*; found 5"),
        (NoiseModel, r"model must be a NoiseModel, or an object to be called as .*; found <class"),
        (lambda clean: clean, r"cannot be called as model\(clean, parameters=.*: got an unexpected keyword argument"),
        (
            lambda clean, iso, **_: clean * iso,
            r"cannot be called as model\(clean, .*: missing a required argument: 'iso'",
        ),
    ],
)
def test_what_cannot_make_noise_is_refused_before_the_first_item(model: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pairs(model)


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (CLEAN[0], r"<lambda> returned float32 of shape \(6, 8\); expected an array like the clean one, \(4, 6, 8\)"),
        (CLEAN.astype(np.uint16), r"returned uint16 of shape"),
        (None, "returned NoneType; expected"),
        ((CLEAN, CLEAN), "returned tuple; expected"),
    ],
)
def test_what_is_not_an_exposure(result: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        made_exposure(lambda *_, **__: result, CLEAN)


def test_names() -> None:
    assert maker_name(brighter) == "brighter"
    assert maker_name(Scaled(2.0)) == "Scaled(2.0)"
    assert maker_name(NoiseModel("P*")) == "NoiseModel('P*')"


def test_the_example_of_the_document_works() -> None:
    """Extracted as it stands: a network of somebody else's, wrapped."""
    (code,) = re.findall(r"```python\n(import torch\n.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    module = types.ModuleType("example")
    exec(compile(code.split("\npairs = ")[0], str(DOCUMENT), "exec"), module.__dict__)  # noqa: S102 # our own document

    class Network(torch.nn.Module):
        def forward(self, clean: torch.Tensor, iso: torch.Tensor, ratio: torch.Tensor, seed: int) -> torch.Tensor:
            generator = torch.Generator().manual_seed(seed)
            assert (iso.shape, ratio.shape) == ((1,), (1,))
            return clean + 0.01 * torch.randn(clean.shape, generator=generator)

    maker = module.__dict__["ForeignNoise"](Network(), 100 / 0.5)
    items = [pairs(maker)[index]["input"] for index in (0, 1, 0)]
    assert torch.equal(items[0], items[2])
    assert not torch.equal(items[0], items[1])
    noise = items[0].double() - 0.3
    assert abs(float(noise.std()) / 0.01 - 1) < 5 / np.sqrt(2 * 4096)


def test_a_maker_of_a_module_goes_to_workers() -> None:
    dataset = pickle.loads(pickle.dumps(pairs(brighter)))
    assert torch.equal(dataset[0]["input"], pairs(brighter)[0]["input"])
    parameters = NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0)
    generator = np.random.default_rng(0)
    options = {"parameters": parameters, "ratio": 1.0, "range_dn": 1.0, "generator": generator}
    assert made_exposure(brighter, CLEAN, **options).dtype == np.float32
