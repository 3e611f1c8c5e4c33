"""The hash of numpy's SeedSequence, compiled: numpy's own takes as long as half of an item's other random numbers.

After ``numpy/random/bit_generator.pyx``, whose results are promised not to change; tests compare them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
def seed_state(first: int, second: int, third: int) -> NDArray[np.uint64]:
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
