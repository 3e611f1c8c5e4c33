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
from eldata.calibration.core.read_noise import read_noise_findings

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.calibration.core.findings import Figure
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
    """Of frames whose values do not end at 0."""
    fixed = stacked(camera, frames)
    sums = BiasSums(fixed)
    for frame in frames:
        sums.add(frame)
    found = sums.figures([camera.black] * len(camera.bias))
    assert found.read is not None
    findings = read_noise_findings(found.read, found.bias, found.rows.rows)
    return Calibration(fixed, found.rows, found.read, found.bias, findings)


def figures_of(found: Calibration, camera: Camera) -> dict[str, tuple[Figure, float, float, float, float]]:
    """Figures of bias frames: what each is withheld with, its value and error, the truth, the scale of allowances."""
    read, rows = found.read, found.rows.rows
    truth = camera.noise.sigma_gauss_dn
    return {
        "lambda": ("shape", read.tukey_lambda, read.tukey_lambda_error, camera.tukey_lambda, 1.0),
        "sigma_TL": ("shape", read.sigma_tl_dn, read.sigma_tl_error_dn, camera.sigma_tl, read.sigma_tl_dn),
        "sigma_G": ("read noise", read.sigma_gauss_dn, read.sigma_gauss_error_dn, truth, read.sigma_gauss_dn),
        "sigma_row": ("row noise", rows.sigma_dn, rows.sigma_error_dn, camera.sigma_row, rows.sigma_dn),
    }


def transferred(
    body: Body, levels: Sequence[float], defects: NDArray[np.bool_] | None = None, **options: Any
) -> PhotonTransfer:
    camera = body.camera
    flats = FlatPairs(camera.cfa, [camera.black] * len(camera.bias), camera.white, defects=defects)
    for first, second in body.flat_pairs(levels, **options):
        flats.add(first, second)
    return photon_transfer(flats)
