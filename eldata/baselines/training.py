"""Training a denoiser: published losses, optimiser and schedule, in steps, and checkpoints that go on to the bit."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import distributed
from tqdm import tqdm

from eldata.base.files import atomic_write, check_same_work
from eldata.base.numbers import checked_number, checked_whole
from eldata.baselines.exported import checked_window
from eldata.datasets.loading import current_rank, set_epoch
from eldata.errors import ArgumentError, EldataError, FileError, check_choice

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from torch.utils.data import DataLoader

    from eldata.baselines.networks import Precision

    Loss = Callable[[torch.nn.Module, Mapping[str, Any]], torch.Tensor]

_PRECISIONS: tuple[Literal["float32", "bfloat16", "float16"], ...] = ("float32", "bfloat16", "float16")


def absolute_error(network: torch.nn.Module, batch: Mapping[str, Any]) -> torch.Tensor:
    """Return the published loss, the mean absolute difference (L1) of prediction and target."""
    error: torch.Tensor = (network(batch["input"]) - batch["target"]).abs().mean()
    return error


PUBLISHED_WEIGHT = 0.05
"""Of the self-consistency: ``alpha`` in train.py of cchen156/Seeing-Motion-in-the-Dark."""


def consistent_error(
    first: torch.Tensor,
    second: torch.Tensor,
    first_target: torch.Tensor,
    second_target: torch.Tensor,
    *,
    weight: float = PUBLISHED_WEIGHT,
) -> torch.Tensor:
    r"""Return the recovery loss of two predictions of one scene, and how much they differ from each other.

    ``|f1 - y1| + |f2 - y2| + weight |(f1 - f2) - (y1 - y2)|``, where ``| |`` is the mean absolute value.

    Of a static scene, where y1 = y2, that is C. Chen et al. (ICCV 2019), their train.py, in raw image space as K. Wei
    et al. (TPAMI 2021, section 4.6) have it: ``|f1 - y| + |f2 - y| + 0.05 |f1 - f2|``. The paper has no
    formula for moving scenes. Here what moved in the clean frames may move in the predictions, and what differs beyond
    that is flicker.

    Parameters
    ----------
    first, second
        The predictions f1 and f2, (N, C, h, w).
    first_target, second_target
        y1 and y2, of the same shape; of a static scene the same.
    weight
        Of the self-consistency, 0 or more.

    Raises
    ------
    ArgumentError
        If the weight is negative or not finite.
    """
    if checked_number("weight", weight) < 0:
        raise ArgumentError(f"weight is 0 or more; found {weight}")
    one, other = first - first_target, second - second_target
    return one.abs().mean() + other.abs().mean() + weight * (one - other).abs().mean()


def clip_error(
    network: torch.nn.Module, batch: Mapping[str, Any], *, window: int, weight: float = PUBLISHED_WEIGHT
) -> torch.Tensor:
    """Return :func:`consistent_error` of the first and the last window of each clip of a batch: a loss of ``Training``.

    Both windows go through the network at once. What a window's prediction is compared with is its middle frame's
    target.

    Parameters
    ----------
    network
        Of windows (N, T, C, h, w), or with T = 1 of frames (N, C, h, w), to (N, C, h, w).
    batch
        ``input`` (N, F, C, h, w), F > T frames of which each has noise of its own; ``target`` (N, F, C, h, w), or
        (N, C, h, w) where one still is the target of all frames. Samples of
        :class:`~eldata.datasets.synthetic.pairs.SyntheticClips` and :class:`~eldata.datasets.clips.ClipWindows` are so.
    window
        T, odd.
    weight
        As :func:`consistent_error` has it.

    Raises
    ------
    ArgumentError
        If T is even, or the batch has no two windows.
    """
    noisy, clean = batch["input"], batch["target"]
    middle = checked_window(window) // 2
    if noisy.ndim != 5 or noisy.shape[1] <= window:
        raise ArgumentError(
            f"clips of {window + 1} frames or more, (N, F, C, h, w), make two windows of {window}; found "
            f"{tuple(noisy.shape)}"
        )
    frames = torch.cat([noisy[:, :window], noisy[:, -window:]])
    first, second = network(frames[:, 0] if window == 1 else frames).chunk(2)
    if clean.ndim == 4:
        return consistent_error(first, second, clean, clean, weight=weight)
    return consistent_error(first, second, clean[:, middle], clean[:, -1 - middle], weight=weight)


def published_rate(step: int, steps: int) -> float:
    """Return the learning rate at a step, as a share of the first one: halved after 1/2 of the steps, 1/10 after 9/10.

    K. Wei et al., TPAMI 2021, section 4.1.1: 200 epochs, 1e-4, halved at epoch 100, reduced to 1e-5 at epoch 180.
    """
    return 1.0 if 2 * step < steps else 0.5 if 10 * step < 9 * steps else 0.1


@dataclass(frozen=True, slots=True)
class EpochReport:
    """What an epoch came to.

    Attributes
    ----------
    epoch, step
        Its number, from 0, and the steps taken since the beginning of the training.
    loss
        Mean over its batches, of all ranks.
    learning_rate
        Of its last step.
    items_per_s
        Of all ranks, in the part of the epoch that this run trained; with the time that the next batch was waited for.
    waited
        Share of the time that the next batch was waited for: near 0, the data are never the limit.
    """

    epoch: int
    step: int
    loss: float
    learning_rate: float
    items_per_s: float
    waited: float

    def __str__(self) -> str:
        return (
            f"epoch {self.epoch}: step {self.step}, loss {self.loss:.5f}, learning rate {self.learning_rate:.2g}, "
            f"{self.items_per_s:.1f} items/s, {self.waited:.0%} of the time waiting for data"
        )


class Training:
    """A network in training by Adam, with all that a checkpoint holds.

    With one kind of machine and one version of torch, the weights after any number of steps depend on the arguments
    alone: not on how often the training was ended and went on. (On a GPU to the bit only with
    ``torch.use_deterministic_algorithms``.) Under torch.distributed every rank makes one, and they step together.

    Parameters
    ----------
    network
        Moved to ``device``. What it draws (dropout) comes from torch's own generators, whose states are kept.
    loader
        Of :func:`eldata.datasets.training_loader`, which gives dictionaries with tensors.
    steps
        In all, which the schedule is scaled to.
    learning_rate
        At first (:func:`published_rate`).
    loss
        Of the network and a batch, whose tensors lie on the device.
    device
        Of this process.
    precision
        ``"bfloat16"`` or ``"float16"``: torch's autocast, for float16 with its gradient scaler.
    settings
        What else decides the weights, in plain words (the data, the network): a checkpoint of others is refused.

    Raises
    ------
    ArgumentError
        If a number is out of its range.
    """

    def __init__(
        self, network: torch.nn.Module, loader: DataLoader[Any], *,
        steps: int, learning_rate: float = 1e-4, loss: Loss = absolute_error, device: torch.device | str = "cpu",
        precision: Precision = "float32", settings: Mapping[str, str | int | float] | None = None,
    ) -> None:  # fmt: skip
        check_choice("precision", precision, _PRECISIONS)
        self.steps = checked_whole("steps", steps, at_least=1)
        self.device = torch.device(device)
        self.network = network.to(self.device)
        self.loader = loader
        self.loss = loss
        self.precision = precision
        self.step = 0
        self.saved = 0  # steps, of the checkpoint
        self._rank = current_rank()
        parallel = torch.nn.parallel.DistributedDataParallel
        self._parallel = parallel(self.network) if self._rank.of > 1 else self.network
        rate = checked_number("learning_rate", learning_rate, above=0)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=rate)
        self._schedule = torch.optim.lr_scheduler.LambdaLR(
            self.optimiser, lambda step: published_rate(step, self.steps)
        )
        self._scaler = torch.amp.GradScaler(self.device.type, enabled=precision == "float16")
        self._loss_sum = torch.zeros((), dtype=torch.float64, device=self.device)  # of the epoch so far, on this rank
        self.settings: dict[str, str | int | float] = {
            "steps": self.steps,
            "learning_rate": rate,
            "precision": precision,
            "batch_size": loader.batch_size or 1,
            "batches": len(loader),
            "ranks": self._rank.of,
            **(settings or {}),
        }

    def epochs(self, checkpoint: Path | str | None = None, *, save_every: int | None = None) -> Iterator[EpochReport]:
        """Train on, and yield a report after each epoch; the last one may be a part.

        Parameters
        ----------
        checkpoint
            A file: if it is there, the training goes on from it. It is written after each epoch and at the end.
        save_every
            Write it after so many steps too.

        Raises
        ------
        ArgumentError
            If the checkpoint is of a training with other settings.
        FileError
            If it cannot be read.
        EldataError
            If the loss is not finite: the last checkpoint is the one before.
        """
        path = None if checkpoint is None else Path(checkpoint)
        if path is not None and path.exists():
            self.load(path)
        while self.step < self.steps:
            epoch, first = divmod(self.step, len(self.loader))
            begun, waited = time.perf_counter(), 0.0
            set_epoch(self.loader, epoch, first_batch=first)
            batches = iter(self.loader)
            end = min(self.steps, (epoch + 1) * len(self.loader))
            self._parallel.train()
            quiet = True if self._rank.number else None  # one bar, and only on a terminal
            with tqdm(total=len(self.loader), initial=first, desc=f"epoch {epoch}", disable=quiet, leave=False) as bar:
                while self.step < end:
                    asked = time.perf_counter()
                    batch = next(batches)
                    waited += time.perf_counter() - asked
                    self._train_on(batch)
                    bar.update()
                    if path is not None and save_every and self.step % save_every == 0 and self.step < end:
                        self.save(path)
            report = self._report(epoch, end - epoch * len(self.loader), first, time.perf_counter() - begun, waited)
            self._loss_sum.zero_()
            if path is not None:
                self.save(path)
            yield report

    def save(self, path: Path | str) -> None:
        """Write all that decides the next steps, whole or not at all; every rank takes part, the first one writes."""
        self._check_finite(self._loss_sum)
        own = {"torch": torch.get_rng_state(), "loss_sum": self._loss_sum.cpu()}
        if self.device.type == "cuda":
            own["cuda"] = torch.cuda.get_rng_state(self.device)
        each: list[Any] = [own]
        if self._rank.of > 1:
            each = [None] * self._rank.of
            distributed.all_gather_object(each, own)
        if self._rank.number == 0:
            state = {
                "settings": self.settings,
                "step": self.step,
                "network": self.network.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "schedule": self._schedule.state_dict(),
                "scaler": self._scaler.state_dict(),
                "ranks": each,
            }
            with atomic_write(path) as file:
                torch.save(state, file)
        if self._rank.of > 1:
            distributed.barrier()  # a rank that goes on alone could end the others before it is written
        self.saved = self.step

    def load(self, path: Path | str, *, any_steps: bool = False) -> None:
        """Take up a checkpoint: weights, optimiser, schedule, scaler, random numbers, and the place in the epoch.

        ``any_steps``: it may be of a training of other length, whose weights are wanted.

        Raises
        ------
        FileError
            If it cannot be read, or is not a checkpoint.
        ArgumentError
            If it is of a training with other settings.
        """
        path = Path(path)
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            begun, own = state["settings"], state["ranks"]
        except Exception as error:  # torch raises what its parts raise
            raise FileError(path, f"is not a checkpoint of a training: {type(error).__name__}") from error
        check_same_work(path, begun, self.settings | {"steps": begun.get("steps")})
        if begun["steps"] != self.steps and not any_steps:
            epochs, now = (steps / len(self.loader) for steps in (begun["steps"], self.steps))
            raise ArgumentError(
                f"{path}: was started for {epochs:g} epochs ({begun['steps']} steps), now {now:g}; give --epochs "
                f"{epochs:g}, or --finish to keep what is trained"
            )
        self.step = self.saved = state["step"]
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self._schedule.load_state_dict(state["schedule"])
        self._scaler.load_state_dict(state["scaler"])
        mine = own[self._rank.number]
        torch.set_rng_state(mine["torch"])
        if "cuda" in mine and self.device.type == "cuda":
            torch.cuda.set_rng_state(mine["cuda"], self.device)
        self._loss_sum.copy_(mine["loss_sum"])

    def _train_on(self, batch: Mapping[str, Any]) -> None:
        """Take one optimiser step on a batch."""
        moved = {
            name: value.to(self.device, non_blocking=True) if isinstance(value, torch.Tensor) else value
            for name, value in batch.items()
        }
        mixed = self.precision != "float32"
        kind = getattr(torch, self.precision) if mixed else None
        with torch.autocast(self.device.type, dtype=kind, enabled=mixed):
            loss = self.loss(self._parallel, moved)
        self.optimiser.zero_grad()
        self._scaler.scale(loss).backward()  # type: ignore[no-untyped-call]
        self._scaler.step(self.optimiser)
        self._scaler.update()
        self._schedule.step()
        self._loss_sum += loss.detach()
        self.step += 1

    def _report(self, epoch: int, done: int, first: int, seconds: float, waited: float) -> EpochReport:
        """Make the report of an epoch so far: mean loss over all ranks, learning rate, speed."""
        total = self._loss_sum.clone()
        if self._rank.of > 1:
            distributed.all_reduce(total)
        self._check_finite(total)
        items = (done - first) * (self.loader.batch_size or 1) * self._rank.of
        rate = float(self.settings["learning_rate"]) * published_rate(self.step - 1, self.steps)
        return EpochReport(
            epoch, self.step, total.item() / (done * self._rank.of), rate, items / seconds, waited / seconds
        )

    def _check_finite(self, loss: torch.Tensor) -> None:
        """Stop the training if the loss is not finite."""
        if not math.isfinite(loss.item()):
            raise EldataError(
                f"the loss is not finite at step {self.step}; take a lower learning rate than "
                f"{self.settings['learning_rate']}, or another precision than {self.precision}"
            )
