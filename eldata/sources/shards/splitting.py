"""Who reads what, and in which order: an epoch's samples, split over ranks and workers without overlap or loss.

Shards are not dealt out whole, for then ranks and workers get unequal parts, or none where there are fewer shards than
workers. The epoch's samples are one sequence, and each reader gets a part of it, which may begin in the middle of a
shard. All is integer arithmetic on lengths: no reader has to know what another one does.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Run:
    """Neighbouring samples of one shard: from ``first`` up to below ``last``."""

    shard: int
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first


def exact_part(total: int, part: int, parts: int) -> range:
    """Return one of several parts that are all of it together; their lengths differ by one at most."""
    return range(total * part // parts, total * (part + 1) // parts)


def even_part(total: int, part: int, parts: int) -> range:
    """Return one of several parts of the same length; fewer than ``parts`` at the end are in none of them."""
    length = total // parts
    return range(part * length, (part + 1) * length)


def worker_part(items: range, worker: int, workers: int, batch_size: int) -> range:
    """Return a worker's part of a rank's items, in whole batches: at most one batch of a rank is smaller."""
    batches = exact_part(-(-len(items) // batch_size), worker, workers)
    first, last = items.start + batches.start * batch_size, items.start + batches.stop * batch_size
    return range(min(first, items.stop), min(last, items.stop))


def turns(batches: Sequence[int], given: int) -> list[tuple[int, int]]:
    """Return the workers in the order of their turns after so many batches of a rank, each with its share of them.

    A DataLoader asks its workers for a batch in turn, from the first one on, and passes over those that have no more.
    Where one goes on, its first worker takes the place of the one whose turn it was, and so on.

    Parameters
    ----------
    batches
        Of each worker's part (:func:`worker_part`): they differ by one at most.
    given
        How many batches were given out.
    """
    least, workers = min(batches), len(batches)
    rounds, turn = divmod(given, workers)
    if rounds >= least:  # the last round is of those that have one batch more
        last = [worker for worker, count in enumerate(batches) if count > least]
        rounds, turn = least, [*last, workers][min(given - least * workers, len(last))]
    shares = [min(count, rounds + (worker < turn)) for worker, count in enumerate(batches)]
    return [(place % workers, shares[place % workers]) for place in range(turn, turn + workers)]


def in_order(lengths: Sequence[int]) -> list[Run]:
    """Return all samples in the order of the shards."""
    return [Run(shard, 0, length) for shard, length in enumerate(lengths)]


def shuffled(lengths: Sequence[int], generator: np.random.Generator) -> list[Run]:
    """Return all samples with the shards in a drawn order, beginning at a drawn sample.

    The beginning moves the borders between readers, and with them the few samples that even parts leave out.
    """
    runs = [Run(int(shard), 0, lengths[shard]) for shard in generator.permutation(len(lengths))]
    total = sum(lengths)
    start = int(generator.integers(total))
    return [*cut(runs, range(start, total)), *cut(runs, range(start))]


def cut(runs: Sequence[Run], places: range) -> Iterator[Run]:
    """Yield what lies at some places of a sequence of runs."""
    borders: NDArray[np.int64] = np.cumsum([0, *map(len, runs)])
    for run, (begin, end) in zip(runs, pairwise(borders.tolist()), strict=True):
        first, last = max(begin, places.start), min(end, places.stop)
        if first < last:
            yield Run(run.shard, run.first + first - begin, run.first + last - begin)


def shuffled_through(items: Iterable[Item], size: int, generator: np.random.Generator) -> Iterator[Item]:
    """Yield all items, each time one drawn from a buffer of up to ``size``, which then gets the next.

    An item comes at most ``size - 1`` places early; 1 leaves the order as it is.
    """
    buffer: list[Item] = []
    for item in items:
        buffer.append(item)
        if len(buffer) >= size:
            yield _drawn(buffer, generator)
    while buffer:
        yield _drawn(buffer, generator)


def as_called(read: Iterator[tuple[int, Item]], order: Iterable[int]) -> Iterator[Item]:
    """Yield items as their places come in an order; what is read before its turn waits, and nothing is read ahead."""
    waiting: dict[int, Item] = {}
    for place in order:
        while place not in waiting:
            found, item = next(read)
            waiting[found] = item
        yield waiting.pop(place)


def _drawn(buffer: list[Item], generator: np.random.Generator) -> Item:
    place = int(generator.integers(len(buffer)))
    buffer[place], buffer[-1] = buffer[-1], buffer[place]
    return buffer.pop()
