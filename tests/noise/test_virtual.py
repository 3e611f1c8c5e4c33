"""Profiles from elsewhere: virtual cameras from LED's ranges, and the parameters that the ELD authors published."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from eldata.datasets import Arrays, SyntheticPairs
from eldata.errors import ArgumentError, ProfileError
from eldata.noise import LED_RANGES, CameraProfile, VirtualCameras, read_published, shipped_profiles
from eldata.noise.profile import LogLogFit
from eldata.noise.published import profiles_from_published
from tests.cases import in_one_test
from tests.noise.test_profile import FITS
from tests.shared import there

PARTS = ("slope", "intercept", "sigma")
FIGURES = [name for name in LED_RANGES.named() if not name.startswith(("gain", "colour_bias"))]


def figures(profile: CameraProfile) -> dict[str, float]:
    found = {f"{fit}.{part}": getattr(getattr(profile, fit), part) for fit, part in itertools.product(FITS, PARTS)}
    return found | {"tukey_lambda": profile.rows[0].tukey_lambda}


# --- the ranges -----------------------------------------------------------------------------------------------------


def test_leds_ranges_are_the_limits_of_the_cameras_that_eld_published() -> None:
    """One calibration a camera, to the digits of the shipped profiles; so LED made them, and so they can be checked."""
    profiles = [CameraProfile.load(name) for name in shipped_profiles() if "-" not in name]
    assert len(profiles) == 5
    found: dict[str, list[float]] = {}
    for profile in profiles:
        for name, value in figures(profile).items():
            found.setdefault(name, []).append(value)
    found["tukey_lambda"] = [row.tukey_lambda for profile in profiles for row in profile.rows]
    biases = np.array([row.colour_bias_dn for profile in profiles for row in profile.rows])
    found["colour_bias_dn"], found["colour_bias_spread_dn"] = biases.mean(1).tolist(), biases.std(1).tolist()
    named = LED_RANGES.named()
    assert named.pop("gain_dn_per_e") == (0.1, 30.0)  # not theirs: 0.09 to 28.6
    assert set(found) == set(named)
    for name, values in found.items():
        np.testing.assert_allclose(named[name], (min(values), max(values)), atol=2e-7, err_msg=name)


# --- what they cover ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 5, 64])
def test_camera_i_draws_from_the_ith_share(n: int) -> None:
    cameras = VirtualCameras(n, seed=3)
    for number, camera in enumerate(cameras):
        for name, value in figures(camera).items():
            low, high = LED_RANGES.named()[name]
            place = (value - low) / (high - low) * n
            assert number - 1e-9 <= place <= number + 1 + 1e-9, (name, number)
        assert camera.gain_range_dn_per_e == (0.1, 30.0)
    assert len({value for camera in cameras for value in figures(camera).values()}) == n * len(FIGURES)


def test_figures_are_uniform_over_their_ranges() -> None:
    """150 times 5 cameras, Kolmogorov-Smirnov; figures have their share in common, all but 1/25 of the variance."""
    cameras = [camera for seed in range(150) for camera in VirtualCameras(5, seed=seed)]
    for name in FIGURES:
        low, high = LED_RANGES.named()[name]
        places = (np.array([figures(camera)[name] for camera in cameras]) - low) / (high - low)
        assert stats.kstest(places, "uniform").pvalue > 1e-6, name
    together = np.corrcoef([[figures(camera)[name] for camera in cameras] for name in FIGURES])
    expected = 1 - 1 / 25
    others = together[np.triu_indices(len(FIGURES), 1)]
    assert np.abs(others - expected).max() < 5 * (1 - expected**2) / math.sqrt(750)


def test_colour_biases_are_those_of_the_ranges() -> None:
    """500 times 4 cameras of 16 rows: means and variances of each camera, within 5 standard errors of their laws.

    A row's mean over its channels is U(a, b) plus the mean of four normal draws of variance s^2, s being uniform in the
    camera's share; the variance of the channels around it has the mean s^2.
    """
    (low, high), (least, most) = LED_RANGES.colour_bias_dn, LED_RANGES.colour_bias_spread_dn
    for share in range(4):
        rows = [VirtualCameras(4, seed=seed)[share].rows for seed in range(500)]
        bias = np.array([[row.colour_bias_dn for row in of_camera] for of_camera in rows])
        assert bias.shape == (500, 16, 4)
        start, end = (least + (most - least) * (share + step) / 4 for step in (0, 1))
        squared, means = (start**2 + start * end + end**2) / 3, bias.mean(axis=2)  # E s^2
        for of_cameras, law in (
            (means.mean(axis=1), (low + high) / 2),
            (means.var(axis=1, ddof=1), (high - low) ** 2 / 12 + squared / 4),
            (bias.var(axis=2, ddof=1).mean(axis=1), squared),
        ):
            assert abs(of_cameras.mean() - law) < 5 * of_cameras.std() / math.sqrt(500)


# --- as cameras -----------------------------------------------------------------------------------------------------


def test_synthetic_pairs_take_them_and_say_which() -> None:
    """400 items of 5 cameras: each within 5 standard deviations of 80."""
    source = Arrays(np.full((1, 4, 16, 16), 0.3, np.float32), range_dn=15871.0)
    cameras = VirtualCameras(5, seed=2)
    dataset = SyntheticPairs(source, cameras, crop=8, crops_per_frame=400)
    found = list(dataset)
    for number, camera in enumerate(cameras):
        of_camera = [item for item in found if item["camera_id"] == number]
        assert {item["camera"] for item in of_camera} == {camera.camera}
        assert {item["tukey_lambda"] for item in of_camera} == {camera.rows[0].tukey_lambda}
        assert abs(len(of_camera) - 80) < 5 * math.sqrt(400 * 0.2 * 0.8)
    assert "virtual-1-of-5, virtual-2-of-5, ... 5 in all" in repr(dataset)
    again = SyntheticPairs(source, tuple(cameras), crop=8, crops_per_frame=400)
    assert torch.equal(again[7]["input"], found[7]["input"])
    with pytest.raises(ArgumentError, match="virtual-1-of-5 does not say which ISO its gains belong to; give a gain"):
        SyntheticPairs(source, cameras, iso=800)


def test_they_are_a_sequence_of_whole_profiles(tmp_path: Any) -> None:
    cameras = VirtualCameras(5, seed=1)
    assert len(cameras) == len(list(cameras)) == 5
    assert cameras[-1] == cameras[4]
    assert cameras[1:4] == tuple(cameras)[1:4]
    assert pickle.loads(pickle.dumps(cameras))[2] == cameras[2]
    with pytest.raises(ArgumentError, match="ranges must be a CameraRanges"):
        VirtualCameras(5, LED_RANGES.named())  # type: ignore[arg-type]
    for index in (5, -6):
        with pytest.raises(IndexError, match=rf"camera {index} of 5 virtual ones"):
            cameras[index]
    cameras[3].save(tmp_path / "virtual.json")
    assert CameraProfile.load(tmp_path / "virtual.json") == cameras[3]
    assert cameras[3].camera == "virtual-4-of-5"
    assert "Srameo/LED" in cameras[3].source
    assert repr(cameras).startswith("VirtualCameras(5, seed=1; LED (")


# --- refusals -------------------------------------------------------------------------------------------------------


@in_one_test(
    "change, words",
    [
        ({"gain_dn_per_e": (0, 30)}, "gain_dn_per_e must be finite and above 0"),
        ({"gain_dn_per_e": (30, 0.1)}, "gain_dn_per_e must be the lowest, then the highest"),
        ({"tukey_lambda": (-0.6, 0.2)}, "tukey_lambda must lie above"),
        ({"tukey_lambda": 0.2}, "tukey_lambda must be the lowest and the highest"),
        ({"colour_bias_spread_dn": (-1, 1)}, "colour_bias_spread_dn must not be negative"),
        ({"row_fit": (LogLogFit(1, 0, 0), LogLogFit(0, 0, 0))}, r"row_fit\.slope must be the lowest"),
        ({"rows": 0}, "rows must be 1 or more"),
    ],
)
def test_ranges_that_make_no_sense(change: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        dataclasses.replace(LED_RANGES, **change)


# --- published parameters: the JSON that numpy makes of a file, and the profiles in it ---------------------------

DOCUMENT = Path(__file__).parents[2] / "docs" / "noise.md"
SCALES = ("G_scale", "g_scale", "R_scale")  # of the Tukey-lambda read noise, the Gaussian one, and the rows

# --- the file -------------------------------------------------------------------------------------------------------


def test_the_documented_lines_make_the_json_that_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all that numpy may hold: arrays, also of no dimension, and scalars of its own types."""
    content = {
        "Kmin": np.float64(0.25),
        "Kmax": np.float32(16),
        "G_shape": np.array([0.1, 0.0, -0.2]),
        "color_bias": [np.arange(4, dtype=np.float32), [np.int64(1), 2.5, -3, 0], np.array([1.5] * 4, dtype=">f8")],
        "Profile-1": {name: {"slope": np.float64(0.5), "bias": -1, "sigma": np.array(0.25)} for name in SCALES},
    }
    monkeypatch.chdir(tmp_path)
    np.save("SonyA7S2_params.npy", np.array(content, dtype=object), allow_pickle=True)
    (lines,) = re.findall(r"```python\n(import json, numpy, .*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    exec(lines, {})  # noqa: S102 # our own document
    read = read_published("SonyA7S2_params.json")
    assert read == {
        "Kmin": 0.25,
        "Kmax": 16.0,
        "G_shape": [0.1, 0.0, -0.2],
        "color_bias": [[0.0, 1.0, 2.0, 3.0], [1, 2.5, -3, 0], [1.5] * 4],
        "Profile-1": {name: {"slope": 0.5, "bias": -1, "sigma": 0.25} for name in SCALES},
    }


# --- profiles -------------------------------------------------------------------------------------------------------

ROWS = 5


def published(profiles: int = 1) -> dict[str, Any]:
    """A dictionary as the published files hold it."""
    fit = {"slope": 0.5, "bias": -0.25, "sigma": 0.125}
    return {
        "Kmin": 0.125,
        "Kmax": 8.0,
        "G_shape": [0.01 * i for i in range(ROWS)],
        "color_bias": [[i, -i, 2 * i, 0.5] for i in range(ROWS)],
    } | {
        f"Profile-{n}": {
            name: fit | {part: float(n)} for name, part in zip(SCALES, ("slope", "bias", "sigma"), strict=True)
        }
        for n in range(1, profiles + 1)
    }


def test_a_shipped_camera_from_its_published_form(tmp_path: Path) -> None:
    shipped = CameraProfile.load("SonyA7S2")

    lines = [shipped.tukey_lambda_fit, shipped.gauss_fit, shipped.row_fit]
    data = {
        "Kmin": shipped.gain_range_dn_per_e[0],
        "Kmax": shipped.gain_range_dn_per_e[1],
        "G_shape": [row.tukey_lambda for row in shipped.rows],
        "color_bias": [row.colour_bias_dn for row in shipped.rows],
        "Profile-1": {
            name: {"slope": line.slope, "bias": line.intercept, "sigma": line.sigma}
            for name, line in zip(SCALES, map(there, lines), strict=True)
        },
    }
    path = tmp_path / "SonyA7S2_params.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    # Its levels are from elsewhere, and the last note says so.
    published_alone = dataclasses.replace(shipped, black_level_dn=None, white_level_dn=None, notes=shipped.notes[:-1])
    assert profiles_from_published("SonyA7S2", read_published(path)) == (published_alone,)


def test_a_profile_of_each_calibration() -> None:
    """Rows run two an ISO, and a note says so."""
    profiles = profiles_from_published("Camera", published(2), source="a test")
    assert [profile.source for profile in profiles] == ["a test, Profile-1", "a test, Profile-2"]
    for number, profile in enumerate(profiles, 1):
        assert profile.tukey_lambda_fit == LogLogFit(number, -0.25, 0.125)
        assert profile.gauss_fit == LogLogFit(0.5, number, 0.125)
        assert profile.row_fit == LogLogFit(0.5, -0.25, number)
        assert (profile.gain_range_dn_per_e, profile.iso_range) == ((0.125, 8.0), (100, 6400))
        assert [row.tukey_lambda for row in profile.rows] == [0.01 * i for i in range(ROWS)]
        assert [row.colour_bias_dn for row in profile.rows] == [(i, -i, 2 * i, 0.5) for i in range(ROWS)]
        assert [row.iso for row in profile.rows] == [100, 100, 200, 200, 400]
        assert [row.gain_dn_per_e for row in profile.rows] == [0.125, 0.125, 0.25, 0.25, 0.5]
        assert any("inferred" in note for note in profile.notes)


@in_one_test(
    "change, words",
    [
        ({"Kmin": "much"}, "all numbers; found something else"),
        ({"G_shape": 0.1}, "all numbers"),
        ({"G_shape": [0.1]}, "as many G_shape as color_bias rows, and a Profile-1"),
        ({"color_bias": [[1, 2, 3]] * ROWS}, "all numbers"),
        ({"Profile-1": None}, "all numbers"),
        ({"Profile-1": {"G_scale": {"slope": 1, "bias": 0, "sigma": 0}}}, "'g_scale' is missing"),
    ],
)
def test_another_kind_of_value(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ProfileError, match=rf"^Camera: expected .*{words}|^Camera: expected {words}"):
        profiles_from_published("Camera", published() | change)


def test_the_pickle_itself_is_refused_with_what_to_do(tmp_path: Path) -> None:
    np.save(tmp_path / "Camera_params.npy", np.array({"Kmin": 1}, dtype=object), allow_pickle=True)
    with pytest.raises(ProfileError, match=r"Camera_params\.npy: .*docs/noise\.md"):
        read_published(tmp_path / "Camera_params.npy")
