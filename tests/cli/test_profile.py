from __future__ import annotations

import json
from pathlib import Path

import pytest

from eldata.noise.profile import CameraProfile, shipped_profiles
from tests.cli.conftest import Cli
from tests.cli.test_usage import assert_one_line
from tests.noise.test_virtual import ROWS, published
from tests.shared import there

pytestmark = pytest.mark.usefixtures("undrawn")


def test_show(eldata: Cli) -> None:
    outcome = eldata("profile", "show", "SonyA7S2", "--json", "shown.json")
    assert (outcome.code, outcome.err) == (0, "")
    lines = outcome.out.splitlines()
    assert lines[0] == "SonyA7S2"
    assert "  gain    0.09392 to 6.011 DN/e-" in lines
    assert "  ISO     100 to 6400" in lines
    assert any(line.startswith("  note    ISO and gain of the rows") for line in lines)
    shown = json.loads(Path("shown.json").read_text(encoding="utf-8"))
    assert shown == json.loads(json.dumps(CameraProfile.load("SonyA7S2").as_dict()))


def test_list(eldata: Cli) -> None:
    outcome = eldata("profile", "list", "--json", "list.json")
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    assert [line.split()[0] for line in lines[2:]] == list(shipped_profiles())
    assert lines[-2].split()[1:7] == ["0.09392", "to", "6.011", "100", "to", "6400"]
    listed = json.loads(Path("list.json").read_text(encoding="utf-8"))
    assert [item["profile"] for item in listed] == list(shipped_profiles())


def test_import(eldata: Cli) -> None:
    Path("NikonD850_params.json").write_text(json.dumps(published()), encoding="utf-8")
    outcome = eldata("profile", "import", "NikonD850_params.json", "-o", "nikon.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.splitlines()[0] == f"NikonD850: {ROWS} rows, Profile-1"
    Path("both.json").write_text(json.dumps(published(2)), encoding="utf-8")
    importing = ("profile", "import", "both.json", "-o", "two.json")
    words = "both.json holds 2 calibrations; choose one with --calibration: Profile-1, Profile-2"
    assert_one_line(eldata(*importing), words)
    assert_one_line(eldata(*importing, "--calibration", "3"), "both.json holds no calibration '3'; known are Profile-1")
    assert not Path("two.json").exists()
    assert eldata(*importing, "--calibration", "Profile-2", "--camera", "Mine").code == 0
    second = CameraProfile.load("two.json")
    assert (second.camera, there(second.gain_modes[0].tukey_lambda_fit).slope) == ("Mine", 2.0)
