"""What single frames show: R^2 as the paper takes it, against scipy's probability plots, and the power spectrum."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import stats

from eldata.calibration import power_spectrum, single_frame_plot
from eldata.errors import DatasetError
from tests.calibration.chain import stacked
from tests.calibration.simulation import XTRANS, Body, Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

SHAPE = (252, 384)  # whole periods of X-Trans


def residuals_of(
    mosaic: NDArray[np.uint16], channel: NDArray[np.int64], defects: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The published way in plain numpy: off with the channels' means, then with the rows'."""
    values = np.ma.masked_array(mosaic.astype(np.float64), defects)
    for index in np.unique(channel):
        values[channel == index] -= values[channel == index].mean()
    return np.asarray((values - values.mean(axis=1, keepdims=True)).compressed())


CAMERAS = {
    "heavy tails": Camera(shape=SHAPE, tukey_lambda=-0.1, hot_share=0.0),
    "hot pixels": Camera(shape=SHAPE, hot_share=2e-4),
    "nearly normal, quiet": Camera(shape=SHAPE, tukey_lambda=0.14, sigma_tl=0.8, hot_share=0.0),
    "X-Trans": Camera(shape=SHAPE, cfa=XTRANS, bias=(1.5, -0.75, 0.5)),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_r_squared_is_that_of_every_pixel(name: str) -> None:
    """The cells, of a twentieth of a standard deviation, cost some 1e-4 of R^2."""
    camera = CAMERAS[name]
    frames = Body(camera, np.random.default_rng(3)).bias_frames(5)
    fixed = stacked(camera, frames)
    of_shape, of_normal, shape = single_frame_plot(frames[0], fixed)
    residuals = residuals_of(frames[0], camera.channel, fixed.defects)
    _, (_, _, normal) = stats.probplot(residuals, dist="norm")
    _, (_, _, tukey) = stats.probplot(residuals, dist="tukeylambda", sparams=(shape,))
    assert of_normal == pytest.approx(normal**2, abs=1e-3)
    assert of_shape == pytest.approx(tukey**2, abs=2e-3)
    assert of_shape >= of_normal - 1e-4
    if name == "heavy tails":
        assert shape == pytest.approx(stats.ppcc_max(residuals, brack=(-0.3, 0.1)), abs=0.02)


# --- spectrum ---------------------------------------------------------------------------------------------------------

TILE = 256
QUIET = Camera(
    shape=(512, 768), sigma_tl=3.0, tukey_lambda=0.1, sigma_row=0.0, dsnu=0.0, column_pattern=0.0, hot_share=0.0
)


def spectrum(camera: Camera, seed: int = 0) -> NDArray[np.float32]:
    frames = Body(camera, np.random.default_rng(seed)).bias_frames(4)
    return power_spectrum(frames[0], stacked(camera, frames))


def test_one_tile_is_numpys() -> None:
    """256 x 256 pixels, no defects: periodogram of the frame less the mean of each of its four sites."""
    camera = QUIET.with_(shape=(TILE, TILE))
    frames = Body(camera, np.random.default_rng(1)).bias_frames(4)
    fixed = stacked(camera, frames)
    assert not fixed.defects.any()
    tile = frames[0].astype(np.float64)
    for site in ((0, 0), (0, 1), (1, 0), (1, 1)):
        tile[site[0] :: 2, site[1] :: 2] -= tile[site[0] :: 2, site[1] :: 2].mean()
    expected = np.abs(np.fft.fftshift(np.fft.fft2(tile))) ** 2 / TILE**2
    found = power_spectrum(frames[0], fixed)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * expected.mean())


@pytest.mark.parametrize(("cfa", "bias"), [(QUIET.cfa, QUIET.bias), (XTRANS, (1.0, -0.5, 0.3))])
def test_row_noise_is_a_line_of_known_height(cfa: tuple[tuple[int, ...], ...], bias: tuple[float, ...]) -> None:
    """White noise s^2, row noise r^2: on the column of horizontal frequency 0, s^2 + 256 r^2.

    254 frequencies (0 and the highest belong to the sites' means) of 6 tiles, two of which side by side share their
    rows; 5 standard errors are 5 / sqrt(2 x 127).
    """
    camera = QUIET.with_(sigma_row=1.0, cfa=cfa, bias=bias, shape=(516, 768) if len(cfa) == 6 else (512, 768))
    found = spectrum(camera, 3)
    line, floor = found[:, TILE // 2], float(np.median(found)) / 0.945
    expected = floor + TILE
    inner = np.delete(line, [0, TILE // 2])
    assert float(inner.mean()) == pytest.approx(expected, rel=5 / math.sqrt(2 * 127))
    assert float(np.delete(found, [0, TILE // 2], axis=1).max()) < 5 * floor, "nothing beside it"


def test_defects_do_not_show() -> None:
    """A hot pixel of 3000 DN alone would lift the whole spectrum by 3000^2 / 256^2 = 137 DN^2."""
    camera = QUIET.with_(hot_share=1e-4)
    assert float(spectrum(camera).mean()) == pytest.approx(float(spectrum(QUIET).mean()), rel=0.05)


@pytest.mark.parametrize("shape", [(254, 512), (512, 254)])
def test_a_frame_smaller_than_a_tile_is_refused(shape: tuple[int, int]) -> None:
    camera = QUIET.with_(shape=shape)
    frames = Body(camera, np.random.default_rng(6)).bias_frames(4)
    with pytest.raises(DatasetError, match=f"256 x 256 pixels or more; found {shape[0]} x {shape[1]}"):
        power_spectrum(frames[0], stacked(camera, frames))
