"""Camera colour to sRGB, from the file's own matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError

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

    Raises
    ------
    ArgumentError
        If the matrix is not 3 x 3 finite numbers, gives sRGB white no response in a channel, or has no inverse.
    """
    matrix = np.asarray(xyz_to_camera, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ArgumentError(f"xyz_to_camera must be 3 x 3 finite numbers; found {xyz_to_camera}")
    srgb_to_camera = matrix @ SRGB_TO_XYZ
    white = srgb_to_camera.sum(axis=1, keepdims=True)
    scaled = srgb_to_camera / np.where(white > 0, white, 1)
    if not (white > 0).all() or np.linalg.matrix_rank(scaled) < 3:
        raise ArgumentError(
            f"xyz_to_camera {xyz_to_camera}: is not a camera's matrix; white must give every channel a response, and "
            "the channels must differ"
        )
    return np.linalg.inv(scaled)
