"""`capture script`: the shell script is run, against a stand-in for gphoto2 that hands out real DNG files."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.camera import Shutter
from capture.cli import main
from capture.cli.script import gphoto_script
from capture.plan import make_plan
from capture.protocol import CaptureProtocol
from capture.shots import plan_calibration
from eldata.manifest.table import load_records
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated import CAMERA, SENSOR, plan_of
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.plan import Plan

SMALL = CaptureProtocol(noisy_isos=(800,), low_light_factors=(10,))  # scenes of three frames
ENTER = "\n" * 20


def small_plan(*metered: str) -> Plan:
    return make_plan(CAMERA, SMALL, {f"scene-{n}": Fraction(time) for n, time in enumerate(metered, 1)})


class Rig:
    """A plan, a folder for its script and frames, and a camera on the cable that can take them."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder, self.plan, self.camera = folder / "my shots", folder / "plan.json", folder / "camera"
        self.script, self.bin = self.folder / "shoot.sh", folder / "bin"
        for path in (self.folder, self.bin, *(self.camera / name for name in ("frames", "choices", "now"))):
            path.mkdir(parents=True)
        plan.save(self.plan)
        shots = [shot for _, shot in plan.shots]
        names = {time: "Bulb" if time.dial.startswith("bulb") else time.dial for time in CAMERA.shutter.times}
        names |= {shot.setting: "Bulb" if "bulb" in shot.setting.dial else shot.setting.dial for shot in shots}
        for iso, time in {(shot.iso, shot.setting) for shot in shots}:
            mosaic = np.random.default_rng(iso).integers(600, 15000, (SENSOR.height, SENSOR.width), dtype=np.uint16)
            path = self.camera / "frames" / f"{iso}_{names[time].replace('/', '-')}.dng"
            exposure = Exposure(Fraction(iso), time.nominal_s)
            write_dng(path, mosaic, SENSOR, exposure, taken=datetime(2000, 1, 1))  # noqa: DTZ001
        self.offer("iso", ["Auto", *map(str, CAMERA.isos)])
        self.offer("shutterspeed", list(dict.fromkeys(names.values())))
        (self.camera / "count").write_text("0")
        (self.camera / "bad").touch()
        shutil.copy(Path(__file__).with_name("fake_gphoto2.sh"), self.bin / "gphoto2")
        (self.bin / "gphoto2").chmod(0o755)

    def offer(self, setting: str, choices: Sequence[str]) -> None:
        (self.camera / "choices" / setting).write_text("".join(f"{choice}\n" for choice in choices))

    def write(self, *options: str) -> str:
        assert main(["script", str(self.plan), "-o", str(self.script), *options]) == 0
        assert subprocess.run(["/bin/sh", "-n", str(self.script)]).returncode == 0
        return self.script.read_text(encoding="utf-8")

    def run(self, typed: str = ENTER) -> subprocess.CompletedProcess[str]:
        path = f"{self.bin}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "FAKE_GPHOTO2": str(self.camera)}
        return subprocess.run(
            [self.script], input=typed, capture_output=True, text=True, timeout=PATIENCE_S, env=environment
        )

    def frames(self) -> list[str]:
        return sorted(path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*.dng"))

    def calls(self, option: str) -> list[str]:
        return [line for line in (self.camera / "calls").read_text().splitlines() if option in line]


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path, small_plan("4", "2"))


def test_from_plan_to_manifest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = Rig(tmp_path, plan_of("4", "2", "1"))
    text = rig.write()
    assert rig.script.stat().st_mode & stat.S_IXUSR
    assert text.startswith("#!/bin/sh\n# plan.json: 3 scenes, 48 frames with AcmeNocturne (Nocturne 1), about ")
    assert "set -eu\n" in text
    shown = (Path(__file__).parents[2] / "docs" / "capture.md").read_text(encoding="utf-8")
    (excerpt,) = re.findall(r"```\n(# scene-1: .*?)```", shown, re.DOTALL)
    assert excerpt in text
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("Enter when ready") == 3
    assert "scene-2\n    Metered at 2 s, ISO 100\n" in done.stdout
    assert rig.frames() == sorted(f"scene-{n}/IMG_{m:04d}.dng" for n in (1, 2, 3) for m in range(1, 17))
    manifest, set_folder = tmp_path / "mine.csv", tmp_path / "data"
    capsys.readouterr()
    arguments = [str(rig.plan), str(rig.folder), "-o", str(manifest), "--copy-to", str(set_folder), "--jobs", "1"]
    assert main(["manifest", *arguments]) == 0
    assert "48 of 48 shots have a file" in capsys.readouterr().out
    rows = load_records(manifest)
    assert len(rows) == 48
    for row in rows:
        assert (set_folder / row.path).read_bytes() == (
            rig.folder / row.path.removeprefix("AcmeNocturne/")
        ).read_bytes(), "each frame is what its name said"


def test_it_goes_on_where_it_was_cut_off(rig: Rig) -> None:
    rig.write()
    # Scene 2 is closed: nobody presses Enter for it.
    done = rig.run("\n")
    assert done.returncode == 1
    assert done.stderr == "nobody can press Enter here: run this script in a terminal\n"
    assert rig.frames() == [f"scene-1/IMG_000{n}.dng" for n in (1, 2, 3)]
    (rig.folder / "scene-1" / "IMG_0002.dng").rename(rig.folder / "scene-1" / "IMG_0002.DNG")  # as some cameras call it
    (rig.folder / "scene-1" / "IMG_0003.dng").unlink()
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("Enter when ready") == 2
    assert len(rig.calls("--capture")) == 7
    assert "scene-1/IMG_0002.dng" not in rig.frames()
    done = rig.run("")
    assert (done.returncode, done.stderr, done.stdout) == (0, "", ""), "nothing is left to do"
    assert len(rig.calls("--capture")) == 7


@pytest.mark.parametrize("setting", ["iso", "shutterspeed"])
def test_what_the_camera_calls_otherwise_stops_it_before_the_first_shot(rig: Rig, setting: str) -> None:
    lacking = {"iso": "800", "shutterspeed": "1/20"}[setting]
    rig.write()
    offered = (rig.camera / "choices" / setting).read_text().split()
    offered.remove(lacking)
    rig.offer(setting, [*offered, f"{lacking}0", f"1{lacking}"])  # longer names are others
    done = rig.run()
    assert done.returncode == 1
    assert f"the camera's {setting} has no {lacking}: see gphoto2 --get-config {setting}" in done.stderr
    assert rig.calls("--capture") == []


def test_a_setting_that_fails_is_followed_by_no_frame(rig: Rig) -> None:
    """Gphoto2 itself would release all the same: it goes on after an option that failed."""
    text = rig.write()
    rig.script.write_text(text.replace("offers iso 100 800", "offers iso 100").replace("0002 800 ", "0002 850 "))
    assert rig.run().returncode == 1
    assert rig.frames() == ["scene-1/IMG_0001.dng"]


@pytest.mark.parametrize(
    ("bad", "said"), [("fails", ""), ("nothing", "there is no scene-1/IMG_0001: look at the camera")]
)
def test_a_frame_that_does_not_come_stops_it(rig: Rig, bad: str, said: str) -> None:
    rig.write()
    (rig.camera / "bad").write_text(bad)
    done = rig.run()
    assert done.returncode == 1
    assert said in done.stderr
    assert len(rig.calls("--capture")) == 1


def test_calibration_frames_and_one_scene(tmp_path: Path) -> None:
    calibration = plan_calibration(CAMERA, 100, (800,), Fraction(1, 2), bias_frames=4, warm=True)
    plan = replace(small_plan("4", "2"), calibration=calibration)
    rig = Rig(tmp_path, plan)
    rig.write("--only", "scene-2", "--only", "calibration")
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    # A scene, bias frames, flats, and bias frames with the sensor warm.
    assert done.stdout.count("Enter when ready") == 4
    assert "Bias frames\n    Lens cap on, viewfinder covered, dark room\n" in done.stdout
    numbers = [shot.number for shot in calibration.shots]
    scene = [f"scene-2/IMG_000{n}.dng" for n in (1, 2, 3)]
    assert rig.frames() == [*(f"calibration/IMG_{n:04d}.dng" for n in numbers), *scene]
    order = [shot.settings for shot in (*plan.scenes[1].shots, *calibration.shots)]
    set_to = [call.partition("=")[2] for call in rig.calls("--set-config-value")]
    assert [f"ISO {iso}, {time} s" for iso, time in zip(set_to[::2], set_to[1::2], strict=True)] == order


def test_bulb_exposures(tmp_path: Path) -> None:
    camera = replace(CAMERA, shutter=Shutter.between("1/8000", "30", Fraction(1, 3), bulb_s=240))
    rig = Rig(tmp_path, make_plan(camera, SMALL, {"scene-1": Fraction(64)}))
    assert "shot scene-1/IMG_0001 100 Bulb 64  # reference\n" in rig.write()
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    bulb = "--set-config bulb=1 --wait-event=64s --set-config bulb=0 --wait-event-and-download=10s"
    assert rig.calls("bulb=1") == [f"{bulb} --filename scene-1/IMG_000{n}.%C" for n in (1, 3)]
    assert len(rig.frames()) == 3


def test_nothing_that_a_plan_says_is_run(tmp_path: Path) -> None:
    notes = (
        "it's $(touch pwned) `touch pwned`; touch pwned",
        "two\ntouch pwned\n' touch pwned '",
        "\\",
        "%s\x1b[2J -n",
    )
    plan = small_plan("4")
    for note in notes:
        plan = plan.add_note("scene-1", note)
    plan = replace(plan, camera=replace(CAMERA, models=("Nocturne 1\ntouch pwned", "$(touch pwned)")))
    rig = Rig(tmp_path, plan)
    rig.script.write_text(gphoto_script(plan, "plan\ntouch pwned\n.json"))
    rig.script.chmod(0o755)
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    assert not [*tmp_path.rglob("pwned")]
    shown = ("it's $(touch pwned) `touch pwned`; touch pwned", "two touch pwned ' touch pwned '", "\\", "%s [2J -n")
    assert "".join(f"    {line}\n" for line in shown) in done.stdout


def test_the_plan_is_not_written_over(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    before = rig.plan.read_bytes()
    assert main(["script", str(rig.plan), "-o", str(rig.plan)]) == 2
    assert "plan" in capsys.readouterr().err
    assert rig.plan.read_bytes() == before
