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
import threading
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset, Sampler

from eldata.base.numbers import available_cpus, checked_whole
from eldata.base.seeds import checked_epoch, checked_seed, purpose_sequence
from eldata.base.workers import require_main_guard
from eldata.datasets.items import keep_counts
from eldata.errors import ArgumentError, check_choice

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

# Keep these random numbers apart from each other and from the items', (seed, epoch, index).
_ORDER, _WORKERS = 1, 2


StartMethod = Literal["forkserver", "spawn", "fork"]
_Near = tuple["NDArray[np.int64] | None", int]


def training_loader(
    dataset: Dataset[Any],
    batch_size: int,
    *,
    num_workers: int | None = None, seed: int = 0, device: torch.device | str | None = None, prefetch: int = 2,
    start_method: StartMethod = "forkserver", collate: Callable[[list[Any]], Any] | None = None,
    rank: Rank | None = None, records_at_a_time: int | None = None,
) -> DataLoader[Any]:  # fmt: skip
    """Return a DataLoader for training: shuffled again each epoch, as many whole batches on every rank.

    Several ranks call :func:`set_epoch` before each epoch, and who wants to go on later to the bit; else each pass goes
    on by itself. :func:`describe` says what was chosen, and why.

    Parameters
    ----------
    dataset
        One with ``len`` and indices. Its items should depend on (seed, draw, index) alone, as this package's do.
    batch_size
        Items per batch; the last batch is dropped if it is smaller.
    num_workers
        Number of worker processes; 0 reads in this process; ``None`` chooses by CPUs and memory, for which one item is
        read.
    seed
        Of the order, and of the random numbers that a transform of yours may draw in a worker from torch, numpy or
        random.
    device
        Where batches will go: they are put into pinned memory if it is a CUDA device (``None``: if CUDA is there).
    prefetch
        Batches that each worker reads ahead.
    start_method
        How workers start. ``"forkserver"``: from a clean process that has the libraries loaded. ``"spawn"``: from
        nothing, in seconds. ``"fork"``: copies of this process, which hang if a library's threads hold a lock.
    collate
        Instead of torch's default collate.
    rank
        Which process of how many this is; ``None`` asks torch.distributed.
    records_at_a_time
        Shuffle the records, and then the crops of so many at a time, for frames that are decoded; ``None``: all crops.

    Raises
    ------
    ArgumentError
        If an argument is out of its range, the dataset cannot be sent to workers, or no whole batch is there;
        or if ``WORLD_SIZE`` is above 1 without torch.distributed.

    Examples
    --------
    >>> from eldata import PackedStore
    >>> from eldata.datasets import training_loader
    >>> loader = training_loader(PackedStore("demo.h5", crop=64, seed=0), 4, num_workers=0)
    >>> len(loader), next(iter(loader))["input"].shape
    (6, torch.Size([4, 4, 64, 64]))
    """
    reading = num_workers, prefetch, start_method, device
    numbers = None if records_at_a_time is None else getattr(dataset, "record_numbers", None)
    if records_at_a_time is not None and (numbers is None or records_at_a_time < 1):
        raise ArgumentError(f"records_at_a_time must be 1 or more, of crops of records; found {records_at_a_time}")
    near = numbers, records_at_a_time or 1
    return _Loader(dataset, batch_size, reading, seed, rank, collate, near, is_training=True)


def evaluation_loader(
    dataset: Dataset[Any],
    batch_size: int = 1,
    *,
    num_workers: int | None = None, seed: int = 0, device: torch.device | str | None = None, prefetch: int = 2,
    start_method: StartMethod = "forkserver", collate: Callable[[list[Any]], Any] | None = None,
    rank: Rank | None = None,
) -> DataLoader[Any]:  # fmt: skip
    """Return a DataLoader for validation and evaluation: each item exactly once over all ranks, in order.

    To score random crops or made noise alike in each pass, call :func:`set_epoch` once. Ranks may get unequal numbers
    of batches: gather their results afterwards, and do not synchronise batch by batch. Parameters and errors are those
    of :func:`training_loader`; but the last batch may be smaller, and a rank may have none.
    """
    reading = num_workers, prefetch, start_method, device
    return _Loader(dataset, batch_size, reading, seed, rank, collate, is_training=False)


def describe(loader: DataLoader[Any]) -> str:
    """Describe the settings of a loader and the reasons for them, one setting per line.

    Raises
    ------
    ArgumentError
        If the loader was not made here.
    """
    return "\n".join(_require_own_loader(loader).why)


def set_epoch(loader: DataLoader[Any], epoch: int, *, first_batch: int = 0) -> None:
    """Fix the epoch that iterations over a loader give: its order, its items' crops and noise.

    The same call after a restart goes on with that epoch, with ``first_batch`` in the middle of it: the batches before
    are not read, and the others are the same. (What a transform draws at random in a worker differs.)

    Raises
    ------
    ArgumentError
        If the loader was not made here, the epoch is not a whole number from 0 up to below 2^32, or there is a first
        batch but the loader is not one for training.
    """
    known = _require_own_loader(loader)
    epoch = checked_epoch(epoch)
    checked_whole("first_batch", first_batch, at_least=0)
    if isinstance(loader.sampler, ShuffledSampler):
        loader.sampler.set_epoch(epoch, first_batch * (loader.batch_size or 1))
    elif first_batch:
        raise ArgumentError(f"first_batch={first_batch}: only a training loader can begin there")
    for part in _parts(loader.dataset):
        if callable(getattr(part, "set_epoch", None)):
            part.set_epoch(epoch)
    known.seed_workers(epoch)


def _parts(dataset: Any) -> Iterator[Any]:
    """Yield a dataset and those that it wraps, as Subset, ConcatDataset and StagedPairs do."""
    yield dataset
    inner = [getattr(dataset, name) for name in ("dataset", "pairs") if hasattr(dataset, name)]
    for part in [*inner, *getattr(dataset, "datasets", ())]:
        yield from _parts(part)


def _require_own_loader(loader: DataLoader[Any]) -> _Loader:
    """Refuse a DataLoader that this module did not make."""
    if not isinstance(loader, _Loader):
        raise ArgumentError("expected a loader from training_loader or evaluation_loader, found another DataLoader")
    return loader


# --- building -----------------------------------------------------------------------------------------------------


_Reading = tuple["int | None", int, StartMethod, "torch.device | str | None"]
"""How batches are read: workers, prefetch, start method and device, as of :func:`training_loader`."""


class _Loader(DataLoader[Any]):
    """A DataLoader with the reasons for its settings; ``seed`` and ``rank`` decide its order."""

    def __init__(
        self, dataset: Any, batch_size: int, reading: _Reading, seed: int, rank: Rank | None,
        collate: Callable[[list[Any]], Any] | None, near: _Near = (None, 1), *, is_training: bool,
    ) -> None:  # fmt: skip
        _, prefetch, start_method, _ = reading
        if batch_size < 1 or prefetch < 1:
            raise ArgumentError(f"batch_size and prefetch must be 1 or more; found {batch_size}, {prefetch}")
        self.seed = checked_seed(seed)
        check_choice("start_method", start_method, get_args(StartMethod))
        if start_method not in multiprocessing.get_all_start_methods():
            raise ArgumentError(f"this system has no start method {start_method!r}; take 'spawn'")
        self.rank = rank = rank or current_rank()
        length = _count_items(dataset)
        sampler: Any = range(rank.number, length, rank.of)
        if is_training:
            sampler = ShuffledSampler(length, seed=self.seed, rank=rank, near=near)
        items = len(sampler)
        if is_training:
            if items < batch_size:
                raise ArgumentError(
                    f"{items} items for rank {rank.number} of {rank.of} do not fill a batch of {batch_size}; take a "
                    "smaller batch_size, or more crops per frame"
                )
            left = items % batch_size
            reasons = [
                f"training: {items} items in {items // batch_size} batches of {batch_size}, shuffled by (seed, epoch)"
                + (f", {left} left over in the last batch dropped" if left else "")
            ]
            promise = f"as many items on each, none twice; at most {rank.of - 1} items left out, others each epoch"
            stay = "workers stay for the next epochs (persistent_workers)"
        else:
            batches = -(-items // batch_size)
            reasons = [f"evaluation: {items} items in {batches} batches of up to {batch_size}, in order"]
            promise = "every item exactly once over all of them, so they may differ by one batch"
            stay = "workers end with each pass, which gives their memory back"
        reasons.append("ranks: one process" if rank.of == 1 else f"ranks: number {rank.number} of {rank.of}; {promise}")
        settings = _choose_settings(dataset, batch_size, reading, rank, reasons)
        if settings["num_workers"] > 0:
            reasons.append(stay)
        self.why = tuple(reasons)
        super().__init__(
            dataset,
            batch_size=batch_size,
            sampler=sampler,
            drop_last=is_training,
            collate_fn=collate,
            generator=torch.Generator(),  # torch seeds the workers' random numbers from it
            persistent_workers=is_training and settings["num_workers"] > 0,
            worker_init_fn=_end_with_parent,
            **settings,
        )
        self.seed_workers(0)

    def __iter__(self) -> Any:
        if self.num_workers and self.multiprocessing_context.get_start_method() != "fork":
            require_main_guard()
        return super().__iter__()

    def seed_workers(self, epoch: int) -> None:
        """Seed the generator from which torch seeds its workers' torch, numpy and random."""
        sequence = purpose_sequence(self.seed, epoch, _WORKERS, self.rank.number)
        self.generator.manual_seed(int(sequence.generate_state(1, np.uint64)[0] >> 1))  # torch takes a signed number


def _end_with_parent(_: int) -> None:
    """End this worker with the process that reads from it, even if that is killed.

    torch's own look at the parent sees the server that the worker was forked from, which lives as long as its workers.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(sentinel: int) -> None:
    """Wait until a process ends, by its sentinel; then end this one."""
    connection.wait([sentinel])
    os._exit(1)


def _count_items(dataset: Any) -> int:
    """Count a dataset's items; refuse a dataset without indices, or empty."""
    has_both = hasattr(dataset, "__len__") and hasattr(dataset, "__getitem__")
    if isinstance(dataset, IterableDataset) or not has_both:
        raise ArgumentError(f"expected a dataset with len and indices; found {type(dataset).__name__}")
    length = len(dataset)
    if length == 0:
        raise ArgumentError(f"{type(dataset).__name__} holds no items")
    return length


def _choose_settings(
    dataset: Any, batch_size: int, reading: _Reading, rank: Rank, reasons: list[str]
) -> dict[str, Any]:
    """Return the DataLoader's settings of workers and memory; the reasons are added to ``reasons``."""
    workers, prefetch, start_method, device = reading
    if workers is None:
        with keep_counts():
            nbytes = _nbytes(dataset[0])
        count, why = loader_workers(nbytes * batch_size, prefetch, start_method, rank)
        reasons.append(f"workers: {count} ({why})")
    elif workers < 0:
        raise ArgumentError(f"num_workers must be 0 or more; found {workers}")
    else:
        count = workers
        reasons.append(f"workers: {count} (as asked)")
    settings: dict[str, Any] = {"num_workers": count}
    if count > 0:
        _check_can_be_sent(dataset, start_method)
        context = multiprocessing.get_context(start_method)
        if start_method == "forkserver":
            # Imported once by the server that workers are forked from, for it would take seconds in each worker.
            # Not __main__: what a script imports may start threads, which the server must not have as it forks.
            context.set_forkserver_preload(["eldata.datasets._preloaded"])
        settings |= {"multiprocessing_context": context, "prefetch_factor": prefetch}
        reasons.append(f"start method: {start_method} ({_WHY[start_method]})")
        reasons.append(f"read ahead: {prefetch} batches a worker")
    settings["pin_memory"], why = _choose_pinning(device)
    reasons.append(f"pinned memory: {why}")
    return settings


_WHY: dict[StartMethod, str] = {
    "forkserver": "workers come from a clean process that has the libraries loaded: no lock or thread of this one is "
    "copied, and they start fast",
    "spawn": "workers start from nothing, and load the libraries each",
    "fork": "as asked; workers are copies of this process, and hang if a thread of a library holds a lock",
}


def _check_can_be_sent(dataset: Any, start_method: StartMethod) -> None:
    """Refuse a dataset that cannot be pickled for worker processes."""
    if start_method == "fork":
        return
    advice = "define what it holds at the top of a module, or give start_method='fork' or num_workers=0"
    if type(dataset).__module__ == "__main__" and not hasattr(sys.modules["__main__"], "__file__"):
        raise ArgumentError(
            f"{type(dataset).__name__} is defined in an interactive session, which workers cannot import; {advice}"
        )
    try:
        with Path(os.devnull).open("wb") as nowhere:
            pickle.dump(dataset, nowhere)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ArgumentError(f"{type(dataset).__name__} cannot be sent to workers ({error}); {advice}") from error


def _choose_pinning(device: torch.device | str | None) -> tuple[bool, str]:
    """Choose whether batches lie in pinned memory, and give the reason."""
    if not torch.cuda.is_available():
        return False, "no (CUDA is not there)"
    if device is not None and torch.device(device).type != "cuda":
        return False, f"no (batches go to {device})"
    return True, "yes (CUDA copies from it while the network runs: batch.to(device, non_blocking=True))"


def _nbytes(item: Any) -> int:
    """Return the size of an item's tensors and arrays."""
    if isinstance(item, (torch.Tensor, np.ndarray)):
        return int(item.nbytes)
    if isinstance(item, dict):
        return sum(map(_nbytes, item.values()))
    return sum(map(_nbytes, item)) if isinstance(item, (list, tuple)) else 0


# --- which of several processes this is, and how many workers it gets -----------------------------------------------


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

    The k-th iteration has the order of epoch k, from 0 on, unless :meth:`set_epoch` was called. Fewer indices than
    there are ranks are left out, others each epoch. ``near``: the record of each, of which so many are mixed.
    """

    def __init__(self, length: int, *, seed: int, rank: Rank, near: _Near = (None, 1)) -> None:
        self.length = length
        self.near = near
        self.seed = seed
        self.rank = rank
        self.epoch: int | None = None
        self.first = 0
        self._passes = 0

    def set_epoch(self, epoch: int, first: int = 0) -> None:
        """Fix the epoch whose order iterations have, and from which of this rank's indices they go on."""
        self.epoch, self.first = epoch, first

    def __len__(self) -> int:
        return self.length // self.rank.of

    def __iter__(self) -> Iterator[int]:
        epoch = self._passes if self.epoch is None else self.epoch
        self._passes += 1
        sequence = purpose_sequence(self.seed, epoch, _ORDER)
        generator, (records, at_a_time) = np.random.default_rng(sequence), self.near
        order = generator.permutation(self.length)
        if records is not None:
            turn = generator.permutation(records.max() + 1)[records] // at_a_time
            order = order[np.argsort(turn[order], kind="stable")]
        yield from order[self.rank.number :: self.rank.of][self.first : len(self)].tolist()


# What a worker adds to the memory in use beside its batches: measured with PackedStore, docs/training.md has the
# figures. With fork and forkserver, pages of the libraries are shared with the process that it comes from.
_WORKER_BYTES: dict[StartMethod, int] = {"forkserver": 100_000_000, "spawn": 300_000_000, "fork": 100_000_000}
# Half of the memory is left to the model, the page cache and everybody else.
_MEMORY_SHARE = 0.5
# A worker reads hundreds of crops a second; more than this many cost more in starting and memory than they bring.
_MOST_WORKERS = 16


def loader_workers(batch_bytes: int, prefetch: int, start_method: StartMethod, rank: Rank) -> tuple[int, str]:
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
    """
    stated = os.environ.get("LOCAL_WORLD_SIZE", "")  # torchrun's
    here = int(stated) if stated.isdecimal() and int(stated) > 0 else rank.of
    cpus = usable_cpus()
    count = max(1, cpus // here - 1)
    left = f" by {here} ranks, one of each" if here > 1 else ", one"
    reasons = [f"{cpus} CPUs usable{left} left to training"]
    if count > _MOST_WORKERS:
        count = _MOST_WORKERS
        reasons.append(f"more than {_MOST_WORKERS} bring little")
    ahead = prefetch * batch_bytes
    for what, free, share, each in (
        ("memory", available_memory_bytes(), _MEMORY_SHARE, _WORKER_BYTES[start_method] + ahead),
        ("shared memory (/dev/shm)", shared_memory_bytes(), 1.0, ahead),
    ):
        if free is None:
            reasons.append(f"{what} not known")
            continue
        most = int(share * free / here // each) if each else count
        reasons.append(f"{what} for {most}" if most < 1000 else f"{what} for any number")
        count = min(count, most)
    reasons.append(f"{batch_bytes / 1e6:.1f} MB a batch" if batch_bytes else "size of a batch not known")
    return count, "; ".join(reasons)


def usable_cpus() -> int:
    """Count the CPUs that this process may use: its affinity, and the quota of its control group."""
    cpus = available_cpus()
    quota, _, period = _read_text(_CGROUP / "cpu.max").partition(" ")
    if quota.isdecimal() and period.isdecimal() and int(period) > 0:
        cpus = min(cpus, max(1, int(quota) // int(period)))
    return cpus


def available_memory_bytes() -> int | None:
    """Return the memory that is free to use, the limit of the control group included; ``None`` if not known."""
    lines = _read_text(Path("/proc/meminfo")).splitlines()
    found = [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    limit, used = (_read_text(_CGROUP / f"memory.{name}") for name in ("max", "current"))
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


def _read_text(path: Path) -> str:
    """Read a file of the system, such as a limit of a control group; empty if it cannot be read."""
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""
