from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rawpy

from eldata.demo.camera import CAMERAS
from eldata.errors import ArgumentError
from eldata.isp.rendering import preview, srgb_encode
from eldata.raw.dng import write_dng
from eldata.raw.levels import packed_frame
from eldata.raw.reading import read_raw
from eldata.records import Exposure, Sensor

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SENSORS = {camera.name: camera.sensor for camera in CAMERAS}
XTRANS = replace(SENSORS["DemoAlpha"], black_level_dn=(512.0,) * 3)

# Which of R, G, B each packed channel shows.
COLOURS = {4: [0, 1, 2, 1], 9: [0, 1, 2, 0, 2, 1, 1, 1, 1]}


def balanced(camera_rgb: tuple[float, float, float], sensor: Sensor, channels: int = 4) -> NDArray[np.float32]:
    """Packed data that is ``camera_rgb`` after white balance, everywhere."""
    assert sensor.white_balance is not None
    values = [camera_rgb[colour] / sensor.white_balance[colour] for colour in COLOURS[channels]]
    return np.broadcast_to(np.array(values, np.float32)[:, None, None], (channels, 6, 8)).copy()


# --- the transfer function ------------------------------------------------------------------------------------


def test_srgb_encode_inverts_the_standards_decoding() -> None:
    encoded = np.linspace(0, 1, 1001)
    decoded = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    assert np.abs(srgb_encode(decoded) - encoded).max() < 1e-6


# --- the rendering --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("channels", [4, 9])
@pytest.mark.parametrize("level", [0.01, 0.18, 0.5, 0.9])
def test_grey_is_neutral(level: float, channels: int, name: str) -> None:
    image = preview(balanced((level,) * 3, SENSORS[name], channels), SENSORS[name])
    assert image.shape == (6, 8, 3)
    assert image.dtype == np.uint8
    expected = 255 * float(srgb_encode(np.array(level)))
    assert np.abs(image.astype(float) - expected).max() <= 1


@pytest.mark.parametrize("value", [1.0, 5.0, 1e6])
def test_blown_highlights_are_white(value: float) -> None:
    assert (preview(np.full((4, 6, 8), value, np.float32), SENSORS["DemoAlpha"]) == 255).all()


@pytest.mark.parametrize("channels", [4, 9])
@pytest.mark.parametrize("colour", [0, 1, 2])
def test_each_channel_shows_its_own_colour(colour: int, channels: int) -> None:
    """Without a matrix and a white balance, channels are the camera's own R, G and B."""
    sensor = replace(XTRANS, white_balance=None, xyz_to_camera=None)
    packed = np.zeros((channels, 6, 8), np.float32)
    packed[[index for index, shown in enumerate(COLOURS[channels]) if shown == colour]] = 0.5
    expected = [0, 0, 0]
    expected[colour] = 188  # 255 * 0.7354
    assert (preview(packed, sensor) == expected).all()


@pytest.mark.parametrize("shape", [(3, 6, 8), (6, 8, 4), (6, 8), (1, 4, 6, 8), (12, 6, 8), (0,)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError) as caught:
        preview(np.zeros(shape, np.float32), SENSORS["DemoAlpha"])
    assert str(shape) in str(caught.value)
    assert "(4, h, w)" in str(caught.value)


# --- against LibRaw -------------------------------------------------------------------------------------------

PATCH = 32  # pixels of the mosaic
PATCHES = [
    (0.05, 0.05, 0.05), (0.18, 0.18, 0.18), (0.5, 0.5, 0.5), (0.85, 0.85, 0.85),
    (0.45, 0.35, 0.30), (0.20, 0.30, 0.45), (0.30, 0.40, 0.20), (0.55, 0.45, 0.20),
    (0.35, 0.25, 0.40), (0.02, 0.03, 0.04), (0.60, 0.55, 0.50), (1.00, 1.00, 1.00),
]  # fmt: skip
COLUMNS = 4


@pytest.mark.parametrize("name", SENSORS)
def test_rendering_is_that_of_libraw(name: str, tmp_path: Path) -> None:
    rows = len(PATCHES) // COLUMNS
    sensor = replace(SENSORS[name], height=rows * PATCH, width=COLUMNS * PATCH)
    assert sensor.white_balance is not None
    # Patches in camera colour after white balance; the last is blown in every channel and sets LibRaw's maximum.
    mosaic = np.zeros((sensor.height, sensor.width))
    for index, colour in enumerate(PATCHES):
        top, left = index // COLUMNS * PATCH, index % COLUMNS * PATCH
        for (y, x), channel in np.ndenumerate(np.array(sensor.cfa)):
            share = colour[[0, 1, 2, 1][channel]] / sensor.white_balance[channel]
            share = 1.0 if index == len(PATCHES) - 1 else share
            black = sensor.black_level_dn[channel]
            mosaic[top + y : top + PATCH : 2, left + x : left + PATCH : 2] = black + share * (
                sensor.white_level_dn - black
            )
    path = tmp_path / "patches.dng"
    write_dng(path, np.rint(mosaic).astype(np.uint16), sensor, Exposure())

    with rawpy.imread(str(path)) as raw:
        theirs = raw.postprocess(
            half_size=True, use_camera_wb=True, no_auto_bright=True, gamma=(2.4, 12.92), output_bps=8, user_flip=0
        )
    frame = read_raw(path)
    ours = preview(packed_frame(frame, levels="metadata", clip="both"), frame.sensor)

    assert ours.shape == theirs.shape
    half, edge = PATCH // 2, 3
    for index, _ in enumerate(PATCHES):
        top, left = index // COLUMNS * half, index % COLUMNS * half
        inner = (slice(top + edge, top + half - edge), slice(left + edge, left + half - edge))
        difference = np.abs(ours[inner].astype(int) - theirs[inner].astype(int))
        assert difference.max() <= 3, f"patch {index}: {ours[inner][0, 0]} and {theirs[inner][0, 0]}"
