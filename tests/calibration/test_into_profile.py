"""What bias frames put into a profile beside their figures: each frame's colour bias."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.calibration.camera import joined
from eldata.noise import CameraProfile
from tests.calibration.in_memory import calibrated_arrays
from tests.calibration.simulation import XTRANS, Body, Camera

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.calibration import Calibration

FRAMES, DRAWS = 60, 4000
SHARED_DN, OWN_DN = 1.5, 0.75  # standard deviations over the frames: of all channels together, and of each


def drifting(camera: Camera, frames: int) -> tuple[list[NDArray[np.uint16]], NDArray[np.float64]]:
    """Bias frames whose channels drift, and the bias that each frame was given (frames, channels)."""
    generator = np.random.default_rng(5)
    body = Body(camera, generator)
    shift = SHARED_DN * generator.standard_normal((frames, 1))
    shift = shift + OWN_DN * generator.standard_normal((frames, len(camera.bias)))
    made = [np.rint(body.fixed + body.noise() + one[camera.channel]) for one in shift]
    return [np.maximum(frame, 0).astype(np.uint16) for frame in made], np.array(camera.bias) + shift


def profiled(camera: Camera, frames: list[NDArray[np.uint16]]) -> Calibration:
    found = calibrated_arrays(camera.sensor, frames, [])
    return joined("Simulated", [replace(found, stated_gain_dn_per_e=camera.gain)])


def test_the_spread_of_the_bias_comes_back_by_sampling(tmp_path: Path) -> None:
    """59 frames (one is kept out), 4000 draws.

    A standard deviation of n normal numbers scatters by 1 / sqrt(2 (n - 1)); that of the pixels and rows in a frame's
    own mean, 0.05 DN, adds a thousandth. The correlation r of two channels scatters by (1 - r^2) / sqrt(n - 1). Four of
    these errors.
    """
    camera = Camera(shape=(264, 384))
    frames, given = drifting(camera, FRAMES)
    profiled(camera, frames).profile.save(tmp_path / "p.json")
    profile = CameraProfile.load(tmp_path / "p.json")
    (row,) = profile.rows
    assert len(row.frame_bias_dn) == FRAMES - 1
    # Of each frame itself: the pattern of this specimen is in all frames alike.
    of_pattern = np.array(row.frame_bias_dn).mean(axis=0) - given[:-1].mean(axis=0)
    np.testing.assert_allclose(row.frame_bias_dn, given[:-1] + of_pattern, atol=0.3)
    generator = np.random.default_rng(0)
    drawn = np.array([profile.sample(generator, row="any").colour_bias_dn for _ in range(DRAWS)])
    error = math.hypot(1 / math.sqrt(2 * (FRAMES - 2)), 1 / math.sqrt(2 * DRAWS))
    assert drawn.std(axis=0, ddof=1) == pytest.approx(math.hypot(SHARED_DN, OWN_DN), rel=4 * error)
    correlation = 1 / (1 + (OWN_DN / SHARED_DN) ** 2)
    pairs = np.corrcoef(drawn.T)[np.triu_indices(4, 1)]
    assert pairs == pytest.approx(correlation, abs=4 * (1 - correlation**2) / math.sqrt(FRAMES - 2))
    # Of the frames' own mean, as the errors of 4000 draws allow.
    mean_error = math.hypot(SHARED_DN, OWN_DN) / math.sqrt(DRAWS)
    assert drawn.mean(axis=0) == pytest.approx(row.colour_bias_dn, abs=4 * mean_error)


@pytest.mark.parametrize(
    "camera",
    [Camera(shape=(264, 384), black=8.0, sigma_tl=3.0), Camera(shape=(264, 384), cfa=XTRANS, bias=(1.5, -0.75, 0.5))],
    ids=["black is clipped", "three channels"],
)
def test_frames_of_other_cameras(camera: Camera, tmp_path: Path) -> None:
    """Behind the clip the frames' biases are those of the fitted levels; one green stands for both.

    0.06 DN of pixels and rows are in a frame's mean: four and a half of these. Behind the clip, where levels are taken
    to move in proportion to means, drift of 5 DN over a black of 8 is off by 6 % more.
    """
    frames, given = drifting(camera, 12)
    found = profiled(camera, frames)
    found.profile.save(tmp_path / "p.json")  # and loaded: their mean is the row's bias
    (row,) = CameraProfile.load(tmp_path / "p.json").rows
    biases = np.array(row.frame_bias_dn)
    moved = given[:-1] - given[:-1].mean(axis=0)
    channels = [0, 1, 2, 3 if len(camera.bias) == 4 else 1]
    np.testing.assert_allclose(biases - biases.mean(axis=0), moved[:, channels], atol=0.27, rtol=0.06)
    assert any("clips at black" in remark for remark in found.all_remarks) == (camera.black < 100)
