from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from skimage.color import rgb2xyz
from skimage.color.colorconv import xyz_from_rgb

from eldata.errors import ArgumentError
from eldata.raw.colour import SRGB_TO_XYZ, camera_to_srgb

if TYPE_CHECKING:
    from eldata.records import Matrix3

# ColorMatrix (D65) of a Sony A7S II, a Nikon D850 and a Fujifilm X-T2 as LibRaw's table has them.
CAMERAS: dict[str, tuple[str, Matrix3]] = {
    "ILCE-7SM2": ("SONY", ((0.5838, -0.1430, -0.0246), (-0.3497, 1.1477, 0.2297), (-0.0748, 0.1885, 0.5778))),
    "NIKON D850": (
        "NIKON CORPORATION",
        ((1.0405, -0.3755, -0.1270), (-0.5461, 1.3787, 0.1793), (-0.1040, 0.2015, 0.6785)),
    ),
    "X-T2": ("FUJIFILM", ((1.1434, -0.4948, -0.1210), (-0.3746, 1.2042, 0.1903), (-0.0666, 0.1479, 0.5235))),
}


def test_srgb_primaries_are_those_of_scikit_image() -> None:
    np.testing.assert_allclose(SRGB_TO_XYZ, xyz_from_rgb, atol=1e-4)
    np.testing.assert_allclose(SRGB_TO_XYZ.sum(axis=1), rgb2xyz(np.ones((1, 1, 3)))[0, 0], atol=1e-4)


@pytest.mark.parametrize("model", CAMERAS)
def test_what_the_camera_sees_of_an_srgb_colour_comes_back(model: str) -> None:
    _, matrix = CAMERAS[model]
    linear = np.random.default_rng(0).uniform(0, 1, (100, 3))
    seen = linear @ (np.array(matrix) @ SRGB_TO_XYZ).T
    white = np.array(matrix) @ SRGB_TO_XYZ @ np.ones(3)
    np.testing.assert_allclose((seen / white) @ camera_to_srgb(matrix).T, linear, atol=1e-12)


def test_the_matrix_of_srgb_itself_is_the_identity() -> None:
    # A camera whose primaries are sRGB's: XYZ (D65) to linear sRGB as IEC 61966-2-1 prints it.
    xyz_to_srgb = ((3.2406, -1.5372, -0.4986), (-0.9689, 1.8758, 0.0415), (0.0557, -0.2040, 1.0570))
    np.testing.assert_allclose(camera_to_srgb(xyz_to_srgb), np.eye(3), atol=3e-4)


@pytest.mark.parametrize(
    "matrix",
    [
        ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),  # two channels alike
        ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),  # no response to white
        ((0.0, 0.0, 0.0),) * 3,
        ((float("nan"), 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((1.0, 0.0), (0.0, 1.0)),
    ],
)
def test_what_is_no_cameras_matrix_is_refused(matrix: Matrix3) -> None:
    with pytest.raises(ArgumentError, match="xyz_to_camera"):
        camera_to_srgb(matrix)
