"""Trainings: the programs, with each choice of data, alone and under torchrun, what they leave; and the class."""

from __future__ import annotations

import itertools
import math
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.baselines import NetworkDenoiser, Training, UNet, absolute_error, load_network
from eldata.baselines.training import published_rate
from eldata.cli.main import main as eldata
from eldata.cli.main import parser as eldata_parser
from eldata.datasets import Arrays, SyntheticPairs, training_loader
from eldata.errors import ArgumentError, EldataError, FileError
from eldata.examples import train_video_denoiser
from eldata.examples.train_denoiser import main, parser
from eldata.raw.dng import write_dng
from tests.cases import in_one_test
from tests.drv_tree import REFERENCE, SENSOR, write_raw_clip, write_rgb_clip
from tests.shared import made_once
from tests.sources.store.helpers import pack_tree
from tests.trees import tree_in
from tests.waiting import PATIENCE_S

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
    last: int, said: str, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    steps, train_on = itertools.count(1), Training._train_on

    def interrupted(self: Training, batch: Mapping[str, Any]) -> None:
        if next(steps) == last:
            signal.raise_signal(signal.SIGINT)
        train_on(self, batch)

    monkeypatch.setattr(Training, "_train_on", interrupted)
    command = ["-o", str(tmp_path), *SMALL, *synthetic(store), "--batch-size", "8"]
    assert main([*command, "--epochs", "3"]) == 130
    assert said.format(run=tmp_path) in capsys.readouterr().err
    if last < 4:
        return
    assert main([*command, "--epochs", "2"]) == 2
    said = f"{tmp_path}/checkpoint.pt: was started for 3 epochs (6 steps), now 2; give --epochs 3, or --finish to keep"
    assert said in capsys.readouterr().err
    assert main([*command, "--finish"]) == 0  # whatever --epochs is
    network = UNet(4, width=4, depth=2)
    network.load_state_dict(torch.load(tmp_path / "checkpoint.pt", weights_only=True)["network"])
    image = np.random.default_rng(0).random((4, 24, 32), dtype=np.float32)
    with torch.inference_mode():
        kept = network(torch.from_numpy(image)[None])[0].numpy()
    np.testing.assert_allclose(trained(network, tmp_path, image.shape).run(image), kept, atol=1e-5)


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


# --- the class: a training that was ended goes on to the bit ---------------------------------------------------------

STEPS = 11


def pairs(count: int = 8) -> SyntheticPairs:
    """Smooth frames with the noise of a camera."""
    rng = np.random.default_rng(3)
    phase, turns = rng.uniform(0, 6, (2, 4, 4, 1, 1))
    clean = 0.3 + 0.25 * np.sin(phase + turns * np.linspace(0, 1, 48)[:, None] + np.linspace(0, 3, 48))
    frames = Arrays(clean.astype(np.float32), range_dn=15871.0)
    return SyntheticPairs(frames, "SonyA7S2", crops_per_frame=count // 4, crop=24, ratio=200.0, iso=1600, seed=5)


class Shaken(UNet):
    """One that draws random numbers as it trains."""

    def forward(self, noisy: torch.Tensor) -> torch.Tensor:
        return super().forward(torch.nn.functional.dropout(noisy, 0.1, training=self.training))


def training(network: torch.nn.Module | None = None, **options: Any) -> Training:
    torch.random.set_rng_state(torch.Generator().manual_seed(8).get_state())
    loader = training_loader(pairs(), 2, seed=1, num_workers=0)
    chosen = {"steps": STEPS, "learning_rate": 3e-3} | options
    return Training(network or Shaken(width=4, depth=1), loader, **chosen)


class Stopped(Exception):  # noqa: N818 # as Ctrl-C is not one either
    """Stands for the end of the process."""


def stopping_at(last: int) -> Any:
    """The loss, which ends the training once so many steps were taken."""
    taken = 0

    def loss(network: torch.nn.Module, batch: Mapping[str, Any]) -> torch.Tensor:
        nonlocal taken
        if taken == last:
            raise Stopped
        taken += 1
        return absolute_error(network, batch)

    return loss


def weights(trained: Training) -> list[torch.Tensor]:
    return [*trained.network.state_dict().values(), *trained.optimiser.state_dict()["state"][0].values()]


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_training_that_was_ended_goes_on_to_the_bit(precision: str, tmp_path: Path) -> None:
    """Four steps an epoch, a checkpoint after every third: ended inside of an epoch and at the end of one."""
    straight = training(precision=precision)
    reports = {report.epoch: report.loss for report in straight.epochs()}
    for last in (4, 6, 7, 9):
        path = tmp_path / f"{last}.pt"
        ended = training(precision=precision, loss=stopping_at(last))
        with pytest.raises(Stopped):
            list(ended.epochs(path, save_every=3))
        torch.rand(7)  # another process has other random numbers
        again = training(Shaken(width=4, depth=1, seed=9), precision=precision)
        torch.rand(3)
        resumed = list(again.epochs(path, save_every=3))
        assert resumed[0].epoch == {4: 1, 6: 1, 7: 1, 9: 2}[last]
        for one, other in zip(weights(straight), weights(again), strict=True):
            assert torch.equal(one, other)
        assert {report.epoch: report.loss for report in resumed}.items() <= reports.items()
        finished = training(precision=precision)
        assert list(finished.epochs(path)) == []
        assert torch.equal(weights(finished)[0], weights(straight)[0])


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    ended = training(loss=stopping_at(5), settings={"data": "one"})
    with pytest.raises(Stopped):
        list(ended.epochs(path))
    with pytest.raises(ArgumentError, match="was started with data one, now two"):
        list(training(settings={"data": "two"}).epochs(path))
    with pytest.raises(ArgumentError, match="started with learning rate"):
        list(training(settings={"data": "one"}, learning_rate=1e-3).epochs(path))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileError, match="is not a checkpoint"):
        list(training(settings={"data": "one"}).epochs(path))


def test_a_loss_that_is_not_finite_ends_the_training_before_it_is_kept(tmp_path: Path) -> None:
    def loss(network: torch.nn.Module, batch: Mapping[str, Any]) -> torch.Tensor:
        return absolute_error(network, batch) * math.nan

    with pytest.raises(EldataError, match=r"loss is not finite at step 4; take a lower learning rate than 0.003"):
        list(training(loss=loss).epochs(tmp_path / "checkpoint.pt"))
    assert list(tmp_path.iterdir()) == []


def test_the_schedule_is_the_published_one() -> None:
    """200 epochs, halved at epoch 100, a tenth from epoch 180 on."""
    rates = [published_rate(step, 200) for step in range(200)]
    assert rates == [1.0] * 100 + [0.5] * 80 + [0.1] * 20
    trained = training()
    assert [report.learning_rate for report in trained.epochs()] == pytest.approx([3e-3, 1.5e-3, 3e-4])


def test_loss_and_optimiser_are_the_published_ones() -> None:
    assert type(training().optimiser) is torch.optim.Adam
    first, second = np.random.default_rng(1).random((2, 2, 4, 8, 8))
    batch = {"input": torch.from_numpy(first), "target": torch.from_numpy(second)}
    assert absolute_error(torch.nn.Identity(), batch).item() == pytest.approx(np.abs(first - second).mean(), rel=1e-12)


def test_the_network_is_the_published_one() -> None:
    """As many weights as the U-Net of Chen et al. from 4 to 4 channels has, counted by hand."""
    widths = [32, 64, 128, 256, 512]
    down = [*zip([4, *widths], widths), *zip(widths, widths)]  # noqa: B905 # the first of a level, and the second
    up = [*zip(widths[1:], widths), *zip(widths[:-1], widths[:-1])]  # noqa: B905
    convolutions = [*down, *up]
    enlarging = [(512, 256), (256, 128), (128, 64), (64, 32)]
    count = sum((9 * a + 1) * b for a, b in convolutions) + sum((4 * a + 1) * b for a, b in enlarging) + 33 * 4
    assert sum(one.numel() for one in UNet().parameters()) == count == 7_760_484
    assert UNet(9, width=8)(torch.zeros(1, 9, 32, 16)).shape == (1, 9, 32, 16)
    first, other = (UNet(width=4, seed=seed).state_dict()["last.weight"] for seed in (0, 1))
    assert torch.equal(first, UNet(width=4).last.weight)
    assert not torch.equal(first, other)
    with pytest.raises(ArgumentError, match="width are 1 or more"):
        UNet(width=0)
