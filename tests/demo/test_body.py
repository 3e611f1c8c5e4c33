"""Frames of simulated cameras against closed forms; tolerances are multiples of standard errors of the stated n."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from eldata.demo.body import Body, FixedFeatures, KnownNoise, tukey_lambda_values
from eldata.demo.camera import BASE_ISO, CAMERAS, SimulatedCamera
from eldata.records import Sensor
from tests.calibration.draws import BAYER_PHASES
from tests.calibration.simulation import XTRANS
from tests.cases import in_one_test

BAYER = Sensor("eldata", "Test", BAYER_PHASES[0], (512.0, 513.0, 510.0, 512.0), 16383.0, height=512, width=768)
FUJI = Sensor("eldata", "Test", XTRANS, (1024.0, 1024.0, 1024.0), 16383.0, height=510, width=768)
NOISE = KnownNoise(400, 0.5, -0.1, 2.0, 0.5, (1.5, -0.75, 0.5, -2.0))
SILENT = replace(NOISE, sigma_tl_dn=0.0, sigma_row_dn=0.0, colour_bias_dn=(0.0,) * 4)
PATTERN = FixedFeatures(
    prnu=0.01, dsnu_dn=0.8, column_pattern_dn=0.4, hot_share=1e-3, bias_shading_dn=1.5, vignetting=0.4
)
NONE = FixedFeatures()
rng = np.random.default_rng


def body(sensor: Sensor = BAYER, features: FixedFeatures = NONE, seed: int = 0) -> Body:
    return Body(sensor, features, rng(seed))


def noise_of(sensor: Sensor) -> KnownNoise:
    return replace(NOISE, colour_bias_dn=NOISE.colour_bias_dn[: len(sensor.black_level_dn)])


# --- read noise -----------------------------------------------------------------------------------------------------


@in_one_test("shape", [-0.24, -0.1, -1e-4, -1e-9, 0.0, 1e-12, 1e-4, 0.14, 0.2, 1.0])
def test_the_quantile_is_scipys(shape: float) -> None:
    u = np.array([1e-15, 1e-9, 1e-4, 0.2, 0.5, 0.7, 0.9999, 1 - 1e-9])
    np.testing.assert_allclose(
        tukey_lambda_values(u, shape), stats.tukeylambda.ppf(u, shape), rtol=2e-6, atol=1e-12 + 1e-7 * abs(shape)
    )


# --- light ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", [BAYER, FUJI], ids=["Bayer", "X-Trans"])
@pytest.mark.parametrize(("gain", "level"), [(0.095, 800.0), (6.0, 2000.0)])
def test_mean_and_variance_of_flats(sensor: Sensor, gain: float, level: float) -> None:
    """mean = black + bias + level; variance = K level + sigma_read^2 + sigma_row^2 + 1/12, within 5 standard errors."""
    noise = replace(noise_of(sensor), gain_dn_per_e=gain)
    one = body(sensor)
    frame = one.flat_frame(noise, level, rng(4)).astype(np.float64)
    pixel = gain * level + noise.sigma_gauss_dn**2 + 1 / 12
    for channel, (black, bias) in enumerate(zip(sensor.black_level_dn, noise.colour_bias_dn, strict=True)):
        values = frame[one.channel == channel]
        rows = sensor.height / (2 if sensor is BAYER else 1)
        assert values.mean() == pytest.approx(
            black + bias + level, abs=5 * math.sqrt(pixel / values.size + 0.25 / rows)
        )
        # Heavy tails and Poisson counts add less to the fourth moment than the normal's own 2 sigma^4.
        error = math.sqrt(4 * pixel**2 / values.size + 2 * 0.5**4 / rows + 4 * 0.25 * pixel / values.size)
        assert abs(values.var() - pixel - 0.25) < 5 * error < 0.1 * pixel


# --- rows -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [BAYER, FUJI, *CAMERAS], ids=["Bayer", "X-Trans", "DemoAlpha", "DemoBeta"])
def test_a_mosaic_row_shares_one_normal_draw(kind: Sensor | SimulatedCamera) -> None:
    if isinstance(kind, Sensor):
        sensor, noise, one = kind, replace(noise_of(kind), sigma_row_dn=1.5, sigma_tl_dn=1.0), body(kind)
        residual = one.bias_frame(noise, rng(6)) - one.offset_dn(noise)
        sigma_row, rest = 1.5, noise.sigma_gauss_dn**2 / sensor.width
    else:
        sensor, gain = kind.sensor, kind.gain_dn_per_e(3200)
        dark = np.zeros((3, sensor.height, sensor.width), np.float32)
        residual = kind.photograph(dark, Fraction(1), 3200, rng(5)).astype(np.float32)
        for channel in CHANNELS:
            residual[sites(kind, channel)] -= residual[sites(kind, channel)].mean()
        sigma_row = gain * kind.sigma_row_e
        rest = ((gain * kind.sigma_read_e) ** 2 + kind.sigma_quantiser_dn**2 + 1 / 12) / sensor.width
    rows = residual.mean(axis=1)
    assert rows.var() == pytest.approx(sigma_row**2 + rest, rel=5 * math.sqrt(2 / sensor.height))
    # All of a row's pixels share it, the columns' parities alike; neighbouring rows do not.
    shared = sigma_row**2 / (sigma_row**2 + 2 * rest)
    found = np.corrcoef(residual[:, ::2].mean(axis=1), residual[:, 1::2].mean(axis=1))
    assert found[0, 1] == pytest.approx(shared, abs=5 * (1 - shared**2) / math.sqrt(sensor.height))
    assert abs(np.corrcoef(rows[:-1], rows[1:])[0, 1]) < 5 / math.sqrt(sensor.height)
    assert stats.kstest(rows / rows.std(), stats.norm.cdf).statistic < 1.95 / math.sqrt(sensor.height)
    columns = residual - rows[:, None]
    assert columns.mean(axis=0).var() == pytest.approx(rest * sensor.width / sensor.height, rel=5 * math.sqrt(2 / 768))


# --- what stays -----------------------------------------------------------------------------------------------------


def test_the_pattern_has_the_features_strength() -> None:
    """Each alone, within 5 standard errors of a standard deviation: sigma / sqrt(2 n)."""
    pixels, columns = 512 * 768, 768
    assert body(features=FixedFeatures(prnu=0.01)).response.std() == pytest.approx(0.01, rel=5 / math.sqrt(2 * pixels))
    found = body(features=FixedFeatures(dsnu_dn=0.8)).pattern_dn
    assert found.std() == pytest.approx(0.8, rel=5 / math.sqrt(2 * pixels))
    found = body(features=FixedFeatures(column_pattern_dn=0.4)).pattern_dn
    assert np.ptp(found, axis=0).max() == 0
    assert found[0].std() == pytest.approx(0.4, rel=5 / math.sqrt(2 * columns))
    found = body(features=FixedFeatures(bias_shading_dn=2.0)).pattern_dn
    assert found[[0, 0, -1, 255], [0, -1, 0, 383]] == pytest.approx([0, 0, 4, 0], abs=0.01)
    hot = body(features=FixedFeatures(hot_share=0.01))
    assert hot.hot.mean() == pytest.approx(0.01, rel=5 / math.sqrt(0.01 * pixels))
    np.testing.assert_array_equal(hot.pattern_dn != 0, hot.hot)
    assert (hot.pattern_dn[hot.hot] > 0).mean() == pytest.approx(0.8, abs=5 * math.sqrt(0.16 / hot.hot.sum()))
    assert hot.pattern_dn.max() <= 3000
    assert hot.pattern_dn.min() >= -150


def test_hot_pixels_stay_at_every_iso_and_grow_with_the_root_of_the_gain() -> None:
    """Frames without noise: black, bias and the pattern, which is four times as strong at 16 times the gain."""
    one = body(features=replace(PATTERN, gain_dn_per_e=0.5))
    bias = (10.0, 20.0, 30.0, 40.0)
    levels = np.add(BAYER.black_level_dn, bias)[one.channel]
    for gain, scale in ((0.5, 1), (8.0, 4)):
        noise = replace(SILENT, gain_dn_per_e=gain, colour_bias_dn=bias)
        frame = one.bias_frame(noise, rng(9))
        np.testing.assert_allclose(frame, np.maximum(levels + scale * one.pattern_dn, 0), atol=0.501)
        bright = frame > levels + 50
        assert bright.sum() > 200  # of 393 hot ones on average, four in five of them bright
        assert (bright <= one.hot).all()


@pytest.mark.parametrize("sensor", [BAYER, FUJI], ids=["Bayer", "X-Trans"])
def test_the_true_bias_is_that_of_all_pixels(sensor: Sensor) -> None:
    """Six frames per channel: within 5 standard errors of the truth, which the shading moves by 0.5 DN."""
    noise = noise_of(sensor)
    one, generator = body(sensor, replace(PATTERN, gain_dn_per_e=0.5)), rng(10)
    mean = np.mean([one.bias_frame(noise, generator) for _ in range(6)], axis=0)
    for channel, (black, truth) in enumerate(zip(sensor.black_level_dn, one.colour_bias_dn(noise), strict=True)):
        chosen = one.channel == channel
        error = math.sqrt((0.25 / 255 + (noise.sigma_gauss_dn**2 + 0.1) / chosen.sum()) / 6)
        assert abs(mean[chosen].mean() - black - truth) < 5 * error
        sound = mean[chosen & ~one.hot].mean() - black - noise.colour_bias_dn[channel]
        assert sound == pytest.approx(0.5, abs=0.1)  # s / 3, and the columns'
        assert truth - noise.colour_bias_dn[channel] > 0.5 + sound


# --- range ----------------------------------------------------------------------------------------------------------


def test_frames_end_at_0_and_white() -> None:
    low = replace(BAYER, black_level_dn=(2.0,) * 4, white_level_dn=4000.0)
    dark = body(low).bias_frame(replace(NOISE, sigma_row_dn=0.0), rng(11))
    assert dark.dtype == np.uint16
    assert dark.shape == (512, 768)
    below = stats.tukeylambda(-0.1, scale=2.0).cdf(0.5 - 2 - np.array(NOISE.colour_bias_dn)).mean()
    assert (dark == 0).mean() == pytest.approx(below, abs=5 * math.sqrt(0.25 / dark.size))
    bright = body(low).flat_frame(NOISE, 50_000.0, rng(11))
    assert (bright == 4000).all()


# --- the cameras that photograph scenes ------------------------------------------------------------------------------

SIZE = (600, 512)
ALPHA, BETA = CAMERAS
CHANNELS = range(4)

# Linear sRGB to CIE XYZ (D65), IEC 61966-2-1.
XYZ_OF_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])

COLOURS = {"black": (0, 0, 0), "dark": (0.02,) * 3, "grey": (0.18,) * 3, "skin": (0.6, 0.4, 0.3)}


def lit(colour: tuple[float, ...]) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
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


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
@pytest.mark.parametrize(("iso", "name"), [(100, "skin"), (800, "grey"), (3200, "dark"), (3200, "black")])
def test_mean_and_variance_are_those_of_the_noise_model(camera: SimulatedCamera, iso: int, name: str) -> None:
    """mean = black + K I + K bias; variance = K^2 I + sigma_read^2 + sigma_row^2 + 1/12 (rounding)."""
    sensor = camera.sensor
    exposure = Fraction(1, 8) * BASE_ISO / iso  # the same brightness in DN at every ISO
    shot = camera.with_size(*SIZE)
    mosaic = shot.photograph(lit(COLOURS[name]), exposure, iso, np.random.default_rng(iso)).astype(np.float64)
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
