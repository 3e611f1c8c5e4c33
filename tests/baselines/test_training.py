"""Training: the loss falls, a training that was ended goes on to the bit, and the exported file is the network."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from eldata.baselines import Training, UNet, absolute_error
from eldata.baselines.training import published_rate
from eldata.datasets import Arrays, SyntheticPairs, training_loader
from eldata.errors import ArgumentError, EldataError, FileError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

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
    loader = training_loader(pairs(), 2, seed=1, workers=0)
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


def test_the_loss_falls() -> None:
    trained = training(UNet(width=6, depth=1), steps=40, learning_rate=1e-2)
    losses = [report.loss for report in trained.epochs()]
    assert len(losses) == 10
    # Two epochs of eight crops differ by a few per cent; the last four are at 0.45 of the first two here.
    assert np.mean(losses[-4:]) < 0.6 * np.mean(losses[:2])


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
