"""DataLoaders whose settings fit these datasets, and the reasons for each setting in words.

Two loaders, for two promises. Training: every rank gets as many batches (else they wait for each other for ever), none
of an item twice, a new order each epoch. Evaluation: every item exactly once over all ranks, in order. torch's
DistributedSampler keeps neither promise whole: it repeats items until the ranks are even, which counts some twice in a
score.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, Sampler

from eldata.errors import ArgumentError, check_choice

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.context import BaseContext

    from torch.utils.data import Dataset

StartMethod = Literal["forkserver", "spawn", "fork"]
START_METHODS: tuple[StartMethod, ...] = get_args(StartMethod)

# What a worker adds to the memory in use beside its batches: measured with PackedStore, docs/streaming.md has the
# figures. With fork and forkserver, pages of the libraries are shared with the process that it comes from.
_WORKER_BYTES: dict[StartMethod, int] = {"forkserver": 100_000_000, "spawn": 300_000_000, "fork": 100_000_000}
# Half of the memory is left to the model, the page cache and everybody else.
_MEMORY_SHARE = 0.5
# A worker reads hundreds of crops a second; more than this many cost more in starting and memory than they bring.
_MOST_WORKERS = 16

# Imported once by the server that workers are forked from, for it would take seconds in each worker.
_PRELOADED = ("eldata.datasets._preloaded",)

# Keeps these random numbers apart from those of the items, which are seeded by (seed, epoch, index).
_ORDER, _WORKERS = 1, 2


@dataclass(frozen=True, slots=True)
class Rank:
    """Which of several training processes this is: ``number`` (from 0) of ``of``."""

    number: int = 0
    of: int = 1

    def __post_init__(self) -> None:
        if not 0 <= self.number < self.of:
            raise ArgumentError(f"a rank is from 0 up to below their number; found {self.number} of {self.of}")


def current_rank() -> Rank:
    """Return this process's place in torch.distributed; the only one if that is not used.

    Raises
    ------
    ArgumentError
        If the environment states a ``WORLD_SIZE`` above 1, but torch.distributed is not initialised: each process would
        read everything.
    """
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        return Rank(torch.distributed.get_rank(), torch.distributed.get_world_size())
    stated = os.environ.get("WORLD_SIZE", "1")
    if stated != "1":
        raise ArgumentError(
            f"WORLD_SIZE is {stated!r}, but torch.distributed is not initialised, so each process would read "
            "everything; call torch.distributed.init_process_group first, or give rank=Rank(number, of)"
        )
    return Rank()


class ShuffledSampler(Sampler[int]):
    """Indices in an order that depends on (seed, epoch); as many for each rank, none twice.

    Fewer indices than there are ranks are left out, others each epoch.
    """

    def __init__(self, length: int, *, seed: int, rank: Rank) -> None:
        self.length = length
        self.seed = seed
        self.rank = rank
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose order the next iteration has."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.length // self.rank.of

    def __iter__(self) -> Iterator[int]:
        sequence = np.random.SeedSequence((self.seed, self.epoch), spawn_key=(_ORDER,))
        order = np.random.default_rng(sequence).permutation(self.length)
        yield from order[self.rank.number :: self.rank.of][: len(self)].tolist()


class ExactSampler(Sampler[int]):
    """Every index exactly once over all ranks, in order: rank r of n has r, r + n, r + 2n, ...

    Ranks may differ by one.
    """

    def __init__(self, length: int, *, rank: Rank) -> None:
        self.length = length
        self.rank = rank

    def __len__(self) -> int:
        return len(range(self.rank.number, self.length, self.rank.of))

    def __iter__(self) -> Iterator[int]:
        yield from range(self.rank.number, self.length, self.rank.of)


@runtime_checkable
class SelfSplitting(Protocol):
    """An iterable dataset that splits itself over ranks and workers, such as eldata.streaming.StreamedPairs."""

    sample_bytes: int
    buffer_bytes: int

    def for_training(self, batch_size: int, rank: Rank) -> Any:
        """Return the dataset shuffled, with as many items on every rank."""

    def for_evaluation(self, batch_size: int, rank: Rank) -> Any:
        """Return the dataset in order, with each item exactly once over all ranks."""

    def __len__(self) -> int:
        """Return the number of items of this rank."""


@dataclass(frozen=True, slots=True)
class _Known:
    """What is remembered of a loader that was made here."""

    seed: int
    rank: Rank
    why: tuple[str, ...]


_KNOWN: WeakKeyDictionary[DataLoader[Any], _Known] = WeakKeyDictionary()


def training_loader(
    dataset: Dataset[Any],
    batch_size: int,
    *,
    workers: int | None = None,
    seed: int = 0,
    device: torch.device | str | None = None,
    prefetch: int = 2,
    start_method: StartMethod = "forkserver",
    collate: Callable[[list[Any]], Any] | None = None,
    rank: Rank | None = None,
) -> DataLoader[Any]:
    """Return a DataLoader for training: shuffled anew each epoch, as many whole batches on every rank.

    Call :func:`set_epoch` before each epoch. :func:`describe` says what was chosen, and why.

    Parameters
    ----------
    dataset
        One with ``len`` and indices, or an iterable one that splits itself (eldata.streaming.StreamedPairs). Items
        are to depend on (seed, epoch, index) alone, as those of this package do.
    batch_size
        Items a batch; the last batch is dropped if it is smaller.
    workers
        Number of worker processes; 0 reads in this process; ``None`` chooses by CPUs and memory, for which one item is
        read.
    seed
        Of the order (a stream has a seed of its own) and of the random numbers that a transform of yours may draw in a
        worker from torch, numpy or random.
    device
        Where batches will go: they are put into pinned memory if it is a CUDA device (``None``: if CUDA is there).
    prefetch
        Batches that each worker reads ahead.
    start_method
        How workers start. ``"forkserver"``: from a clean process that has the libraries loaded. ``"spawn"``: from
        nothing, in seconds. ``"fork"``: copies of this process, which hang if a library's threads hold a lock.
    collate
        In place of torch's default collate.
    rank
        Which process of how many this is; ``None`` asks torch.distributed.

    Raises
    ------
    ArgumentError
        If an argument is out of its range, the dataset cannot be sent to workers or be split, or no whole batch is
        there; or if ``WORLD_SIZE`` is above 1 without torch.distributed.
    """
    rank = current_rank() if rank is None else rank
    _check(batch_size, seed, prefetch, start_method)
    if isinstance(dataset, IterableDataset):
        dataset = _self_splitting(dataset).for_training(batch_size, rank)
        sampler, items = None, len(dataset)  # type: ignore[arg-type] # it has a length, by its protocol
    else:
        sampler = ShuffledSampler(_length(dataset), seed=seed, rank=rank)
        items = len(sampler)
    if items < batch_size:
        raise ArgumentError(
            f"{items} items for rank {rank.number} of {rank.of} are no whole batch of {batch_size}; take a smaller "
            "batch_size, or more crops per frame"
        )
    told = [
        f"training: {items} items in {items // batch_size} batches of {batch_size}, shuffled by (seed, epoch)"
        + (f", {items % batch_size} left over in the last batch dropped" if items % batch_size else ""),
        "ranks: one process"
        if rank.of == 1
        else f"ranks: number {rank.number} of {rank.of}; as many items on each, none twice; at most {rank.of - 1} "
        "items left out, others each epoch",
    ]
    settings = _settings(dataset, batch_size, workers, device, prefetch, start_method, rank, told)
    if settings["num_workers"] > 0:
        told.append("workers stay for the next epochs (persistent_workers)")
        settings["persistent_workers"] = True
    return _loader(dataset, batch_size, sampler, settings, collate, _Known(seed, rank, tuple(told)), drop_last=True)


def evaluation_loader(
    dataset: Dataset[Any],
    batch_size: int = 1,
    *,
    workers: int | None = None,
    seed: int = 0,
    device: torch.device | str | None = None,
    prefetch: int = 2,
    start_method: StartMethod = "forkserver",
    collate: Callable[[list[Any]], Any] | None = None,
    rank: Rank | None = None,
) -> DataLoader[Any]:
    """Return a DataLoader for validation and evaluation: each item exactly once over all ranks, in order.

    Several workers of a stream give the batches of their parts in turn. Ranks may get unequal numbers of batches:
    gather their results afterwards, and do not synchronise batch by batch. Parameters and errors are those of
    :func:`training_loader`; but the last batch may be smaller, and a rank may have none.
    """
    rank = current_rank() if rank is None else rank
    _check(batch_size, seed, prefetch, start_method)
    order = "in order"
    if isinstance(dataset, IterableDataset):
        dataset = _self_splitting(dataset).for_evaluation(batch_size, rank)
        sampler, items = None, len(dataset)  # type: ignore[arg-type] # as above
        order = "in the order of the shards, the workers' batches in turn"
    else:
        sampler = ExactSampler(_length(dataset), rank=rank)
        items = len(sampler)
    told = [
        f"evaluation: {items} items in {-(-items // batch_size)} batches of up to {batch_size}, {order}",
        "ranks: one process"
        if rank.of == 1
        else f"ranks: number {rank.number} of {rank.of}; every item exactly once over all of them, so they may differ "
        "by one batch",
    ]
    settings = _settings(dataset, batch_size, workers, device, prefetch, start_method, rank, told)
    if settings["num_workers"] > 0:
        told.append("workers end with each pass, which gives their memory back")
    return _loader(dataset, batch_size, sampler, settings, collate, _Known(seed, rank, tuple(told)), drop_last=False)


def describe(loader: DataLoader[Any]) -> str:
    """Return what was chosen for a loader, and why, one setting a line.

    Raises
    ------
    ArgumentError
        If the loader was not made here.
    """
    return "\n".join(_known(loader).why)


def set_epoch(loader: DataLoader[Any], epoch: int) -> None:
    """Choose the epoch that the next iteration over a loader gives: its order, its items' crops and noise.

    The same call after a restart goes on with that epoch.

    Raises
    ------
    ArgumentError
        If the loader was not made here, or the epoch is negative.
    """
    known = _known(loader)
    if epoch < 0:
        raise ArgumentError(f"epoch must be 0 or more; found {epoch}")
    if isinstance(loader.sampler, ShuffledSampler):
        loader.sampler.set_epoch(epoch)
    for part in _parts(loader.dataset):
        if callable(getattr(part, "set_epoch", None)):
            part.set_epoch(epoch)
    if loader.generator is not None:
        loader.generator.manual_seed(_worker_seed(known.seed, epoch, known.rank))


def _parts(dataset: Any) -> Iterator[Any]:
    """Yield a dataset and those that it wraps, as Subset, ConcatDataset and DnPairs do."""
    yield dataset
    inner = [getattr(dataset, name) for name in ("dataset", "pairs") if hasattr(dataset, name)]
    for part in [*inner, *getattr(dataset, "datasets", ())]:
        yield from _parts(part)


def _known(loader: DataLoader[Any]) -> _Known:
    known = _KNOWN.get(loader)
    if known is None:
        raise ArgumentError("expected a loader from training_loader or evaluation_loader, found another DataLoader")
    return known


# --- building -----------------------------------------------------------------------------------------------------


def _check(batch_size: int, seed: int, prefetch: int, start_method: StartMethod) -> None:
    if batch_size < 1 or prefetch < 1:
        raise ArgumentError(f"batch_size and prefetch must be 1 or more; found {batch_size}, {prefetch}")
    if seed < 0:
        raise ArgumentError(f"seed must be 0 or more; found {seed}")
    check_choice("start_method", start_method, START_METHODS)
    if start_method not in multiprocessing.get_all_start_methods():
        raise ArgumentError(f"this system has no start method {start_method!r}; take 'spawn'")


def _self_splitting(dataset: IterableDataset[Any]) -> SelfSplitting:
    if not isinstance(dataset, SelfSplitting):
        raise ArgumentError(
            f"{type(dataset).__name__} is an iterable dataset that does not split itself over ranks and workers, so "
            "each would give every item; expected StreamedPairs, or a dataset with len and indices"
        )
    return dataset


def _length(dataset: Any) -> int:
    if not hasattr(dataset, "__len__") or not hasattr(dataset, "__getitem__"):
        raise ArgumentError(f"expected a dataset with len and indices; found {type(dataset).__name__}")
    length = len(dataset)
    if length == 0:
        raise ArgumentError(f"{type(dataset).__name__} holds no items")
    return length


def _settings(
    dataset: Any,
    batch_size: int,
    workers: int | None,
    device: torch.device | str | None,
    prefetch: int,
    start_method: StartMethod,
    rank: Rank,
    told: list[str],
) -> dict[str, Any]:
    """Return the DataLoader's settings of workers and memory; the reasons are added to ``told``."""
    if workers is None:
        held = dataset.buffer_bytes if isinstance(dataset, SelfSplitting) else 0
        count, why = chosen_workers(_sample_bytes(dataset) * batch_size, prefetch, start_method, rank, held_bytes=held)
        told.append(f"workers: {count} ({why})")
    elif workers < 0:
        raise ArgumentError(f"workers must be 0 or more; found {workers}")
    else:
        count = workers
        told.append(f"workers: {count} (as asked)")
    settings: dict[str, Any] = {"num_workers": count}
    if count > 0:
        _check_can_be_sent(dataset, start_method)
        settings |= {"multiprocessing_context": _context(start_method), "prefetch_factor": prefetch}
        told.append(f"start method: {start_method} ({_WHY[start_method]})")
        told.append(f"read ahead: {prefetch} batches a worker")
    settings["pin_memory"], why = _pinned(device)
    told.append(f"pinned memory: {why}")
    return settings


_WHY: dict[StartMethod, str] = {
    "forkserver": "workers come from a clean process that has the libraries loaded: no lock or thread of this one is "
    "copied, and they start fast",
    "spawn": "workers start from nothing, and load the libraries each",
    "fork": "as asked; workers are copies of this process, and hang if a thread of a library holds a lock",
}


def _loader(
    dataset: Any,
    batch_size: int,
    sampler: Sampler[int] | None,
    settings: dict[str, Any],
    collate: Callable[[list[Any]], Any] | None,
    known: _Known,
    *,
    drop_last: bool,
) -> DataLoader[Any]:
    generator = torch.Generator()
    generator.manual_seed(_worker_seed(known.seed, 0, known.rank))
    loader: DataLoader[Any] = DataLoader(
        dataset,
        batch_size=batch_size,
        sampler=sampler,
        drop_last=drop_last,
        collate_fn=collate,
        generator=generator,  # torch seeds the workers' random numbers from it
        **settings,
    )
    _KNOWN[loader] = known
    return loader


def _worker_seed(seed: int, epoch: int, rank: Rank) -> int:
    """Return the seed of the generator from which torch seeds its workers' torch, numpy and random."""
    sequence = np.random.SeedSequence((seed, epoch), spawn_key=(_WORKERS, rank.number))
    return int(sequence.generate_state(1, np.uint64)[0] >> 1)  # torch takes it as a signed number


def _context(start_method: StartMethod) -> BaseContext:
    context = multiprocessing.get_context(start_method)
    if start_method == "forkserver":
        # Not __main__: what a script imports may start threads, which the server must not have as it forks.
        context.set_forkserver_preload(list(_PRELOADED))
    return context


class _Nowhere:
    """A file that keeps nothing."""

    def write(self, data: Any) -> int:
        return len(data)


def _check_can_be_sent(dataset: Any, start_method: StartMethod) -> None:
    if start_method == "fork":
        return
    advice = "define what it holds at the top of a module, or give start_method='fork' or workers=0"
    if type(dataset).__module__ == "__main__" and not hasattr(sys.modules["__main__"], "__file__"):
        raise ArgumentError(
            f"{type(dataset).__name__} is defined in an interactive session, which workers cannot import; {advice}"
        )
    try:
        pickle.Pickler(_Nowhere()).dump(dataset)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ArgumentError(f"{type(dataset).__name__} cannot be sent to workers ({error}); {advice}") from error


def _pinned(device: torch.device | str | None) -> tuple[bool, str]:
    if not torch.cuda.is_available():
        return False, "no (CUDA is not there)"
    if device is not None and torch.device(device).type != "cuda":
        return False, f"no (batches go to {device})"
    return True, "yes (CUDA copies from it while the network runs: batch.to(device, non_blocking=True))"


# --- how many workers ---------------------------------------------------------------------------------------------


def chosen_workers(
    batch_bytes: int, prefetch: int, start_method: StartMethod, rank: Rank, *, held_bytes: int = 0
) -> tuple[int, str]:
    """Return a number of workers and the reasons: CPUs, memory and shared memory, shared by the ranks of this machine.

    Parameters
    ----------
    batch_bytes
        Size of a batch; 0 if it is not known.
    prefetch
        Batches that each worker reads ahead.
    start_method
        Workers that share pages of libraries need less memory.
    rank
        For the number of ranks, if the environment does not state how many of them run here.
    held_bytes
        What the dataset holds in each worker beside its batches.
    """
    here = _ranks_here(rank)
    cpus = usable_cpus()
    count = max(1, cpus // here - 1)
    reasons = [
        f"{cpus} CPUs usable" + (f" by {here} ranks, one of each" if here > 1 else ", one") + " left to training"
    ]
    if count > _MOST_WORKERS:
        count = _MOST_WORKERS
        reasons.append(f"more than {_MOST_WORKERS} bring little")
    ahead = prefetch * batch_bytes
    for what, free, share, each in (
        ("memory", available_memory_bytes(), _MEMORY_SHARE, _WORKER_BYTES[start_method] + held_bytes + ahead),
        ("shared memory (/dev/shm)", shared_memory_bytes(), 1.0, ahead),
    ):
        if free is None:
            reasons.append(f"{what} not known")
            continue
        most = int(share * free / here // each) if each else count
        reasons.append(f"{what} for {most}" if most < 1000 else f"{what} for any number")
        count = min(count, most)
    reasons.append(f"{batch_bytes / 1e6:.1f} MB a batch" if batch_bytes else "size of a batch not known")
    if held_bytes:
        reasons.append(f"{held_bytes / 1e6:.1f} MB a worker holds to shuffle")
    return count, "; ".join(reasons)


def usable_cpus() -> int:
    """Return how many CPUs this process may use: its affinity, and the quota of its control group."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota, _, period = _first_line(_CGROUP / "cpu.max").partition(" ")
    if quota.isdecimal() and period.isdecimal() and int(period) > 0:
        cpus = min(cpus, max(1, int(quota) // int(period)))
    return cpus


def available_memory_bytes() -> int | None:
    """Return the memory that is free to use, the limit of the control group included; ``None`` if not known."""
    found: list[int] = []
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        lines = []
    found += [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    limit, used = (_first_line(_CGROUP / f"memory.{name}") for name in ("max", "current"))
    if limit.isdecimal() and used.isdecimal():
        found.append(max(0, int(limit) - int(used)))
    return min(found, default=None)


def shared_memory_bytes() -> int | None:
    """Return the room in ``/dev/shm``, through which workers send batches; ``None`` if there is none."""
    try:
        there = os.statvfs("/dev/shm")  # noqa: S108 # the place itself is asked for
    except (OSError, AttributeError):
        return None
    return there.f_bavail * there.f_frsize


_CGROUP = Path("/sys/fs/cgroup")


def _first_line(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _ranks_here(rank: Rank) -> int:
    stated = os.environ.get("LOCAL_WORLD_SIZE", "")  # torchrun's
    return int(stated) if stated.isdecimal() and int(stated) > 0 else rank.of


def _sample_bytes(dataset: Any) -> int:
    """Return the size of an item's tensors and arrays: of the first one, unless the dataset says it."""
    stated = getattr(dataset, "sample_bytes", None)
    return stated if isinstance(stated, int) else _nbytes(dataset[0])


def _nbytes(item: Any) -> int:
    if isinstance(item, (torch.Tensor, np.ndarray)):
        return int(item.nbytes)
    if isinstance(item, dict):
        return sum(map(_nbytes, item.values()))
    return sum(map(_nbytes, item)) if isinstance(item, (list, tuple)) else 0
