"""Which of several training processes this is, and which items it gets."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.utils.data import Sampler

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

    Fewer indices than there are ranks are left out, others each epoch.
    """

    def __init__(self, length: int, *, seed: int, rank: Rank) -> None:
        self.length = length
        self.seed = seed
        self.rank = rank
        self.epoch = 0
        self.first = 0

    def set_epoch(self, epoch: int, first: int = 0) -> None:
        """Choose the epoch whose order the next iteration has, and from which of this rank's indices it goes on."""
        self.epoch, self.first = epoch, first

    def __len__(self) -> int:
        return self.length // self.rank.of

    def __iter__(self) -> Iterator[int]:
        sequence = purpose_sequence(self.seed, self.epoch, _ORDER)
        order = np.random.default_rng(sequence).permutation(self.length)
        yield from order[self.rank.number :: self.rank.of][self.first : len(self)].tolist()
