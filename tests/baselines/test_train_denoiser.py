"""``eldata.examples.train_denoiser`` and that of clips: each choice of data, alone and under torchrun, what is left."""

from __future__ import annotations

import itertools
import os
import re
import shlex
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from eldata.baselines import NetworkDenoiser, Training, UNet, load_network
from eldata.cli.main import main as eldata
from eldata.cli.main import parser as eldata_parser
from eldata.examples import train_video_denoiser
from eldata.examples.train_denoiser import main, parser
from eldata.raw.dng import write_dng
from tests.cases import in_one_test
from tests.drv_tree import REFERENCE, SENSOR, write_raw_clip, write_rgb_clip
from tests.shared import made_once
from tests.sources.store.helpers import pack_tree
from tests.trees import tree_in
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

EXAMPLE = ["-m", "eldata.examples.train_denoiser"]
SMALL = ["--crop", "16", "--width", "4", "--depth", "2", "--learning-rate", "5e-3", "--device", "cpu", "--workers", "0"]
STUDY = pytest.mark.study


@pytest.fixture(scope="session")
def store(demo_tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """24 pairs of two cameras. Not to be changed."""

    def make(folder: Path) -> None:
        folder.mkdir()
        pack_tree(tree_in(demo_tree), folder / "eld.h5")

    with made_once(tmp_path_factory, "training", make) as folder:
        yield folder / "eld.h5"


def losses_in(text: str) -> list[float]:
    """The losses of the epochs that an example has shown."""
    return [float(found) for found in re.findall(r"epoch \d+: step \d+, loss (\S+),", text)]


def synthetic(store: Path) -> list[str]:
    return ["--clean", str(store), "--camera", "SonyA7S2", "--iso", "800", "1600", "--crops-per-frame", "2"]


def test_the_defaults_are_the_papers() -> None:
    """Sections 3.2.3 and 4.1.1: 200 epochs of single crops of 512, 1e-4, factors from 100 to 300, the whole network."""
    chosen = parser().parse_args([])
    assert (chosen.epochs, chosen.batch_size, chosen.crop, chosen.learning_rate) == (200, 1, 512, 1e-4)
    assert (chosen.noise, chosen.iso, chosen.ratio) == ("P*+G*+B+R+U", None, (100.0, 300.0))
    assert (chosen.width, chosen.depth) == (32, 4)


def trained(network: UNet, folder: Path, shape: tuple[int, ...]) -> NetworkDenoiser:
    """Load what a training has left: its exported network gives what the network gives with the weights beside it."""
    network.load_state_dict(torch.load(folder / "weights.pt", weights_only=True))
    loaded = load_network(str(folder / "model.pt2"), device="cpu")
    image = np.random.default_rng(0).random(shape, dtype=np.float32)
    with torch.inference_mode():
        expected = network(torch.from_numpy(image)[None])[0].numpy()
    np.testing.assert_allclose(loaded.run(image), expected, atol=1e-5)
    return loaded


@pytest.mark.parametrize(
    "data", [pytest.param("pairs", marks=STUDY), pytest.param("synthetic", marks=STUDY), "noise2noise", "mixed"]
)
def test_it_learns_and_leaves_a_network_that_predict_runs(
    data: str, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pairs = ["--pairs", str(store)]
    options = {
        "pairs": pairs,
        "synthetic": synthetic(store),
        "noise2noise": [*synthetic(store), "--noise2noise", "--input-clip", "none"],
        "mixed": [*pairs, *synthetic(store)],
    }[data]
    assert main(["-o", str(tmp_path), *SMALL, *options, "--epochs", "6", "--batch-size", "2"]) == 0
    losses = losses_in(capsys.readouterr().out)
    assert len(losses) == 6
    assert losses[-1] < 0.9 * losses[0]  # 0.82 of synthetic pairs, the slowest; seeds are fixed
    trained(UNet(4, width=4, depth=2), tmp_path, (4, 24, 32))


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clean clips of moving waves, and two static clips of DRV, raw and preprocessed. Not to be changed."""
    root = tmp_path_factory.mktemp("clips")
    rows, columns = np.mgrid[: SENSOR.height, : SENSOR.width]
    for clip in range(2):
        (root / f"moving/{clip}").mkdir(parents=True)
        for number in range(1, 8):
            wave = np.sin(rows / (5 + clip) + number / 3) * np.cos(columns / 7 - number / 4)
            mosaic = np.rint(4000 + 3000 * wave).astype(np.uint16)
            write_dng(root / f"moving/{clip}/DSC{number:05d}.dng", mosaic, SENSOR, REFERENCE)
    for name in ("0001", "0002"):
        write_raw_clip(root / "raw", name, 6)
        write_rgb_clip(root / "rgb", name, 12)
    return root


@pytest.mark.parametrize(
    "kind", [pytest.param("moving", marks=STUDY), "still", pytest.param("raw", marks=STUDY), "rgb"]
)
def test_networks_of_clips(kind: str, clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moving = ["--clean", str(clips / "moving"), "--camera", "SonyA7S2", "--iso", "800"]
    options = {
        "moving": moving,
        "still": [*moving, "--still", "--frames", "1", "--input-clip", "none"],
        "raw": ["--clips", str(clips / "raw"), "--frames", "1"],
        "rgb": ["--clips", str(clips / "rgb"), "--rgb", "--ids", "0001", "0002"],
    }[kind]
    options += ["--crops-per-clip", "4", "--depth", "1", "--epochs", "6", "--batch-size", "2"]
    assert train_video_denoiser.main(["-o", str(tmp_path), *SMALL, *options]) == 0
    out = capsys.readouterr().out
    for line in out.splitlines()[-2:]:  # to predict and to score
        found = eldata_parser().parse_args(shlex.split(line)[2:])
        assert (found.dataset, found.manifest) == (("drv", None) if kind == "rgb" else (None, "drv-raw.csv"))
    losses = losses_in(out)
    assert len(losses) == 6
    assert losses[-1] < 0.9 * losses[0]
    channels, frames = 3 if kind == "rgb" else 4, 1 if "--frames" in options else 5
    shape = (channels, 24, 32) if frames == 1 else (frames, channels, 24, 32)
    loaded = trained(UNet(channels, width=4, depth=1, frames=frames), tmp_path, shape)
    assert (loaded.window, loaded.multiple) == (frames, 2)
    assert loaded.clip == ("none" if kind == "still" else "both")


@pytest.mark.parametrize(("task", "channels"), [("raw2rgb", 4), ("rgb2rgb", 3)])
def test_networks_to_srgb(
    task: str, channels: int, store: Path, demo_tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trained, validated as eldata evaluate scores what eldata predict writes, and gone on with by the same command."""
    tree = tree_in(demo_tree)
    options = ["--pairs", str(store), "--task", task, "--epochs", "2", "--batch-size", "2"]
    options += ["--validate", str(tree.csv), "--root", str(tree.root), "--validate-every", "9"]
    for epochs in (2, 0):  # nothing is left to do
        assert main(["-o", str(tmp_path), *SMALL, *options]) == 0
        shown = capsys.readouterr().out
        assert len(losses_in(shown)) == epochs
    network = load_network(str(tmp_path / "model.pt2"), device="cpu")
    assert network.run(np.zeros((channels, 16, 16), np.float32)).shape == (3, 16, 16)
    said = said_by_what_is_shown(shown, capsys)
    assert "12 frames predicted" in said
    assert f"protocol eld-{task}: 12 of 12 pairs" in said


@in_one_test(
    "training, options, words",
    [
        (main, [], "give --clean with --camera, --pairs, or both"),
        (main, ["--clean", "."], "--clean needs a camera's noise: --camera"),
        (main, ["--noise2noise", "--task", "raw2rgb"], "--task raw2rgb has clean targets: leave --noise2noise out"),
        (train_video_denoiser.main, ["--clean", "."], "give --clean with --camera, or --clips"),
    ],
)
def test_what_trainings_refuse(
    training: Callable[[list[str]], int], options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert training([*SMALL, *options]) == 2
    assert words in capsys.readouterr().err


def said_by_what_is_shown(shown: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What the commands that a training has shown at its end print, as they stand there."""
    commands = [shlex.split(line)[1:] for line in shown.splitlines() if line.startswith("$ eldata ")]
    assert [command[1] for command in commands] == ["predict", "evaluate"]
    for command in commands:
        assert eldata(command[1:]) == 0
    return capsys.readouterr().out


def test_what_is_shown_at_the_end_runs(
    demo_tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On clean raws, without what extras install; the score is that of the validation, as far as the table tells it."""
    for name in ("torchmetrics", "tensorboard", "skimage", "hdf5plugin", "onnxruntime", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    tree = tree_in(demo_tree)
    clean = ["--clean", str(tree.data / "DemoAlpha"), "--camera", "SonyA7S2", "--crops-per-frame", "1"]
    where = ["-o", str(tmp_path / "it's new"), "--validate", str(tree.csv), "--root", str(tree.root)]
    assert main([*where, *SMALL, *clean, "--epochs", "1"]) == 0
    shown = capsys.readouterr().out
    (validated,) = re.findall(r"psnr_db (\S+),", shown)
    said = said_by_what_is_shown(shown, capsys)
    (scored,) = re.findall(r"all +12 +(\S+)", said)
    assert float(scored) == pytest.approx(float(validated), abs=0.0051)


@pytest.mark.study
def test_two_processes_train_one_network(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ranks with half of the batch each step as one process with all of it: to float32's last digits, for gradients
    are summed in another order, and Adam's first steps are of the sign alone where a gradient is near 0."""
    options = [*SMALL, *synthetic(store), "--epochs", "3"]
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command = [sys.executable, *launch, *EXAMPLE, "-o", str(tmp_path / "two"), *options, "--batch-size", "2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert main(["-o", str(tmp_path / "one"), *options, "--batch-size", "4"]) == 0
    together, alone = losses_in(done.stdout), losses_in(capsys.readouterr().out)
    assert together == pytest.approx(alone, rel=0.02)
    assert together[-1] < together[0]


@pytest.mark.parametrize(
    ("last", "said"),
    [
        (1, "nothing was saved; the same command begins again"),
        (4, "2 of 6 steps (1 epochs) are saved in {run}/checkpoint.pt, and the same command goes on from there"),
    ],
)
def test_ctrl_c_says_what_is_saved(
    last: int,
    said: str,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    steps, train_on = itertools.count(1), Training._train_on

    def interrupted(self: Training, batch: Mapping[str, Any]) -> None:
        if next(steps) == last:
            signal.raise_signal(signal.SIGINT)
        train_on(self, batch)

    monkeypatch.setattr(Training, "_train_on", interrupted)
    assert main(["-o", str(tmp_path), *SMALL, *synthetic(store), "--epochs", "3", "--batch-size", "8"]) == 130
    assert said.format(run=tmp_path) in capsys.readouterr().err


@pytest.mark.study
def test_a_killed_run_goes_on_to_the_bit(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Kill -9 after its second epoch: once more, in this process, it ends with the weights of one that lived."""
    options = [*SMALL, *synthetic(store), "--epochs", "8", "--batch-size", "2"]
    straight, run = tmp_path / "straight", tmp_path / "killed"
    assert main(["-o", str(straight), *options]) == 0
    command = [sys.executable, *EXAMPLE, "-o", str(run), *options]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        while (line := process.stdout.readline()) and b"epoch 1:" not in line:
            pass
        process.kill()
    assert b"epoch 1:" in line
    assert (run / "checkpoint.pt").exists()
    assert not (run / "weights.pt").exists()
    capsys.readouterr()
    assert main(["-o", str(run), *options]) == 0
    assert 1 <= len(losses_in(capsys.readouterr().out)) <= 6
    whole, resumed = (torch.load(one / "weights.pt", weights_only=True) for one in (straight, run))
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)
