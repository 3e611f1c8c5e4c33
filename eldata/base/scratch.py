"""Memory that a thread uses again and again: the pages of new memory cost as much as what is done in them."""

from __future__ import annotations

import threading

import numpy as np

_MULTIPLE_BYTES = 8  # so that it may be seen as numbers of any kind


class Scratch:
    """Memory of a thread that is used again and again; its address is asked for once."""

    def __init__(self, size: int) -> None:
        self.bytes = np.empty(size, np.uint8)
        self.address = self.bytes.ctypes.data


_OF_THREAD = threading.local()


def scratch(use: str, size: int) -> Scratch:
    """Return this thread's memory for a use, of so many bytes or more."""
    held: Scratch | None = getattr(_OF_THREAD, use, None)
    if held is None or held.bytes.size < size:
        held = Scratch(size + -size % _MULTIPLE_BYTES)
        setattr(_OF_THREAD, use, held)
    return held
