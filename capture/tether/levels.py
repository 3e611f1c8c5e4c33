"""How bright a frame came out: one line for the terminal, and the level that flats are exposed for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from eldata.records import RawFrame

_STOPS: Final = 14  # one character each, up to saturation on the right
_DENSITY: Final = " .:-=+*#%@"
_CLIPPED: Final = 0.001  # of the range below the white level


@dataclass(frozen=True, slots=True)
class Levels:
    """How bright a frame is.

    Attributes
    ----------
    histogram
        How many pixels there are in each stop below saturation, which is on the right, by darker characters; what lies
        below fourteen stops is in the first.
    mean
        Of the brightest channel over black, as a share of the range.
    clipped
        Share of saturated pixels.
    """

    histogram: str
    mean: float
    clipped: float

    def __str__(self) -> str:
        return f"[{self.histogram}] {100 * self.mean:.3g} %, {100 * self.clipped:.2g} % clipped"


def levels_of(frame: RawFrame) -> Levels:
    """Return how bright a frame is."""
    from eldata.raw.cfa import pack, packed_black_level_dn

    sensor = frame.sensor
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn)
    packed = pack(frame.whole_dn("the look at a set's files"), sensor.cfa)
    share = (packed - black[:, None, None].astype(np.float32)) / (sensor.white_level_dn - float(black.max()))
    stops = np.log2(np.maximum(share, 2.0 ** -(_STOPS + 1)))
    counts, _ = np.histogram(np.clip(stops, 0.5 - _STOPS, -0.5), bins=_STOPS, range=(-_STOPS, 0))
    # By the root, so that a tenth of the pixels is seen beside the rest.
    dark = np.ceil(np.sqrt(counts / counts.max()) * (len(_DENSITY) - 1)).astype(int)
    return Levels(
        "".join(_DENSITY[index] for index in dark),
        float(share.mean(axis=(1, 2), dtype=np.float64).max()),
        float(np.mean(share >= 1 - _CLIPPED)),
    )
