"""Frames of the known camera against closed forms; tolerances are multiples of standard errors of the stated n."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from eldata.demo.body import Body, FixedFeatures, KnownNoise, tukey_lambda_values
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


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


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


@in_one_test("shape", [-0.24, 0.0, 0.14])
def test_whole_dn_and_tails_of_bias_frames(shape: float) -> None:
    """Four frames of 0.4 megapixels: the share up to each DN, to one in ten thousand, within 5 standard errors."""
    noise = replace(NOISE, tukey_lambda=shape, sigma_row_dn=0.0, colour_bias_dn=(0.25,) * 4)
    even = replace(BAYER, black_level_dn=(512.0,) * 4)
    generator = rng(2)
    values = np.stack([body(even).bias_frame(noise, generator) for _ in range(4)]).astype(np.int64) - 512
    truth = stats.tukeylambda(shape, loc=0.25, scale=2.0)
    for probability in (1e-4, 1e-3, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 1 - 1e-4):
        edge = round(float(truth.ppf(probability)))
        expected = float(truth.cdf(edge + 0.5))
        error = math.sqrt(expected * (1 - expected) / values.size)
        assert abs(float((values <= edge).mean()) - expected) < 5 * error


# --- light ----------------------------------------------------------------------------------------------------------


def test_electrons_are_poisson() -> None:
    """K = 4 without other noise: whole electrons; chi-squared of their counts at 3 electrons, n = 393 216."""
    noise = replace(SILENT, gain_dn_per_e=4.0)
    even = replace(BAYER, black_level_dn=(512.0,) * 4)
    electrons, rest = np.divmod(body(even).flat_frame(noise, 12.0, rng(3)).astype(np.int64) - 512, 4)
    assert not rest.any()
    observed = np.bincount(electrons.ravel(), minlength=14)[:14]
    expected = stats.poisson.pmf(np.arange(14), 3) * electrons.size
    observed[13] += electrons.size - observed.sum()
    expected[13] = stats.poisson.sf(12, 3) * electrons.size
    assert stats.chisquare(observed, expected).pvalue > 1e-4


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


@pytest.mark.parametrize("sensor", [BAYER, FUJI], ids=["Bayer", "X-Trans"])
def test_a_mosaic_row_shares_one_normal_draw(sensor: Sensor) -> None:
    noise = replace(noise_of(sensor), sigma_row_dn=1.5, sigma_tl_dn=1.0)
    one = body(sensor)
    residual = one.bias_frame(noise, rng(6)) - one.offset_dn(noise)
    rows = residual.mean(axis=1)
    rest = noise.sigma_gauss_dn**2 / sensor.width
    assert rows.var() == pytest.approx(1.5**2 + rest, rel=5 * math.sqrt(2 / sensor.height))
    # All of a row's pixels share it, the columns' parities alike; neighbouring rows do not.
    assert np.corrcoef(residual[:, ::2].mean(axis=1), residual[:, 1::2].mean(axis=1))[0, 1] > 0.98
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


def test_the_pattern_is_the_same_in_every_frame() -> None:
    """Ten frames less the offset: what is left of the mean has the frames' own noise, no more."""
    # Without the shading: it goes along the rows, as their noise does, and the pixels would not be independent.
    one, generator = body(features=replace(PATTERN, bias_shading_dn=0.0)), rng(8)
    mean = np.mean([one.bias_frame(NOISE, generator) for _ in range(10)], axis=0)
    left = (mean - one.offset_dn(NOISE))[~one.hot]
    expected = (NOISE.sigma_gauss_dn**2 + 0.25 + 1 / 12) / 10
    assert left.var() == pytest.approx(expected, rel=0.02)
    assert abs(np.corrcoef(left, one.pattern_dn[~one.hot])[0, 1]) < 5 / math.sqrt(left.size)


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
