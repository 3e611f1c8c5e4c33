"""Memory: threads use some again and again, and the interpreter is kept from searching much of it in vain."""

from __future__ import annotations

import gc
import math
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

# New pages cost as much as what is done in them.
_MULTIPLE_BYTES = 8  # so that it may be seen as numbers of any kind
_OF_THREAD = threading.local()


def scratch(use: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return an array in this thread's memory for a use, which the next one for that use overwrites."""
    size = math.prod(shape) * dtype.itemsize
    held: NDArray[np.uint8] | None = getattr(_OF_THREAD, use, None)
    if held is None or held.size < size:
        import numpy as np

        held = np.empty(size + -size % _MULTIPLE_BYTES, np.uint8)
        setattr(_OF_THREAD, use, held)
    return held[:size].view(dtype).reshape(shape)


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
