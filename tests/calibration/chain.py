"""The two passes over bias frames, and one over flats, as a caller would run them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.calibration import (
    BiasStack,
    ChannelMeans,
    ColourBias,
    FixedPattern,
    FlatPairs,
    LineMeans,
    PhotonTransfer,
    ReadNoise,
    Residuals,
    RowNoise,
    colour_bias,
    fixed_pattern,
    photon_transfer,
    read_noise,
    row_noise,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from tests.calibration.simulation import Body, Camera


@dataclass(frozen=True)
class Calibration:
    fixed: FixedPattern
    rows: RowNoise
    read: ReadNoise
    bias: ColourBias


def stacked(camera: Camera, frames: Sequence[NDArray[np.uint16]]) -> FixedPattern:
    stack = BiasStack(camera.cfa)
    for frame in frames:
        stack.add(frame)
    return fixed_pattern(stack)


def calibrated(camera: Camera, frames: Sequence[NDArray[np.uint16]]) -> Calibration:
    fixed = stacked(camera, frames)
    lines, residuals = LineMeans(fixed), Residuals(fixed)
    means = ChannelMeans(camera.cfa, defects=fixed.defects)
    for frame in frames:
        lines.add(frame)
        residuals.add(frame)
        means.add(frame)
    black = [camera.black] * len(camera.bias)
    read = read_noise(residuals.histogram())
    return Calibration(fixed, row_noise(lines, read.response), read, colour_bias(means, black))


def transferred(
    body: Body, levels: Sequence[float], defects: NDArray[np.bool_] | None = None, drift: float = 0.0
) -> PhotonTransfer:
    camera = body.camera
    flats = FlatPairs(camera.cfa, [camera.black] * len(camera.bias), camera.white, defects=defects)
    for first, second in body.flat_pairs(levels, drift=drift):
        flats.add(first, second)
    return photon_transfer(flats)
