"""Seeds: no two (seed, epoch, place) share a stream, and small seeds give what they always gave."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import numpy as np
import pytest

from eldata.base.seeds import checked_epoch, checked_seed, item_generator, purpose_sequence
from eldata.errors import ArgumentError

WORDS = (0, 1, 2, 5, 2**32 - 1)
# Seeds whose words are those of smaller seeds, epochs and indices, one after the other.
SEEDS = (*WORDS, *(low + (high << 32) for low in WORDS for high in WORDS if high), 1 << 64, 5 + (2 << 96), 2**128 - 1)


def test_small_seeds_give_what_they_always_gave() -> None:
    for seed, epoch, index in itertools.product(WORDS, repeat=3):
        ours, theirs = item_generator(seed, epoch, index), np.random.default_rng([seed, epoch, index])
        assert ours.bit_generator.state == theirs.bit_generator.state
    assert [one.random() for one in ours.spawn(2)] == [one.random() for one in theirs.spawn(2)]
    again: np.random.Generator = pickle.loads(pickle.dumps(ours))
    assert again.random() == theirs.random()
    state = np.random.SeedSequence((7, 3), spawn_key=(2, 1)).generate_state(4)
    np.testing.assert_array_equal(purpose_sequence(7, 3, 2, 1).generate_state(4), state)


def test_no_two_places_share_a_stream() -> None:
    """28 seeds, 5 epochs; 5 items and 6 other purposes of each: states of 128 bits differ, all 1540."""
    states: dict[Any, int] = {}
    for seed, epoch in itertools.product(SEEDS, WORDS):
        for index in WORDS:
            states["item", seed, epoch, index] = item_generator(seed, epoch, index).bit_generator.state["state"][
                "state"
            ]
        for purpose in ((1,), (2,), (2, 0), (2, 1), (2, 1, 5), (2, 0, 1, 0, 2)):
            generator = np.random.default_rng(purpose_sequence(seed, epoch, *purpose))
            states[purpose, seed, epoch] = generator.bit_generator.state["state"]["state"]
    assert len(states) == len(SEEDS) * 5 * 11
    assert len(set(states.values())) == len(states)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (-1, "must be 0 or more; found -1"),
        (1.5, "must be a whole number, 0 or more; found 1.5"),
        ("7", "must be a whole number, 0 or more; found '7'"),
        (None, "must be a whole number, 0 or more; found None"),
        (2**128, r"must be below 2\^(128|32); found"),
    ],
)
def test_what_is_refused(value: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=f"^seed {words}"):
        checked_seed(value)
    with pytest.raises(ArgumentError, match=f"^epoch {words}"):
        checked_epoch(value)
