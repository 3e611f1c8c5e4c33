"""The two passes over bias frames, and one over flats, as a caller would run them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.calibration import (
    BiasStack,
    BiasSums,
    ColourBias,
    Finding,
    FixedPattern,
    FlatPairs,
    PhotonTransfer,
    ReadNoise,
    RowNoise,
    fixed_pattern,
    photon_transfer,
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
    findings: tuple[Finding, ...]


def stacked(camera: Camera, frames: Sequence[NDArray[np.uint16]]) -> FixedPattern:
    stack = BiasStack(camera.cfa)
    for frame in frames:
        stack.add(frame)
    return fixed_pattern(stack)


def calibrated(camera: Camera, frames: Sequence[NDArray[np.uint16]]) -> Calibration:
    sums = BiasSums(stacked(camera, frames))
    for frame in frames:
        sums.add(frame)
    fixed = sums.fixed_pattern()
    found = sums.figures([camera.black] * len(camera.bias))
    return Calibration(fixed, found.rows, found.read, found.bias, found.findings)


def transferred(
    body: Body, levels: Sequence[float], defects: NDArray[np.bool_] | None = None, **options: Any
) -> PhotonTransfer:
    camera = body.camera
    flats = FlatPairs(camera.cfa, [camera.black] * len(camera.bias), camera.white, defects=defects)
    for first, second in body.flat_pairs(levels, **options):
        flats.add(first, second)
    return photon_transfer(flats)
