"""Importing published parameters: the JSON that numpy makes of a file, and the profiles that are in it."""

from __future__ import annotations

import ast
import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata.errors import ProfileError
from eldata.noise import CameraProfile, read_published
from eldata.noise.profile import LogLogFit
from eldata.noise.published import profiles_from_published
from tests.cases import in_one_test
from tests.shared import there

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
    assert len(ast.parse(lines).body) == 3
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
