"""Which of several training processes this is, which items it gets, and by how many workers it reads them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import torch
from torch.utils.data import Sampler

from eldata.base.compiled import available_threads
from eldata.base.seeds import purpose_sequence
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Iterator

# Keeps these random numbers apart from those of the items, (seed, epoch, index), and of workers (loading.py).
_ORDER = 1


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
    there are ranks are left out, others each epoch.
    """

    def __init__(self, length: int, *, seed: int, rank: Rank) -> None:
        self.length = length
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
        order = np.random.default_rng(sequence).permutation(self.length)
        yield from order[self.rank.number :: self.rank.of][self.first : len(self)].tolist()


StartMethod = Literal["forkserver", "spawn", "fork"]
START_METHODS: tuple[StartMethod, ...] = get_args(StartMethod)

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
    here = _ranks_here(rank)
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
    """Return how many CPUs this process may use: its affinity, and the quota of its control group."""
    cpus = available_threads()
    quota, _, period = _text(_CGROUP / "cpu.max").partition(" ")
    if quota.isdecimal() and period.isdecimal() and int(period) > 0:
        cpus = min(cpus, max(1, int(quota) // int(period)))
    return cpus


def available_memory_bytes() -> int | None:
    """Return the memory that is free to use, the limit of the control group included; ``None`` if not known."""
    lines = _text(Path("/proc/meminfo")).splitlines()
    found = [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    limit, used = (_text(_CGROUP / f"memory.{name}") for name in ("max", "current"))
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


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _ranks_here(rank: Rank) -> int:
    stated = os.environ.get("LOCAL_WORLD_SIZE", "")  # torchrun's
    return int(stated) if stated.isdecimal() and int(stated) > 0 else rank.of
