"""R^2 as the paper takes it, against scipy's probability plots of the same residuals, pixel by pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import stats

from eldata.calibration import single_frame_plot
from tests.calibration.chain import calibrated, stacked
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
    found = single_frame_plot(frames[0], fixed)
    residuals = residuals_of(frames[0], camera.channel, fixed.defects)
    _, (_, _, normal) = stats.probplot(residuals, dist="norm")
    _, (_, _, tukey) = stats.probplot(residuals, dist="tukeylambda", sparams=(found.tukey_lambda,))
    assert found.r_squared_gauss == pytest.approx(normal**2, abs=1e-3)
    assert found.r_squared_tl == pytest.approx(tukey**2, abs=2e-3)
    assert found.r_squared_tl >= found.r_squared_gauss - 1e-4
    if name == "heavy tails":
        assert found.tukey_lambda == pytest.approx(stats.ppcc_max(residuals, brack=(-0.3, 0.1)), abs=0.02)


def test_it_is_not_the_estimates_own() -> None:
    """Non-uniformity of Gaussian pixels' levels, larger than the noise, hides its tails from the published one."""
    camera = Camera(shape=SHAPE, tukey_lambda=-0.15, dsnu=12.0, hot_share=0.0)
    frames = Body(camera, np.random.default_rng(5)).bias_frames(5)
    published, own = single_frame_plot(frames[0], stacked(camera, frames)), calibrated(camera, frames).read
    assert published.r_squared_gauss > 0.995 > 0.98 > own.r_squared_gauss
    assert published.tukey_lambda > own.tukey_lambda + 0.1
