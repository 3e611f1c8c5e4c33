"""The compiled loop of a dark shading."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.compiled import kernel

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@kernel
def fill_line(
    slope: NDArray[np.float32],
    offset: NDArray[np.float32],
    iso: np.float32,
    levels: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write ``slope * iso + offset + level``; ``levels`` (period, W) are those of the rows of one period of the CFA."""
    for y in range(out.shape[0]):
        k, b, level, row = slope[y], offset[y], levels[y % levels.shape[0]], out[y]
        for x in range(out.shape[1]):
            row[x] = k[x] * iso + b[x] + level[x]
