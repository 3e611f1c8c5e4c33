"""``eldata.examples.train_denoiser``: each choice of data, alone and under torchrun, and what it leaves."""

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

from eldata.baselines import Training, UNet, load_network
from eldata.cli.main import main as eldata
from eldata.examples import train_denoiser
from eldata.examples.train_denoiser import main, parser
from tests.shared import made_once
from tests.sources.store.helpers import pack_tree
from tests.trees import tree_in
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from types import ModuleType

EXAMPLE = ["-m", "eldata.examples.train_denoiser"]
SMALL = ["--crop", "16", "--width", "4", "--depth", "2", "--learning-rate", "5e-3", "--device", "cpu", "--workers", "0"]


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


@pytest.mark.study
@pytest.mark.parametrize("data", ["pairs", "synthetic", "noise2noise", "mixed"])
def test_it_learns_and_leaves_a_network_that_predict_runs(
    data: str, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In this process: others run the example as a program, which imports torch for some seconds."""
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
    network = UNet(4, width=4, depth=2)
    network.load_state_dict(torch.load(tmp_path / "weights.pt", weights_only=True))
    image = np.random.default_rng(0).random((4, 24, 32), dtype=np.float32)
    with torch.inference_mode():
        expected = network(torch.from_numpy(image)[None])[0].numpy()
    np.testing.assert_allclose(load_network(str(tmp_path / "model.pt2"), device="cpu").run(image), expected, atol=1e-6)


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


def goes_on_to_the_bit(
    example: ModuleType, options: list[str], folder: Path, most: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kill -9 a run after its second epoch: once more, in this process, it ends with the weights of one that lived."""
    straight, run = folder / "straight", folder / "killed"
    assert example.main(["-o", str(straight), *options]) == 0
    command = [sys.executable, "-m", example.__name__, "-o", str(run), *options]
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
    assert example.main(["-o", str(run), *options]) == 0
    assert 1 <= len(losses_in(capsys.readouterr().out)) <= most
    whole, resumed = (torch.load(one / "weights.pt", weights_only=True) for one in (straight, run))
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)


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
    options = [*SMALL, *synthetic(store), "--epochs", "8", "--batch-size", "2"]
    goes_on_to_the_bit(train_denoiser, options, tmp_path, 6, capsys)
