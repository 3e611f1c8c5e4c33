"""The audit of bias frames: faults are named, good frames are not, and what is given lies within its errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.calibration import bias_sums
from eldata.calibration.bias_sums import LAGS, BiasPairs, BiasStatistics
from eldata.calibration.iso_results import IsoCalibration
from tests.calibration.draws import drawn_camera
from tests.calibration.faults import Fault, blurred, coarse, corner_leak, digitised, mixed, plant
from tests.calibration.in_memory import calibrated, calibrated_arrays, figures_of, stacked
from tests.calibration.simulation import XTRANS, Body, Camera
from tests.cases import in_one_test

CAMERA = Camera(shape=(512, 768), shading=1.0)
OF_XTRANS = CAMERA.with_(shape=(516, 768), cfa=XTRANS, bias=(0.0, 0.5, -0.5))
EVEN = CAMERA.with_(dsnu=0.0, column_pattern=0.0, hot_share=0.0, shading=0.0)

# --- faults ---------------------------------------------------------------------------------------------------------


CHECKS = {"light", "correlated noise", "coarse values"}


def audited(camera: Camera, frames: Sequence[NDArray[np.uint16]]) -> tuple[IsoCalibration, dict[str, str]]:
    """One camera, and what each check of its bias frames does, but those of the fit."""
    record = calibrated(camera, frames)
    return record, {one.check: one.effect for one in record.findings if one.check in CHECKS}


@pytest.mark.parametrize(
    ("fault", "camera", "expected"),
    [
        (corner_leak(20.0), CAMERA, {"light": "withheld"}),
        (corner_leak(20.0), OF_XTRANS, {"light": "withheld"}),
        (corner_leak(3.0), CAMERA, {"light": "wider"}),
        (blurred(0.2), CAMERA, {"correlated noise": "withheld"}),
        (blurred(0.02), CAMERA, {"correlated noise": "wider"}),
        (mixed(0.02), OF_XTRANS, {"correlated noise": "wider"}),
        (coarse(2), CAMERA, {"coarse values": "wider"}),
        (coarse(4), CAMERA, {"coarse values": "withheld"}),
    ],
)
def test_a_fault_is_named(fault: Fault, camera: Camera, expected: dict[str, str]) -> None:
    """A camera of 0.4 megapixels and nine frames. Each figure that is given is within 4 of its errors of the truth."""
    record, effects = audited(camera, plant(fault, Body(camera, np.random.default_rng(0)), 9))
    assert effects == expected
    for name, (figure, truth) in figures_of(record, camera).items():
        assert figure is None or abs(figure.value - truth) < 4 * figure.error, name


def test_black_that_drifts_is_remarked() -> None:
    """By 0.4 DN from frame to frame; nine frames, so that their scatter is Student's of 8 degrees of freedom."""
    frames = Body(EVEN, np.random.default_rng(1)).bias_frames(10)
    drifting = [frame + np.rint(0.4 * number).astype(np.uint16) for number, frame in enumerate(frames)]
    without_flats = calibrated_arrays(EVEN.sensor, drifting, [])
    (remark,) = (remark for remark in without_flats.remarks if "black drifts" in remark)
    assert float(remark.split("uncertain by ")[1].split(" DN")[0]) == pytest.approx(
        0.4 * math.sqrt(7.5 / 9) * 2.306 / 1.96, rel=0.1
    )


# --- good frames ----------------------------------------------------------------------------------------------------


@in_one_test("seed", range(4))
def test_nothing_is_said_of_good_frames(seed: int) -> None:
    """Random cameras: Bayer and X-Trans, heavy and light tails, shading, hot pixels and fixed patterns."""
    generator = np.random.default_rng(seed)
    camera = drawn_camera(generator)
    frames = Body(camera, generator).bias_frames(int(generator.choice([4, 5, 9, 12])))
    assert audited(camera, frames)[1] == {}


def test_shading_and_noise_of_columns_are_no_fault() -> None:
    """30 DN of shading, with 2 DN of a pattern of pixels and of columns: nothing of that has noise of its own."""
    camera = CAMERA.with_(shading=30.0, dsnu=2.0, column_pattern=2.0, hot_share=3e-3)
    assert audited(camera, Body(camera, np.random.default_rng(3)).bias_frames(6))[1] == {}
    body = Body(CAMERA, np.random.default_rng(4))
    frames = [body.fixed + body.noise() + body.generator.normal(0, 0.5, (1, CAMERA.shape[1])) for _ in range(9)]
    assert audited(CAMERA, digitised(frames))[1] == {}


def statistics(frames: Sequence[NDArray[np.uint16]], camera: Camera = CAMERA) -> BiasStatistics:
    audit = BiasPairs(stacked(camera, frames))
    for frame in frames:
        audit.add(frame)
    return audit.statistics()


def test_correlations_are_plain_numpys() -> None:
    """Of two bands; the controls are means of products of pixels far apart. What row means took is put back."""
    bands = np.random.default_rng(9).integers(-40, 40, (2, 48, 240)).astype(np.int16)
    bands[:, 1:] += bands[:, :-1] // 8
    pairs = BiasPairs(stacked(CAMERA, Body(CAMERA, np.random.default_rng(9)).bias_frames(4)))
    for band in bands:
        pairs.add_neighbours(band)
    found, _ = pairs.correlation()
    wide = bands.astype(np.float64)

    def correlation(down: int, across: int) -> float:
        here = wide[:, : 48 - down, max(0, -across) : 240 - max(0, across)]
        there = wide[:, down:, max(0, across) : 240 + min(0, across)]
        own = 2 / 240 if (down, across % 2) == (0, 0) else 0.0
        return float((here * there).mean() / (wide**2).mean()) + own

    in_row, in_column = [(0, 36), (0, 48)], [(12, 0), (18, 0)]
    elsewhere = [(1, 36), (2, 36), (1, -36), (2, -36)]
    for (down, across), value in zip(LAGS.tolist(), found, strict=True):
        far = in_row if down == 0 else in_column if across == 0 else elsewhere
        expected = correlation(down, across) - float(np.mean([correlation(*lag) for lag in far]))
        assert value == pytest.approx(expected, abs=1e-12)
    assert found[np.equal(LAGS, (1, 0)).all(axis=1)][0] == pytest.approx(1 / 8, abs=0.05)


def test_blocks_are_plain_numpys() -> None:
    """Level of one half of the columns' periods, variance of the other, whose steps of sigma / 16 move it by 1 %."""
    frames = Body(CAMERA, np.random.default_rng(10)).bias_frames(8)
    found, fixed = statistics(frames), stacked(CAMERA, frames)
    assert found.variance.shape == found.level_dn.shape == (2, 10, 16)
    values, sound = np.stack(frames).astype(np.float64), ~fixed.defects
    is_odd = np.arange(CAMERA.shape[1]) // 2 % 2 == 1
    sigma = np.sqrt(np.array(fixed.temporal_variance_dn2))[CAMERA.channel]
    above = values.mean(axis=0) - np.array(fixed.level_dn)[CAMERA.channel]
    differences = (values[::2] - values[1::2]) / sigma / math.sqrt(2)
    for channel in range(4):
        chosen = CAMERA.channel == channel
        number = np.maximum((sound & chosen).sum(axis=1), 1)[:, None]
        differences -= (differences * (sound & chosen)).sum(axis=2, keepdims=True) / number * chosen
    squares = np.clip(differences, -4, 4) ** 2
    for half, row, column in ((0, 0, 0), (1, 3, 7), (0, 9, 15)):
        block = np.s_[48 * row : 48 * row + 48, 48 * column : 48 * column + 48]
        own, of_level = sound[block], is_odd[block[1]] == half
        assert found.level_dn[half, row, column] == pytest.approx(above[block][own & of_level].mean(), abs=1e-9)
        variance = squares[:, block[0], block[1]][:, own & ~of_level].mean()
        assert found.variance[half, row, column] == pytest.approx(variance, rel=0.01)
    shading = found.level_dn - found.level_dn.mean()
    assert np.abs(shading).max() == pytest.approx(1.5, abs=0.6)  # of y + x^2


def test_large_frames_are_looked_at_in_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = plant(corner_leak(20.0), Body(CAMERA, np.random.default_rng(12)), 6)
    whole = statistics(frames)
    monkeypatch.setattr(bias_sums, "_MOST_PIXELS", CAMERA.shape[0] * CAMERA.shape[1] // 3)
    part = statistics(frames)
    np.testing.assert_array_equal(part.level_dn, whole.level_dn[:, ::3])
    np.testing.assert_array_equal(part.variance, whole.variance[:, ::3])
    assert audited(CAMERA, frames)[1] == {"light": "withheld"}
