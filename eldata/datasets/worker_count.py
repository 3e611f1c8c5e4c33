"""How many workers a DataLoader should have on this machine, and why."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from eldata.base.compiled import available_threads

if TYPE_CHECKING:
    from eldata.datasets.ranks import Rank

StartMethod = Literal["forkserver", "spawn", "fork"]
START_METHODS: tuple[StartMethod, ...] = get_args(StartMethod)

# What a worker adds to the memory in use beside its batches: measured with PackedStore, docs/streaming.md has the
# figures. With fork and forkserver, pages of the libraries are shared with the process that it comes from.
_WORKER_BYTES: dict[StartMethod, int] = {"forkserver": 100_000_000, "spawn": 300_000_000, "fork": 100_000_000}
# Half of the memory is left to the model, the page cache and everybody else.
_MEMORY_SHARE = 0.5
# A worker reads hundreds of crops a second; more than this many cost more in starting and memory than they bring.
_MOST_WORKERS = 16


def loader_workers(
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
