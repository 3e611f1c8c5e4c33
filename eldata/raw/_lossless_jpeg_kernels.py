"""The compiled walk over a lossless JPEG's codes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

ENDED, NO_CODE, TOO_SHORT = 0, 1, 2


@kernel
def walk(
    content: NDArray[np.uint8], start: int, tables: NDArray[np.uint16], samples: int, interval: int
) -> tuple[int, int, int]:
    """Step over ``samples`` codes and their difference bits, component by component.

    ``interval``: samples between restart markers, 0 if there are none. Returns how it went, how many samples were
    found, and the position behind the last byte that was begun.
    """
    at, bits, held = start, np.uint64(0), 0
    component = 0
    for done in range(samples):
        if interval and done and done % interval == 0:
            # What is left of the last byte is padding; a whole byte that was read ahead is given back.
            while held >= 8:
                at -= 2 if at - 2 >= start and content[at - 1] == 0 and content[at - 2] == 0xFF else 1
                held -= 8
            if at + 2 > len(content) or content[at] != 0xFF or content[at + 1] & 0xF8 != 0xD0:
                return NO_CODE, done, at
            at, bits, held = at + 2, np.uint64(0), 0
        while held <= 40 and at < len(content):
            byte = content[at]
            if byte == 0xFF:
                if at + 1 >= len(content) or content[at + 1] != 0:
                    break  # a marker
                at += 1
            at += 1
            bits = (bits << np.uint64(8)) | np.uint64(byte)
            held += 8
        if held >= 16:
            ahead = (bits >> np.uint64(held - 16)) & np.uint64(0xFFFF)
        else:
            ahead = (bits << np.uint64(16 - held)) & np.uint64(0xFFFF)
        entry = int(np.int64(tables[component, ahead]))  # signed: with uint16 numba makes the sums below floats
        if entry == 0:
            return (NO_CODE if held >= 16 else TOO_SHORT), done, at - held // 8
        length, meaning = entry >> 8, entry & 255
        if meaning < 16:  # 16 alone stands for 32768, without bits of its own
            length += meaning
        if length > held:
            return TOO_SHORT, done, at
        held -= length
        component += 1
        if component == tables.shape[0]:
            component = 0
    while held >= 8:
        at -= 2 if at - 2 >= start and content[at - 1] == 0 and content[at - 2] == 0xFF else 1
        held -= 8
    return ENDED, samples, at
