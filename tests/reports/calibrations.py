"""Calibrations of small simulated frames, by the package's own estimators, for the page."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.acceptance.reproduction import reproduction
from eldata.calibration.camera import joined
from eldata.calibration.core.bias_figures import BiasSums
from eldata.calibration.core.defects import BiasStack, fixed_pattern
from eldata.calibration.core.photon_transfer import FlatPairs, photon_transfer
from eldata.calibration.core.single_frame import FlatFrames, power_spectrum, single_frame_plot, spatial_photon_transfer
from eldata.calibration.iso_results import IsoCalibration
from eldata.records import Sensor
from tests.calibration.simulation import Body, Camera

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.core.photon_transfer import PhotonTransfer
    from eldata.calibration.results import Calibration

SHAPE = (264, 384)
LEVELS = (800.0, 3000.0, 7000.0, 12000.0)


def camera_at(iso: float, **changes: object) -> Camera:
    """A camera whose noise grows with its gain, K = ISO / 400."""
    gain = iso / 400
    camera = Camera(shape=SHAPE, gain=gain, sigma_tl=1.2 * gain**0.8, sigma_row=0.4 * gain**0.7)
    return camera.with_(**changes)


def measured(iso: float, camera: Camera, *, frames: int = 6, levels: Sequence[float] = LEVELS) -> IsoCalibration:
    """Measure one ISO as the package does; the last of six frames or more is kept out; without levels, no flats."""
    body = Body(camera, np.random.default_rng(int(iso)))
    channels = len(camera.bias)
    height, width = camera.shape
    sensor = Sensor("Test", "Camera", camera.cfa, (camera.black,) * channels, camera.white, height, width)
    bias = body.bias_frames(frames)
    held_out = bias.pop() if frames >= 6 else None
    stack = BiasStack(camera.cfa)
    for frame in bias:
        stack.add(frame)
    fixed = fixed_pattern(stack)
    sums = BiasSums(fixed)
    for frame in bias:
        sums.add(frame)
    sums.fixed_pattern()
    figures = sums.figures(sensor.black_level_dn)
    transfer, spatial = _transfers(body, sensor, levels) if levels else (None, None)
    found = IsoCalibration(
        iso=iso,
        sensor=sensor,
        bias_frames=len(bias),
        flat_frames=0 if transfer is None else transfer.frames,
        transfer=transfer,
        spatial=spatial,
        bias=figures.bias,
        rows=figures.rows,
        read=figures.read,
        plot=figures.plot,
        pattern=fixed.summary,
        spectrum_dn2=power_spectrum(bias[0], fixed),
        reproduction=None,
        single_frame=single_frame_plot(bias[0], fixed),
        remarks=(),
    )
    if held_out is None or found.parameters is None:
        return found
    compared = reproduction(held_out, fixed, sensor, found.parameters, np.random.default_rng(int(iso)))
    return replace(found, reproduction=compared)


def _transfers(body: Body, sensor: Sensor, levels: Sequence[float]) -> tuple[PhotonTransfer, PhotonTransfer]:
    pairs = FlatPairs(sensor.cfa, sensor.black_level_dn, sensor.white_level_dn)
    singles = FlatFrames(sensor.cfa, sensor.black_level_dn, sensor.white_level_dn)
    for first, second in body.flat_pairs(levels):
        pairs.add(first, second)
        singles.add(first)
        singles.add(second)
    return photon_transfer(pairs), spatial_photon_transfer(singles)


def calibration(isos: Sequence[IsoCalibration], camera: str = "TestCamera") -> Calibration:
    """Join ISOs to a calibration, as the package does."""
    return joined(camera, isos)
