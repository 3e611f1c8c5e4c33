"""Which mosaic row and column each packed entry comes from, and which colour bias each packed channel takes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.cfa import packed_forms, packed_layouts

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
    across
        (C, s, s) int64: the same of mosaic columns, ``(x // s) * period + across[c, y % s, x % s]``.
    """

    table: NDArray[np.int64]
    period: int
    across: NDArray[np.int64]

    @property
    def sub(self) -> int:
        """The s of the table."""
        return int(self.table.shape[1])


@cache
def packed_rows(channels: int) -> PackedRows:
    """Return which mosaic rows lie under packed data with 4 (Bayer), 9 (X-Trans), 16 (quad) or 36 (nona) channels.

    Bayer: R and G1 share a row, B and G2 the other; quad and nona: the same, of each row of the blocks. Which come
    first depends on the phase and changes no statistic.

    Raises
    ------
    ArgumentError
        For any other number of channels.
    """
    sites = packed_layouts().get(channels)
    if sites is None:
        raise ArgumentError(f"packed data has {packed_forms()} channels; found {channels}")
    table, across = np.empty((2, channels, sites.sub, sites.sub), dtype=np.int64)
    for row, column, channel, y, x in sites.table:
        table[channel, y, x], across[channel, y, x] = row, column
    return PackedRows(table, sites.period, across)


def channel_bias_dn(parameters: NoiseParameters, channels: int) -> tuple[float, ...]:
    """Return the colour bias of each packed channel: its colour's. X-Trans has one green: the mean of G1's and G2's."""
    sites = packed_layouts()[channels]
    if sites.colours == (0, 1, 2, 3):  # Bayer, asked for each item of a batch: as it is
        return parameters.colour_bias_dn
    red, green, blue, second_green = parameters.colour_bias_dn
    one_green = red, (green + second_green) / 2, blue
    of_colour = one_green if sites.levels == len(one_green) else parameters.colour_bias_dn
    return tuple(of_colour[colour] for colour in sites.colours)
