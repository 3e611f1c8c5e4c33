from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from eldata.noise.profile import CameraProfile, shipped_profiles
from tests.cli.test_usage import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.cli.conftest import Cli, Outcome

    Profile = Callable[..., Outcome]

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def profile(eldata: Cli) -> Profile:
    return partial(eldata, "profile")


def test_show(profile: Profile) -> None:
    done = profile("show", "SonyA7S2", "--json", "shown.json")
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert lines[0] == "SonyA7S2"
    assert "  gain    0.09392 to 6.011 DN/e-" in lines
    assert "  ISO     100 to 6400" in lines
    assert any(line.startswith("  note    ISO and gain of the rows") for line in lines)
    shown = json.loads(Path("shown.json").read_text(encoding="utf-8"))
    assert shown == json.loads(json.dumps(CameraProfile.load("SonyA7S2").as_dict()))


def test_list(profile: Profile) -> None:
    done = profile("list", "--json", "list.json")
    assert done.code == 0
    lines = done.out.splitlines()
    assert [line.split()[0] for line in lines[2:]] == list(shipped_profiles())
    assert lines[-2].split()[1:7] == ["0.09392", "to", "6.011", "100", "to", "6400"]
    listed = json.loads(Path("list.json").read_text(encoding="utf-8"))
    assert [item["profile"] for item in listed] == list(shipped_profiles())


def test_unusable_input_is_one_line_and_exit_code_2(profile: Profile) -> None:
    assert_one_line(profile("show", "Leica"), "no camera profile is called 'Leica'")
    assert_one_line(profile("show", "absent.json"), "absent.json: cannot be read")


def test_import(profile: Profile) -> None:
    shipped = CameraProfile.load("NikonD850")
    fit = {"slope": 0.5, "bias": -0.25, "sigma": 0.125}
    lines = {"G_scale": fit, "g_scale": fit, "R_scale": fit}
    data = {
        "Kmin": 0.125,
        "Kmax": 8.0,
        "G_shape": [row.tukey_lambda for row in shipped.rows],
        "color_bias": [list(row.colour_bias_dn) for row in shipped.rows],
        "Profile-1": lines,
    }
    Path("NikonD850_params.json").write_text(json.dumps(data), encoding="utf-8")
    done = profile("import", "NikonD850_params.json", "-o", "nikon.json")
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines()[0] == f"NikonD850: {len(shipped.rows)} rows, Profile-1"
    assert len(CameraProfile.load(Path("nikon.json")).rows) == len(shipped.rows)
    both = data | {"Profile-2": lines | {"G_scale": fit | {"slope": 0.75}}}
    Path("both.json").write_text(json.dumps(both), encoding="utf-8")
    refused = profile("import", "both.json", "-o", "two.json")
    assert (refused.code, Path("two.json").exists()) == (2, False)
    assert "both.json holds 2 calibrations; choose one with --calibration: Profile-1, Profile-2" in refused.err
    done = profile("import", "both.json", "-o", "two.json", "--calibration", "Profile-2", "--camera", "Mine")
    assert done.code == 0
    second = CameraProfile.load(Path("two.json"))
    line = second.gain_modes[0].tukey_lambda_fit
    assert (second.camera, line and line.slope) == ("Mine", 0.75)
