"""The mosaic under packed data: its rows, places on the sensor, and packing that loses no pixel.

:func:`eldata.raw.levels.pack` crops what does not fill a period. Here the mosaic is extended instead, and cropped again
on the way back: noise is wanted on every pixel.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.levels import packed_forms, packed_layouts, packed_shape, packing_sites

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters
    from eldata.raw.levels import Cfa

Image = TypeVar("Image", "NDArray[Any]", "torch.Tensor")


class PackedRows(NamedTuple):
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
    table = np.empty((channels, sites.sub, sites.sub), dtype=np.int64)
    for row, _, channel, y, x in sites.table:
        table[channel, y, x] = row
    return PackedRows(table, sites.period)


def channel_bias_dn(parameters: NoiseParameters, channels: int) -> tuple[float, ...]:
    """Return the colour bias of each packed channel: its colour's. X-Trans has one green: the mean of G1's and G2's."""
    sites = packed_layouts()[channels]
    if sites.colours == (0, 1, 2, 3):  # Bayer, asked for each item of a batch: as it is
        return parameters.colour_bias_dn
    red, green, blue, second_green = parameters.colour_bias_dn
    one_green = red, (green + second_green) / 2, blue
    of_colour = one_green if sites.levels == len(one_green) else parameters.colour_bias_dn
    return tuple(of_colour[colour] for colour in sites.colours)


def pack_whole(mosaic: Image, cfa: Cfa) -> Image:
    """Return mosaics (..., H, W) packed as (..., C, h, w), extended by zeros to whole periods on all sides.

    Raises
    ------
    ArgumentError
        If there are fewer than two dimensions, or the CFA is unsupported.
    """
    if mosaic.ndim < 2:
        raise ArgumentError(f"expected mosaics (..., H, W); found shape {tuple(mosaic.shape)}")
    sites = packing_sites(cfa)
    top, left = -sites.top % sites.period, -sites.left % sites.period
    height, width = (
        -(-(first + side) // sites.period) for first, side in ((top, mosaic.shape[-2]), (left, mosaic.shape[-1]))
    )
    leading: tuple[int, ...] = tuple(mosaic.shape[:-2])
    whole: Image = _zeros(mosaic, (*leading, height * sites.period, width * sites.period))
    whole[..., top : top + mosaic.shape[-2], left : left + mosaic.shape[-1]] = mosaic
    packed: Image = _zeros(mosaic, (*leading, sites.channels, height * sites.sub, width * sites.sub))
    for in_mosaic, in_packed in sites.slices:
        packed[in_packed] = whole[in_mosaic]
    return packed


def region_anywhere(
    what: str, shape: tuple[int, int], cfa: Cfa, packed: tuple[int, int, int], generator: np.random.Generator
) -> tuple[int, int, int, int]:
    """Return a region (top, left, height, width) of packed data, drawn in step with the CFA.

    Raises
    ------
    ArgumentError
        If ``packed`` (C, h, w) is not within the sensor, (H, W) ``shape``; the message begins with ``what``.
    """
    whole, step = packed_shape(shape, cfa), packing_sites(cfa).sub
    _, height, width = packed
    fits = packed[0] == whole[0] and height <= whole[1] and width <= whole[2]
    if not fits or height % step or width % step:
        raise ArgumentError(f"{what} crops of {whole} packed pixels or less, and none of {packed}")
    top, left = (
        step * int(generator.integers((of_all - side) // step + 1))
        for of_all, side in zip(whole[1:], packed[1:], strict=True)
    )
    return top, left, height, width


def unpack_whole(packed: Image, cfa: Cfa, shape: tuple[int, int]) -> Image:
    """Undo :func:`pack_whole` for mosaics of ``shape`` (H, W)."""
    sites = packing_sites(cfa)
    height, width = (side // sites.sub * sites.period for side in packed.shape[-2:])
    whole: Image = _zeros(packed, (*tuple(packed.shape[:-3]), height, width))
    for in_mosaic, in_packed in sites.slices:
        whole[in_mosaic] = packed[in_packed]
    top, left = -sites.top % sites.period, -sites.left % sites.period
    cropped: Image = whole[..., top : top + shape[0], left : left + shape[1]]
    return cropped


def _zeros(like: Any, shape: tuple[int, ...]) -> Any:
    return np.zeros(shape, like.dtype) if isinstance(like, np.ndarray) else like.new_zeros(shape)
