"""Did the light change from one reference to another? Median ratios of block means, one channel at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.measures import Estimate

if TYPE_CHECKING:
    from capture.check.cells import Cells

BLOCK: Final = 4  # cells along each side: 16 x 16 packed pixels
_SMALL_BLOCK: Final = 2
# A shift of 0.2 pixels, which is let pass, changes a block of 16 pixels with an edge by less than half of this.
_CHANGE: Final = 0.05
_CHANGE_SIGMAS: Final = 8
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


def changed_share(first: Cells, second: Cells, brightness: float) -> float:
    """Return the share of the picture that changed differently from ``brightness``: something moved.

    Blocks of 8 x 8 packed pixels whose green changed by more than a twentieth and by more than eight robust standard
    deviations, of those that are well exposed in the first frame.
    """
    of_first, unclipped_first = first.pooled(_SMALL_BLOCK, _SMALL_BLOCK)
    of_second, unclipped_second = second.pooled(_SMALL_BLOCK, _SMALL_BLOCK)
    greens = first.greens
    before, after = (mean[greens].mean(axis=0) for mean in (of_first, of_second))
    low, high = (share * first.range_dn for share in WELL_EXPOSED)
    usable = np.all((unclipped_first & unclipped_second)[greens], axis=0) & (before >= low) & (before <= high)
    if int(usable.sum()) < LEAST_BLOCKS:
        return 0.0
    change = np.abs(after[usable] / brightness / before[usable] - 1)
    least = max(_CHANGE, _CHANGE_SIGMAS * TO_SIGMA * float(np.median(change)))
    return float(np.mean(change > least))


def brightest_level(cells: Cells) -> float | None:
    """Return the 99th percentile of the green blocks over black, as a share of the range; ``None`` without a block."""
    mean, _ = cells.pooled(BLOCK, BLOCK)
    if not mean.size:
        return None
    return float(np.quantile(mean[cells.greens], 0.99)) / cells.range_dn
