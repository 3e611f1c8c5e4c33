"""Whose turn it is: every member of a group is used once before any is used twice, in any reading order.

Which member has its turn at a place of the sequence follows from the seed and the place alone: items are read in any
order by any number of workers, and nobody keeps count.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import checked_number
from eldata.base.seeds import purpose_sequence
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_BLOCKS, _MEMBERS, _SPLIT = 4, 5, 7  # purposes of random numbers
_BLOCK = 64  # places


class Turns:
    """An endless sequence of turns, of groups by their weights and of their members one by one.

    In each block of 64 places a group has its turn as often as its weight asks for, to one more or less, in an order
    that is drawn for the block. Its members come in rounds, each round in an order of its own.

    Parameters
    ----------
    seed
        As of a dataset.
    weights
        Of each group, above 0.
    sizes
        Members of each group.
    each
        Members that have a turn together, all different: for that a group must have :func:`fewest_members`.
    """

    def __init__(self, seed: int, weights: Sequence[float], sizes: Sequence[int], each: int = 1) -> None:
        self.seed, self.sizes, self.each = seed, tuple(sizes), each
        left = [sum(map(Fraction, weights[first:])) for first in range(len(weights))]
        # Of what the groups before it leave, a group takes this share. So each group's count never falls from place to
        # place, as it could if shares of the whole were rounded.
        self._shares = [Fraction(weight) / rest for weight, rest in zip(weights, left, strict=True)]

    def at(self, place: int) -> tuple[int, tuple[int, ...]]:
        """Return the group whose turn it is, and which members of it."""
        block, within = divmod(place, _BLOCK)
        before, after = self._counts(block * _BLOCK), self._counts((block + 1) * _BLOCK)
        groups = np.repeat(np.arange(len(before)), np.subtract(after, before))
        if len(before) > 1:
            np.random.default_rng(purpose_sequence(self.seed, 0, _BLOCKS, block)).shuffle(groups)
        group = int(groups[within])
        turn = before[group] + int((groups[:within] == group).sum())
        return group, tuple(self._member(group, turn * self.each + more) for more in range(self.each))

    def _counts(self, places: int) -> list[int]:
        """Count the turns of each group in the first places."""
        counts = []
        for share in self._shares:
            counts.append(int(places * share))
            places -= counts[-1]
        return counts

    def _member(self, group: int, number: int) -> int:
        turn_round, place = divmod(number, self.sizes[group])
        return int(self._order(group, turn_round)[place])

    def _order(self, group: int, turn_round: int) -> NDArray[np.int64]:
        """Return the members in the order of one round.

        The first ``each - 1`` may stand in one turn with the last ones of the round before. Those that do occur there
        change places with others from the middle, so that a round's end is what was drawn, and no round depends on more
        than the one before.
        """
        order = self._drawn(group, turn_round)
        edge = self.each - 1
        if edge == 0 or turn_round == 0:
            return order
        last = set(self._drawn(group, turn_round - 1)[-edge:].tolist())
        others = (place for place in range(edge, len(order) - edge) if order[place] not in last)
        for place in range(edge):
            if order[place] in last:
                other = next(others)
                order[place], order[other] = order[other], order[place]
        return order

    def _drawn(self, group: int, turn_round: int) -> NDArray[np.int64]:
        sequence = purpose_sequence(self.seed, 0, _MEMBERS, group, turn_round)
        return np.random.default_rng(sequence).permutation(self.sizes[group])


def fewest_members(each: int) -> int:
    """Compute the fewest members of a group for turns of several different ones.

    Let e be ``each - 1``. Of n members, n - 2 e stand in the middle of a round. If h of the e last ones of the round
    before stand at its head, h places in the middle must hold none of them, and e - h at most do: n - 2 e - (e - h)
    must be h or more.
    """
    return max(1, each, 3 * (each - 1))


def draw_splits(seed: int, shares: tuple[float, float] | None, count: int) -> list[str]:
    """Draw the split of each of so many scenes or clips, ``train`` or ``test``, by their shares; ``None``: no splits.

    Raises
    ------
    ArgumentError
        If a share is not above 0, or one of the splits would be empty.
    """
    if shares is None:
        return [""] * count
    train, test = (checked_number("split", share, above=0) for share in shares)
    held = round(count * test / (train + test))
    if not 0 < held < count:
        raise ArgumentError(
            f"split {train:g}:{test:g} of {count} scenes or clips leaves {held} to test on; give more, or other shares"
        )
    chosen = set(np.random.default_rng(purpose_sequence(seed, 0, _SPLIT)).permutation(count)[:held].tolist())
    return ["test" if number in chosen else "train" for number in range(count)]
