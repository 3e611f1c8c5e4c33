"""Bias frames whose values end at 0: what comes back of the noise behind the clip, and what is not given."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from eldata.calibration import Residuals
from eldata.calibration.core._clipped_noise import ClippedNoise, laplace, normal
from eldata.calibration.core.findings import given
from eldata.calibration.core.row_noise import line_sums
from eldata.errors import DatasetError
from tests.calibration.chain import calibrated, figures_of, stacked
from tests.calibration.in_memory import calibrated_arrays
from tests.calibration.read_noise_study import REGIMES
from tests.calibration.simulation import XTRANS, Body, Camera

QUIET = Camera(shape=(96, 128), black=0.0, hot_share=0.0)


@pytest.mark.parametrize(("shape", "scale"), [(-0.2, 0.3), (0.2, 2.0), (0.0, 20.0)])
def test_mean_recorded_values(shape: float, scale: float) -> None:
    """Against sums of scipy's tails, far out by its expectation; the tails' own by quadrature of 21 normal nodes."""
    noise = ClippedNoise(shape, scale, -6 * scale, 9 * scale)
    law = stats.tukeylambda(shape, scale=scale)
    levels = np.array([-5.0, -0.3, 0.0, 0.4, 2.0, 8.0]) * scale
    whole = np.arange(1, math.ceil(3000 * scale))
    # The sum stops at 3000 scales; of the heaviest of these tails a ten-thousandth of a scale is left.
    summed = [float(law.sf(whole - 0.5 - level).sum()) for level in levels]
    np.testing.assert_allclose(noise.recorded(levels), summed, atol=2e-4 * scale)
    nodes, weights = normal(4 * scale**2)
    blurred = [float(law.sf(scale - nodes) @ weights)]
    np.testing.assert_allclose(noise.tails(np.array([scale]), (nodes, weights)), blurred, rtol=1e-5)


def test_pattern_distributions() -> None:
    """Variance, and the kurtosis that tells them apart."""
    for nodes, kurtosis in ((normal(2.0), 3.0), (laplace(2.0), 6.0)):
        values, weights = nodes
        assert weights.sum() == pytest.approx(1)
        assert weights @ values**2 == pytest.approx(2.0)
        assert weights @ values**4 == pytest.approx(kurtosis * 4.0)


@pytest.mark.parametrize(
    "name",
    [
        "heavy tails, clipped 2 %",
        "light tails, clipped 16 %",
        "strong pattern and rows, clipped 50 %",
        "quiet, clipped 70 %",
    ],
)
def test_noise_behind_the_clip(name: str) -> None:
    """Five stated errors: one figure in two million is further off. The limits are twice the errors of ten frames."""
    regime = REGIMES[name]
    body = Body(regime.camera, np.random.default_rng(31))
    found = calibrated(body.camera, body.bias_frames(10))
    most = {"lambda": 0.01, "sigma_TL": 0.02 * regime.sigma_tl, "sigma_G": 0.02 * regime.sigma_gauss}
    most |= {"sigma_row": 0.08 * regime.sigma_row, "colour bias": 0.05 * regime.sigma_gauss}
    of_bias = zip(found.bias.bias_dn, found.bias.standard_error_dn, body.colour_bias_dn, strict=True)
    figures: list[tuple[str, tuple[Any, float, float, float, float]]] = [
        *figures_of(found, body.camera).items(),
        *(("colour bias", ("colour bias", *one, 1.0)) for one in of_bias),
    ]
    for name, (figure, value, error, true, scale) in figures:
        one = given(found.findings, figure, value, error, scale)
        assert one is not None
        assert abs(one.value - true) < 5 * one.error, (name, one, true)
        assert error < most[name], (name, error)
    pattern = math.hypot(regime.dsnu, regime.camera.column_pattern)
    for dsnu, error in zip(found.fixed.summary.dsnu_dn, found.fixed.summary.dsnu_error_dn, strict=True):
        assert abs(dsnu - pattern) < 5 * math.hypot(error, 0.04 * pattern)  # that of 384 columns scatters by 4 %


def test_a_pattern_that_is_not_normal_is_in_the_errors() -> None:
    """Levels of a Laplace distribution, half as wide as the noise: as far as the error allows for."""
    camera = Camera(
        shape=(256, 384), black=0.0, bias=(2.0,) * 4, sigma_tl=1.5, dsnu=0.0, column_pattern=0.0, hot_share=0.0
    )
    generator = np.random.default_rng(5)
    body = Body(camera, generator)
    levels = generator.laplace(scale=1.4 / math.sqrt(2), size=camera.shape)
    frames = [np.rint(np.maximum(body.fixed + levels + body.noise(), 0)).astype(np.uint16) for _ in range(10)]
    found = calibrated(camera, frames)
    (wider,) = (one for one in found.findings if one.check == "pattern behind the clip" and "read noise" in one.figures)
    off = abs(found.read.tukey_lambda + 0.05)
    assert off > 5 * found.read.tukey_lambda_error
    assert off < 2 * math.hypot(found.read.tukey_lambda_error, wider.allowance) < 0.1


def test_a_tail_alone_is_withheld() -> None:
    camera = QUIET.with_(bias=(-2.5, 1.0, 1.0, 1.0), sigma_tl=1.5)
    found = calibrated(camera, Body(camera, np.random.default_rng(6)).bias_frames(6))
    assert found.findings[0].effect == "withheld"
    assert found.findings[0].figures == ("read noise", "row noise", "colour bias")
    assert "8" in found.findings[0].text.split("%")[0]


def test_next_to_nothing_above_black() -> None:
    camera = QUIET.with_(bias=(-1.6,) * 4, sigma_tl=0.5, dsnu=0.1, tukey_lambda=0.1)
    with pytest.raises(DatasetError, match="next to all values of the bias frames are 0"):
        calibrated(camera, Body(camera, np.random.default_rng(7)).bias_frames(5))


def test_residuals_do_not_show_clipped_noise() -> None:
    frames = Body(QUIET, np.random.default_rng(8)).bias_frames(4)
    fixed = stacked(QUIET, frames)
    assert fixed.clips_at_black
    residuals = Residuals(fixed)
    for frame in frames:
        residuals.add(frame, line_sums(frame, fixed))
    with pytest.raises(DatasetError, match="ClippedValues"):
        residuals.histogram()


@pytest.mark.parametrize("cfa", ["Bayer", "X-Trans"])
def test_an_iso_that_clips_at_black(cfa: str) -> None:
    """K from the same black, the frame kept out like simulated ones that clip, and no check of its own speaks."""
    camera = Camera(shape=(258, 384), black=0.0, bias=(1.5, 0.2, 0.9, -0.5), gain=2.0)
    if cfa == "X-Trans":
        camera = camera.with_(cfa=XTRANS, bias=(1.5, 0.2, 0.9))
    body = Body(camera, np.random.default_rng(9))
    flats = body.flat_pairs((1500.0, 5000.0, 9000.0, 12000.0), shaded=False)
    found = calibrated_arrays(camera.sensor, body.bias_frames(8), flats)
    assert {one.check for one in found.findings} - {"pattern behind the clip"} == {"clipped black"}
    assert found.single_frame is None
    assert found.gain is not None
    assert abs(found.gain.value - 2.0) < 5 * found.gain.error < 0.1
    assert found.colour_bias is not None
    for figure, true in zip(found.colour_bias, body.colour_bias_dn, strict=True):
        assert abs(figure.value - true) < 5 * figure.error < 0.5
    compared = found.reproduction
    assert compared is not None
    assert compared.histogram_distance < 3 * compared.histogram_distance_by_chance + 0.01
    assert compared.sigma_real_dn == pytest.approx(compared.sigma_simulated_dn, rel=0.03)
