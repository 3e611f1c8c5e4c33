"""A frame in small: means over black of cells of 4 x 4 packed pixels, per channel. Only shift and focus need more.

Averaging takes the pixels' noise off (a quarter of it is left) and makes a frame of 12 megapixels 3 MB, so that a whole
scene fits into the memory of a frame or two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from eldata.raw.levels import packed_black_level_dn, packing_sites

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.records import Sensor

    Mosaic = NDArray[np.uint16]

CELL: Final = 4  # packed pixels along each side

_NEAR: Final = 8  # values on either side, whose mean says how often one should occur
_LEAST_EACH: Final = 30  # pixels a value: chance leaves one empty once in 1e13
_TAILS: Final = (0.05, 0.95)

# Pixels in the last thousandth of the range below the highest value, if these are more than thrice those in the
# thousandth below: a sensor that saturates below its white level. The upper tail of shot noise is several thousandths
# wide and falls, so it holds fewer.
_PILE_BAND: Final = 0.001
_PILE_FACTOR: Final = 3
_PILE_LEAST: Final = 100
_PILE_FROM: Final = 0.5  # of the range: real cameras saturate above 0.8 of it (Canon 70D at ISO 100)


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A frame reduced to cells.

    Attributes
    ----------
    mean_dn
        Mean of each cell over the recorded black level, (C, rows, columns) float32, DN.
    clipped
        Whether a pixel of the cell is saturated, (C, rows, columns).
    range_dn
        White level less black level, DN.
    clipped_share, zero_share
        Share of the frame's pixels that are saturated, and that are 0 DN.
    spread_dn
        Half the distance of the 16th and the 84th percentile of the pixels: of a bias frame, its noise. DN.
    colours
        Colour of each channel: ``"R"``, ``"G"`` or ``"B"``.
    """

    mean_dn: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    range_dn: float
    clipped_share: float
    zero_share: float
    spread_dn: float
    colours: tuple[str, ...]

    @property
    def greens(self) -> list[int]:
        """The indices of the green channels."""
        return [index for index, colour in enumerate(self.colours) if colour == "G"]

    def pooled(self, rows: int, columns: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return means of groups of cells, and which groups hold no saturated pixel."""
        channels, height, width = self.mean_dn.shape
        height, width = height // rows, width // columns
        shape = (channels, height, rows, width, columns)
        crop = np.s_[:, : height * rows, : width * columns]
        mean: NDArray[np.float32] = self.mean_dn[crop].reshape(shape).mean(axis=(2, 4))
        clipped: NDArray[np.bool_] = np.any(self.clipped[crop].reshape(shape), axis=(2, 4))
        return mean, ~clipped


def reduce_to_cells(mosaic: Mosaic, sensor: Sensor, packed: NDArray[np.uint16]) -> Cells:
    """Return a frame's cells, from its mosaic and the same packed; a frame smaller than a cell has none."""
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn)
    range_dn = sensor.white_level_dn - float(black.max())
    saturated = saturation_dn(mosaic, sensor)
    counts = _summed(packed >= saturated) if int(mosaic.max()) >= saturated else None
    mean: NDArray[np.float32] = _summed(packed).astype(np.float32)
    mean /= CELL**2
    mean -= black[:, None, None]
    clipped = np.zeros(mean.shape, dtype=np.bool_) if counts is None else counts > 0
    step = max(1, math.isqrt(mosaic.size // 100_000)) | 1  # odd: every site of the CFA takes part
    low, high = np.quantile(mosaic[::step, ::step], (0.159, 0.841))
    return Cells(
        mean_dn=mean,
        clipped=clipped,
        range_dn=range_dn,
        clipped_share=0.0 if counts is None else float(np.count_nonzero(mosaic >= saturated)) / mosaic.size,
        zero_share=1 - float(np.count_nonzero(mosaic)) / mosaic.size,
        spread_dn=float(high - low) / 2,
        colours=tuple(name[0] for name in packing_sites(sensor.cfa).names),
    )


def luminance(packed: NDArray[np.uint16], cells: Cells) -> NDArray[np.float32]:
    """Return the sum of the packed channels, (h, w), each scaled to the same mean: what a grey scene has.

    The sum of all sites of a CFA cell is a low-pass filter: detail finer than the packed pixels, which a single channel
    would show as coarser detail (aliasing) that moves differently from the scene, cancels for the most part.
    """
    mean = np.maximum(cells.mean_dn.mean(axis=(1, 2), dtype=np.float64), 1.0)
    total = np.zeros(packed.shape[1:], dtype=np.float32)
    for channel, scale in zip(packed, (mean.max() / mean).astype(np.float32), strict=True):
        total += channel * scale
    return total


def saturation_dn(mosaic: Mosaic, sensor: Sensor) -> float:
    """Return the level from which on pixels are saturated: the recorded white level, or that of a pile below it.

    Some cameras saturate below the white level that their files state, by some DN more or less from pixel to pixel.
    """
    black, white = max(sensor.black_level_dn), sensor.white_level_dn
    top = float(mosaic.max())
    band = max(2.0, math.ceil(_PILE_BAND * (white - black)))
    if top - band <= black + _PILE_FROM * (white - black):
        return white
    inside = int(np.count_nonzero(mosaic > top - band))
    below = int(np.count_nonzero(mosaic > top - 2 * band)) - inside
    piled = inside >= _PILE_LEAST and inside > _PILE_FACTOR * below
    return min(white, top - band + 1) if piled else white


def _summed(packed: NDArray[np.uint16] | NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Return sums over cells; slices are added, since numpy sums short axes slowly."""
    height, width = (size // CELL * CELL for size in packed.shape[1:])
    crop = packed[:, :height, :width]
    rows = np.zeros((len(crop), height // CELL, width), dtype=np.uint32)
    for offset in range(CELL):
        rows += crop[:, offset::CELL]
    sums = np.zeros((len(crop), height // CELL, width // CELL), dtype=np.uint32)
    for offset in range(CELL):
        sums += rows[:, :, offset::CELL]
    return sums


def empty_share(mosaic: NDArray[np.uint16]) -> float:
    """Return the share of values that never occur, of those whose neighbours are frequent; 0 if none is.

    A file of 14 bits that holds 12 lacks 3 of 4. Neighbours on both sides: beside a saturated area or a peak of black,
    values that do not occur are not a gap.
    """
    counts = np.bincount(mosaic.ravel())
    below = np.cumsum(counts)
    low, high = (int(np.searchsorted(below, share * mosaic.size)) for share in _TAILS)
    inner = counts[low : high + 1]
    if len(inner) < _NEAR:
        return 0.0
    sums = np.convolve(inner, np.ones(_NEAR, np.int64))
    before, after = np.concatenate([[0], sums])[: len(inner)], np.append(sums, 0)[_NEAR : _NEAR + len(inner)]
    frequent = np.minimum(before, after) >= _NEAR * _LEAST_EACH
    return float(np.mean(inner[frequent] == 0)) if frequent.any() else 0.0
