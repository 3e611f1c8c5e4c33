"""Defects, fixed pattern, row and column noise, colour bias, and the fit over the gain."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from eldata.calibration import RowNoise, colour_bias, fit_log_log, row_noise
from eldata.errors import ArgumentError, DatasetError
from tests.calibration.faults import digitised
from tests.calibration.in_memory import stacked, summed
from tests.calibration.simulation import BAYER, XTRANS, Body, Camera

CAMERA = Camera(shape=(512, 768))


def lines_of(frames: Sequence[NDArray[np.uint16]]) -> RowNoise:
    return row_noise(summed(stacked(CAMERA, frames), frames))


# --- defects ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cfa", "step"), [(BAYER, 1), (BAYER, 7), (XTRANS, 7)])
def test_the_stack_is_plain_numpys(
    cfa: tuple[tuple[int, ...], ...], step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of large frames a seventh of the rows tells the noise: each channel's own, so that a wrong row would show."""
    if step > 1:
        monkeypatch.setattr("eldata.calibration.defects._SQUARED_PIXELS", 0)
    camera = CAMERA.with_(shape=(300, 420), cfa=cfa, bias=(0.0,) * (np.max(cfa) + 1))
    sigma = 2.0 + camera.channel
    generator = np.random.default_rng(12)
    frames = [np.rint(generator.normal(500, sigma)).astype(np.uint16) for _ in range(5)]
    fixed = stacked(camera, frames)
    variance = np.stack(frames).var(axis=0, ddof=1, dtype=np.float64)
    np.testing.assert_array_equal(fixed.total_dn, np.sum(frames, axis=0))
    seventh = np.arange(300)[:, None] // len(cfa) % step == 0
    for channel in range(len(camera.bias)):
        chosen = (camera.channel == channel) & ~fixed.defects & seventh
        assert fixed.temporal_variance_dn2[channel] == pytest.approx(variance[chosen].mean(), rel=1e-12)
        assert variance[chosen].mean() == pytest.approx((2.0 + channel) ** 2, rel=0.1)


def test_hot_and_stuck_pixels_are_found() -> None:
    camera = CAMERA.with_(hot_share=2e-3, shading=5.0)
    body = Body(camera, np.random.default_rng(1))
    frames = body.bias_frames(8)
    for frame in frames:
        frame[10, 20] = 513  # stuck at a value that is not conspicuous
    fixed = stacked(camera, frames)
    bright = np.abs(body.fixed - np.median(body.fixed)) > 40
    assert bright.sum() > 500
    assert fixed.defects[bright].all()
    assert fixed.summary.stuck == 1
    assert fixed.defects[10, 20]
    assert (fixed.defects & ~body.hot).sum() < 20


@pytest.mark.parametrize("frames", [5, 20])
def test_non_uniformity_less_the_frames_noise(frames: int) -> None:
    """The plain standard deviation of the mean frame holds sigma / sqrt(n); what is left is the pattern's own."""
    camera = CAMERA.with_(column_pattern=0.0, hot_share=0.0, dsnu=0.6, tukey_lambda=0.1)
    fixed = stacked(camera, Body(camera, np.random.default_rng(2)).bias_frames(frames))
    for value, error in zip(fixed.summary.dsnu_dn, fixed.summary.dsnu_error_dn, strict=True):
        assert abs(value - 0.6) < 5 * error < 0.15
    assert float((fixed.total_dn[::2, ::2] / fixed.frames).std()) > 0.75


def test_shading_is_seen() -> None:
    camera = CAMERA.with_(shading=3.0, hot_share=0.0)
    fixed = stacked(camera, Body(camera, np.random.default_rng(3)).bias_frames(8))
    y, x = np.ogrid[-1:1:512j, -1:1:768j]
    truth = 3 * (y + x**2)
    truth = (truth - truth.mean()).reshape(16, 32, 24, 32).mean(axis=(1, 3))
    assert fixed.summary.shading_dn.shape == (4, 16, 24)
    for channel in range(4):
        error = math.sqrt((fixed.temporal_variance_dn2[channel] / 8 + 0.6**2) / 256)
        assert np.abs(fixed.summary.shading_dn[channel] - truth).max() < 8 * error + 0.3


def test_unusable_stacks() -> None:
    frames = Body(CAMERA, np.random.default_rng(4)).bias_frames(3)
    with pytest.raises(DatasetError, match="3 bias frames, and 4 are needed, 10 or more advised"):
        stacked(CAMERA, frames)
    with pytest.raises(DatasetError, match=r"have one value in every frame, 5.. DN most often"):
        stacked(CAMERA, [frames[0]] * 4)
    below = CAMERA.with_(black=0.0, bias=(-15.0,) * 4, hot_share=0.0)
    with pytest.raises(DatasetError, match="in every frame, 0 DN most often"):
        stacked(below, Body(below, np.random.default_rng(5)).bias_frames(4))


# --- rows ---------------------------------------------------------------------------------------------------------


def test_plain_row_means_are_biased() -> None:
    """Quiet rows: fixed pattern, and the pixels' share of the means, would double the figure."""
    camera = CAMERA.with_(sigma_row=0.06, shading=0.3)
    frames = Body(camera, np.random.default_rng(6)).bias_frames(10)
    rows = lines_of(frames).rows
    assert abs(rows.sigma_dn - 0.06) < 4 * rows.sigma_error_dn < 0.02
    plain = np.concatenate([frame.mean(axis=1) - frame.mean() for frame in frames]).std()
    assert plain > 2 * 0.06


def test_column_noise_and_fixed_columns() -> None:
    camera = CAMERA.with_(column_pattern=0.8, hot_share=0.0)
    generator = np.random.default_rng(7)
    body = Body(camera, generator)
    frames = digitised(body.fixed + body.noise() + generator.normal(0, 0.4, (1, 768)) for _ in range(10))
    found = lines_of(frames)
    assert abs(found.columns.sigma_dn - 0.4) < 4 * found.columns.sigma_error_dn < 0.05
    assert found.columns.fixed_sigma_dn == pytest.approx(0.8, rel=0.12)  # of 768 columns
    assert abs(found.rows.sigma_dn - 0.5) < 4 * found.rows.sigma_error_dn


def test_spectrum_normality_and_plot() -> None:
    """Against a direct transform of the line means, and scipy's test and plot."""
    frames = Body(CAMERA, np.random.default_rng(9)).bias_frames(6)
    rows = lines_of(frames).rows
    deviations = rows.deviations_dn
    k = np.arange(512)
    direct = np.exp(-2j * math.pi * 37 * k / 512) @ deviations.T
    assert rows.power_dn2[37] == pytest.approx((np.abs(direct) ** 2).mean() / 512 * 6 / 5)
    assert rows.frequency[37] == pytest.approx(37 / 512)
    assert rows.power_dn2[1:].mean() == pytest.approx(deviations.var() * 6 / 5, rel=0.05)
    values = deviations.ravel() * math.sqrt(6 / 5)
    assert rows.shapiro_values == values.size == 3072
    assert rows.shapiro_p == pytest.approx(stats.shapiro(values).pvalue, rel=1e-6)
    np.testing.assert_allclose(rows.ordered_dn, np.sort(values))
    assert rows.r_squared > 0.99


# --- colour bias --------------------------------------------------------------------------------------------------


def test_bias_per_frame_and_pooled() -> None:
    frames = Body(CAMERA, np.random.default_rng(13)).bias_frames(6)
    fixed, stack = stacked(CAMERA, frames), np.stack(frames)
    assert fixed.defects.any()
    means = summed(fixed, frames)
    noise = row_noise(means)
    found = colour_bias(means, noise, [512.0, 512.0, 510.0, 512.0])
    ratios = []
    for channel, (y, x) in enumerate([(0, 0), (0, 1), (1, 1), (1, 0)]):
        expected = stack[:, y::2, x::2].mean(axis=(1, 2)) - (510 if channel == 2 else 512)
        np.testing.assert_allclose(found.frame_bias_dn[:, channel], expected, atol=1e-9)
        assert found.bias_dn[channel] == pytest.approx(expected.mean())
        sound = stack[:, y::2, x::2][:, ~fixed.defects[y::2, x::2]].mean(axis=1)
        assert found.of_defects_dn[channel] == pytest.approx((expected + 512 - sound).mean() - 2 * (channel == 2))
        pixels = stack[0, y::2, x::2].size
        of_frame = noise.pixel_variance_dn2 / pixels + noise.rows.variance_dn2 / (CAMERA.shape[0] / 2)
        of_frame += max(noise.columns.variance_dn2, 0.0) / (CAMERA.shape[1] / 2)
        ratios.append((found.standard_error_dn[channel] ** 2 * 6 / of_frame, expected.var(ddof=1) / of_frame))
    errors, scatter = np.array(ratios).T
    assert errors == pytest.approx(max(scatter.mean(), 1.0), rel=2e-3)  # a thousandth of the pixels are defects
    assert found.frames == 6


# --- over the gain --------------------------------------------------------------------------------------------------


def test_the_line_is_scipys() -> None:
    generator = np.random.default_rng(15)
    gains = np.array([0.1, 0.2, 0.4, 0.8, 1.6, 3.2])
    scales = np.exp(0.5 * np.log(gains) + 0.3 + generator.normal(0, 0.1, 6))
    found = fit_log_log(gains.tolist(), scales.tolist())
    theirs = stats.linregress(np.log(gains), np.log(scales))
    assert found.fit.slope == pytest.approx(theirs.slope)
    assert found.fit.intercept == pytest.approx(theirs.intercept)
    assert found.slope_error == pytest.approx(theirs.stderr)
    assert found.intercept_error == pytest.approx(theirs.intercept_stderr)
    assert found.r_squared == pytest.approx(theirs.rvalue**2)
    assert found.fit.sigma == pytest.approx(theirs.stderr * math.sqrt(6) * np.log(gains).std())  # without a bias
    with pytest.raises(ArgumentError, match="in pairs, finite and above 0"):
        fit_log_log([1.0, 2.0, 3.0], [1.0, 2.0, 0.0])
    for same in ([1.0, 2.0], [2.0, 2.0, 2.0]):
        with pytest.raises(DatasetError, match="three ISOs of different gain"):
            fit_log_log(same, same)
