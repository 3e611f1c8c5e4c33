"""The two passes over bias frames, and one over flats, as a caller would run them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.calibration import (
    BiasStack,
    ChannelMeans,
    ClippedValues,
    ColourBias,
    Finding,
    FixedPattern,
    FlatPairs,
    LineMeans,
    PhotonTransfer,
    ReadNoise,
    Residuals,
    RowNoise,
    clipped_fit,
    colour_bias,
    fixed_pattern,
    photon_transfer,
    read_noise,
    read_noise_findings,
    row_noise,
)
from eldata.calibration.core.clipped_figures import (
    clipped_bias,
    clipped_findings,
    clipped_read_noise,
    unclipped_pattern,
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
    fixed = stacked(camera, frames)
    lines, values = LineMeans(fixed), ClippedValues(fixed) if fixed.clips_at_black else Residuals(fixed)
    means = ChannelMeans(camera.cfa, defects=fixed.defects)
    for frame in frames:
        lines.add(frame)
        values.add(frame)
        means.add(frame)
    bias = colour_bias(means, [camera.black] * len(camera.bias))
    findings: tuple[Finding, ...] = ()
    if isinstance(values, ClippedValues):
        fit = clipped_fit(values, lines, means)
        read, bias, fixed = clipped_read_noise(fit), clipped_bias(fit, bias, fixed), unclipped_pattern(fixed, fit)
        findings = tuple(clipped_findings(fit, read, bias))
    else:
        read = read_noise(values.histogram())
    findings = (*findings, *read_noise_findings(read, bias, fixed.summary))
    return Calibration(fixed, row_noise(lines, read.response), read, bias, findings)


def transferred(
    body: Body, levels: Sequence[float], defects: NDArray[np.bool_] | None = None, drift: float = 0.0
) -> PhotonTransfer:
    camera = body.camera
    flats = FlatPairs(camera.cfa, [camera.black] * len(camera.bias), camera.white, defects=defects)
    for first, second in body.flat_pairs(levels, drift=drift):
        flats.add(first, second)
    return photon_transfer(flats)
