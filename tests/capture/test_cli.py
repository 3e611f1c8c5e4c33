"""`capture camera` and `capture plan`, and wrong usage of every command."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from capture.camera import EXAMPLE
from capture.plan import Plan
from tests.capture.simulated import plan_of, run_capture
from tests.cases import in_one_test
from tests.shared import there

# Of the table: a time of 3/8 s is 0.4 s on the dial and 0.3969 s in the camera, which EXIF's names do not show.
LINES = """\
SonyA7S2: 14 shots; base ISO 100, ISOs 800, 1600, low-light factors 10, 200
scene-1: metered at 4 s
scene-1: books
frame role ISO factor asked set gives ratio EXIF error stops reference
1 reference 100 - 4 s 4 s 4 s - - - - -
3 noisy 800 x200 1/400 s 1/400 s 0.002461 s 203.19 200.00 +1.6 % +0.023 4
6 noisy 1600 x200 1/800 s 1/800 s 0.00123 s 203.19 200.00 +1.6 % +0.023 7
scene-2: metered at 30 s
1 reference 100 - 30 s 30 s 32 s - - - - -
2 noisy 800 x10 3/8 s 0.4 s 0.3969 s 10.08 9.38 +0.8 % +0.011 1
3 noisy 800 x200 3/160 s 1/50 s 0.01969 s 203.19 187.50 +1.6 % +0.023 4
"""


@pytest.fixture
def at_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the example camera."""
    monkeypatch.chdir(tmp_path)
    run_capture("camera", "--example", "cam.json")
    return tmp_path


def test_a_camera(at_work: Path) -> None:
    replace(EXAMPLE, true_isos=((100, Fraction(81)),)).save("own.json")
    lines = run_capture("camera", "own.json", "--json", "shown.json").splitlines()
    assert lines[0] == "SonyA7S2 (ILCE-7SM2): .ARW, bayer"
    assert lines[2] == "measured: ISO 100 is 81"
    assert lines[-1].split() == ["30", "s", "32", "s"]
    times = json.loads((at_work / "shown.json").read_text())["times"]
    assert times[0] == {"dial": "1/8000", "nominal_s": "1/8000", "true_s": 2**-13}


def test_a_plan_and_its_changes(at_work: Path) -> None:
    def run(line: str) -> str:
        return run_capture("plan", *line.split())

    output = run("--camera cam.json --scenes 2 --metered 4 --isos 800 1600 --factors 10 200 -o plan.json")
    assert "scene-1, scene-2: metered at 4 s" in output
    output = run("plan.json --remeter scene-2=30 --note scene-1=books")
    assert set(LINES.splitlines()) <= {" ".join(line.split()) for line in output.splitlines()}
    assert output.endswith("plan: plan.json\n")
    before = Path("plan.json").read_bytes()
    assert "plan: plan.json" not in run("plan.json")  # to look at
    changes = "--add-scene scene-3=2 --aperture scene-2=5.6 --aperture f/8"
    assert "scene-2: metered at 30 s, f/5.6" in run(f"plan.json {changes} -o other.json --json shown.json")
    shown = json.loads(Path("shown.json").read_text())
    assert shown == json.loads(Path("other.json").read_text())
    run("other.json --aperture scene-1=11 --remeter scene-2=20")
    apertures = {scene.name: scene.aperture for scene in Plan.load("other.json").scenes}
    assert apertures == {"scene-1": 11, "scene-2": Fraction("5.6"), "scene-3": 8}
    assert Path("plan.json").read_bytes() == before
    assert sorted(path.name for path in at_work.iterdir()) == ["cam.json", "other.json", "plan.json", "shown.json"]


def test_calibration_frames(at_work: Path) -> None:
    new = ("plan", "--camera", "cam.json", "-o", at_work / "plan.json")
    output = run_capture(*new, "--calibration", "--flat-clips-at", "1/2", "--calibration-isos", "800", "100")
    assert "calibration: the surface clips at 1/2 s, ISO 100" in output
    assert len(Plan.load("plan.json").shots) == 2 * (10 + 12)
    run_capture(*new, "--scenes", "3", "--metered", "scene-2=4", "--metered", "2", "--protocol", "paper")
    scenes = [(str(scene.metered_s), len(scene.shots)) for scene in Plan.load("plan.json").scenes]
    assert scenes == [("2", 10), ("4", 10), ("2", 10)]
    run_capture("plan", "plan.json", "--calibration", "--flat-clips-at", "1/2", "--bias-frames", "6")
    calibration = there(Plan.load("plan.json").calibration)
    assert (calibration.bias_frames, calibration.isos) == (6, (100, 200, 400, 800, 1600, 3200))


NEW = "plan --camera cam.json"
ONE = f"{NEW} --scenes 1 --metered 4"
MANIFEST = "manifest plan.json card -o mine.csv"


@in_one_test(
    "line, words",
    [
        ("camera", "give either a camera description to check, or --example FILE"),
        ("camera --example cam.json", "--example cam.json: is there already; give another name"),
        ("plan", "a new plan needs --camera FILE; capture camera --example"),
        ("plan nowhere.json", "nowhere.json: cannot be read"),
        (NEW, "a new plan needs --scenes, a number of scenes, or the first and the last, as 11-15"),
        (f"{NEW} --scenes 0 --metered 4", "expected a number of scenes from 1 to 1000, or the first and the last"),
        (f"{NEW} --scenes 1-x --metered 4", "expected a whole number of 0 or more, found 'x'"),
        (f"{NEW} --scenes 11-12 --metered scene-1=4", "--metered scene-1: the scenes are scene-11 to scene-12"),
        (f"{NEW} --scenes 2", "scene-1, scene-2 need a metered time"),
        (f"{NEW} --scenes 1 --metered 1/2", "scene-1: metered at 1/2 s (ISO 100): noisy frame 15"),
        (f"{ONE} --remeter scene-2", "such as scene-2=1/4; found 'scene-2'"),
        (f"{ONE} -o cam.json", "-o: cam.json is a file that this command reads"),
        (f"{ONE} --calibration", "--calibration needs --flat-clips-at SECONDS"),
        (f"{ONE} --bias-frames 5", "--bias-frames goes with --calibration"),
        ("plan --metered soon", "argument --metered: expected seconds above 0, such as 4, 1/2"),
        ("plan --isos " + "9" * 5000, "expected a whole number"),
        ("plan plan.json --factors 10", "--factors is for a new plan; plan.json has its own"),
        ("plan plan.json --note scene-1=", "--note: expected a scene and a text, such as scene-2=bookshelf"),
        *(
            (f"plan plan.json --aperture {f_number}", "expected an f-number")
            for f_number in ("x", "0", "=8", "s=", "1000")
        ),
        ("checklist plan.json --format html", "a page needs a file"),
        ("checklist plan.json -o list.pdf", "expected a name that ends in .html, .md or .txt"),
        ("checklist plan.json -o plan.json --format txt", "-o: plan.json is a file that this command reads"),
        ("manifest plan.json card -o mine.json", "expected a name that ends in .csv"),
        ("manifest plan.json card -o plan.csv", "-o: plan.json is a file that this command reads"),
        (MANIFEST, "card: no such file or folder"),
        ("manifest plan.json plan.json -o mine.csv", "no raw file (.dng) was given"),
        (f"{MANIFEST} --only scene-7", "no scene called 'scene-7'"),
        (f"{MANIFEST} --only calibration", "the plan has no calibration frames"),
        (f"{MANIFEST} --append", "--append goes with --copy-to DIR or --link-to DIR"),
        (f"{MANIFEST} --append --copy-to set", "this set does not exist yet; leave --append out"),
        ("check mine.csv --sheet sheet.gif", "expected a name that ends in .html"),
    ],
)
def test_wrong_usage_is_one_line(at_work: Path, line: str, words: str) -> None:
    plan_of("4").save("plan.json")
    before = {path.name: path.read_bytes() for path in at_work.iterdir()}
    printed = run_capture(*line.split(), code=2)
    assert printed.startswith(f"capture {line.split(maxsplit=1)[0]}: ")
    assert printed.count("\n") == 1
    assert words in printed
    assert {path.name: path.read_bytes() for path in at_work.iterdir()} == before
