"""The network that is told the noise: its transformation, and its training."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from eldata.baselines.classical import SignalNoise, stabilised
from eldata.baselines.noise_aware import NoiseAwareUNet, stabilise, undo

if TYPE_CHECKING:
    from collections.abc import Iterator

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_noise_aware.py"
LINES = {"shot noise": (0.05, 1e-6), "both": (0.01, 1e-4), "read noise": (1e-6, 0.01), "read noise alone": (0.0, 0.01)}


@pytest.mark.parametrize("name", LINES)
def test_above_black_the_transform_is_anscombes_and_leads_back(name: str) -> None:
    """The other one, in numpy, was checked against its definition (test_classical.py)."""
    slope, offset = LINES[name]
    line, signals = SignalNoise(slope, offset), np.linspace(-0.3, 1.5, 1000)
    known = torch.tensor([slope, offset], dtype=torch.float64)
    values, black = stabilise(torch.from_numpy(signals), *known)
    theirs = stabilised(signals, line) - stabilised(np.zeros(1), line)
    np.testing.assert_allclose(values[signals >= 0], theirs[signals >= 0], rtol=1e-6, atol=1e-4)
    assert bool((values.diff() > 0).all()), "below black nothing is cut off"
    np.testing.assert_allclose(undo(values, known[0], black), signals, rtol=1e-9, atol=1e-12)


def test_before_its_training_it_returns_its_input() -> None:
    noisy = torch.randn(4, 4, 16, 24, generator=torch.Generator().manual_seed(0)) + 0.5
    slope, offset = torch.tensor(list(LINES.values())).T
    with torch.inference_mode():
        torch.testing.assert_close(NoiseAwareUNet(width=4)(noisy, slope, offset), noisy, rtol=1e-5, atol=1e-6)


def test_noise_has_one_deviation_behind_the_transform() -> None:
    """4,096 draws each of 64 signals from 20 electrons: that of one has an error of 0.011; the transform's is 0.01."""
    generator = np.random.default_rng(0)
    signals, slope, sigma = np.geomspace(20, 2000, 64)[:, None], 0.001, 0.003
    noisy = slope * generator.poisson(signals, (64, 4096)) + generator.normal(0, sigma, (64, 4096))
    values, _ = stabilise(torch.from_numpy(noisy), torch.tensor(slope), torch.tensor(sigma**2))
    assert np.std(values.numpy(), axis=1) == pytest.approx(1, abs=0.01 + 5 * 0.011)
    assert float(values.std(dim=1).mean()) == pytest.approx(1, abs=0.01 + 5 * 0.0014)


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The script of the training, with three frames, and epochs of nine steps."""
    spec = importlib.util.spec_from_file_location("train_noise_aware", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    small = {"FRAMES": {"still life": 1, "picture": 1, "leaves": 1}, "SIDE": 64, "EPOCH": 9, "BATCH": 2, "CROP": 32}
    for name, value in {**small, "VALIDATION": (32, 3)}.items():
        monkeypatch.setattr(module, name, value)
    threads = torch.get_num_threads()
    yield module
    torch.set_num_threads(threads)


def test_the_training_goes_on_and_is_ended_on_a_copy(example: Any, tmp_path: Path) -> None:
    made = [example.clean_frame("leaves", 2, np.random.default_rng([5, 2])) for _ in range(2)]
    assert np.array_equal(*made)
    assert made[0].shape == (4, 64, 64)
    assert 0 <= made[0].min() < made[0].max() <= 1
    given = ["--width", "4", "--precision", "float32"]
    example.main([str(tmp_path), "--steps", "18", *given])
    begun = (tmp_path / "checkpoint.pt").read_bytes()
    assert (tmp_path / "curve.csv").read_text(encoding="utf-8").count("\n") == 3
    example.main([str(tmp_path), "--cooldown", "9", "--export", str(tmp_path / "w.safetensors"), *given])
    assert (tmp_path / "checkpoint.pt").read_bytes() == begun
    network = NoiseAwareUNet(width=4)
    network.load_state_dict(load_file(tmp_path / "w.safetensors"))
    assert network.network.last.weight.detach().any(), "it was trained"
    with (tmp_path / "cooldown-9.csv").open(encoding="utf-8") as file:
        assert all(np.isfinite(float(value)) for line in csv.DictReader(file) for value in line.values())


def test_the_mean_of_the_weights_is_what_is_used(example: Any) -> None:
    """After n steps with weights w, a mean that began at 0 is w (1 - (1 - share)^n)."""
    network = example.Averaged(NoiseAwareUNet(width=4), share=0.25)
    with torch.no_grad():
        network.network.network.last.bias.fill_(2.0)
        for _ in range(3):
            network.train()(torch.zeros(1, 4, 8, 8), torch.ones(1), torch.ones(1))
    bias = network.average.network.last.bias
    torch.testing.assert_close(bias, torch.full_like(bias, 2 * (1 - 0.75**3)))
