"""The network that is told the noise: its transformation, and its training."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file

from eldata.base.workers import Workers
from eldata.baselines import classical, unet
from eldata.baselines.classical import BASELINES, SignalNoise, apply_anscombe, noise_of_parameters
from eldata.baselines.noisy_frames import line_of_profile
from eldata.baselines.photographs import denoise
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.baselines.unet import NoiseAwareUNet, load_weights, remove_noise, stabilise, threshold, undo
from eldata.datasets import Arrays, SyntheticPairs
from eldata.demo.camera import CAMERAS
from eldata.demo.evaluation import known_profile
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError, DatasetError, FileError
from eldata.noise import LED_RANGES, NoiseModel, NoiseParameters, VirtualCameras
from eldata.noise.parameters import tukey_lambda_variance
from eldata.raw import read_raw
from eldata.raw.levels import packed_frame
from tests.trees import frame, tree_in

EXAMPLES = Path(__file__).parents[2] / "examples"
WEIGHTS = Path(unet.__file__).with_name("noise_aware.safetensors")
NOISY = 4  # of the tree's frames, at factor 100
LINES = {"shot noise": (0.05, 1e-6), "both": (0.01, 1e-4), "read noise": (1e-6, 0.01), "read noise alone": (0.0, 0.01)}


@pytest.mark.parametrize("name", LINES)
def test_above_black_the_transform_is_anscombes_and_leads_back(name: str) -> None:
    """The other one, in numpy, was checked against its definition (test_classical.py)."""
    slope, offset = LINES[name]
    line, signals = SignalNoise(slope, offset), np.linspace(-0.3, 1.5, 1000)
    known = torch.tensor([slope, offset], dtype=torch.float64)
    values, black = stabilise(torch.from_numpy(signals), *known)
    theirs = apply_anscombe(signals, line) - apply_anscombe(np.zeros(1), line)
    np.testing.assert_allclose(values[signals >= 0], theirs[signals >= 0], rtol=1e-6, atol=1e-4)
    assert bool((values.diff() > 0).all()), "below black nothing is cut off"
    np.testing.assert_allclose(undo(values, known[0], black), signals, rtol=1e-9, atol=1e-12)


def test_thresholding_is_the_baselines_of_all_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one in numpy takes each second window, and mirrors the image at its edges."""
    monkeypatch.setattr(classical, "_STEP", 1)
    monkeypatch.setattr(unet, "_TOGETHER", 200)  # bands of few rows
    noisy = np.random.default_rng(3).standard_normal((4, 48, 64)).astype(np.float32)
    noisy[:, 20:] += 9 * np.indices((4, 28, 64)).sum(axis=0) % 7
    planes = np.tensordot(classical.decorrelation(4), noisy, axes=1).astype(np.float32)
    made = np.tensordot(classical.decorrelation(4).T, threshold(torch.from_numpy(planes)[None])[0].numpy(), axes=1)
    theirs = classical.threshold_dct(noisy, SignalNoise(0.0, 1.0))
    np.testing.assert_allclose(made[:, 8:-8, 8:-8], theirs[:, 8:-8, 8:-8], atol=2e-5)
    assert not threshold(torch.zeros(1, 1, 8, 8)).any()


def test_before_its_training_it_is_halfway_to_the_dct() -> None:
    noisy = torch.randn(4, 4, 16, 24, generator=torch.Generator().manual_seed(0)) + 0.5
    slope, offset = torch.tensor(list(LINES.values())).T
    with torch.inference_mode():
        made = NoiseAwareUNet(widths=(4, 6), blocks=(1, 1))(noisy, slope, offset)
    slope, offset = (one[:, None, None, None] for one in (slope, offset))
    values, black = stabilise(noisy, slope, offset)
    colours = torch.from_numpy(classical.decorrelation(4)).float()
    found = torch.einsum("ij,nihw->njhw", colours, threshold(torch.einsum("ij,njhw->nihw", colours, values)))
    torch.testing.assert_close(made, undo((values + found) / 2, slope, black), rtol=1e-4, atol=1e-5)


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The script of the training, with a frame of each kind."""
    monkeypatch.syspath_prepend(EXAMPLES)  # whose pictures are the virtual benchmark's
    module = import_module("train_noise_aware")
    Image.fromarray(np.random.default_rng(4).integers(0, 256, (200, 150, 3), np.uint8)).save(tmp_path / "small.jpg")
    names, counts = {"small.jpg": None}, dict.fromkeys(("photograph", "picture", "still life", "leaves", "chart"), 1)
    small = {"FRAMES": counts, "HELD": {"photograph": 2}, "SIDE": 64, "EPOCH": 9, "TRAIN": names, "STOP": names}
    for name, value in {**small, "HELD_SIDE": 32}.items():
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(module, "fetch_photographs", lambda _: None)  # 170 MB of the distribution's
    network = partial(NoiseAwareUNet, widths=(4, 6), blocks=(1, 1))
    monkeypatch.setattr(module, "NoiseAwareUNet", network)
    threads = torch.get_num_threads()
    yield module
    torch.set_num_threads(threads)


def test_the_training_goes_on_and_another_begins_with_its_weights(example: Any, tmp_path: Path) -> None:
    photographs = (tmp_path / "small.jpg",)
    frames = example.clean_frames(tmp_path / "frames.npy", {"photograph": 2, "chart": 1}, photographs, 5, Workers(1))
    clean = np.load(frames.path)
    assert clean.shape == (3, 4, 64, 64)
    assert 0 <= clean.min() < clean.max() <= 1
    assert np.array_equal(clean[1], example.clean_frame(("photograph", 1, 5, photographs)))
    given = ["--steps", "26", "--batch", "4", "--crop", "32", "--precision", "float32"]
    given += ["--photographs", str(tmp_path)]
    example.main([str(tmp_path), *given])
    assert (tmp_path / "curve.csv").read_text(encoding="utf-8").count("\n") == 3
    example.main([str(tmp_path), *given])  # nothing is left to do
    weights = load_file(tmp_path / "noise_aware.safetensors")
    assert weights["last.weight"].any(), "it was trained"
    example.main([str(tmp_path / "two"), *given, "--begin", str(tmp_path / "noise_aware.safetensors")])
    moved = load_file(tmp_path / "two" / "noise_aware.safetensors")
    assert 0 < max(float((moved[name] - weights[name]).abs().max()) for name in weights) < 0.02
    with (tmp_path / "two" / "curve.csv").open(encoding="utf-8") as file:
        assert all(np.isfinite(float(value)) for line in csv.DictReader(file) for value in line.values())


def test_a_photograph_is_averaged_in_linear_light_and_its_curve_undone(example: Any, tmp_path: Path) -> None:
    checks = np.indices((4, 6)).sum(axis=0) % 2 * 255
    Image.fromarray(checks[..., None].repeat(3, -1).astype(np.uint8)).save(tmp_path / "checks.png")
    assert (example.photograph_radiance(tmp_path / "checks.png", 2) == 0.5).all()
    ramp = np.arange(256, dtype=np.uint8)[None, :, None].repeat(3, -1)
    Image.fromarray(ramp).save(tmp_path / "ramp.png")
    x = example.photograph_radiance(tmp_path / "ramp.png", 1, True)[0, 0].astype(float)
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)  # sRGB's definition
    np.testing.assert_allclose(3 * x**2 - 2 * x**3, np.arange(256) / 255, atol=2e-3)


def test_the_line_of_a_batch_is_the_models(example: Any) -> None:
    """Of lambda from -0.24 to 0.2 and near 0, against the closed form that the noise model has."""
    shapes = torch.tensor([-0.24, -0.05, -1e-6, 0.0, 1e-3, 0.2], dtype=torch.float64)
    found = example.tukey_lambda_variances(shapes)
    assert found.tolist() == pytest.approx([tukey_lambda_variance(float(shape)) for shape in shapes], rel=5e-4)


# --- the one that ships -----------------------------------------------------------------------------------------------


def test_the_network_is_as_small_as_it_is_said_to_be() -> None:
    assert WEIGHTS.stat().st_size < 2_000_000
    with torch.inference_mode():
        assert sum(one.numel() for one in NoiseAwareUNet().parameters()) == 992_280


def test_tiles_are_not_seen() -> None:
    """A quarter of the overlap is as far as it sees, so that tiles make what the whole frame makes."""
    image = np.random.default_rng(0).random((4, 300, 700)).astype(np.float32)
    line, network = SignalNoise(0.05, 1e-3), BASELINES["network"]
    whole = network.denoise(image, line)
    found = replace(network, tile=544).denoise(image, line)
    np.testing.assert_allclose(found, whole, atol=1e-5)


def test_what_black_is_off_by_is_taken_off() -> None:
    image = np.random.default_rng(1).random((4, 32, 32)).astype(np.float32)
    black = (0.01, 0.02, -0.03, 0.0)
    less = (image - np.array(black)[:, None, None]).astype(np.float32)
    assert np.array_equal(remove_noise(image, 0.05, 1e-3, black), remove_noise(less, 0.05, 1e-3, ()))
    parameters = NoiseParameters(2.0, 0.0, 3.0, 4.0, 0.5, (1.0, -2.0, 3.0, 0.5))
    found = noise_of_parameters(parameters, ratio=100.0, range_dn=10_000.0).black
    assert found == pytest.approx((0.01, -0.02, 0.03, 0.005), rel=1e-12)


def test_denoise_makes_what_the_command_makes(demo_tree: Path, tmp_path: Path) -> None:
    tree, out = tree_in(demo_tree), tmp_path / "p"
    profiles = tuple(known_profile(camera, (800, 1600, 3200)) for camera in CAMERAS)
    denoiser = BaselineDenoiser("network", profiles)
    report = write_predictions(denoiser, "", out, manifest=tree.csv, root=tree.root, cameras=["DemoAlpha"])
    assert (report.written, report.problems) == (6, ())
    made = np.load((out / frame(NOISY)).with_suffix(".npy"))
    noisy, pair = read_raw(tree.file(NOISY)), next(one for one in tree.manifest.records if one.path == frame(NOISY))
    ratio = float(pair.ratio or 0)
    np.testing.assert_allclose(denoise(noisy, profiles[0], ratio=ratio, levels="published"), made, atol=1e-6)
    bias_dn = profiles[0].measured(float(noisy.exposure.iso or 0)).colour_bias_dn
    taken = packed_frame(noisy, levels="published", clip="none", gain=ratio).mean(axis=(1, 2))
    taken -= ratio * np.array(bias_dn) / 15871
    np.testing.assert_allclose(made.mean(axis=(1, 2)), taken, rtol=0.03, err_msg="colours are not its input's")
    with pytest.raises(DatasetError, match="its ISO is not known"):
        denoise(replace(noisy, exposure=replace(noisy.exposure, iso=None)), profiles[0])
    with pytest.raises(ArgumentError, match="ratio"):
        denoise(noisy, profiles[0], ratio=0.0)
    with pytest.raises(DatasetError, match="With the camera's noise given"):
        denoise(noisy)
    with pytest.raises(DatasetError, match="its white level is 1"):
        line_of_profile(profiles[0], "a.dng", 800.0, ratio=1.0, range_dn=1.0)
    with pytest.raises(DatasetError, match="takes packed Bayer frames of 4 channels; found 9"):
        remove_noise(np.zeros((9, 32, 32), np.float32), 0.05, 1e-3, ())
    with pytest.raises(FileError, match="is not what was shipped"):
        load_weights(NoiseAwareUNet(widths=(4, 6), blocks=(1, 1)), WEIGHTS.name)


@pytest.mark.parametrize(
    ("gain", "ratio", "before_db", "gained_db"),
    [(0.05, 300.0, 35.2, 7.1), (0.3, 10.0, 47.2, 4.3), (1.0, 100.0, 29.7, 8.1), (20.0, 300.0, 11.0, 12.5)],
)
def test_what_it_gains(gain: float, ratio: float, before_db: float, gained_db: float) -> None:
    """By six cameras of another seed, of two scenes of the demo's kind beyond all that it was trained on.

    Means of six images as they were measured, within 0.1 dB; and no image is worse than its input.
    """
    cameras = VirtualCameras(6, replace(LED_RANGES, gain_dn_per_e=(gain, gain * 1.001)), seed=99)
    clean = np.stack([scene_radiance(scene, 136, 136)[[0, 1, 2, 1]] for scene in (777, 778)]).astype(np.float32)
    model = NoiseModel("P*+G*+R+U")
    pairs = SyntheticPairs(
        Arrays(clean, range_dn=15871), cameras, ratio=ratio, model=model, clip="none", crop=128, crops_per_frame=3
    )
    found = []
    for one in map(pairs.__getitem__, range(len(pairs))):
        read = tukey_lambda_variance(one["tukey_lambda"]) * one["sigma_tl_dn"] ** 2 + one["sigma_row_dn"] ** 2 + 1 / 12
        scale = ratio / 15871
        made = remove_noise(one["input"].numpy(), one["gain_dn_per_e"] * scale, read * scale**2, ())
        noisy, target = one["input"].numpy(), one["target"].numpy()
        found.append([-10 * np.log10(np.mean((np.clip(x, 0, 1) - target) ** 2)) for x in (noisy, made)])
    before, after = np.array(found).T
    assert (after > before).all()
    assert before.mean() == pytest.approx(before_db, abs=0.1)
    assert (after - before).mean() == pytest.approx(gained_db, abs=0.1)
