"""Camera colour to sRGB, from the file's own matrix; and white balance as a DNG holds it.

AsShotNeutral is the camera's response to a neutral colour in R, G, B: three fractions of 32 bits, known up to a common
factor, with one green for both (Adobe DNG specification 1.6). White balance is its inverse, R, G1, B, G2 over G1.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.tiff import RATIONAL, round_fraction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.records import Matrix3

# Temperatures of the sources of light, as EXIF numbers them: CIE's, and the DNG SDK's for the others.
_KELVIN = {17: 2850, 3: 2850, 24: 3200, 23: 5000, **dict.fromkeys((20, 1, 4, 9, 18), 5500)}
_KELVIN |= {**dict.fromkeys((21, 10, 19), 6500), **dict.fromkeys((22, 11), 7500)}
_KELVIN |= {2: 4150, 12: 6400, 13: 5050, 14: 4150, 15: 3525, 16: 2925}  # fluorescent lamps

# Linear sRGB to CIE XYZ (D65), IEC 61966-2-1.
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def camera_to_srgb(xyz_to_camera: Matrix3) -> NDArray[np.float64]:
    """Matrix (3, 3) from white-balanced camera R, G, B to linear sRGB.

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


# --- white balance ----------------------------------------------------------------------------------------------------


def neutral_of(white_balance: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Compute AsShotNeutral, green 1, from the multipliers of R, G1, B, G2; a DNG has no place for the last.

    Fractions whose parts do not fit 32 bits are rounded.

    Raises
    ------
    ArgumentError
        If a multiplier is not positive, or 2^32 times green's or the other way round, which no rounding mends.
    """
    shown = ", ".join(f"{float(value):.17g}" for value in white_balance)
    if not all(value > 0 for value in white_balance):
        raise ArgumentError(f"white_balance ({shown}): expected positive multipliers")
    red, blue = white_balance[0] / white_balance[1], white_balance[2] / white_balance[1]
    if not all(1 <= RATIONAL * value <= RATIONAL**2 for value in (red, blue)):
        raise ArgumentError(f"white_balance ({shown}): expected multipliers within 32 bits of green's")
    return round_fraction(1 / red, RATIONAL), Fraction(1), round_fraction(1 / blue, RATIONAL)


def neutral_of_white(
    x: float, y: float, lights: Sequence[tuple[int, NDArray[np.float64], NDArray[np.float64]]]
) -> NDArray[np.float64]:
    """Camera's response to a white of chromaticity x, y > 0: (3,), before the analog balance.

    ``CameraCalibration @ ColorMatrix @ XYZ``, both matrices interpolated between one or two ``lights`` (illuminant as
    EXIF numbers it, ColorMatrix, CameraCalibration) over the inverse of the white's temperature (DNG specification
    1.7.1, chapter 6), which McCamy's formula gives (Color Research and Application 17, 1992, p. 142).
    """
    n = (x - 0.3320) / (0.1858 - y or 1e-9)
    kelvin = ((449 * n + 3525) * n + 6823.3) * n + 5520.33
    (first, matrix, calibration), (second, other_matrix, other_calibration) = lights[0], lights[-1]
    cold, warm = _KELVIN.get(second, 0), _KELVIN.get(first, 0)
    if cold and warm and cold != warm and kelvin > 0:
        share = min(max((1 / kelvin - 1 / warm) / (1 / cold - 1 / warm), 0.0), 1.0)
        matrix = (1 - share) * matrix + share * other_matrix
        calibration = (1 - share) * calibration + share * other_calibration
    neutral: NDArray[np.float64] = calibration @ matrix @ np.array([x / y, 1.0, (1 - x - y) / y])
    return neutral
