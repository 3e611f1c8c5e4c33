"""Did the light change from one reference to another? Median ratios of block means, one channel at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.measures import Estimate

if TYPE_CHECKING:
    from capture.check.cells import Cells

BLOCK: Final = 4  # cells along each side: 16 x 16 packed pixels
LEAST_BLOCKS: Final = 12
WELL_EXPOSED: Final = (0.02, 0.9)  # of the range over black

TO_SIGMA: Final = 1.4826  # of a median absolute deviation, for normal errors
OF_MEDIAN: Final = 1.2533  # standard error of a median over that of a mean


def brightness_ratios(first: Cells, second: Cells) -> tuple[Estimate | None, ...]:
    """Return the brightness of ``second`` over that of ``first``, one estimate per packed channel.

    The median of ``mean_2 / mean_1`` over blocks that are well exposed and not clipped in both frames. Medians forgive
    what moved or glints in a part of the picture. The standard error is that of a median, from the blocks' own scatter.
    ``None`` for a channel with too few such blocks.
    """
    of_first, unclipped_first = first.pooled(BLOCK, BLOCK)
    of_second, unclipped_second = second.pooled(BLOCK, BLOCK)
    low, high = (share * first.range_dn for share in WELL_EXPOSED)
    # The mean of both decides, and the limits for each stand apart from it: a limit on one alone would favour errors
    # of one sign there.
    middle = (of_first + of_second) / 2
    usable = unclipped_first & unclipped_second & (middle >= low) & (middle <= high) & (of_first > 0) & (of_second > 0)
    estimates: list[Estimate | None] = []
    for mean_1, mean_2, chosen in zip(of_first, of_second, usable, strict=True):
        count = int(chosen.sum())
        if count < LEAST_BLOCKS:
            estimates.append(None)
            continue
        ratios = mean_2[chosen].astype(np.float64) / mean_1[chosen]
        middle_ratio = float(np.median(ratios))
        scatter = TO_SIGMA * float(np.median(np.abs(ratios - middle_ratio)))
        estimates.append(Estimate(middle_ratio, OF_MEDIAN * scatter / count**0.5))
    return tuple(estimates)


def brightest_level(cells: Cells) -> float | None:
    """Return the 99th percentile of the green blocks over black, as a share of the range; ``None`` without a block."""
    mean, _ = cells.pooled(BLOCK, BLOCK)
    if not mean.size:
        return None
    return float(np.quantile(mean[cells.greens], 0.99)) / cells.range_dn
