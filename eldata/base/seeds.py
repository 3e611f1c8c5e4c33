"""Random numbers that depend on (seed, epoch, place) alone, and that no other seed shares.

numpy cuts what it is seeded with into words of 32 bits, one after the other, and fills up with zeros. To it
``[2**32, 5, 0]`` and ``[0, 1, 5]`` are one and the same: a large seed is read as a small one and its epoch. Here a
large seed keeps four words for itself. Seeds below 2^32 give what ``default_rng([seed, epoch, index])`` gives, as they
always have.
"""

from __future__ import annotations

import numpy as np

from eldata.base.numbers import checked_whole

_ITEMS = 0  # other purposes have numbers from 1 on
_LARGE = 0  # the first key of large seeds, where small ones have their purpose's number
_ONE_WORD = 1 << 32
_SEED_BITS = 128  # the entropy that numpy's SeedSequence draws for itself


def checked_seed(seed: int) -> int:
    """Return a seed: a whole number from 0 up to below 2^128.

    Raises
    ------
    ArgumentError
        If it is something else.
    """
    return checked_whole("seed", seed, bits=_SEED_BITS)


def checked_epoch(epoch: int) -> int:
    """Return an epoch: a whole number from 0 up to below 2^32.

    Raises
    ------
    ArgumentError
        If it is something else.
    """
    return checked_whole("epoch", epoch, bits=32)


def item_generator(seed: int, epoch: int, index: int) -> np.random.Generator:
    """Return the generator of one item, for a seed and an epoch that were checked and an index below 2^32."""
    if seed < _ONE_WORD:
        return np.random.default_rng([seed, epoch, index])
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_LARGE, epoch, _ITEMS, index)))


def purpose_sequence(seed: int, epoch: int, purpose: int, *place: int) -> np.random.SeedSequence:
    """Make the seed sequence of another purpose than items: its number, from 1 on, and a place such as a rank."""
    if seed < _ONE_WORD:
        return np.random.SeedSequence((seed, epoch), spawn_key=(purpose, *place))
    return np.random.SeedSequence(seed, spawn_key=(_LARGE, epoch, purpose, *place))
