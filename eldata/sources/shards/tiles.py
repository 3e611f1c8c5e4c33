"""Where the tiles of a frame lie."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError, DatasetError
from eldata.raw.cfa import cfa_from, packed_area, packing_sites

if TYPE_CHECKING:
    from eldata.raw.cfa import CfaRows
    from eldata.records import Sensor


@dataclass(frozen=True, slots=True)
class Tile:
    """A part of a mosaic, in its pixels, and the CFA that it starts with."""

    top: int
    left: int
    height: int
    width: int
    cfa: CfaRows

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of the tile: ``mosaic[tile.slices]``."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def sensor(self, sensor: Sensor) -> Sensor:
        """Return a frame's sensor as that of the tile."""
        return replace(sensor, cfa=self.cfa, height=self.height, width=self.width)


def whole(sensor: Sensor) -> list[Tile]:
    """Return the one tile that is the whole frame, pixels that packing drops included."""
    return [Tile(0, 0, sensor.height, sensor.width, sensor.cfa)]


def grid(name: str, sensor: Sensor, tile: int, overlap: int) -> list[Tile]:
    """Return the tiles that cover all that packing keeps of a frame, row by row.

    Each has ``tile`` packed pixels a side and one period of the CFA more, so that a crop of the whole side can still be
    turned. They are spread evenly, the last of a row or column ends with the frame: most overlap by more.

    Parameters
    ----------
    name
        Of the frame, for errors.
    sensor
        Size and CFA.
    tile, overlap
        In packed pixels, even for X-Trans.

    Raises
    ------
    ArgumentError
        If a length is out of its range, or odd for X-Trans.
    DatasetError
        If the frame is smaller than a tile.
    """
    period = len(sensor.cfa)
    scale = packing_sites(sensor.cfa).scale
    if tile < 2 or not 0 <= overlap < tile:
        raise ArgumentError(f"tile must be 2 or more and overlap from 0 up to below it; found {tile}, {overlap}")
    side, stride = tile * scale, (tile - overlap) * scale
    if side % period or stride % period:
        raise ArgumentError(f"tile and overlap must be even for X-Trans; found {tile}, {overlap}")
    side += period
    area = packed_area((sensor.height, sensor.width), sensor.cfa)
    if side > min(area.height, area.width):
        raise DatasetError(
            f"{name}: {area.height} x {area.width} pixels are too few for a tile of {side} x {side} (tile={tile}); "
            "take smaller tiles, or whole frames"
        )
    cfa = cfa_from(sensor.cfa, area.top, area.left)
    starts = [_starts(length - side, stride, period) for length in (area.height, area.width)]
    return [Tile(area.top + top, area.left + left, side, side, cfa) for top, left in product(*starts)]


def _starts(last: int, stride: int, period: int) -> list[int]:
    """Return places from 0 to ``last``, spread evenly, at most a stride apart; all are multiples of the period."""
    steps = -(-last // stride)
    return [last // period * step // steps * period for step in range(steps)] + [last]
