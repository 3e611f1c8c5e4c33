"""Batches in memory that is used again: equal to torch's own, and never overwritten while anybody can see them."""

from __future__ import annotations

import copy
import gc
import os
import pickle
from collections.abc import Sequence
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset, default_collate

from eldata.datasets import batches
from eldata.datasets.batches import Field, new_batch
from tests.datasets.comparing import same

# Python 3.12 and later warn of any fork in a process that has threads.
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning"),
    pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="this system has no memfd_create"),
]

SIDE = 40


class Numbers(Dataset[Any]):
    """Sample i is full of i: whoever reads other memory than its own sees it."""

    def __len__(self) -> int:
        return 24

    def __getitem__(self, index: int) -> dict[str, Any]:
        return self.facts(index) | {
            "image": torch.full((2, SIDE, SIDE), index, dtype=torch.float32),
            "mosaic": torch.full((SIDE, SIDE), index, dtype=torch.uint16),
        }

    def facts(self, index: int) -> dict[str, Any]:
        return {
            "name": f"item {index}",
            "image": None,
            "ratio": index / 3,
            "count": index,
            "mosaic": None,
            "bias": torch.tensor([index, 1.5], dtype=torch.float64),
        }

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        count = len(indices)
        batch = new_batch([Field("image", (count, 2, SIDE, SIDE), "<f4"), Field("mosaic", (count, SIDE, SIDE), "<u2")])
        if batch is None:
            return [self[index] for index in indices]
        for number, index in enumerate(indices):
            batch.arrays["image"][number] = index
            batch.arrays["mosaic"][number] = index
        return batch.parts([self.facts(index) for index in indices])


class Plain(Numbers):
    """The same without batches."""

    __getitems__ = None  # type: ignore[assignment] # as of a dataset that has none


@pytest.mark.parametrize(("workers", "method"), [(0, None), (2, "fork")])
def test_batches_are_those_of_torch(workers: int, method: str | None) -> None:
    """Plain dictionaries of plain tensors, in the same order, with the same dtypes, the last batch smaller.

    Those that are kept, or views of them, are not overwritten.
    """
    loader = DataLoader(
        Numbers(), batch_size=5, num_workers=workers, multiprocessing_context=method, persistent_workers=workers > 0
    )
    kept = [batch for _ in range(2) for batch in loader]
    views = [np.asarray(batch["image"])[1:, :, 3] for batch in loader]
    for number, batch in enumerate([*loader, *kept]):
        other = default_collate([Plain()[index] for index in range(number % 5 * 5, min(number % 5 * 5 + 5, 24))])
        assert type(batch) is dict
        same(batch, {name: other[name] for name in batch})
        assert list(batch) == ["name", "image", "ratio", "count", "mosaic", "bias"]
        assert (views[number % 5] == np.asarray(other["image"])[1:, :, 3]).all()


def test_memory_is_used_again_once_nobody_sees_it() -> None:
    def address() -> int:
        return int(Numbers().__getitems__([1, 2, 3])[0]["image"].data_ptr())

    gc.collect()
    first = address()
    assert {address() for _ in range(5)} == {first}
    parts = Numbers().__getitems__([4, 5])
    view = parts[1]["mosaic"][3:5]
    del parts
    others = [Numbers().__getitems__([6, 7]) for _ in range(6)]
    assert (view == 5).all()
    assert len({part[0]["image"].data_ptr() for part in others}) == 6
    assert len(batches._own_pieces(batches._Piece).all) >= 7
    del others, view
    address()
    assert len(batches._own_pieces(batches._Piece).all) <= 1 + batches._MOST_FREE


def test_who_keeps_very_many_batches_gets_other_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not an error for want of descriptors, in a worker or not."""
    for info in (None, object()):
        monkeypatch.setattr(batches, "get_worker_info", lambda info=info: info)
        kept = [Numbers().__getitems__([index])[0]["image"] for index in range(2 * batches._MOST_HELD)]
        for index, image in enumerate(kept):
            assert (image == index).all()
        pieces = batches._own_pieces(batches._Piece if info is None else batches._SharedPiece)
        assert len(pieces.all) <= batches._MOST_HELD


# --- what workers send ------------------------------------------------------------------------------------------------


def send(numbers: Sequence[int]) -> tuple[dict[str, Any], batches._Piece]:
    """Make a batch as a worker does, and receive it; and the worker's piece of memory that it lies in."""
    whole = default_collate(Numbers().__getitems__(numbers))
    received = ForkingPickler.loads(ForkingPickler.dumps(whole))
    return received, whole.batch.piece


@pytest.fixture
def as_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batches, "get_worker_info", object)


@pytest.mark.usefixtures("as_worker")
@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs /proc")
def test_memory_that_was_sent_is_used_again_once_both_are_done() -> None:
    """80 batches: as many pieces as are held, and no descriptor is left where they are read."""
    received, piece = send([3, 4, 5])
    same(received, default_collate([plain_part(Plain(), index) for index in (3, 4, 5)]))
    opened = []
    for number in range(80):
        other, its_piece = send([number, 7])
        assert its_piece is not piece
        assert (other["image"][0] == number).all()
        del other, its_piece
        links = [link.readlink() for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
        opened.append(sum("eldata-batch" in str(link) for link in links))
    assert (received["image"][2] == 5).all()
    assert max(opened[10:]) < 40  # of 80, had each left one
    assert len(batches._own_pieces(batches._SharedPiece).all) <= 2 + batches._MOST_FREE
    view = received["image"][1, :, 3]
    del received
    assert not piece.is_free()
    del view
    assert piece.is_free()


@pytest.mark.usefixtures("as_worker")
def test_a_batch_that_was_changed_is_sent_as_it_is() -> None:
    whole = default_collate(Numbers().__getitems__([3, 4]))
    del whole["mosaic"]  # torch itself cannot pickle a uint16
    whole["image"] = whole["image"] + 1
    assert (ForkingPickler.loads(ForkingPickler.dumps(whole))["image"][1] == 5).all()


@pytest.mark.usefixtures("as_worker")
def test_a_fork_that_ends_gives_back_nothing() -> None:
    """Its copies of the arrays go, those of the process that reads stay: the worker must not write there."""
    received, piece = send([3, 4, 5])
    for _ in range(2):
        child = os.fork()
        if child == 0:
            del received
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert not piece.is_free()
    del received
    assert piece.is_free()


# --- what others do with the samples ----------------------------------------------------------------------------------


def test_samples_are_dictionaries() -> None:
    parts = Numbers().__getitems__([7, 8])
    for part, index in zip(parts, (7, 8), strict=True):
        same(dict(part), {name: Numbers()[index][name] for name in part})
        for other in (copy.copy(part), copy.deepcopy(part)):
            assert type(other) is dict
            same(other, dict(part))
        del part["mosaic"]  # torch itself cannot read a pickled uint16
        same(pickle.loads(pickle.dumps(part)), dict(part))


def test_changed_samples_are_collated_as_they_are() -> None:
    numbers, plain = Numbers(), Plain()
    reordered = numbers.__getitems__([3, 4, 5])[::-1]
    same(default_collate(reordered), default_collate([plain_part(plain, index) for index in (5, 4, 3)]))
    mixed = [numbers.__getitems__([3, 4])[0], numbers.__getitems__([5, 6])[1]]
    same(default_collate(mixed), default_collate([plain_part(plain, index) for index in (3, 6)]))
    replaced = numbers.__getitems__([3, 4])
    replaced[1]["image"] = replaced[1]["image"] + 1
    assert (default_collate(replaced)["image"][1] == 5).all()
    without = numbers.__getitems__([3, 4])
    for part in without:
        del part["image"]
    assert "image" not in default_collate(without)


def plain_part(plain: Plain, index: int) -> dict[str, Any]:
    sample = plain[index]
    return {name: sample[name] for name in plain.facts(index)}
