"""A quick look at packed raw data in sRGB: binned, white-balanced, colour-corrected, gamma-encoded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError
from eldata.isp.steps import CHANNELS_OF_COLOUR
from eldata.raw.colour import camera_to_srgb
from eldata.raw.levels import packed_forms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.records import Sensor


_DARK, _BRIGHT, _MOST_BRIGHTER = 0.4, 0.6, 8.0


def srgb_encode(linear: NDArray[Any]) -> NDArray[Any]:
    """Return linear light in [0, 1] with the sRGB transfer function applied (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def brightening(reference: NDArray[Any]) -> float:
    """Return what a dark reference is to be multiplied by to be seen, rounded to two digits; 1 of a bright one."""
    light = float(np.quantile(reference, 0.99))
    if light >= _DARK or light <= 0:
        return 1.0
    return float(f"{min(_MOST_BRIGHTER, _BRIGHT / light):.2g}")


def preview(packed: NDArray[np.floating[Any]], sensor: Sensor | None) -> NDArray[np.uint8]:
    """Render packed raw data for viewing: one pixel per packed pixel, no demosaicing.

    Parameters
    ----------
    packed
        (C, h, w), normalised; values outside [0, 1] are clipped.
    sensor
        White balance and colour matrix; without them, or a sensor, the camera's own colours are shown.

    Returns
    -------
    ndarray
        (h, w, 3) uint8, sRGB.

    Raises
    ------
    ArgumentError
        If there are not 4, 9, 16 or 36 channels.
    """
    if packed.ndim != 3 or packed.shape[0] not in CHANNELS_OF_COLOUR:
        raise ArgumentError(f"expected packed data {packed_forms('({channels}, h, w)')}; found shape {packed.shape}")
    clipped = np.clip(packed, 0, 1)
    camera = np.stack([clipped[list(indices)].mean(axis=0) for indices in CHANNELS_OF_COLOUR[packed.shape[0]]])
    if sensor is not None and sensor.white_balance is not None:
        red, green, blue, _ = sensor.white_balance
        # Clipped at the level where the first channel saturates, so that blown highlights stay white.
        camera = np.minimum(camera * np.array([red, green, blue])[:, None, None], 1.0)
    if sensor is not None and sensor.xyz_to_camera is not None:
        camera = np.einsum("ij,jhw->ihw", camera_to_srgb(sensor.xyz_to_camera), camera)
    codes: NDArray[np.uint8] = np.rint(srgb_encode(np.clip(camera, 0, 1)) * 255).astype(np.uint8)
    return codes.transpose(1, 2, 0)
