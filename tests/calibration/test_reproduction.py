"""The noise model with the right parameters makes frames like the camera's, with wrong ones it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from eldata.calibration import FixedPattern, Reproduction, reproduction
from eldata.noise import NoiseParameters
from tests.calibration.in_memory import stacked
from tests.calibration.simulation import XTRANS, Body, Camera

FRAMES = 8
SHAPE = (512, 768)
NO_PATTERN: dict[str, Any] = dict.fromkeys(("dsnu", "column_pattern", "hot_share"), 0.0)
CAMERAS = {
    "middle": Camera(shape=SHAPE),
    "heavy tails, no pattern": Camera(shape=SHAPE, tukey_lambda=-0.1, sigma_tl=6.0, sigma_row=1.5, **NO_PATTERN),
    "light tails, shading": Camera(shape=SHAPE, tukey_lambda=0.15, sigma_tl=3.0, shading=3.0, hot_share=1e-3),
    # Rounding leaves ripples, which the pixels' fixed levels blur.
    "quiet": Camera(shape=SHAPE, gain=0.4, tukey_lambda=0.11, sigma_tl=0.77, sigma_row=0.14, dsnu=0.38),
    "quiet, no pattern": Camera(shape=SHAPE, tukey_lambda=0.11, sigma_tl=0.77, sigma_row=0.14, **NO_PATTERN),
    "X-Trans": Camera(shape=(516, 768), cfa=XTRANS, bias=(1.0, -0.5, 0.3), shading=1.0),
}


def true_parameters(camera: Camera, **changes: float) -> NoiseParameters:
    bias = camera.bias if len(camera.bias) == 4 else (*camera.bias, camera.bias[1])
    values: dict[str, float] = {
        "gain_dn_per_e": camera.gain,
        "tukey_lambda": camera.tukey_lambda,
        "sigma_tl_dn": camera.sigma_tl,
        "sigma_gauss_dn": camera.noise.sigma_gauss_dn,
        "sigma_row_dn": camera.sigma_row,
        **changes,
    }
    return NoiseParameters(**values, colour_bias_dn=bias)  # type: ignore[arg-type] # four numbers


def taken(camera: Camera) -> tuple[NDArray[np.uint16], FixedPattern]:
    """A bias frame, and the fixed pattern of eight others."""
    *frames, last = Body(camera, np.random.default_rng(0)).bias_frames(FRAMES + 1)
    return last, stacked(camera, frames)


def compared(camera: Camera, **changes: float) -> Reproduction:
    held_out, fixed = taken(camera)
    return reproduction(held_out, fixed, camera.sensor, true_parameters(camera, **changes), np.random.default_rng(7))


@pytest.mark.parametrize("name", CAMERAS)
def test_the_truth_reproduces_the_camera(name: str) -> None:
    """393,000 pixels. The simulated camera shares no code with the noise model.

    Standard deviations of heavy-tailed residuals scatter by some 0.2 % here, those of 512 row means by 3.1 % each.
    1 - R^2 of the quantiles of two samples is on average what the variance of a quantile, u (1 - u) / n f^2, makes it.
    Their errors go together, as neighbouring quantiles share their extreme values: it scatters by a multiple.
    """
    camera = CAMERAS[name]
    found, noise = compared(camera), stats.tukeylambda(camera.tukey_lambda)
    quantiles = noise.ppf(found.levels)
    variances = found.levels * (1 - found.levels) / found.pixels / noise.pdf(quantiles) ** 2
    by_chance = float(2 * variances.sum() / ((quantiles - quantiles.mean()) ** 2).sum())
    assert found.pixels == pytest.approx(SHAPE[0] * SHAPE[1], rel=0.01)
    assert found.frames == FRAMES
    assert 1 - found.r_squared < 4 * by_chance
    assert found.r_squared > 0.995
    assert found.histogram_distance < 2 * found.histogram_distance_by_chance
    assert found.histogram_distance_by_chance < 0.015
    assert found.sigma_simulated_dn == pytest.approx(found.sigma_real_dn, rel=0.01)
    assert found.row_sigma_simulated_dn == pytest.approx(found.row_sigma_real_dn, rel=5 * 0.031 * 2**0.5)


def test_wrong_parameters_are_told_apart() -> None:
    """The shape shows in R^2, which no scale changes; scales in their own figures; all in the histogram."""
    right, shape, scale, rows = (
        compared(CAMERAS["middle"], **changes)
        for changes in ({}, {"tukey_lambda": 0.15}, {"sigma_tl_dn": 1.9}, {"sigma_row_dn": 1.5})
    )
    for wrong in (shape, scale, rows):
        assert wrong.histogram_distance > 2 * right.histogram_distance
        assert wrong.histogram_distance > 2 * wrong.histogram_distance_by_chance
        assert wrong.histogram_distance_by_chance < 0.015, "two simulations are still alike"
    assert shape.r_squared < right.r_squared - 0.005
    assert scale.r_squared > 0.997
    assert scale.sigma_simulated_dn / right.sigma_simulated_dn == pytest.approx(0.95, abs=0.02)
    assert rows.row_sigma_simulated_dn / right.row_sigma_simulated_dn == pytest.approx(3, rel=0.15)


def test_the_pieces_that_are_shown() -> None:
    """The middle of the frame, (128, 192): the real one is the frame itself less the black level."""
    camera = CAMERAS["middle"]
    held_out, fixed = taken(camera)
    found = reproduction(held_out, fixed, camera.sensor, true_parameters(camera), np.random.default_rng(7))
    np.testing.assert_array_equal(found.real_dn, held_out[192:320, 288:480] - 512.0)
    assert found.simulated_dn.shape == (128, 192)
    np.testing.assert_array_equal(found.simulated_dn, np.rint(found.simulated_dn))
    for channel in range(4):
        chosen = camera.channel[:128, :192] == channel
        # 5 standard errors of the mean of 64 rows of 96 pixels
        error = (camera.sigma_row**2 / 64 + (4 * camera.sigma_tl) ** 2 / (64 * 96)) ** 0.5
        assert found.simulated_dn[chosen].mean() == pytest.approx(camera.bias[channel], abs=5 * error)


@pytest.mark.parametrize("black", [(512.0, 513.0, 512.0, 513.0), (511.75, 512.0, 512.25, 513.5)])
def test_black_levels_by_channel_round_where_the_camera_does(black: tuple[float, ...]) -> None:
    """Their mean is not a whole DN, and noise of half a DN without fixed pattern shows where whole DN lie."""
    camera = CAMERAS["quiet, no pattern"].with_(sigma_tl=0.3)
    held_out, fixed = taken(camera)
    # The same frames, of which the file states other black levels: the colour bias makes up for them.
    sensor = replace(camera.sensor, black_level_dn=black)
    bias = tuple(camera.black + offset - level for offset, level in zip(camera.bias, black, strict=True))
    parameters = replace(true_parameters(camera), colour_bias_dn=bias)  # type: ignore[arg-type] # four numbers
    found = reproduction(held_out, fixed, sensor, parameters, np.random.default_rng(7))
    assert found.histogram_distance < 2 * found.histogram_distance_by_chance
    assert found.histogram_distance < 0.03, "rounded at the mean of the levels, it was 0.21"
