"""The network that ships: its file, and what it does with the noise of cameras that its training did not have."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import eldata.baselines.unet
from eldata.baselines import load_network, reference_network
from eldata.baselines.unet import blank_reference, save_weights
from eldata.datasets import Arrays, SyntheticPairs
from eldata.demo.scenes import scene_radiance
from eldata.errors import FileError
from eldata.noise import LED_RANGES, VirtualCameras

WEIGHTS = Path(eldata.baselines.unet.__file__).with_name("reference.safetensors")


def psnr(image: torch.Tensor, clean: torch.Tensor) -> float:
    """In [0, 1], without the protocol's factor, which would hide a wrong brightness."""
    return float(-10 * torch.log10(((image.clamp(0, 1) - clean.clamp(0, 1)) ** 2).mean()))


@pytest.mark.parametrize(
    ("gain", "ratio", "least"), [(1.0, 300.0, 3.0), (3.0, 200.0, 4.0), (10.0, 100.0, 5.0), (10.0, 300.0, 7.0)]
)
def test_it_denoises_cameras_and_scenes_that_it_never_saw(gain: float, ratio: float, least: float) -> None:
    """Six cameras of another seed, two scenes of the demo's kind with numbers beyond all that it was trained on."""
    cameras = VirtualCameras(6, replace(LED_RANGES, gain_dn_per_e=(gain, gain * 1.001)), seed=99)
    clean = np.stack([scene_radiance(scene, 136, 136)[[0, 1, 2, 1]] for scene in (777, 778)]).astype(np.float32)
    pairs = SyntheticPairs(
        Arrays(clean, range_dn=15871), cameras, ratio=(ratio, ratio * 1.001), clip="none", crop=128, crops_per_frame=3
    )
    network = reference_network()
    gains = []
    for index in range(len(pairs)):
        sample = pairs[index]
        with torch.inference_mode():
            made = network(sample["input"][None])[0]
        gains.append(psnr(made, sample["target"]) - psnr(sample["input"], sample["target"]))
    assert np.mean(gains) > least


def test_a_brighter_image_is_a_brighter_prediction() -> None:
    """It has no constants; 64 times is exact in binary floats."""
    noisy = torch.rand(1, 4, 32, 40, generator=torch.Generator().manual_seed(1))
    with torch.inference_mode():
        torch.testing.assert_close(reference_network()(64 * noisy), 64 * reference_network()(noisy), rtol=0, atol=0)


def test_the_file_is_small_and_half_precision(tmp_path: Path) -> None:
    assert WEIGHTS.stat().st_size < 1_000_000
    save_weights(reference_network(), tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == WEIGHTS.read_bytes()


def test_it_is_a_network_of_eldata_predict() -> None:
    network = load_network("eldata.baselines:reference_network", device="cpu")
    assert (network.multiple, network.window) == (8, 1)
    image = np.random.default_rng(0).random((4, 20, 30)).astype(np.float32)
    with torch.inference_mode():
        own = reference_network()(torch.nn.functional.pad(torch.from_numpy(image)[None], (0, 2, 0, 4), "reflect"))
    np.testing.assert_allclose(network.run(np.pad(image, ((0, 0), (0, 4), (0, 2)), "reflect")), own[0], atol=1e-6)


def test_before_its_training_it_returns_its_input() -> None:
    noisy = torch.rand(1, 4, 16, 16)
    with torch.inference_mode():
        assert torch.equal(blank_reference()(noisy), noisy)


@pytest.mark.parametrize("damage", ["gone", "cut", "another's"])
def test_a_damaged_installation_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str) -> None:
    place = tmp_path / "baselines" / WEIGHTS.name
    place.parent.mkdir()
    if damage == "cut":
        place.write_bytes(WEIGHTS.read_bytes()[:5000])
    elif damage == "another's":
        from safetensors.torch import save_file

        save_file({"weight": torch.zeros(3)}, place)
    else:
        assert not place.exists()
        shutil.copy(WEIGHTS, tmp_path)
    monkeypatch.setattr(eldata.baselines.unet, "files", lambda _: place.parent)
    with pytest.raises(FileError, match="is not what was shipped; install eldata again") as raised:
        reference_network()
    assert str(place) in str(raised.value)
