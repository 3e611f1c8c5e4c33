"""``eldata.examples.train_video_denoiser``: each choice of data and network, what it leaves, and kill -9."""

from __future__ import annotations

import shlex
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from eldata.baselines import UNet, load_network
from eldata.cli.main import parser as eldata_parser
from eldata.examples.train_video_denoiser import main
from eldata.raw.dng import write_dng
from eldata.records import Exposure, Sensor
from tests.baselines.test_train_denoiser import losses_in
from tests.drv_tree import write_raw_clip, write_rgb_clip

if TYPE_CHECKING:
    from pathlib import Path

SMALL = ["--crop", "16", "--width", "4", "--depth", "1", "--learning-rate", "5e-3", "--device", "cpu", "--workers", "0"]
SENSOR = Sensor("SONY", "ILCE-7SM2", ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, 64, 80, (2.0, 1.0, 1.5, 1.0))

EXPOSURE = Exposure(Fraction(100), Fraction(1), Fraction(4))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clean clips of moving waves, and two static clips of DRV, raw and preprocessed. Not to be changed."""
    root = tmp_path_factory.mktemp("clips")
    rows, columns = np.mgrid[:64, :80]
    for clip in range(2):
        for number in range(1, 8):
            wave = np.sin(rows / (5 + clip) + number / 3) * np.cos(columns / 7 - number / 4)
            mosaic = np.rint(4000 + 3000 * wave).astype(np.uint16)
            (root / f"moving/{clip}").mkdir(parents=True, exist_ok=True)
            write_dng(root / f"moving/{clip}/DSC{number:05d}.dng", mosaic, SENSOR, EXPOSURE)
    for name in ("0001", "0002"):
        write_raw_clip(root / "raw", name, 6)
        write_rgb_clip(root / "rgb", name, 12)
    return root


def moving(data: Path) -> list[str]:
    return ["--clean", str(data / "moving"), "--camera", "SonyA7S2", "--iso", "800", "--crops-per-clip", "4"]


@pytest.mark.study
@pytest.mark.parametrize("kind", ["moving", "still", "raw", "rgb"])
def test_it_trains_and_leaves_a_network_that_predict_runs(
    kind: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In this process: the next one runs the example as a program, which imports torch for some seconds."""
    options = {
        "moving": moving(data),
        "still": [*moving(data), "--still", "--frames", "1", "--input-clip", "none"],
        "raw": ["--clips", str(data / "raw"), "--crops-per-clip", "4", "--frames", "1"],
        "rgb": ["--clips", str(data / "rgb"), "--rgb", "--ids", "0001", "0002", "--crops-per-clip", "4"],
    }[kind]
    assert main(["-o", str(tmp_path), *SMALL, *options, "--epochs", "6", "--batch-size", "2"]) == 0
    out = capsys.readouterr().out
    for line in out.splitlines()[-2:]:  # to predict and to score
        found = eldata_parser().parse_args(shlex.split(line)[2:])
        assert (found.dataset, found.manifest) == (("drv", None) if kind == "rgb" else (None, "drv-raw.csv"))
    losses = losses_in(out)
    assert len(losses) == 6
    channels, is_single = 3 if kind == "rgb" else 4, "--frames" in options
    network = UNet(channels, width=4, depth=1, frames=1 if is_single else 5)
    network.load_state_dict(torch.load(tmp_path / "weights.pt", weights_only=True))
    assert losses[-1] < 0.9 * losses[0]
    loaded = load_network(str(tmp_path / "model.pt2"), device="cpu")
    assert (loaded.window, loaded.multiple) == (1 if is_single else 5, 2)
    assert loaded.clip == ("none" if kind == "still" else "both")
    shape = (channels, 24, 32) if is_single else (5, channels, 24, 32)
    image = np.random.default_rng(0).random(shape, dtype=np.float32)
    with torch.inference_mode():
        expected = network(torch.from_numpy(image)[None])[0].numpy()
    np.testing.assert_allclose(loaded.run(image), expected, atol=1e-5)
