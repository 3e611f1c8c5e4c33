"""A colour chart photographed by real cameras' matrices: our rendering, LibRaw's and the chart's own colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
import torch
from numpy.typing import NDArray
from skimage.color import deltaE_ciede2000, rgb2lab, rgb2xyz

from eldata.isp.rendering import Gamma, Rendering, srgb_encode
from eldata.raw.dng import write_dng
from eldata.raw.levels import packed_area, packed_frame
from eldata.raw.reading import read_raw
from eldata.records import Sensor
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, Cfa, make_sensor
from tests.raw.test_colour import CAMERAS

Floats = NDArray[np.float64]

# The 24 patches of the ColorChecker Classic in 8-bit sRGB, as its maker publishes them.
CHART = np.array([
    (115, 82, 68), (194, 150, 130), (98, 122, 157), (87, 108, 67), (133, 128, 177), (103, 189, 170),
    (214, 126, 44), (80, 91, 166), (193, 90, 99), (94, 60, 108), (157, 188, 64), (224, 163, 46),
    (56, 61, 150), (70, 148, 73), (175, 54, 60), (231, 199, 31), (187, 86, 149), (8, 133, 161),
    (243, 243, 242), (200, 200, 200), (160, 160, 160), (122, 122, 121), (85, 85, 85), (52, 52, 52),
]) / 255  # fmt: skip
ROWS, COLUMNS = 4, 6
WHITE_BALANCE = (2.1, 1.0, 1.5, 1.0)
WHITE_DN = 16300.0


def photographed(cfa: Cfa, matrix: Any, patch: int) -> tuple[Sensor, NDArray[np.uint16]]:
    """The chart as a sensor of this CFA and matrix sees it, white just filling the range, rounded to DN."""
    bayer = len(cfa) == 2
    black = (512.0, 509.0, 511.0, 514.0) if bayer else (1024.0,) * 3
    sensor = make_sensor(
        cfa,
        ROWS * patch,
        COLUMNS * patch,
        black_level_dn=black,
        white_level_dn=WHITE_DN,
        white_balance=WHITE_BALANCE,
        xyz_to_camera=matrix,
    )
    xyz = rgb2xyz(CHART[None])[0]
    white = rgb2xyz(np.ones((1, 1, 3)))[0, 0]
    camera = (xyz @ np.array(matrix).T) / (np.array(matrix) @ white)
    assert camera.min() > 0
    assert camera.max() <= 1
    index = np.tile(np.array(cfa), (sensor.height // len(cfa) + 1, sensor.width // len(cfa) + 1))
    index = index[: sensor.height, : sensor.width]
    colour = np.array([0, 1, 2, 1])[index]
    rows, columns = np.indices(index.shape)
    signal = camera[rows // patch * COLUMNS + columns // patch, colour] / np.array(WHITE_BALANCE)[colour]
    levels = np.array(black)[index]
    return sensor, np.rint(levels + signal * (WHITE_DN - levels)).astype(np.uint16)


def patch_means(image: Floats, side: int, top: int = 0, left: int = 0) -> Floats:
    """Means of the middle halves of the patches, (24, 3); the image has lost rows and columns at its top and left."""
    edge = side // 4
    return np.array(
        [
            image[row * side + edge - top : (row + 1) * side - edge - top][
                :, column * side + edge - left : (column + 1) * side - edge - left
            ].mean(axis=(0, 1))
            for row in range(ROWS)
            for column in range(COLUMNS)
        ]
    )


def delta_e(first: Floats, second: Floats) -> Floats:
    difference: Floats = deltaE_ciede2000(rgb2lab(first[None]), rgb2lab(second[None]))[0]  # type: ignore[no-untyped-call]
    return difference


# X-Trans needs 512 pixels per side: LibRaw does not demosaic less.
MOSAICS = {name: (cfa, 32) for name, cfa in BAYER.items()} | {"xtrans-42": (XTRANS["xtrans-42"], 132)}
FIRST, *OTHERS = CAMERAS


@pytest.mark.parametrize(
    ("model", "mosaic_of"), [*((FIRST, name) for name in MOSAICS), *((model, "RGGB") for model in OTHERS)]
)
def test_the_chart(mosaic_of: str, model: str, tmp_path: Path) -> None:
    """One camera's matrix through every mosaic, the others' through one."""
    cfa, patch = MOSAICS[mosaic_of]
    sensor, mosaic = photographed(cfa, CAMERAS[model][1], patch)
    path = tmp_path / "chart.dng"
    write_dng(path, mosaic, sensor, EXPOSURE)
    frame = read_raw(path)
    packed = torch.from_numpy(packed_frame(frame, levels="metadata", clip="both")).double()
    scale = 2 if len(cfa) == 2 else 3
    area = packed_area(mosaic.shape, cfa)
    crop = {"top": area.top // scale, "left": area.left // scale}

    for response, libraw_gamma in ((Gamma(1), (1, 1)), (Gamma(2.2), (2.2, 0))):
        with rawpy.imread(str(path)) as raw:
            theirs = raw.postprocess(
                use_camera_wb=True,
                no_auto_bright=True,
                output_bps=16,
                gamma=libraw_gamma,
                adjust_maximum_thr=0.0,  # the file's white level, not the brightest pixel
                user_flip=0,
            )
        ours = Rendering.of(frame.sensor, response)(packed).permute(1, 2, 0).numpy()
        our_patches = patch_means(ours, patch // scale, **crop)
        their_patches = patch_means(theirs / 65535, patch)
        if response == Gamma(1):
            our_patches, their_patches = srgb_encode(our_patches), srgb_encode(their_patches)
            # Rounding to DN moves each channel by up to 0.5 DN: of the darkest patch, 250 DN above black in red, 0.2 %.
            # Red alone by that much is 38.7 * 0.33 * 0.002 * 0.21 in L* and 167 * 0.33 * 0.002 * 0.4 in a*: 0.05.
            # Three channels of different sign, worst case: 0.15.
            from_truth = delta_e(our_patches, CHART)
            assert from_truth.max() < 0.15
        # LibRaw scales every channel by one range, white less the least black level: 5 DN of 15791 too much or too
        # little where black levels differ, 0.03 % of a channel, at most 0.02 in delta E as above. It rounds to 16 bits
        # after white balance and after the matrix: 1 of 2200 in the darkest patch, below 0.01.
        difference = delta_e(our_patches, their_patches)
        assert difference.mean() < 0.015
        assert difference.max() < 0.03


def test_the_measure_sees_a_wrong_matrix() -> None:
    """A third of a percent in one channel is visible to it, so the bounds above say something."""
    moved = np.clip(CHART * [1.003, 1, 1], 0, 1)
    assert delta_e(moved, CHART).max() > 0.1
