"""Tethered sessions with a stand-in for gphoto2: a real executable with a camera that can fail in every way."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import random
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import capture.tether.gphoto
import capture.tether.lock
import capture.tether.session
from capture.calibration import plan_calibration
from capture.cli import main
from capture.plan import make_plan
from capture.protocol import CaptureProtocol
from capture.tether import journal as journals
from capture.tether.gphoto import Gphoto
from capture.tether.journal import NAME, Entry, Journal, place
from capture.tether.lock import locked
from capture.tether.session import run_session
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_header
from eldata.records import Exposure
from tests.capture import fake_gphoto2
from tests.capture.simulated import CAMERA, SENSOR, plan_of
from tests.syncing import OnDisk
from tests.waiting import PATIENCE_S, until

if TYPE_CHECKING:
    from pathlib import Path

    from capture.plan import Plan

pytestmark = pytest.mark.tether

PORT = "usb:001,005"
SMALL = CaptureProtocol(noisy_isos=(800,), low_light_factors=(10,))


def small_plan(*metered: str) -> Plan:
    """Scenes of three frames: a reference, a noisy one, a reference."""
    return make_plan(CAMERA, SMALL, {f"scene-{n}": Fraction(time) for n, time in enumerate(metered, 1)})


class Rig:
    """A plan, a folder for its frames, and a camera on the cable."""

    def __init__(self, folder: Path, plan: Plan, **config: dict[str, Any]) -> None:
        self.folder, self.plan, self.shots = folder, plan, folder / "shots"
        self.camera, self.program, self.file = folder / "camera", folder / "bin" / "gphoto2", folder / "plan.json"
        (self.camera / "frames").mkdir(parents=True)
        (self.camera / "card").mkdir()
        self.program.parent.mkdir()
        self.program.write_text(
            f"#!/bin/sh\nFAKE_GPHOTO2='{self.camera}' exec '{sys.executable}' -S -I '{fake_gphoto2.__file__}' \"$@\"\n"
        )
        self.program.chmod(self.program.stat().st_mode | stat.S_IXUSR)
        self.state = {
            "cameras": [["Acme Nocturne 1 (PC Control)", PORT]],
            "plugged": True,
            "keeps": True,
            "count": 0,
            "trouble": [],
            "config": {
                "cameramodel": {"current": "Nocturne 1"},
                "batterylevel": {"current": "85%"},
                "iso": {"current": "400", "choices": ["Auto", *map(str, CAMERA.isos)]},
                "shutterspeed": {"current": "1/50", "choices": [*reversed(CAMERA.shutter.dials), "Bulb"]},
                "imageformat": {"current": "RAW", "choices": ["RAW", "RAW + Large Fine JPEG", "Large Fine JPEG"]},
            }
            | config,
        }
        self.save()
        self.plan_again(plan)

    def plan_again(self, plan: Plan) -> None:
        """Take a plan, and let the camera have a frame for each of its settings."""
        self.plan = plan
        plan.save(self.file)
        for _, shot in plan.shots:
            name = f"{shot.iso}_{shot.setting.dial.replace('/', '-')}.dng"
            self.develop(name, Exposure(Fraction(shot.iso), shot.setting.nominal_s))
        self.develop("wrong.dng", Exposure(Fraction(6400), Fraction(1, 8000)))

    def develop(self, name: str, exposure: Exposure) -> None:
        mosaic = np.random.default_rng(len(name)).integers(600, 15000, (SENSOR.height, SENSOR.width), dtype=np.uint16)
        write_dng(self.camera / "frames" / name, mosaic, SENSOR, exposure, taken=datetime(2000, 1, 1))  # noqa: DTZ001

    def save(self) -> None:
        (self.camera / "state.json").write_text(json.dumps(self.state))

    def read(self) -> Any:
        return json.loads((self.camera / "state.json").read_text())

    def change(self, **what: Any) -> None:
        self.state = self.read() | what
        self.save()

    def fail(self, *troubles: dict[str, Any]) -> None:
        self.change(trouble=list(troubles))

    def arguments(self, *options: str) -> list[str]:
        # Most of these frames show no scene, and there would be nothing to check.
        common = ["--gphoto2", str(self.program), "--yes", "--no-check", "--timeout", f"{PATIENCE_S:g}"]
        return ["run", str(self.file), "-o", str(self.shots), *common, *options]

    def run(self, *options: str) -> int:
        return main(self.arguments(*options))

    def session(self) -> None:
        """Run a session as the command does, with nothing that would catch what is raised."""
        gphoto = Gphoto(str(self.program), timeout_s=PATIENCE_S)
        run_session(self.plan, self.shots, gphoto, ask=lambda _: None, say=lambda _: None, check=False)

    def frames(self) -> list[str]:
        return sorted(path.name for path in self.shots.glob("*.dng"))

    def asides(self) -> list[str]:
        return sorted(path.name for path in self.shots.glob("*.aside"))

    def calls(self, option: str) -> int:
        lines = (self.camera / "calls").read_text().splitlines() if (self.camera / "calls").exists() else []
        return sum(option in json.loads(line)[0] for line in lines)

    def expected(self) -> list[str]:
        return sorted(f"{scene}_{shot.number:04d}.dng" for scene, shot in self.plan.shots)

    def check_whole(self) -> None:
        """Each planned frame once, with its settings, in the order of time; the journal and the folder agree."""
        assert self.frames() == self.expected()
        digests, times = [], []
        journal = Journal(self.shots / "journal.jsonl", writable=False)
        assert journal.open_intents() == ()
        done = journal.done()
        for scene, shot in self.plan.shots:
            path = self.shots / f"{scene}_{shot.number:04d}.dng"
            header = read_header(path)
            assert (header.exposure.iso, header.exposure.exposure_s) == (Fraction(shot.iso), shot.setting.nominal_s)
            assert header.taken is not None
            times.append(header.taken)
            digests.append(f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}")
            assert done[scene, shot.number].details["sha256"] == digests[-1]
        assert len(set(digests)) == len(digests)
        assert times == sorted(times)
        ends = Counter(entry.slot for entry in journal.entries if entry.event == "done")
        assert set(ends.values()) == {1}
        assert not (self.shots / ".incoming").exists()


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture.tether.session, "_READ_BACK_PAUSE_S", 0.01)
    monkeypatch.setattr(capture.tether.gphoto, "_GRACE_S", 0.3)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path, small_plan("1/8"))


@pytest.fixture
def two(tmp_path: Path) -> Rig:
    return Rig(tmp_path, small_plan("1/8", "1/4"))


# --- all well ---------------------------------------------------------------------------------------------------------


def test_from_plan_to_manifest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = plan_of("1/2", factors=(10,))
    rig = Rig(
        tmp_path,
        replace(
            plan,
            calibration=plan_calibration(
                CAMERA, 100, (100,), Fraction(1, 4), bias_frames=4, flat_levels=(Fraction(1, 2),)
            ),
        ),
    )
    assert rig.run("--json", str(rig.shots / "run.json")) == 0  # a folder that the run itself makes
    output = capsys.readouterr().out
    rig.check_whole()
    assert "Acme Nocturne 1 (PC Control) at usb:001,005, battery 85%" in output
    assert "metered at 1/2 s, ISO 100" in output
    assert "scene-1  2/7  noisy, ISO 800, 1/160 s  scene-1_0002.dng" in output
    assert "lens capped" in output
    assert output.index("lens capped") < output.index("cap off")
    assert "13 of 13 frames" in output
    content = json.loads((rig.shots / "run.json").read_text())
    assert (content["planned"], content["taken_now"]) == (13, 13)
    assert content["frames"][0] == {"scene": "scene-1", "number": 1, "file": str(rig.shots / "scene-1_0001.dng")}
    # A setting is made where it changes, not for each of ten equal frames.
    assert rig.calls("--set-config-value") < 10
    (rig.shots / "scene-1_0003.wrong-ISO200-4s.1.dng.aside").write_bytes(b"kept aside")
    files = [str(path) for path in sorted(rig.shots.glob("*"))]
    csv, data = tmp_path / "mine.csv", tmp_path / "data" / "mine"
    assert main(["manifest", str(rig.file), *files, "-o", str(csv), "--copy-to", str(data), "--jobs", "1"]) == 0
    assert "13 of 13 shots have a file; 13 files were given" in capsys.readouterr().out
    from eldata.manifest import verify

    assert verify(csv, tmp_path / "data", dataset="mine", level="full").ok


def test_a_second_run_has_nothing_to_do(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert rig.run() == 0
    calls = rig.calls("--auto-detect")
    assert rig.run() == 0
    assert rig.calls("--auto-detect") == calls
    assert "3 of 3 frames are in" in capsys.readouterr().out


def test_scene_by_scene(two: Rig) -> None:
    assert two.run("--scene", "1") == 0
    assert two.frames() == two.expected()[:3]
    assert two.run("--scene", "scene-2") == 0
    two.check_whole()
    assert two.run("--scene", "7") == 2


def test_a_deleted_frame_is_taken_again(two: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert two.run() == 0
    (two.shots / "scene-2_0003.dng").unlink()
    assert two.run() == 0
    assert "scene-2_0003.dng is gone; it will be taken again" in capsys.readouterr().out
    assert two.frames() == two.expected()
    (two.shots / "scene-2_0003.dng").write_bytes(b"edited")
    assert two.run() == 2
    assert "bring the original back" in capsys.readouterr().err


def test_dry_run_lists_what_is_left_and_leaves_the_camera_alone(two: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(two.file), "-o", str(two.shots), "--dry-run", "--port", PORT]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert not two.shots.exists()
    assert (
        lines.count("gphoto2 --port usb:001,005 --capture-image-and-download --filename frame.%C --force-overwrite")
        == 6
    )
    assert "# scene-1 frame 2" in lines
    assert "--set-config-value iso=800 --set-config-value shutterspeed=1/640" in "\n".join(lines)
    assert two.run("--scene", "1") == 0
    capsys.readouterr()
    assert main(["run", str(two.file), "-o", str(two.shots), "--dry-run"]) == 0
    assert capsys.readouterr().out.count("--capture-image-and-download") == 3


def test_it_asks_before_each_scene(two: Rig) -> None:
    import pty

    command = [sys.executable, "-m", "capture.cli.main", *(a for a in two.arguments() if a != "--yes")]
    none = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE_S)
    assert none.returncode == 2
    assert "there is no terminal to ask on" in none.stderr
    ours, theirs = pty.openpty()
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        os.write(ours, b"\n\n")
        output = process.communicate(timeout=PATIENCE_S)[0].decode()
    os.close(ours)
    os.close(theirs)
    assert process.returncode == 0
    assert output.count("Enter when ready") == 2
    two.check_whole()


# --- before the first shot --------------------------------------------------------------------------------------------


def without(rig: Rig, name: str) -> dict[str, Any]:
    return {key: value for key, value in rig.read()["config"].items() if key != name}


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"cameramodel": {"current": "Toy 7"}}, "calls itself Toy 7, and the plan is for Nocturne 1"),
        (
            {"imageformat": {"current": "Large Fine JPEG", "choices": ["RAW", "Large Fine JPEG"]}},
            "set it to RAW in its",
        ),
        ({"imageformat": {"current": "RAW + Large Fine JPEG", "choices": ["RAW"]}}, "set it to RAW alone"),
        ({"iso": {"current": "Auto", "choices": ["Auto", "100", "400"]}}, "does not offer ISO 800; it offers"),
        (
            {"shutterspeed": {"current": "30", "choices": ["30", "1/8", "1/4", "Bulb"]}},
            "does not offer 1/640 s, 1/320 s",
        ),
        (
            {"shutterspeed": {"current": "1/50", "read_only": 1, "choices": ["1/50"]}},
            "read-only: turn its mode dial to M",
        ),
        ({"shutterspeed": {"current": "300/10"}}, "not offered as a list (now '300/10')"),
    ],
)
def test_refused_before_the_first_shot(
    tmp_path: Path, config: dict[str, Any], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = Rig(tmp_path, small_plan("1/8", "1/4"), **config)
    assert rig.run() == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert rig.calls("--capture-image-and-download") == 0
    assert rig.frames() == []


def test_no_program(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(rig.file), "-o", str(rig.shots), "--yes", "--gphoto2", "gphoto-not-there"]) == 2
    assert "program not found; install it with: apt install gphoto2" in capsys.readouterr().err


def test_no_camera_several_and_one_that_is_held(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.change(plugged=False)
    assert rig.run() == 2
    assert "no camera was found: plug the cable in" in capsys.readouterr().err
    two = [["Toy", "usb:001,009"], ["Acme Nocturne 1", PORT]]
    rig.change(plugged=True, cameras=[["Mass Storage Camera", "disk:/media/card"], *two])
    assert rig.run() == 2
    assert "usb:001,009 (Toy), usb:001,005 (Acme Nocturne 1); choose one with --port" in capsys.readouterr().err
    assert rig.run("--port", "usb:003,001") == 2
    assert "no camera is there" in capsys.readouterr().err
    rig.fail({"on": "any", "do": "claimed"})
    assert rig.run("--port", PORT) == 2
    assert "gio mount -s gphoto2" in capsys.readouterr().err
    assert rig.run("--port", PORT) == 0
    rig.check_whole()


def test_settings_without_names(tmp_path: Path) -> None:
    """A camera that tells neither model, battery nor format, and has Nikon's exact times beside the cut ones."""
    rig = Rig(tmp_path, small_plan("1/8"))
    config = {name: one for name, one in rig.read()["config"].items() if name in ("iso", "shutterspeed")}
    rig.change(config=config)
    assert rig.run() == 0
    rig.check_whole()


def test_a_language_with_decimal_commas_changes_nothing(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    monkeypatch.setenv("LANGUAGE", "de")
    assert rig.run("--scene", "1") == 0
    lines = (rig.camera / "calls").read_text().splitlines()
    assert {json.loads(line)[1] for line in lines} == {"C"}


# --- what goes wrong while shooting -----------------------------------------------------------------------------------


def test_a_frame_with_wrong_settings_is_kept_aside_and_taken_again(
    rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.fail({"on": "capture", "do": "wrong", "skip": 1})
    assert rig.run() == 0
    assert rig.asides() == ["scene-1_0002.wrong-ISO6400-1_8000s.1.DNG.aside"]
    assert "taken at ISO 6400, 1/8000 s, and the plan asks for ISO 800, 1/640 s; once more" in capsys.readouterr().out
    rig.check_whole()


def test_wrong_twice_stops_and_says_what_to_look_at(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.fail({"on": "capture", "do": "wrong", "skip": 1, "times": 2})
    assert rig.run() == 2
    error = capsys.readouterr().err
    assert "scene-1 frame 2 (ISO 800, 1/640 s) failed 2 times" in error
    assert "mode dial on M" in error
    assert rig.frames() == ["scene-1_0001.dng"]
    assert rig.run() == 0
    rig.check_whole()
    assert len(rig.asides()) == 2


@pytest.mark.parametrize("what", ["busy", "partial-well", "nothing", "jpeg"])
def test_one_failed_shot_is_taken_again(rig: Rig, what: str) -> None:
    rig.change(keeps=False)
    rig.fail({"on": "capture", "do": what, "skip": 1})
    assert rig.run() == 0
    rig.check_whole()


def test_a_camera_that_sends_the_frame_before_again(tmp_path: Path) -> None:
    plan = replace(
        small_plan("1/8"),
        calibration=plan_calibration(CAMERA, 100, (100,), Fraction(1, 4), bias_frames=4, flat_levels=(Fraction(1, 2),)),
    )
    rig = Rig(tmp_path, plan)
    rig.fail({"on": "capture", "do": "same", "skip": 4})
    assert rig.run() == 0
    rig.check_whole()
    assert len(rig.asides()) == 1


def test_a_setting_that_does_not_take(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.fail({"on": "set", "do": "fails"})
    assert rig.run() == 0  # once more, and it took
    rig.check_whole()
    (rig.shots / "scene-1_0002.dng").unlink()
    rig.fail({"on": "set", "do": "ignored", "times": 4})
    assert rig.run() == 2
    assert "the camera shows ISO 100, 1/8 after it was set to ISO 800, 1/640 s" in capsys.readouterr().err


def test_a_broken_download_is_fetched_from_the_card(two: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    two.fail({"on": "capture", "do": "download", "skip": 1}, {"on": "capture", "do": "partial", "skip": 2})
    assert two.run() == 0
    assert "DSC00002.DNG was fetched from the camera's card" in capsys.readouterr().out
    assert two.calls("--capture-image-and-download") == 6  # none twice
    two.check_whole()


@pytest.mark.parametrize("what", ["unplug", "unplug-download"])
def test_an_unplugged_cable(rig: Rig, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    rig.fail({"on": "capture", "do": what, "skip": 1})
    assert rig.run() == 2
    assert "no camera answers" in capsys.readouterr().err
    assert rig.run() == 2  # still unplugged
    rig.change(plugged=True, cameras=[["Acme Nocturne 1", "usb:001,006"]])  # another port, as after every plugging
    assert rig.run() == 0
    rig.check_whole()
    assert rig.calls("--capture-image-and-download") == (4 if what == "unplug" else 3)


@pytest.mark.parametrize("what", ["hang", "hang-download", "hang-after"])
def test_a_hanging_program_is_ended(rig: Rig, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    rig.fail({"on": "capture", "do": what, "skip": 1})
    code = rig.run("--timeout", "4")  # the calls that do not hang take far less, on a busy machine too
    if what == "hang-after":
        assert code == 0  # the frame had come
    else:
        assert code == 2
        assert "did not end within" in capsys.readouterr().err
        assert rig.run() == 0
    rig.check_whole()
    assert rig.calls("--capture-image-and-download") == (4 if what == "hang" else 3)


def test_a_full_disk(two: Rig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert two.run("--scene", "1") == 0
    real = shutil.disk_usage
    monkeypatch.setattr(shutil, "disk_usage", lambda path: real(path)._replace(free=100))
    assert two.run() == 2
    assert "make room" in capsys.readouterr().err
    monkeypatch.undo()
    assert two.run() == 0
    two.check_whole()


# --- the journal ------------------------------------------------------------------------------------------------------


def test_a_changed_plan(two: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert two.run("--scene", "1") == 0
    two.plan_again(two.plan.remeter("scene-2", Fraction(1, 2)))  # not begun: metered again, as at any tripod
    assert two.run("--scene", "2") == 0
    two.check_whole()
    two.plan_again(two.plan.add_note("scene-1", "a bookshelf"))
    assert two.run() == 0
    two.plan_again(two.plan.remeter("scene-1", Fraction(1)))
    assert two.run() == 2
    error = capsys.readouterr().err
    assert "was changed after scene-1 had been begun here" in error
    assert "move the files of scene-1 away" in error
    for path in two.shots.glob("scene-1_*"):
        path.unlink()
    assert two.run() == 0
    assert two.frames() == two.expected()


def test_a_torn_last_line_never_happened(two: Rig) -> None:
    assert two.run("--scene", "1") == 0
    journal = two.shots / "journal.jsonl"
    data = journal.read_bytes()
    last = data.rstrip(b"\n").rfind(b"\n") + 1
    for size in (last + 40, len(data) - 1):
        journal.write_bytes(data[:size])
        assert two.run("--scene", "1") == 0
        assert two.calls("--capture-image-and-download") == 3  # the frame was there
    assert two.run() == 0
    two.check_whole()


def test_the_journal_and_the_frames_are_on_the_disk_when_they_are_said_to_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The journal's name, each of its lines, the cut of a torn one; a frame before its name, and that name."""
    path = tmp_path / "journal" / NAME
    path.parent.mkdir()
    disk = OnDisk(monkeypatch)
    journal = Journal(path)
    assert disk.has(path.parent)
    for _ in range(2):
        journal.write(Entry("intent", ("scene-1", 1), "shot", "token", {}))
        assert disk.has(path)
    torn = tmp_path / "torn"
    torn.write_bytes(path.read_bytes() + b'{"event"')
    Journal(torn)
    assert torn.read_bytes() == path.read_bytes()
    assert disk.has(torn)
    (tmp_path / "frames").mkdir()
    (tmp_path / "frame").write_bytes(b"frame")
    place(tmp_path / "frame", tmp_path / "frames" / "IMG_0001.dng")
    assert disk.named == {"IMG_0001.dng": True}
    assert disk.has(tmp_path / "frames")


def test_a_damaged_journal_is_refused(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    assert rig.run("--scene", "1") == 0
    journal = rig.shots / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b'"event": "done"', b'"event": "dine"', 1))
    assert rig.run() == 2
    assert "journal.jsonl, line 3, field event: expected one of 'plan', 'intent'" in capsys.readouterr().err


def test_a_disk_that_is_full_for_the_journal(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    assert rig.run() == 0
    (rig.shots / "scene-1_0002.dng").unlink()
    before = (rig.shots / "journal.jsonl").read_bytes()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert rig.run() == 2
    assert "journal.jsonl: cannot be written to (No space left on device)" in capsys.readouterr().err
    assert (rig.shots / "journal.jsonl").read_bytes() == before
    assert rig.run() == 0
    assert rig.frames() == rig.expected()


def test_a_disk_without_hard_links(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    assert rig.run() == 0
    rig.check_whole()


def test_a_foreign_file_is_never_written_over(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.shots.mkdir()
    (rig.shots / "scene-1_0001.dng").write_bytes(b"mine")
    assert rig.run() == 2
    assert "is there already, and this session did not take it" in capsys.readouterr().err
    assert (rig.shots / "scene-1_0001.dng").read_bytes() == b"mine"


def test_two_sessions_and_an_orphan(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(capture.tether.lock, "WAIT_S", 0.1)
    rig.shots.mkdir()
    with locked(rig.shots):
        assert rig.run() == 2
    assert f"another session is at work in this folder (process {os.getpid()})" in capsys.readouterr().err
    with locked(rig.shots) as lock:
        sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], pass_fds=(lock.descriptor,))
        os.pwrite(lock.descriptor, json.dumps({"session": 2**22 + 5, "gphoto2": sleeper.pid}).encode().ljust(64), 0)
    assert rig.run() == 2
    assert f"end it with: kill {sleeper.pid}" in capsys.readouterr().err
    sleeper.kill()
    sleeper.wait()
    assert rig.run() == 0


# --- cut off at any moment --------------------------------------------------------------------------------------------


class Crash(BaseException):
    """As if the power went."""


STEPS = ("get", "intent torn", "intent written", "capture", "captured", "place", "placed", "done")


@pytest.mark.parametrize("step", [*STEPS, "done torn", "done written"])
def test_cut_off_at_every_step(tmp_path: Path, step: str) -> None:
    rig = Rig(tmp_path, small_plan("1/8"))
    with pytest.MonkeyPatch.context() as patch:
        crash_at(patch, step)
        with pytest.raises(Crash):
            rig.session()
    assert rig.run() == 0
    rig.check_whole()
    assert rig.asides() == []
    assert rig.calls("--capture-image-and-download") == 3, "no shot is taken twice"


@pytest.mark.parametrize("step", ["captured", "placed"])
def test_cut_off_while_a_deleted_frame_is_taken_again(tmp_path: Path, step: str) -> None:
    rig = Rig(tmp_path, small_plan("1/8"))
    assert rig.run() == 0
    for name in ("scene-1_0002.dng", "scene-1_0003.dng"):
        (rig.shots / name).unlink()
    with pytest.MonkeyPatch.context() as patch:
        crash_at(patch, step)
        with pytest.raises(Crash):
            rig.session()
    assert rig.run() == 0
    assert rig.frames() == rig.expected()
    assert rig.calls("--capture-image-and-download") == 5
    done = Journal(rig.shots / "journal.jsonl", writable=False).done()
    digest = hashlib.sha256((rig.shots / "scene-1_0003.dng").read_bytes()).hexdigest()
    assert done["scene-1", 3].details["sha256"] == f"sha256:{digest}"


def crash_at(patch: pytest.MonkeyPatch, step: str) -> None:
    """Let the second frame's step be the last thing that happens."""
    seen: Counter[str] = Counter()

    def second(name: str) -> bool:
        seen[name] += 1
        return seen[name] == 2

    run, append, place = Gphoto._run, Journal._append, journals.place

    def run_or_crash(self: Gphoto, arguments: list[str], **options: Any) -> str:
        name = {"--set-config-value": "set", "--get-config": "get", "--capture-image-and-download": "capture"}
        here = name.get(arguments[0], "")
        if here == step and options.get("log", 1) is not None and second(here):
            raise Crash
        output = run(self, arguments, **options)
        if here == "capture" and step == "captured" and second(step):
            raise Crash
        return output

    def append_or_crash(self: Journal, line: dict[str, Any]) -> None:
        event = line["event"]
        if event == step and second(step):
            raise Crash
        if f"{event} torn" == step and second(step):
            with self.path.open("ab") as file:
                file.write(json.dumps(line).encode()[:50])
            raise Crash
        append(self, line)
        if f"{event} written" == step and second(step):
            raise Crash

    def place_or_crash(source: Path, target: Path) -> None:
        if step == "place" and second(step):
            raise Crash
        place(source, target)
        if step == "placed" and second(step):
            raise Crash

    patch.setattr(Gphoto, "_run", run_or_crash)
    patch.setattr(Journal, "_append", append_or_crash)
    patch.setattr(capture.tether.session, "place", place_or_crash)


TROUBLES: tuple[tuple[str, str], ...] = (
    *(
        ("capture", what)
        for what in ("busy", "wrong", "partial", "partial-well", "nothing", "lost", "jpeg", "download")
    ),
    *(("capture", what) for what in ("unplug", "unplug-download", "hang-download", "same")),
    *(("set", "fails"), ("set", "ignored"), ("any", "claimed"), ("get", "fails")),
)


@pytest.mark.parametrize("seed", range(3))
def test_any_sequence_of_failures_ends_with_every_frame_once(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311 # a test's
    rig = Rig(tmp_path, small_plan("1/8", "1/15"))
    rig.change(keeps=chance.random() < 0.7)
    troubles = [
        {"on": on, "do": do, "skip": chance.randrange(4), "times": chance.choice((1, 1, 2))}
        for on, do in chance.sample(TROUBLES, 7)
    ]
    rig.fail(*troubles)
    for tried in range(30):
        if rig.run("--timeout", str(1 + tried // 3)) == 0:  # one second may be short on a busy machine
            break
        rig.change(plugged=True)
    else:
        pytest.fail("it never came to its end")
    rig.check_whole()


@pytest.mark.parametrize("seed", range(2))
def test_killed_at_random_moments(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311 # a test's
    rig = Rig(tmp_path, small_plan("1/8", "1/15"))
    rig.change(slow_s=0.05)
    command = [sys.executable, "-m", "capture.cli.main", *rig.arguments()]
    begun = rig.shots / "journal.jsonl"
    kills = 0
    while kills < 2:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        before = begun.stat().st_size if begun.exists() else 0
        until(lambda: process.poll() is not None or (begun.exists() and begun.stat().st_size > before), "shooting")  # noqa: B023
        time.sleep(chance.random() * 0.35)
        process.send_signal(signal.SIGKILL)
        if process.wait() == 0:
            break
        kills += 1
    assert kills
    assert rig.run() == 0
    rig.check_whole()


def test_ctrl_c_ends_the_program_and_keeps_the_journal(rig: Rig) -> None:
    rig.fail({"on": "capture", "do": "hang", "skip": 1})
    command = [sys.executable, "-m", "capture.cli.main", *rig.arguments()]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    until(lambda: rig.calls("--capture-image-and-download") >= 2, "the second frame")
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 130
    assert "interrupted" in error
    with locked(rig.shots):  # no gphoto2 was left behind
        pass
    assert rig.frames() == ["scene-1_0001.dng"]
    assert rig.run() == 0
    rig.check_whole()
