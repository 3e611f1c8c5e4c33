"""Shuffling a stream with a bounded buffer."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy as np

Item = TypeVar("Item")


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


def _drawn(buffer: list[Item], generator: np.random.Generator) -> Item:
    place = int(generator.integers(len(buffer)))
    buffer[place], buffer[-1] = buffer[-1], buffer[place]
    return buffer.pop()
