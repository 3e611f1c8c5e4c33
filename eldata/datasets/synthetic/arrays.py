"""Clean frames from arrays in memory."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel, scratch
from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.noise.model import check_normalised
from eldata.raw.levels import packing_sites, unpack
from eldata.sources.frames import Frame, Pixels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.levels import CfaRows

_BAYER: CfaRows = ((0, 1), (3, 2))


class Arrays:
    """Clean frames from packed, normalised arrays (C, h, w) in memory (or memory-mapped).

    Parameters
    ----------
    arrays
        One array per frame, or one array (N, C, h, w).
    range_dn
        White minus black level of the camera that is simulated, DN.
    cfa
        Their CFA; by default RGGB.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.datasets import Arrays
    >>> len(Arrays(np.zeros((3, 4, 64, 64), np.float32), range_dn=15871.0))
    3
    """

    reads_parts = True

    def __init__(
        self, arrays: Sequence[NDArray[Any]] | NDArray[Any], *, range_dn: float, cfa: CfaRows = _BAYER
    ) -> None:
        if len(arrays) == 0:
            raise ArgumentError("no array was given")
        self.arrays = arrays
        self.range_dn = checked_number("range_dn", range_dn, above=0)
        self._sites = packing_sites(cfa)  # packed data starts where packing does, whatever the offset of its sensor
        self._black_level_dn = (0.0,) * self._sites.levels
        self.cfa = cfa
        check_normalised(np.asarray(arrays[0]), "array 0")

    def __len__(self) -> int:
        return len(self.arrays)

    def frame(self, index: int) -> Frame:
        """Return one array as a mosaic."""
        packed, name, sites = np.asarray(self.arrays[index]), f"array {index}", self._sites
        check_normalised(packed, name)
        if packed.ndim != 3 or len(packed) != sites.channels or any(side % sites.sub for side in packed.shape[1:]):
            unpack(packed, sites.cfa)  # raises, saying what is expected
        shape = packed.shape[1] * sites.scale, packed.shape[2] * sites.scale
        mosaic = Pixels(shape, np.dtype(np.float32), partial(self._read, packed))
        return Frame(mosaic, sites.cfa, self._black_level_dn, self.range_dn, name)

    def _read(self, packed: NDArray[Any], rows: slice, columns: slice) -> NDArray[np.float32]:
        """Return a part of a mosaic, in DN, put together in memory that the next call of this thread overwrites."""
        sites, range_dn = self._sites, np.float32(self.range_dn)
        period, scale = sites.period, sites.scale
        top, bottom, _ = rows.indices(packed.shape[1] * scale)
        left, right, _ = columns.indices(packed.shape[2] * scale)
        above, before = top % period, left % period  # of the periods that hold it
        height, width = above + bottom - top, before + right - left
        height, width = height + -height % period, width + -width % period
        row, column = (top - above) // scale, (left - before) // scale
        if period == 2 and packed.dtype == np.float32:
            whole: NDArray[np.float32] = scratch("unpacked", (height, width), range_dn.dtype)
            _scatter_bayer(packed, row, column, sites.channel_of, range_dn, whole)
        else:
            periods = packed[:, row : row + height // scale, column : column + width // scale]
            whole = unpack(periods.astype(np.float32, copy=False), sites.cfa)
            whole *= range_dn
        return whole[above : above + bottom - top, before : before + right - left]

    def __repr__(self) -> str:
        return f"Arrays({len(self)} frames of shape {self.arrays[0].shape}, range_dn={self.range_dn:g})"


@kernel
def _scatter_bayer(
    packed: NDArray[Any], top: int, left: int, channel: NDArray[np.int64], scale: Any, mosaic: NDArray[Any]
) -> None:
    """Fill a Bayer mosaic from the part of ``packed`` that begins at (top, left), times ``scale``.

    ``channel`` (2, 2) names the packed channel of each site. The whole array comes with the part's place, for the
    compiler does not know that the rows of a part are contiguous.
    """
    for i in range(mosaic.shape[0] // 2):
        for y in range(2):
            even, odd = packed[channel[y, 0], top + i], packed[channel[y, 1], top + i]
            even, odd = even[left:], odd[left:]
            target = mosaic[2 * i + y]
            for j in range(mosaic.shape[1] // 2):
                target[2 * j] = even[j] * scale
                target[2 * j + 1] = odd[j] * scale
