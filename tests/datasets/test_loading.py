"""Loaders: what each rank, worker and epoch gets; which settings are chosen, and that the reasons are the true ones."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader, Dataset, IterableDataset, Subset

from eldata import PackedStore
from eldata.datasets import ELDDataset, loading
from eldata.datasets.loading import (
    Rank,
    ShuffledSampler,
    StartMethod,
    current_rank,
    describe,
    evaluation_loader,
    loader_workers,
    set_epoch,
    training_loader,
)
from eldata.errors import ArgumentError
from tests.trees import Tree


def pairs(store: Path, **options: Any) -> PackedStore:
    return PackedStore(store, **{"crop": 8, "crops_per_frame": 2, "seed": 3} | options)


# --- who gets what ------------------------------------------------------------------------------------------------


@given(length=st.integers(0, 60), ranks=st.integers(1, 7), epoch=st.integers(0, 5), seed=st.integers(0, 9))
def test_every_rank_gets_as_many_and_none_twice(length: int, ranks: int, epoch: int, seed: int) -> None:
    got = []
    for number in range(ranks):
        sampler = ShuffledSampler(length, seed=seed, rank=Rank(number, ranks))
        sampler.set_epoch(epoch)
        got.append(list(sampler))
        assert len(sampler) == len(got[-1]) == length // ranks
    together = [index for part in got for index in part]
    assert len(set(together)) == len(together) == length // ranks * ranks
    assert set(together) <= set(range(length))


@given(length=st.integers(1, 60), ranks=st.integers(1, 7), batch=st.integers(1, 4))
def test_every_item_is_evaluated_exactly_once(length: int, ranks: int, batch: int) -> None:
    items: Any = range(length)
    loaders = [evaluation_loader(items, batch, rank=Rank(number, ranks), num_workers=0) for number in range(ranks)]
    got = [[index for part in loader for index in part.tolist()] for loader in loaders]
    assert sorted(index for part in got for index in part) == list(range(length))
    assert all(part == sorted(part) for part in got)
    assert [len(loader) for loader in loaders] == [-(-len(part) // batch) for part in got]
    assert max(map(len, got)) - min(map(len, got)) <= 1


def test_frames_are_decoded_once_for_the_crops_of_them(tree: Tree) -> None:
    def crops(most: int) -> tuple[ELDDataset, list[Any]]:
        dataset = ELDDataset(tree.data, manifest=tree.csv, crop=8, crops_per_frame=4, seed=3)
        dataset.source.kept.most = most
        loader = training_loader(dataset, 4, num_workers=0, records_at_a_time=2)
        return dataset, [sample for batch in loader for sample in zip(batch["path"], batch["input"], strict=True)]

    frame_bytes = 2 * 64 * 96
    (dataset, kept), (_, decoded) = crops(4 * frame_bytes), crops(0)  # two pairs of frames
    assert all(a[0] == b[0] and torch.equal(a[1], b[1]) for a, b in zip(kept, decoded, strict=True))
    assert all(len({path for path, _ in kept[at : at + 8]}) == 2 for at in range(0, len(kept), 8))
    assert dataset.source.kept.hits >= 6 * len(dataset.records)
    assert dataset.source.kept.hits + dataset.source.kept.misses == 8 * len(dataset.records)
    path = tree.data / dataset.records[0].path
    frame = dataset.source.frame(dataset.records[0].path)
    assert dataset.source.frame(dataset.records[0].path) is frame
    path.write_bytes(path.read_bytes() + b"\0")
    assert dataset.source.frame(dataset.records[0].path) is not frame


@pytest.mark.parametrize("workers", [0, 2])
def test_batches_do_not_depend_on_workers(workers: int, store: Path) -> None:
    """A running loader, told of the next epoch, gives what a fresh one of that epoch gives, and the dataset itself."""
    loader = training_loader(pairs(store), 5, num_workers=workers, seed=1)
    assert len(loader) == 48 // 5
    seen = []
    for epoch in range(2):
        set_epoch(loader, epoch)
        reference = pairs(store)
        reference.set_epoch(epoch)
        order = ShuffledSampler(48, seed=1, rank=Rank())
        order.set_epoch(epoch)
        batches = list(loader)
        got = [tensor for batch in batches for tensor in batch["target"]]
        assert [len(batch["target"]) for batch in batches] == [5] * 9
        assert all(torch.equal(mine, reference[index]["target"]) for mine, index in zip(got, order, strict=False))
        seen.append([path for batch in batches for path in batch["path"]])
    assert seen[0] != seen[1]
    set_epoch(loader, 1, first_batch=7)
    assert [path for batch in loader for path in batch["path"]] == seen[1][7 * 5 :]
    assert loader.persistent_workers == (workers > 0)


def test_random_numbers_that_a_transform_draws_are_seeded_by_epoch() -> None:
    """torch seeds its workers' generators, numpy's and random's too, from the loader's."""

    def seed_at(epoch: int, **options: Any) -> int:
        loader = training_loader(Numbers(), 2, num_workers=0, **options)
        set_epoch(loader, epoch)
        assert loader.generator is not None
        return int(loader.generator.initial_seed())

    assert seed_at(1) == seed_at(1)
    assert len({seed_at(1), seed_at(2), seed_at(1, seed=1), seed_at(1, rank=Rank(1, 2))}) == 4


# --- settings -----------------------------------------------------------------------------------------------------


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A machine with as much of everything as a test wants."""

    def made(cpus: int = 8, memory: int | None = 10**12, shared: int | None = 10**12) -> None:
        monkeypatch.setattr(loading, "usable_cpus", lambda: cpus)
        monkeypatch.setattr(loading, "available_memory_bytes", lambda: memory)
        monkeypatch.setattr(loading, "shared_memory_bytes", lambda: shared)

    monkeypatch.delenv("LOCAL_WORLD_SIZE", raising=False)
    return made


def test_workers_follow_cpus_and_memory(machine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 3 GB one half: each worker takes 100 MB, or 300 MB if it is spawned, and 2 batches of 200 MB."""
    large, small, gigabytes = 200_000_000, 10**6, 10**9
    cases: list[tuple[dict[str, Any], int, StartMethod, Rank, int, str]] = [
        ({"cpus": 8}, small, "forkserver", Rank(), 7, "8 CPUs usable, one left to training; memory for any number"),
        ({"cpus": 8}, small, "forkserver", Rank(0, 4), 1, "8 CPUs usable by 4 ranks"),
        ({"cpus": 1}, small, "forkserver", Rank(), 1, "1 CPUs"),
        ({"cpus": 128}, small, "forkserver", Rank(), 16, "more than 16 bring little"),
        ({"memory": 3 * gigabytes}, large, "forkserver", Rank(), 3, "memory for 3; "),
        ({"memory": 3 * gigabytes}, large, "spawn", Rank(), 2, "200.0 MB a batch"),
        ({"shared": gigabytes}, large, "forkserver", Rank(), 2, "shared memory (/dev/shm) for 2"),
        ({"shared": 64 << 20}, large, "forkserver", Rank(), 0, "shared memory (/dev/shm) for 0"),
        ({"memory": None, "shared": None}, 0, "forkserver", Rank(), 7, "memory not known"),
    ]
    for resources, nbytes, method, rank, wanted, words in cases:
        machine(**resources)
        count, why = loader_workers(nbytes, 2, method, rank)
        assert (count, words in why) == (wanted, True), why
    machine(cpus=128)
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "8")  # of 64 ranks, 8 run here
    assert loader_workers(10**6, 2, "forkserver", Rank(0, 64))[0] == 15


def test_what_the_machine_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A control group's limits count, as those of a container; and what cannot be asked is not known."""
    monkeypatch.setattr(loading, "_CGROUP", tmp_path)
    for name, text in (("cpu.max", "150000 100000"), ("memory.max", "5000000"), ("memory.current", "2000000")):
        (tmp_path / name).write_text(text)
    assert (loading.usable_cpus(), loading.available_memory_bytes()) == (1, 3_000_000)
    monkeypatch.delattr(os, "statvfs")
    assert loading.shared_memory_bytes() is None
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [loading._choose_pinning(device)[0] for device in (None, "cuda:1", "cpu")] == [True, True, False]
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 2)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 4)
    assert current_rank() == Rank(2, 4)


def test_the_description_says_what_the_loader_does(machine: Any, store: Path) -> None:
    machine(cpus=6)
    loader = training_loader(pairs(store), 5, rank=Rank(1, 2))
    text = describe(loader)
    assert loader.num_workers == 2
    for words in (
        *("training: 24 items in 4 batches of 5", "4 left over in the last batch dropped", "ranks: number 1 of 2"),
        *("workers: 2 (6 CPUs usable by 2 ranks", "start method: forkserver", "persistent", "at most 1 items left out"),
    ):
        assert words in text
    asked = evaluation_loader(pairs(store), 5, num_workers=0)
    assert "workers: 0 (as asked)" in describe(asked)
    assert "evaluation: 48 items in 10 batches of up to 5, in order" in describe(asked)
    assert not asked.persistent_workers
    # An item is 2 x 4 x 8 x 8 float32 and 4 float64: 2080 bytes.
    assert "0.0 MB a batch" in text
    assert loading._nbytes(pairs(store)[0]) == 2080


# --- refusals -----------------------------------------------------------------------------------------------------


class Endless(IterableDataset[int]):
    def __iter__(self) -> Iterator[int]:
        yield from range(5)


class Numbers(Dataset[int]):
    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> int:
        return index


def test_a_dataset_that_cannot_be_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = Numbers()
    dataset.transform = lambda value: value  # type: ignore[attr-defined] # which no other process can find
    with pytest.raises(ArgumentError, match=r"Numbers cannot be sent to .*start_method='fork' or num_workers=0"):
        training_loader(dataset, 2, num_workers=2)
    assert len(list(training_loader(dataset, 2, num_workers=0))) == 2
    monkeypatch.setattr(Numbers, "__module__", "__main__")
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    with pytest.raises(ArgumentError, match="defined in an interactive session, which workers cannot import"):
        training_loader(Numbers(), 2, num_workers=2)
    assert training_loader(Numbers(), 2, num_workers=2, start_method="fork").num_workers == 2


def test_wrong_arguments(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = pairs(store)
    wrong: list[tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any], str]] = [
        *(
            (training_loader, (dataset,), {"batch_size": 4, "num_workers": 0} | options, words)
            for options, words in (
                ({"records_at_a_time": 0}, "records_at_a_time must be 1 or more"),
                ({"batch_size": 0}, "batch_size and prefetch must be 1 or more; found 0, 2"),
                ({"prefetch": 0}, "found 4, 0"),
                ({"num_workers": -1}, "num_workers must be 0 or more; found -1"),
                ({"seed": -1}, "seed must be 0 or more; found -1"),
                ({"start_method": "thread"}, "start_method must be one of 'forkserver', 'spawn', 'fork'"),
                ({"batch_size": 49}, "48 items for rank 0 of 1 do not fill a batch of 49"),
                ({"batch_size": 5, "rank": Rank(3, 10)}, "4 items for rank 3 of 10 do not fill a batch of 5"),
            )
        ),
        (training_loader, (Endless(), 2), {}, "expected a dataset with len and indices; found Endless"),
        (evaluation_loader, (5,), {}, "expected a dataset with len and indices; found int"),
        (evaluation_loader, (Subset(dataset, []),), {}, "Subset holds no items"),
        (describe, (DataLoader(dataset),), {}, "found another DataLoader"),
        (Rank, (2, 2), {}, "found 2 of 2"),
        (set_epoch, (evaluation_loader(dataset, num_workers=0), 1), {"first_batch": 2}, "only a training loader"),
    ]
    for work, arguments, options, words in wrong:
        with pytest.raises(ArgumentError, match=words):
            work(*arguments, **options)
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])  # as on Windows
    with pytest.raises(ArgumentError, match="this system has no start method 'forkserver'; take 'spawn'"):
        training_loader(dataset, 4)


def test_many_processes_without_torch_distributed(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert current_rank() == Rank(0, 1)
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(ArgumentError, match=r"WORLD_SIZE is '2', but torch.distributed is not initialised"):
        training_loader(pairs(store), 4)
    assert len(training_loader(pairs(store), 4, num_workers=0, rank=Rank(1, 2))) == 6
