"""Splitting and shuffling as arithmetic: for any numbers, each item exactly once."""

from __future__ import annotations

from collections import Counter
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eldata.datasets import streamed_pairs as splitting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.datasets.streamed_pairs import Run

LENGTHS = st.lists(st.integers(1, 9), min_size=1, max_size=8)


@given(total=st.integers(0, 100), ranks=st.integers(1, 9), workers=st.integers(1, 9), batch_size=st.integers(1, 8))
def test_each_place_goes_to_exactly_one_worker_of_one_rank(
    total: int, ranks: int, workers: int, batch_size: int
) -> None:
    """Also where there are fewer items than workers. At most one batch of a rank is smaller than the others."""
    got = []
    for rank in range(ranks):
        items = splitting.exact_part(total, rank, ranks)
        parts = [splitting.worker_part(items, worker, workers, batch_size) for worker in range(workers)]
        assert list(chain(*parts)) == list(items)
        assert sum(len(part) % batch_size > 0 for part in parts) <= 1
        assert sum(-(-len(part) // batch_size) for part in parts) == -(-len(items) // batch_size)
        got.append(items)
    assert list(chain(*got)) == list(range(total))
    assert max(map(len, got)) - min(map(len, got)) <= 1


@given(total=st.integers(0, 100), ranks=st.integers(1, 9))
def test_even_parts_are_even_and_leave_out_fewer_than_ranks(total: int, ranks: int) -> None:
    parts = [splitting.even_part(total, rank, ranks) for rank in range(ranks)]
    assert {len(part) for part in parts} == {total // ranks}
    assert list(chain(*parts)) == list(range(total // ranks * ranks))


@given(items=st.integers(0, 60), workers=st.integers(1, 6), batch_size=st.integers(1, 4), data=st.data())
def test_workers_that_go_on_take_the_turns_that_were_theirs(
    items: int, workers: int, batch_size: int, data: st.DataObject
) -> None:
    """The oracle is what a DataLoader does: a batch of each worker in turn, those without any passed over."""

    def in_turn(queues: list[list[tuple[int, int]]]) -> list[tuple[int, int]]:
        longest = max(map(len, queues))
        return [queue[turn] for turn in range(longest) for queue in queues if turn < len(queue)]

    parts = [splitting.worker_part(range(items), worker, workers, batch_size) for worker in range(workers)]
    counts = [len(part) // batch_size for part in parts]
    whole = in_turn([[(worker, batch) for batch in range(count)] for worker, count in enumerate(counts)])
    given = data.draw(st.integers(0, len(whole)))
    turns = splitting.turns(counts, given)
    assert (
        in_turn([[(worker, batch) for batch in range(share, counts[worker])] for worker, share in turns])
        == (whole[given:])
    )
    assert sorted(worker for worker, _ in turns) == list(range(workers))


def test_items_come_as_they_are_called_and_none_is_read_early() -> None:
    taken: list[int] = []

    def read() -> Iterator[tuple[int, str]]:
        for place in range(5):
            taken.append(place)
            yield place, f"item {place}"

    called = splitting.as_called(read(), [2, 0, 1, 4, 3])
    assert (next(called), taken) == ("item 2", [0, 1, 2])
    assert (next(called), next(called), taken) == ("item 0", "item 1", [0, 1, 2])
    assert [*called] == ["item 4", "item 3"]


def samples(runs: list[Run]) -> list[tuple[int, int]]:
    return [(run.shard, sample) for run in runs for sample in range(run.first, run.last)]


@given(lengths=LENGTHS, seed=st.integers(0, 5), data=st.data())
def test_an_epoch_has_each_sample_once_however_it_is_cut(lengths: list[int], seed: int, data: st.DataObject) -> None:
    every = [(shard, sample) for shard, length in enumerate(lengths) for sample in range(length)]
    assert samples(splitting.in_order(lengths)) == every
    runs = splitting.shuffled(lengths, np.random.default_rng(seed))
    assert sorted(samples(runs)) == every
    assert all(len(run) > 0 for run in runs)
    assert len(runs) <= len(lengths) + 1  # one shard is begun in its middle and ended later
    borders = sorted(data.draw(st.lists(st.integers(0, len(every)), max_size=5)))
    cuts = [range(a, b) for a, b in zip([0, *borders], [*borders, len(every)], strict=True)]
    assert [s for places in cuts for s in samples(list(splitting.cut(runs, places)))] == samples(runs)


def test_even_parts_leave_out_other_samples_each_epoch() -> None:
    """Of one shard of 7 samples 3 ranks leave out 1, which is the one before the drawn beginning: uniform, so that
    one of 7 is missed by 100 epochs has p < 7 (6/7)^100 = 1.4e-6. The seed is fixed.
    """
    out: Counter[tuple[int, int]] = Counter()
    for epoch in range(100):
        runs = splitting.shuffled([7], np.random.default_rng([1, epoch]))
        read = {s for rank in range(3) for s in samples(list(splitting.cut(runs, splitting.even_part(7, rank, 3))))}
        out.update({(0, sample) for sample in range(7)} - read)
    assert len(out) == 7
    assert sum(out.values()) == 100


@given(count=st.integers(0, 60), size=st.integers(1, 20), seed=st.integers(0, 5))
def test_the_buffer_is_bounded_and_loses_nothing(count: int, size: int, seed: int) -> None:
    taken: list[int] = []

    def source() -> Iterator[int]:
        for item in range(count):
            taken.append(item)
            yield item

    given_out: list[int] = []
    for item in splitting.shuffled_through(source(), size, np.random.default_rng(seed)):
        given_out.append(item)
        assert len(taken) - len(given_out) < size
        assert item - len(given_out) < size  # none comes more than size - 1 places early
    assert sorted(given_out) == list(range(count))
    if size == 1:
        assert given_out == list(range(count))


def test_the_buffer_mixes() -> None:
    generator = np.random.default_rng(0)
    mixed = list(splitting.shuffled_through(range(1000), 100, generator))
    late = np.abs(np.array(mixed) - np.arange(1000))
    assert np.median(late) > 30  # an item waits 100 steps in the mean
    assert mixed != list(splitting.shuffled_through(range(1000), 100, np.random.default_rng(1)))
    assert mixed == list(splitting.shuffled_through(range(1000), 100, np.random.default_rng(0)))
