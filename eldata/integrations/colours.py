"""A sensor's white balance and matrix as published code has them beside a frame: float32, nan where unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.raw.colour import camera_to_srgb

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.records import Sensor


def balance_multipliers(sensor: Sensor | None) -> NDArray[np.float32]:
    """Return the multipliers of R, G1, B and G2 as shot, G1 = 1: (4,); nan if the file states none."""
    stated = None if sensor is None else sensor.white_balance
    return np.array((np.nan,) * 4 if stated is None else tuple(map(float, stated)), np.float32)


def matrix_to_srgb(sensor: Sensor | None) -> NDArray[np.float32]:
    """Return the matrix from white-balanced camera R, G, B to linear sRGB: (3, 3); nan if the file states none."""
    if sensor is None or sensor.xyz_to_camera is None:
        return np.full((3, 3), np.nan, np.float32)
    return camera_to_srgb(sensor.xyz_to_camera).astype(np.float32)
