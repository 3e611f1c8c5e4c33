"""The Tukey-lambda fit against scipy, and what its corrections are for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from eldata.calibration import ResidualHistogram, power_spectrum, ppcc, read_noise
from eldata.calibration.tukey_lambda import ResidualModel, tukey_lambda_tail
from eldata.errors import DatasetError
from tests.calibration.in_memory import stacked, summed
from tests.calibration.simulation import XTRANS, Body, Camera


def integers(shape: float, scale: float, size: int, seed: int = 0) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    draws = stats.tukeylambda.rvs(shape, scale=scale, size=size, random_state=np.random.default_rng(seed))
    return np.rint(draws).astype(np.int64)


def counted(values: np.ndarray[tuple[int], np.dtype[np.int64]]) -> ResidualHistogram:
    half = int(np.abs(values).max()) + 1
    counts = np.stack([np.bincount(part + half, minlength=2 * half + 1) for part in np.array_split(values, 20)])
    return ResidualHistogram(counts, 1.0, rounding_dn=0.0)


@pytest.mark.parametrize("shape", [-0.3, -0.05, -1e-3, 0.0, 1e-10, 1e-3, 0.14, 0.4, 1.0])
def test_the_tail_is_scipys(shape: float) -> None:
    x = np.array([-30.0, -2.0, 0.0, 0.3, 1.0, 2.4, 6.0, 40.0])
    ours = [tukey_lambda_tail(float(value), shape) for value in x]
    np.testing.assert_allclose(ours, stats.tukeylambda(shape).sf(x), rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize(("shape", "sigma"), [(-0.2, 1.3), (0.14, 0.7), (0.0, 20.0)])
def test_the_model_of_a_residual_is_that_of_simulated_ones(shape: float, sigma: float) -> None:
    """Residuals of 5 frames and rows of 30 pixels, two million: P beyond each edge within 5 standard errors."""
    generator = np.random.default_rng(4)
    count = 400_000 // 30
    noise = sigma * stats.tukeylambda.rvs(shape, size=(5, count, 30), random_state=generator)
    noise += generator.random(noise.shape) - 0.5
    noise -= noise.mean(axis=0)
    noise -= noise.mean(axis=2, keepdims=True)
    edges = np.std(noise) * np.array([0.0, 0.5, 1.0, 2.0, 3.0, 5.0])
    tails = ResidualModel(5, 30.0, 1.0).tails(edges, shape, sigma)
    for edge, tail in zip(edges, tails, strict=True):
        share = float((noise > edge).mean())
        assert abs(share - tail) < 5 * np.sqrt(tail / noise.size) + 1e-9


@pytest.mark.parametrize(("shape", "scale"), [(-0.1, 3.0), (0.08, 0.85), (0.14, 2.0)])
def test_as_accurate_as_scipys(shape: float, scale: float) -> None:
    """300 000 integers: the probability plots agree to 0.003; the likelihood finds the truth within 4 errors."""
    values = integers(shape, scale, 300_000)
    histogram = counted(values)
    found, slope, curve = ppcc(histogram.values_dn, histogram.counts.sum(axis=0))
    theirs = float(stats.ppcc_max(values, brack=(-0.3, 0.3)))
    assert found == pytest.approx(theirs, abs=0.003)
    _, (their_slope, _, correlation) = stats.probplot(values, sparams=(theirs,), dist="tukeylambda")
    _, (_, _, normal) = stats.probplot(values)
    assert slope == pytest.approx(their_slope, rel=0.005)
    assert curve.shape == (2, 41)
    assert curve[1].max() <= 1
    read = read_noise(histogram)
    assert (read.r_squared_tl, read.r_squared_gauss) == pytest.approx((correlation**2, normal**2), abs=1e-3)
    assert abs(read.tukey_lambda - shape) < 4 * read.tukey_lambda_error < 0.02
    assert abs(read.sigma_tl_dn - scale) < 4 * read.sigma_tl_error_dn < 0.02 * scale


def test_values_that_end_below_do_not_enter() -> None:
    """Cut off at three standard deviations: what is above 0 tells lambda and both sigmas within four errors."""
    values = integers(-0.1, 3.0, 600_000)
    deviation = 3.0 * float(stats.tukeylambda(-0.1).std())
    histogram = counted(np.maximum(values, round(-3 * deviation)))
    assert abs(read_noise(histogram).tukey_lambda + 0.1) > 0.01
    found = read_noise(replace(histogram, is_cut=True))
    assert abs(found.tukey_lambda + 0.1) < 4 * found.tukey_lambda_error < 0.02
    assert abs(found.sigma_tl_dn - 3.0) < 4 * found.sigma_tl_error_dn < 0.1
    assert abs(found.sigma_gauss_dn - deviation) < 4 * found.sigma_gauss_error_dn < 0.1


def test_hot_pixels_do_not_enter_but_outliers_of_one_frame_do() -> None:
    camera = Camera(shape=(512, 768), hot_share=1e-3)
    body = Body(camera, np.random.default_rng(5))
    frames = body.bias_frames(8)
    for ray in (frames[3][100, 100], 16000):
        frames[3][100, 100] = ray
        fixed = stacked(camera, frames)
        assert not fixed.defects[100, 100]
        assert abs(read_noise(summed(fixed, frames).residuals()).tukey_lambda + 0.05) < 0.005


def test_the_histogram_is_that_of_plain_numpy() -> None:
    """In any order of the frames, to the bit: counts are of integers."""
    camera = Camera(shape=(64, 96), hot_share=0.0)
    frames = Body(camera, np.random.default_rng(7)).bias_frames(6)
    fixed = stacked(camera, frames)
    histogram, backwards = (summed(stacked(camera, order), order).residuals() for order in (frames, frames[::-1]))
    np.testing.assert_array_equal(histogram.counts, backwards.counts)
    stack = np.stack(frames).astype(np.float64)
    stack -= stack.mean(axis=0)
    stack[:, fixed.defects] = np.nan
    for channel in range(4):
        chosen = stack[:, camera.channel == channel]
        stack[:, camera.channel == channel] = chosen - np.nanmean(chosen, axis=1, keepdims=True)
    stack -= np.nanmean(stack, axis=2, keepdims=True)
    values = stack[np.isfinite(stack)]
    total = histogram.counts.sum(axis=0)
    assert total.sum() == values.size
    assert total @ histogram.values_dn**2 / total.sum() == pytest.approx(values.var(), rel=0.01)
    below = np.cumsum(total)[total.size // 2 + 5] / total.sum()
    assert below == pytest.approx((values < 5.5 * histogram.cell_dn).mean(), abs=0.01)


def test_unusable_input() -> None:
    camera = Camera(shape=(64, 96))
    frames = Body(camera, np.random.default_rng(8)).bias_frames(4)
    with pytest.raises(DatasetError, match="add the same frames again"):
        summed(stacked(camera, frames), frames[:1]).residuals()
    single = np.zeros((1, 101), dtype=np.int64)
    single[0, 50] = 5000
    with pytest.raises(DatasetError, match="lost in rounding"):
        read_noise(ResidualHistogram(single, 1.0))
    with pytest.raises(DatasetError, match="256 x 256 pixels or more; found 64 x 96"):
        power_spectrum(frames[0], stacked(camera, frames))


# --- spectrum ---------------------------------------------------------------------------------------------------------

TILE = 256
QUIET = Camera(
    shape=(512, 768), sigma_tl=3.0, tukey_lambda=0.1, sigma_row=0.0, dsnu=0.0, column_pattern=0.0, hot_share=0.0
)


@pytest.mark.parametrize("cfa", [QUIET.cfa, XTRANS])
def test_one_tile_is_numpys(cfa: tuple[tuple[int, ...], ...]) -> None:
    """256 x 256 pixels: periodogram of the frame less the mean of each site, which stands for a hot pixel too."""
    camera = QUIET.with_(shape=(TILE, TILE), cfa=cfa, bias=QUIET.bias[: np.max(cfa) + 1])
    frames = Body(camera, np.random.default_rng(1)).bias_frames(4)
    for frame in frames:
        frame[7, 100] += 3000
    fixed = stacked(camera, frames)
    assert fixed.defects[7, 100]
    tile = np.where(fixed.defects, np.nan, frames[0])
    for row, column in np.ndindex(len(cfa), len(cfa)):
        tile[row :: len(cfa), column :: len(cfa)] -= np.nanmean(tile[row :: len(cfa), column :: len(cfa)])
    expected = np.abs(np.fft.fftshift(np.fft.fft2(np.nan_to_num(tile)))) ** 2 / TILE**2
    found = power_spectrum(frames[0], fixed)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * expected.mean())
