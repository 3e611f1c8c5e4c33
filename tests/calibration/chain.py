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
    colour_bias,
    fixed_pattern,
    photon_transfer,
    read_noise,
    row_noise,
)
from eldata.calibration.checks import read_noise_findings
from eldata.calibration.iso_results import IsoGain, MeasuredFigure
from eldata.records import Sensor
from tests.calibration.simulation import BAYER

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.calibration.iso_results import Quantity
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
    rows, read = row_noise(sums), read_noise(sums.residuals())
    bias = colour_bias(sums, rows, [camera.black] * len(camera.bias))
    return Calibration(fixed, rows, read, bias, read_noise_findings(read, bias, rows.rows))


def given(
    findings: Sequence[Finding], quantity: Quantity, value: float, error: float, scale: float
) -> MeasuredFigure | None:
    """A figure with what findings make of it; ``None`` if it is withheld."""
    one = IsoGain(iso=100.0, sensor=Sensor("", "", BAYER, (512.0,) * 4, 16383.0, 2, 2), findings=tuple(findings))
    figure = one.judge(quantity, MeasuredFigure("x", "x", value, error), scale)
    return None if figure.why_withheld else figure


def figures_of(found: Calibration, camera: Camera) -> dict[str, tuple[Quantity, float, float, float, float]]:
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
