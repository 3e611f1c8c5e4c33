"""`capture script`: the shell script is run, against a stand-in for gphoto2 that hands out real DNG files."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np

from capture.camera import Shutter
from capture.cli.script import gphoto_script
from capture.plan import Plan, make_plan
from capture.protocol import CaptureProtocol
from capture.shots import plan_calibration
from eldata.manifest.table import load_records
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated import CAMERA, SENSOR, plan_of, run_capture
from tests.waiting import PATIENCE_S


class Rig:
    """A plan, a folder for its script and frames, and a camera on the cable that can take them."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder, self.plan, self.camera = folder / "my shots", folder / "plan.json", folder / "camera"
        self.script, self.bin = self.folder / "shoot.sh", folder / "bin"
        for path in (self.folder, self.bin, *(self.camera / name for name in ("frames", "choices", "now"))):
            path.mkdir(parents=True)
        plan.save(self.plan)
        shots = [shot for _, shot in plan.shots]
        times = [*CAMERA.shutter.times, *(shot.setting for shot in shots)]
        names = {time: "Bulb" if "bulb" in time.dial else time.dial for time in times}
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
        run_capture("script", self.plan, "-o", self.script, *options)
        return self.script.read_text(encoding="utf-8")

    def run(self, typed: str = "\n" * 20) -> subprocess.CompletedProcess[str]:
        path = f"{self.bin}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "FAKE_GPHOTO2": str(self.camera)}
        return subprocess.run(
            [self.script], input=typed, capture_output=True, text=True, timeout=PATIENCE_S, env=environment
        )

    def frames(self) -> list[str]:
        return sorted(path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*.dng"))

    def calls(self, option: str) -> list[str]:
        return [line for line in (self.camera / "calls").read_text().splitlines() if option in line]


def test_from_plan_to_manifest(tmp_path: Path) -> None:
    """A scene by the dial, one by the timer, and calibration frames, of the plan's second scene on."""
    camera = replace(CAMERA, shutter=Shutter.between("1/8000", "30", Fraction(1, 3), bulb_s=240))
    calibration = plan_calibration(camera, 100, (800,), Fraction(1, 2), bias_frames=4)
    metered = {"scene-1": Fraction(4), "scene-2": Fraction(4), "scene-3": Fraction(64)}
    plan = make_plan(camera, CaptureProtocol(100, (800,), (10,)), metered, calibration)
    plan = plan.set_aperture("scene-2", Fraction(8))
    rig = Rig(tmp_path, plan)
    parts = ["--only", "scene-2", "--only", "scene-3", "--only", "calibration"]
    text = rig.write(*parts)
    assert rig.script.stat().st_mode & stat.S_IXUSR
    count = 6 + len(calibration.shots)
    assert text.startswith(f"#!/bin/sh\n# plan.json: 2 scenes, {count} frames with AcmeNocturne (Nocturne 1), about ")
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    # Two scenes, bias frames, flats.
    assert done.stdout.count("Enter when ready") == 4
    assert "scene-2\n    Metered at 4 s, ISO 100\n    Aperture f/8\n" in done.stdout
    assert "Bias frames\n    Lens cap on, viewfinder covered, dark room\n" in done.stdout
    bulb = "--set-config bulb=1 --wait-event=64s --set-config bulb=0 --wait-event-and-download=10s"
    assert rig.calls("bulb=1") == [f"{bulb} --filename scene-3/IMG_000{n}.%C" for n in (1, 3)]
    order = [shot.settings for _, shot in plan.only(parts[1::2]).shots]
    set_to = [call.partition("=")[2] for call in rig.calls("--set-config-value")]
    dialled = [f"ISO {iso}, {time} s" for iso, time in zip(set_to[::2], set_to[1::2], strict=True)]
    assert [line.replace("Bulb", "bulb 64") for line in dialled] == order
    manifest, set_folder = tmp_path / "mine.csv", tmp_path / "data"
    arguments = (rig.plan, rig.folder, "-o", manifest, "--copy-to", set_folder, "--jobs", "1", *parts, "--yes")
    assert f"{count} of {count} shots have a file" in run_capture("manifest", *arguments)
    for row in load_records(manifest):
        if row.scene:
            written = rig.folder / row.path.removeprefix("AcmeNocturne/")
            assert (set_folder / row.path).read_bytes() == written.read_bytes(), "each frame is what its name said"


def test_it_stops_at_what_goes_wrong_and_goes_on_there(tmp_path: Path) -> None:
    rig = Rig(tmp_path, plan_of("4", "2", isos=(800,), factors=(10,)))
    text = rig.write()
    for setting, lacking in (("iso", "800"), ("shutterspeed", "1/20")):
        offered = (rig.camera / "choices" / setting).read_text().split()
        rig.offer(setting, [*(choice for choice in offered if choice != lacking), f"{lacking}0"])  # a longer name
        done = rig.run()
        assert done.returncode == 1
        assert f"the camera's {setting} has no {lacking}: see gphoto2 --get-config {setting}" in done.stderr
        rig.offer(setting, offered)
    assert rig.calls("--capture") == []
    (rig.camera / "bad").write_text("nothing")
    assert "there is no scene-1/IMG_0001: look at the camera" in rig.run().stderr
    (rig.camera / "bad").write_text("")
    # A setting that fails is followed by no frame: gphoto2 itself would release all the same.
    rig.script.write_text(text.replace("offers iso 100 800", "offers iso 100").replace("0002 800 ", "0002 850 "))
    assert rig.run().returncode == 1
    assert rig.frames() == ["scene-1/IMG_0001.dng"]
    rig.write()
    # Scene 2 is closed: nobody presses Enter for it.
    done = rig.run("\n")
    assert (done.returncode, done.stderr) == (1, "nobody can press Enter here: run this script in a terminal\n")
    assert rig.frames() == [f"scene-1/IMG_000{n}.dng" for n in (1, 2, 3)]
    (rig.folder / "scene-1" / "IMG_0002.dng").rename(rig.folder / "scene-1" / "IMG_0002.DNG")  # as some cameras call it
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    assert "scene-1/IMG_0002.dng" not in rig.frames()
    done = rig.run("")
    assert (done.returncode, done.stderr, done.stdout) == (0, "", ""), "nothing is left to do"


def test_nothing_that_a_plan_says_is_run(tmp_path: Path) -> None:
    plan = plan_of("4", isos=(800,), factors=(10,))
    for note in (
        "it's $(touch pwned) `touch pwned`; touch pwned",
        "two\ntouch pwned\n' touch pwned '",
        "\\",
        "%s\x1b[2J",
    ):
        plan = plan.add_note("scene-1", note)
    plan = replace(plan, camera=replace(CAMERA, models=("Nocturne 1\ntouch pwned", "$(touch pwned)")))
    rig = Rig(tmp_path, plan)
    rig.script.write_text(gphoto_script(plan, "plan\ntouch pwned\n.json"))
    rig.script.chmod(0o755)
    done = rig.run()
    assert (done.returncode, done.stderr) == (0, "")
    assert not [*tmp_path.rglob("pwned")]
    shown = ("it's $(touch pwned) `touch pwned`; touch pwned", "two touch pwned ' touch pwned '", "\\", "%s [2J")
    assert "".join(f"    {line}\n" for line in shown) in done.stdout
