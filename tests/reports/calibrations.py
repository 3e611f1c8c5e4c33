"""Calibrations of small simulated frames, by the package's own estimators, for the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldata.calibration.camera import join_isos
from eldata.calibration.iso_results import IsoCalibration
from eldata.calibration.results import Calibration
from tests.calibration.in_memory import calibrated_arrays
from tests.calibration.simulation import Body, Camera

SHAPE = (264, 384)
LEVELS = (800.0, 3000.0, 7000.0, 12000.0)


def camera_at(iso: float, **changes: object) -> Camera:
    """A camera whose noise grows with its gain, K = ISO / 400."""
    gain = iso / 400
    camera = Camera(shape=SHAPE, gain=gain, sigma_tl=1.2 * gain**0.8, sigma_row=0.4 * gain**0.7)
    return camera.with_(**changes)


def measured(iso: float, camera: Camera, *, frames: int = 6, levels: Sequence[float] = LEVELS) -> IsoCalibration:
    """Measure one ISO; the last of six frames or more is kept out. What is found of the frames is left out."""
    body = Body(camera, np.random.default_rng(int(iso)))
    bias = body.bias_frames(frames)
    found = calibrated_arrays(camera.sensor, bias, body.flat_pairs(levels))
    return replace(found, iso=iso, findings=(), remarks=())


def calibration(isos: Sequence[IsoCalibration], camera: str = "TestCamera") -> Calibration:
    """Join ISOs to a calibration, as the package does."""
    return join_isos(camera, isos)
