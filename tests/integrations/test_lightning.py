"""A LightningDataModule: a few steps, and a run that goes on in the middle of an epoch, to the bit."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest
import torch

pytest.importorskip("lightning", reason="needs eldata[lightning]")

import lightning

from eldata import PackedStore, StreamedPairs
from eldata.cli.main import main
from eldata.datasets import set_epoch, training_loader
from eldata.errors import ArgumentError
from eldata.integrations.lightning import EldataModule, TrainingBatches
from eldata.sources.shards import write_shards

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning", "ignore::FutureWarning")
]  # Lightning's: few workers, no logger, what it uses of others


@pytest.fixture(scope="module")
def store(demo_tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lightning") / "demo.h5"
    csv = demo_tree / "manifests/eld-demo.csv"
    assert main(["pack", "eld-demo", "--manifest", str(csv), "--root", str(demo_tree / "data"), "-o", str(path)]) == 0
    return path


class Module(lightning.LightningModule):
    """One convolution; keeps what it was given, and stops dead after so many steps."""

    def __init__(self, stop_after: int | None = None) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.network = torch.nn.Conv2d(4, 4, 3, padding=1)
        self.stop_after = stop_after
        self.seen: list[tuple[int, torch.Tensor]] = []
        self.validated: list[str] = []

    def training_step(self, batch: dict[str, Any], _: int) -> torch.Tensor:
        if self.stop_after is not None and len(self.seen) == self.stop_after:
            raise KeyboardInterrupt
        self.seen.append((self.current_epoch, batch["input"].clone()))
        return torch.nn.functional.l1_loss(self.network(batch["input"]), batch["target"])

    def validation_step(self, batch: dict[str, Any], _: int) -> None:
        self.validated += batch["path"]

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.parameters(), 1e-3)


def data(store: Path, **more: Any) -> EldataModule:
    training = PackedStore(store, crop=16, seed=3, crops_per_frame=1)
    return EldataModule(training, batch_size=4, workers=0, seed=1, **more)


def trainer(folder: Path, **more: Any) -> lightning.Trainer:
    quiet = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False}
    every_step = lightning.pytorch.callbacks.ModelCheckpoint(
        folder, filename="{epoch}-{step}", every_n_train_steps=1, save_top_k=-1, save_on_train_epoch_end=False
    )
    options = {"max_epochs": 2, "accelerator": "cpu", "devices": 1, "num_sanity_val_steps": 0, **quiet, **more}
    return lightning.Trainer(default_root_dir=folder, callbacks=[every_step], **options)


def expected(store: Path) -> list[torch.Tensor]:
    """The batches of two epochs, as the loader gives them without Lightning."""
    loader = training_loader(PackedStore(store, crop=16, seed=3, crops_per_frame=1), 4, workers=0, seed=1)
    batches = []
    for epoch in range(2):
        set_epoch(loader, epoch)
        batches += [batch["input"].clone() for batch in loader]
    return batches


def test_its_batches_are_the_loaders(store: Path, tmp_path: Path) -> None:
    module, wanted = Module(), expected(store)
    whole = PackedStore(store, crop=None, augment=False)
    trainer(tmp_path).fit(module, data(store, validation=whole))
    assert len(module.seen) == len(wanted) == 12
    assert all(torch.equal(seen, one) for (_, seen), one in zip(module.seen, wanted, strict=True))
    assert [epoch for epoch, _ in module.seen] == [0] * 6 + [1] * 6
    assert module.validated == [record.path for record in whole.records] * 2


@pytest.mark.parametrize("steps", [4, 6])
def test_a_run_goes_on_in_the_middle_of_an_epoch(steps: int, store: Path, tmp_path: Path) -> None:
    whole = Module()
    trainer(tmp_path / "whole").fit(whole, data(store))
    (tmp_path / "cut").mkdir()
    cut = Module(stop_after=steps)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        trainer(tmp_path / "cut").fit(cut, data(store))
    (checkpoint,) = (tmp_path / "cut").glob(f"*-step={steps}.ckpt")
    again = Module()
    trainer(tmp_path / "cut").fit(again, data(store), ckpt_path=os.fspath(checkpoint), weights_only=False)
    seen = [batch for _, batch in (*cut.seen, *again.seen)]
    assert len(seen) == 12
    assert all(torch.equal(one, other) for one, (_, other) in zip(seen, whole.seen, strict=True))
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, again.network.state_dict()[name])


def test_states(store: Path) -> None:
    def batches() -> TrainingBatches:
        found = data(store).train_dataloader()
        assert isinstance(found, TrainingBatches)
        return found

    wanted, first = expected(store), batches()
    steps = iter(first)
    for _ in range(4):
        next(steps)
    assert first.state_dict() == {"epoch": 0, "batches": 4}
    second = batches()
    second.load_state_dict(first.state_dict())
    rest = [batch["input"].clone() for _ in range(2) for batch in second]
    assert len(rest) == 8
    assert all(torch.equal(one, other) for one, other in zip(rest, wanted[4:], strict=True))
    with pytest.raises(ArgumentError, match="7 batches of an epoch, and here one has 6"):
        second.load_state_dict({"epoch": 0, "batches": 7})
    with pytest.raises(ArgumentError, match="found epoch"):
        second.load_state_dict({"epoch": 0})


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.study)])
def test_states_of_a_stream(workers: int, store: Path, tmp_path: Path) -> None:
    """Three of 16 batches, then the rest of the epoch and the next one, as without a stop."""
    write_shards(store, tmp_path / "shards", tile=16, samples_per_shard=50)

    def batches() -> TrainingBatches:
        pairs = StreamedPairs(str(tmp_path / "shards"), crop=16, seed=3, shuffle_buffer=30)
        return TrainingBatches(training_loader(pairs, 9, workers=workers))

    whole, cut, again = batches(), batches(), batches()
    wanted = [batch["input"].clone() for _ in range(2) for batch in whole]
    steps = iter(cut)
    begun = [next(steps)["input"].clone() for _ in range(3)]
    again.load_state_dict(cut.state_dict())
    del steps
    got = [*begun, *(batch["input"].clone() for _ in range(2) for batch in again)]
    assert len(got) == len(wanted) == 2 * len(whole)
    assert all(torch.equal(one, other) for one, other in zip(got, wanted, strict=True))


def test_without_lightning_it_says_so() -> None:
    from importlib import reload
    from unittest.mock import patch

    from eldata.integrations import lightning as module

    with (
        patch.dict("sys.modules", {"lightning.pytorch": None}),
        pytest.raises(ImportError, match=r"pip install 'eldata\[lightning\]'"),
    ):
        reload(module)
