"""Memory: threads use some again and again, and the interpreter is kept from searching much of it in vain."""

from __future__ import annotations

import gc
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

# New pages cost as much as what is done in them.
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


@contextmanager
def no_search_for_cycles() -> Iterator[None]:
    """Keep the interpreter from searching millions of new objects, none of them part of a cycle, again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
