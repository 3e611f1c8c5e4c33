from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from eldata.demo.camera import BASE_ISO, CAMERAS, SimulatedCamera
from tests.cases import in_one_test

SIZE = (600, 512)
ALPHA, BETA = CAMERAS
CHANNELS = range(4)

# Linear sRGB to CIE XYZ (D65), IEC 61966-2-1.
XYZ_OF_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])

COLOURS = {"black": (0, 0, 0), "dark": (0.02,) * 3, "grey": (0.18,) * 3, "white": (0.9,) * 3, "skin": (0.6, 0.4, 0.3)}


def flat(colour: tuple[float, ...]) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.broadcast_to(np.array(colour, np.float32)[:, None, None], (3, *SIZE)).copy()


def expected_electrons(camera: SimulatedCamera, colour: tuple[float, ...], exposure: float, channel: int) -> float:
    """The closed form: white gives 0.9 of the range at the metered exposure and ISO 100, before white balance."""
    sensor = camera.sensor
    assert sensor.xyz_to_camera is not None
    assert sensor.white_balance is not None
    matrix = np.array(sensor.xyz_to_camera) @ XYZ_OF_SRGB
    response = (matrix / matrix.sum(axis=1, keepdims=True)) @ np.array(colour)
    span = sensor.white_level_dn - max(sensor.black_level_dn)
    share = response[[0, 1, 2, 1][channel]] / sensor.white_balance[channel]
    return float(0.9 * span / camera.base_gain_dn_per_e * exposure * share)


def sites(camera: SimulatedCamera, channel: int) -> tuple[slice, slice]:
    """Rows and columns of a channel, from the pattern."""
    ((row,), (column,)) = np.where(np.array(camera.sensor.cfa) == channel)
    return slice(row, None, 2), slice(column, None, 2)


@in_one_test("camera", CAMERAS)
@in_one_test("name", COLOURS)
def test_expected_electrons(camera: SimulatedCamera, name: str) -> None:
    electrons = camera.with_size(*SIZE).electrons(flat(COLOURS[name]), Fraction(1, 4))
    for channel in CHANNELS:
        found = electrons[sites(camera, channel)]
        assert np.ptp(found) == 0
        assert found[0, 0] == pytest.approx(expected_electrons(camera, COLOURS[name], 0.25, channel), rel=2e-3)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
@pytest.mark.parametrize(("iso", "name"), [(100, "skin"), (800, "grey"), (3200, "dark"), (3200, "black")])
def test_mean_and_variance_are_those_of_the_noise_model(camera: SimulatedCamera, iso: int, name: str) -> None:
    """mean = black + K I + K bias; variance = K^2 I + sigma_read^2 + sigma_row^2 + 1/12 (rounding)."""
    sensor = camera.sensor
    exposure = Fraction(1, 8) * BASE_ISO / iso  # the same brightness in DN at every ISO
    shot = camera.with_size(*SIZE)
    mosaic = shot.photograph(flat(COLOURS[name]), exposure, iso, np.random.default_rng(iso)).astype(np.float64)
    assert mosaic.max() < sensor.white_level_dn  # or the closed form would not hold
    assert mosaic.min() > 0
    gain = camera.base_gain_dn_per_e * iso / 100
    row = gain * camera.sigma_row_e
    for channel in CHANNELS:
        signal = mosaic[sites(camera, channel)]
        rows, count = signal.shape[0], signal.size
        electrons = expected_electrons(camera, COLOURS[name], float(exposure), channel)
        pixel = gain**2 * electrons + (gain * camera.sigma_read_e) ** 2 + camera.sigma_quantiser_dn**2 + 1 / 12
        mean = sensor.black_level_dn[channel] + gain * electrons + gain * camera.colour_bias_e[channel]
        # Five standard errors; the sites of a row share its noise. The matrix' digits add a thousandth of the signal.
        slack = 5 * np.sqrt(pixel / count + row**2 / rows)
        assert signal.mean() == pytest.approx(mean, abs=slack + 1e-3 * gain * electrons)
        fourth = gain**3 * electrons * gain  # a Poisson variable's excess over the normal's fourth moment
        error = np.sqrt((2 * pixel**2 + fourth) / count + 2 * row**4 / rows + 4 * row**2 * pixel / count)
        assert signal.var() == pytest.approx(pixel + row**2, abs=5 * error + 1e-3 * gain**2 * electrons)
        # The tolerance would notice if a part were missing that is larger than it.
        assert 5 * error < 0.1 * (pixel + row**2)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
def test_each_mosaic_row_has_one_draw_of_row_noise(camera: SimulatedCamera) -> None:
    """Shared by all sites of a row (both colours), independent between rows."""
    rows, columns = 2000, 512
    shot = camera.with_size(rows, columns)
    dark = np.zeros((3, rows, columns), np.float32)
    mosaic = shot.photograph(dark, Fraction(1), 3200, np.random.default_rng(5)).astype(np.float64)
    gain = camera.base_gain_dn_per_e * 32
    pixel = (gain * camera.sigma_read_e) ** 2 + camera.sigma_quantiser_dn**2 + 1 / 12
    for channel in CHANNELS:
        mosaic[sites(camera, channel)] -= mosaic[sites(camera, channel)].mean()
    means = mosaic.mean(axis=1)
    expected = (gain * camera.sigma_row_e) ** 2 + pixel / columns
    assert means.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / rows))
    assert means.var() > 5 * pixel / columns  # without row noise it would be pixel / columns
    even, odd = mosaic[:, 0::2].mean(axis=1), mosaic[:, 1::2].mean(axis=1)
    assert np.corrcoef(even, odd)[0, 1] > 0.8
    assert abs(np.corrcoef(means[:-1], means[1:])[0, 1]) < 5 / np.sqrt(rows)
    columns_variance = mosaic.mean(axis=0).var()
    assert columns_variance == pytest.approx(pixel / rows, rel=0.4)  # and none of columns
