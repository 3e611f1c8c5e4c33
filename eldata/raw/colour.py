"""Camera colour to sRGB, from the file's own matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.records import Matrix3

# Linear sRGB to CIE XYZ (D65), IEC 61966-2-1.
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def camera_to_srgb(xyz_to_camera: Matrix3) -> NDArray[np.float64]:
    """Return the matrix (3, 3) from white-balanced camera R, G, B to linear sRGB.

    sRGB to camera is ``xyz_to_camera @ SRGB_TO_XYZ`` with each row scaled to sum to 1, so that sRGB white is
    camera white after white balance; the result is its inverse. That is dcraw's rule, which LibRaw follows.
    """
    srgb_to_camera = np.asarray(xyz_to_camera, dtype=np.float64) @ SRGB_TO_XYZ
    return np.linalg.inv(srgb_to_camera / srgb_to_camera.sum(axis=1, keepdims=True))
