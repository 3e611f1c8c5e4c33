from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.color import rgb2xyz
from skimage.color.colorconv import xyz_from_rgb

from eldata.errors import ArgumentError
from eldata.isp import render_libraw
from eldata.raw import read_raw
from eldata.raw.colour import SRGB_TO_XYZ, camera_to_srgb
from eldata.records import Matrix3
from tests.raw.helpers import Tag, add_tags, random_mosaic, write_plain_dng

Array = NDArray[np.float64]

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


# --- AsShotWhiteXY ----------------------------------------------------------------------------------------------------

D50 = (0.3457, 0.3585)
AT_A, AT_D65 = (7, -2, -1, -4, 12, 2, -1, 2, 6), (9, -3, -1, -5, 13, 1, -1, 3, 5)  # tenths


def tenths(tag: int, numbers: Sequence[int]) -> Tag:
    return tag, "2i", len(numbers), tuple(part for number in numbers for part in (number, 10)), True


def share_of(kelvin: float) -> float:
    """Of the second of two matrices, for illuminant A (2850 K in the DNG SDK) and D65."""
    return (1 / kelvin - 1 / 2850) / (1 / 6500 - 1 / 2850)


def multipliers(white: tuple[float, float], matrix: Array) -> list[float]:
    x, y = white
    red, green, blue = matrix @ [x / y, 1, (1 - x - y) / y]
    return [green / red, 1, green / blue, 1]


@pytest.mark.parametrize(
    ("white", "share", "more", "scale"),
    [
        (D50, 0.0, [], np.eye(3)),  # one matrix
        ((0.4476, 0.4074), share_of(2856), [21], np.eye(3)),  # illuminant A
        ((0.3127, 0.3290), 1.0, [21], np.eye(3)),  # D65
        ((0.2990, 0.3149), 1.0, [21], np.eye(3)),  # D75, beyond it
        (D50, share_of(5003), [21], np.eye(3)),
        (D50, 0.0, [0], np.eye(3)),  # for a light that is not known
        (D50, 0.0, ["calibration", "signature"], np.eye(3)),  # of another profile
        (D50, 0.0, ["third"], None),
        (D50, 0.0, ["balance", "calibration"], np.diag([1.2, 1.0, 0.8]) @ np.diag([1.1, 1.0, 0.9])),
    ],
)
def test_a_white_point_gives_the_white_balance(
    white: tuple[float, float], share: float, more: Sequence[int | str], scale: Array | None, tmp_path: Path
) -> None:
    """DNG specification 1.7.1, chapter 6: AnalogBalance * CameraCalibration * ColorMatrix * XYZ is the neutral."""
    tags = [tenths(50721, AT_A), (50778, "H", 1, 17, True)]
    named: dict[int | str, Tag] = {
        "balance": (50727, "2I", 3, (12, 10, 1, 1, 8, 10), True),
        "calibration": tenths(50723, (11, 0, 0, 0, 10, 0, 0, 0, 9)),
        "signature": (50931, "s", 0, "another", True),
        "third": tenths(52531, AT_D65),
    }
    for name in more:
        tags += [named[name]] if name in named else [tenths(50722, AT_D65), (50779, "H", 1, name, True)]
    path = tmp_path / "a.dng"
    write_plain_dng(path, random_mosaic(64, 64), ("RG", "GB"), *tags)
    assert read_raw(path).sensor.white_balance is None
    add_tags(path, (50729, "2I", 2, (round(white[0] * 10**4), 10**4, round(white[1] * 10**4), 10**4), True))
    if scale is None:
        assert read_raw(path).sensor.white_balance is None
        return
    first, second = (np.array(numbers).reshape(3, 3) / 10 for numbers in (AT_A, AT_D65))
    expected = multipliers(white, scale @ ((1 - share) * first + share * second))
    found = read_raw(path).sensor.white_balance
    # McCamy's temperature is off by some kelvin, which moves the share by a thousandth.
    assert found == pytest.approx(expected, rel=1e-3)
    if 21 not in more:
        assert found == pytest.approx(expected, abs=1e-6)
    if not more:
        assert found == pytest.approx((2.495, 1, 1.636, 1), abs=5e-4)
    # LibRaw does not read the tag: its rendering is that of the same neutral.
    rendering = render_libraw(path)
    assert found is not None
    add_tags(path, (50728, "2I", 3, (10**9, round(found[0] * 10**9), 1, 1, 10**9, round(found[2] * 10**9)), True))
    # Multipliers in float32 against six decimals move a value by one of 65,536, and AHD's choices by a few.
    np.testing.assert_allclose(rendering.astype(float), render_libraw(path), rtol=0, atol=1)
