"""The quick look: it shows what the paper's pipeline shows, which is held against LibRaw (test_chart)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from eldata.demo.camera import CAMERAS
from eldata.errors import ArgumentError
from eldata.isp.rendering import Gamma, Rendering, preview, srgb_encode

SENSORS = {camera.name: camera.sensor for camera in CAMERAS}

# Which of R, G, B each packed channel shows.
COLOURS = {4: [0, 1, 2, 1], 9: [0, 1, 2, 0, 2, 1, 1, 1, 1]}


def test_srgb_encode_inverts_the_standards_decoding() -> None:
    encoded = np.linspace(0, 1, 1001)
    decoded = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    assert np.abs(srgb_encode(decoded) - encoded).max() < 1e-6


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("channels", [4, 9])
def test_it_is_the_rendering_in_linear_light_encoded_and_rounded(channels: int, name: str) -> None:
    """One value for each channel of a colour: the two clip before and after they average those."""
    sensor = SENSORS[name]
    colours = np.random.default_rng(0).uniform(-0.1, 1.1, (3, 30, 40)).astype(np.float32)
    image = preview(colours[COLOURS[channels]], sensor)
    packed = torch.from_numpy(colours[COLOURS[channels]]).double()
    linear = Rendering.of(sensor, Gamma(1))(packed).permute(1, 2, 0).numpy()
    assert image.shape == (30, 40, 3)
    assert image.dtype == np.uint8
    # In float32 a value within 1e-5 of the middle between two codes may fall on its other side.
    exact = 255 * srgb_encode(linear)
    assert np.abs(image - exact).max() < 0.5 + 1e-3


@pytest.mark.parametrize("channels", [4, 9])
@pytest.mark.parametrize("colour", [0, 1, 2])
def test_each_channel_shows_its_own_colour(colour: int, channels: int) -> None:
    """Without a matrix and a white balance, or a sensor, channels are the camera's own R, G and B."""
    packed = np.zeros((channels, 6, 8), np.float32)
    packed[[index for index, shown in enumerate(COLOURS[channels]) if shown == colour]] = 0.5
    expected = [0, 0, 0]
    expected[colour] = 188  # 255 * 0.7354
    for sensor in (replace(SENSORS["DemoAlpha"], white_balance=None, xyz_to_camera=None), None):
        assert (preview(packed, sensor) == expected).all()


@pytest.mark.parametrize("shape", [(3, 6, 8), (6, 8, 4), (6, 8), (1, 4, 6, 8), (12, 6, 8), (0,)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError) as caught:
        preview(np.zeros(shape, np.float32), SENSORS["DemoAlpha"])
    assert str(shape) in str(caught.value)
    assert "(4, h, w)" in str(caught.value)
