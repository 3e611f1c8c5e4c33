"""Which mosaic row each packed entry comes from, and which colour bias each packed channel takes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters


@dataclass(frozen=True, eq=False)
class PackedRows:
    """Rows of the mosaic under packed data.

    Attributes
    ----------
    table
        (C, s, s) int64: packed entry (c, y, x) lies in mosaic row ``(y // s) * period + table[c, y % s, x % s]``.
    period
        Mosaic rows per s packed rows.
    """

    table: NDArray[np.int64]
    period: int

    @property
    def sub(self) -> int:
        """The s of the table."""
        return int(self.table.shape[1])


@cache
def packed_rows(channels: int) -> PackedRows:
    """Return which mosaic rows lie under packed data with 4 (Bayer) or 9 (X-Trans) channels.

    Bayer: R and G1 share a row, B and G2 the other; which of the two comes first depends on the phase and changes no
    statistic.

    Raises
    ------
    ArgumentError
        For any other number of channels.
    """
    if channels == 4:
        return PackedRows(np.array([[[0]], [[0]], [[1]], [[1]]], dtype=np.int64), 2)
    if channels == 9:
        from eldata.raw.cfa import XTRANS_CFA, packing_sites

        table = np.empty((9, 2, 2), dtype=np.int64)
        for row, _, channel, y, x in packing_sites(XTRANS_CFA).table:
            table[channel, y, x] = row
        return PackedRows(table, 6)
    raise ArgumentError(f"packed data has 4 (Bayer) or 9 (X-Trans) channels; found {channels}")


def channel_bias_dn(parameters: NoiseParameters, channels: int) -> tuple[float, ...]:
    """Return the colour bias of each packed channel. X-Trans has one green: the mean of G1's and G2's bias."""
    red, green, blue, second_green = parameters.colour_bias_dn
    if channels == 4:
        return red, green, blue, second_green
    mean = (green + second_green) / 2
    return red, mean, blue, red, blue, mean, mean, mean, mean
