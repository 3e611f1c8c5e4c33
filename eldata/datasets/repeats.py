"""Noticing that a dataset is gone through a second time with the same random numbers."""

from __future__ import annotations

import warnings
from typing import Any

import torch

_NUMBERS = 3  # items that were made, how often one came again, whether all is said
_HEADER_BYTES = 8 * _NUMBERS
_LOOKS = 8  # an item is looked at before training begins


class Repeats:
    """Warns once, in whichever process, when a second pass gives the items of the first one again.

    Which items were made is kept in shared memory, a byte each, for workers come and go. Looking at some items before
    the first pass is not a second one. So half of the items that were made, and a few more, have to come again; where
    they are a part of the dataset (a rank's, those of a ``Subset``, or those that were looked at), all of them three
    times. Processes may miss each other's count, which says it later.

    Parameters
    ----------
    owner
        Name of the dataset.
    length
        Number of its items.
    """

    def __init__(self, owner: str, length: int) -> None:
        self.owner = owner
        self._memory = torch.zeros(_HEADER_BYTES + length, dtype=torch.uint8)
        self._share()

    def _share(self) -> None:
        self._memory.share_memory_()  # type: ignore[no-untyped-call]
        array = self._memory.numpy()
        self._numbers, self._is_made = array[:_HEADER_BYTES].view("i8"), array[_HEADER_BYTES:]

    def __getstate__(self) -> dict[str, Any]:
        return {"owner": self.owner, "_memory": self._memory}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._share()

    def settle(self) -> None:
        """Say nothing from now on: the epoch was chosen."""
        self._numbers[2] = 1

    def note(self, *indices: int) -> None:
        """Note that items were made."""
        for index in indices:
            if self._numbers[2]:
                return
            self._note(index)

    def _note(self, index: int) -> None:
        numbers = self._numbers
        if not self._is_made[index]:
            self._is_made[index] = 1
            numbers[0] += 1
            return
        numbers[1] += 1
        made, again = int(numbers[0]), int(numbers[1])
        is_whole = 4 * made >= 3 * self._is_made.size
        if again > (made // 2 if is_whole else 3 * made) + _LOOKS:
            self.settle()
            warnings.warn(
                f"{self.owner}: items of epoch 0 come again, with the same crops and the same noise to the bit, "
                "for set_epoch was not called; call dataset.set_epoch(epoch) before each pass. If they are to stay the "
                "same, as for validation, call dataset.set_epoch(0) once",
                stacklevel=3,
            )
