"""What single frames show: R^2 as the paper takes it, against scipy's probability plots, and the power spectrum."""

from __future__ import annotations

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


def test_a_frame_smaller_than_a_tile_is_refused() -> None:
    camera = QUIET.with_(shape=(512, 254))
    frames = Body(camera, np.random.default_rng(6)).bias_frames(4)
    with pytest.raises(DatasetError, match="256 x 256 pixels or more; found 512 x 254"):
        power_spectrum(frames[0], stacked(camera, frames))
