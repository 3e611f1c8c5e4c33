"""The mosaic under packed data: its rows, and packing that loses no pixel.

:func:`eldata.raw.levels.pack` crops what does not fill a period. Here the mosaic is extended instead, and cropped again
on the way back: noise is wanted on every pixel.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.levels import packed_forms, packed_layouts, packing_sites

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.raw.levels import Cfa

Image = TypeVar("Image", "NDArray[Any]", "torch.Tensor")


@cache
def packed_rows(channels: int) -> tuple[NDArray[np.int64], int]:
    """Describe which mosaic rows lie under packed data with 4 (Bayer), 9 (X-Trans), 16 (quad) or 36 (nona) channels.

    Bayer: R and G1 share a row, B and G2 the other; quad and nona: the same, of each row of the blocks. Which come
    first depends on the phase and changes no statistic.

    Returns
    -------
    table, period
        (C, s, s) int64 and the mosaic rows per s packed rows: packed entry (c, y, x) lies in mosaic row
        ``(y // s) * period + table[c, y % s, x % s]``.

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
    return table, sites.period


def mosaic_rows(channels: int, height: int, width: int) -> NDArray[np.int64]:
    """Return the mosaic row of each entry of packed data (C, h, w)."""
    table, period = packed_rows(channels)
    sub = table.shape[1]
    y, x = np.arange(height)[:, None], np.arange(width)
    return np.asarray((y // sub) * period + table[:, y % sub, x % sub])


def pack_whole(mosaic: Image, cfa: Cfa) -> Image:
    """Pack mosaics (..., H, W) to (..., C, h, w), extended by zeros to whole periods on all sides.

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
