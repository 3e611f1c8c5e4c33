"""Memory that a thread uses again and again: the pages of new memory cost as much as what is done in them."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MULTIPLE_BYTES = 8  # so that it may be seen as numbers of any kind
_OF_THREAD = threading.local()


def scratch(use: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return an array in this thread's memory for a use, which the next one for that use overwrites."""
    size = math.prod(shape) * dtype.itemsize
    held: NDArray[np.uint8] | None = getattr(_OF_THREAD, use, None)
    if held is None or held.size < size:
        held = np.empty(size + -size % _MULTIPLE_BYTES, np.uint8)
        setattr(_OF_THREAD, use, held)
    return held[:size].view(dtype).reshape(shape)
