"""Random numbers that depend on (seed, epoch, place) alone, and that no other seed shares.

numpy cuts what it is seeded with into words of 32 bits, one after the other, and fills up with zeros. To it
``[2**32, 5, 0]`` and ``[0, 1, 5]`` are one and the same: a large seed is read as a small one and its epoch. Here a
large seed keeps four words for itself. Seeds below 2^32 give what ``default_rng([seed, epoch, index])`` gives, as they
always have.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random.bit_generator import ISpawnableSeedSequence

from eldata.base.compiled import kernel
from eldata.base.numbers import checked_whole

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ITEMS = 0  # other purposes have numbers from 1 on
_LARGE = 0  # the first key of large seeds, where small ones have their purpose's number
_ONE_WORD = 1 << 32
_PCG64_WORDS = 4
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


class _ItemSequence(ISpawnableSeedSequence):
    """``SeedSequence([seed, epoch, index])`` in a third of the time, as long as it does nothing but seed PCG64."""

    def __init__(self, *words: int) -> None:
        self._words = words

    @cached_property
    def _plain(self) -> np.random.SeedSequence:
        return np.random.SeedSequence(self._words)

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[Any]:
        is_usual = n_words == _PCG64_WORDS and dtype is np.uint64
        return _seed_state(*self._words) if is_usual else self._plain.generate_state(n_words, dtype)

    def spawn(self, n_children: int) -> list[np.random.SeedSequence]:  # type: ignore[override] # they need not be ours
        return self._plain.spawn(n_children)


def item_generator(seed: int, epoch: int, index: int) -> np.random.Generator:
    """Return the generator of one item, for a seed and an epoch that were checked and an index below 2^32."""
    if seed < _ONE_WORD:
        return np.random.Generator(np.random.PCG64(_ItemSequence(seed, epoch, index)))  # type: ignore[arg-type] # any ISeedSequence
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_LARGE, epoch, _ITEMS, index)))


def purpose_sequence(seed: int, epoch: int, purpose: int, *place: int) -> np.random.SeedSequence:
    """Return what seeds another purpose than items. It has a number from 1 on; ``place`` is a rank's, for one."""
    if seed < _ONE_WORD:
        return np.random.SeedSequence((seed, epoch), spawn_key=(purpose, *place))
    return np.random.SeedSequence(seed, spawn_key=(_LARGE, epoch, purpose, *place))


# --- the hash of numpy's SeedSequence, compiled ---------------------------------------------------------------------
# numpy's own takes as long as half of an item's other random numbers. After numpy/random/bit_generator.pyx, whose
# results are promised not to change; tests compare them.

_U4 = np.uint32
_U8 = np.uint64
_INIT_A, _MULT_A = _U4(0x43B0D7E5), _U4(0x931E8875)
_INIT_B, _MULT_B = _U4(0x8B51F9DD), _U4(0x58F38DED)
_MIX_L, _MIX_R = _U4(0xCA01F9DD), _U4(0x4973F715)
_HALF, _WORD = _U4(16), _U8(32)


@kernel
def _hashed(value: Any, constant: Any, factor: Any) -> Any:
    """Return a hashed word, and the next constant."""
    following = _U4(constant * factor)
    value = _U4(_U4(value ^ constant) * following)
    return _U4(value ^ _U4(value >> _HALF)), following


@kernel
def _seed_state(first: int, second: int, third: int) -> NDArray[np.uint64]:
    """Return ``SeedSequence([first, second, third]).generate_state(4, uint64)``, for numbers below 2^32."""
    pool = np.array([first, second, third, 0], np.uint32)
    constant = _INIT_A
    for place in range(4):
        pool[place], constant = _hashed(pool[place], constant, _MULT_A)
    for source in range(4):
        for place in range(4):
            if place != source:
                value, constant = _hashed(pool[source], constant, _MULT_A)
                mixed = _U4(_U4(_MIX_L * pool[place]) - _U4(_MIX_R * value))
                pool[place] = _U4(mixed ^ _U4(mixed >> _HALF))
    state, constant = np.empty(4, np.uint64), _INIT_B
    for place in range(4):
        low, constant = _hashed(pool[2 * place % 4], constant, _MULT_B)
        high, constant = _hashed(pool[(2 * place + 1) % 4], constant, _MULT_B)
        state[place] = _U8(low) | (_U8(high) << _WORD)
    return state
