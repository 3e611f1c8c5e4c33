"""Whose turn it is: counted over whole sequences, and asked for in any order."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from eldata.datasets.synthetic.draws import Turns, fewest_members


def test_each_member_once_before_any_twice() -> None:
    """One group: rounds of all members, in orders that differ from round to round."""
    turns = Turns(3, [1.0], [7])
    rounds = [[turns.at(place)[1][0] for place in range(7 * number, 7 * number + 7)] for number in range(20)]
    assert all(sorted(one) == list(range(7)) for one in rounds)
    assert len({tuple(one) for one in rounds}) > 15
    assert [turns.at(place) for place in (130, 5)] == [Turns(3, [1.0], [7]).at(place) for place in (130, 5)]
    assert [turns.at(place) for place in range(7)] != [Turns(4, [1.0], [7]).at(place) for place in range(7)]


@pytest.mark.parametrize("weights", [[1.0, 1.0, 1.0], [5.0, 1.0, 0.01, 2.0], [0.1, 0.2]])
def test_groups_come_by_their_weights_and_their_members_stay_level(weights: list[float]) -> None:
    """At each place a group's members differ by one use at most; at each block's end groups have had their shares."""
    sizes = [5, 3, 4, 6][: len(weights)]
    turns, counts = Turns(0, weights, sizes), [Counter[int]() for _ in weights]
    shares = np.array(weights) / sum(weights)
    for place in range(640):
        group, (member,) = turns.at(place)
        counts[group][member] += 1
        used = [counts[group][one] for one in range(sizes[group])]
        assert max(used) - min(used) <= 1
        if place % 64 == 63:
            found = np.array([count.total() for count in counts])
            assert np.abs(found - shares * (place + 1)).max() < len(weights)
    assert len({turns.at(place)[0] for place in range(0, 640, 64)}) > 1  # blocks do not begin alike


@pytest.mark.parametrize("each", [2, 3, 5])
def test_members_of_one_turn_are_different(each: int) -> None:
    """With the fewest members that there may be, over 400 rounds: no turn has one twice, and they stay level."""
    size = fewest_members(each)
    turns, used = Turns(1, [1.0], [size], each), Counter[int]()
    for place in range(400 * size // each):
        members = turns.at(place)[1]
        assert len(set(members)) == each
        used.update(members)
    assert max(used.values()) - min(used.values()) <= 1
