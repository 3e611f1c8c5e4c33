"""What a session sees in its frames: scenes are checked, flats exposed until they are right, levels and time shown."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.calibration import plan_calibration
from capture.capture_errors import TetherError
from capture.cli import main
from capture.plan import CALIBRATION, Plan, make_plan
from capture.protocol import CaptureProtocol
from capture.shutter import Shutter
from capture.tether.flats import with_flats
from capture.tether.gphoto import Gphoto
from capture.tether.levels import levels_of
from capture.tether.pace import Pace
from capture.tether.session import run_session
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_header, read_raw
from eldata.records import Exposure, RawFrame
from tests.capture.simulated import CAMERA, SENSOR, plan_of
from tests.capture.simulated_scenes import moved
from tests.capture.test_tether import Rig, small_plan
from tests.capture.test_whole_path import description
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.tether

TAKEN = datetime(2000, 1, 1)  # noqa: DTZ001 # the stand-in's stamp
BLACK, RANGE = 512, 16383 - 512


# --- levels and time --------------------------------------------------------------------------------------------------


def frame_of(mosaic: np.ndarray[tuple[int, int], np.dtype[np.uint16]], path: Path) -> RawFrame:
    write_dng(path, mosaic, SENSOR, Exposure(Fraction(100), Fraction(1)))
    return read_raw(path)


def test_levels(tmp_path: Path) -> None:
    """A quarter of the pixels each: saturated, below one stop, below four stops, and at black."""
    mosaic = np.empty((SENSOR.height, SENSOR.width), dtype=np.uint16)
    for index, share in enumerate((1.0, 0.4, 0.05, 0.0)):
        mosaic[6 * index : 6 * index + 6] = BLACK + round(share * RANGE)
    levels = levels_of(frame_of(mosaic, tmp_path / "a.dng"))
    assert levels.histogram == "@        @  @@"  # 0.4 lies in the second stop below saturation, 0.05 in the fifth
    assert levels.clipped == pytest.approx(0.25)
    assert levels.mean == pytest.approx((1 + 0.4 + 0.05) / 4, abs=1e-3)
    assert str(levels) == "[@        @  @@] 36.3 %, 25 % clipped"


def test_the_mean_is_that_of_the_brightest_channel(tmp_path: Path) -> None:
    mosaic = np.full((SENSOR.height, SENSOR.width), BLACK, dtype=np.uint16)
    mosaic[::2, 1::2] = BLACK + RANGE // 2  # one of the greens
    assert levels_of(frame_of(mosaic, tmp_path / "a.dng")).mean == pytest.approx(0.5, abs=1e-3)


def test_the_time_that_is_left() -> None:
    plan = plan_of("4")
    pace = Pace()
    pace.overheads_s = [1.0, 3.0]
    numbers = [shot.number for shot in plan.scenes[0].shots]
    assert pace.text(plan, {("scene-1", number) for number in numbers}) == ""
    # Reference 16: 4 s, and 2 s as the others had beyond their exposure.
    assert pace.text(plan, {("scene-1", number) for number in numbers[:-1]}) == "  6 s left"


# --- scenes -----------------------------------------------------------------------------------------------------------


class SceneRig(Rig):
    """A camera that photographs a scene, in one frame from another place."""

    def __init__(self, folder: Path, moved_px: float = 0.0) -> None:
        self.demo = CAMERAS[0].with_size(384, 576)
        self.moved_px = moved_px
        self.f_number: Fraction | None = None
        told = description(CAMERAS[0])
        plan = make_plan(told, CaptureProtocol(100, (800,), (1,)), {"scene-1": Fraction(4), "scene-2": Fraction(4)})
        super().__init__(
            folder,
            plan,
            cameramodel={"current": told.models[0]},
            iso={"current": "400", "choices": list(map(str, told.isos))},
        )

    def develop(self, name: str, exposure: Exposure) -> None:
        radiance = scene_radiance(1, 384, 576)
        if exposure.iso == 800:
            radiance = moved(radiance, self.moved_px, 0)
        share = (exposure.exposure_s or 0) / Fraction(4)
        mosaic = self.demo.photograph(radiance, share, int(exposure.iso or 0), np.random.default_rng(len(name)))
        exposure = replace(exposure, f_number=self.f_number)
        write_dng(self.camera / "frames" / name, mosaic, self.demo.sensor, exposure, taken=TAKEN, compression="none")

    def run_checked(self, *options: str) -> int:
        return main([one for one in self.arguments(*options) if one != "--no-check"])


def test_a_scene_is_checked_when_it_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = SceneRig(tmp_path)
    assert rig.run_checked("--json", str(tmp_path / "run.json")) == 0
    lines = capsys.readouterr().out.splitlines()
    verdicts = [index for index, line in enumerate(lines) if line.startswith("DemoAlpha scene-")]
    assert [lines[index].partition(" (")[0] for index in verdicts] == [
        "DemoAlpha scene-1: keep",
        "DemoAlpha scene-2: keep",
    ]
    # The first verdict comes before anything of the second scene.
    assert "scene-1  3/3" in lines[verdicts[0] - 1]
    sheet = rig.shots / "checked" / "scene-1.html"
    assert lines[verdicts[0] + 1 : verdicts[0] + 3] == [f"    to look at: {sheet}", "scene-2: 3 frames"]
    page = sheet.read_text("utf-8")
    assert page.count("data:image/jpeg;base64,") >= 3
    assert all(f"scene-1_000{number}.dng" in page for number in (1, 2, 3))
    assert "scene-2_000" not in page
    assert json.loads((tmp_path / "run.json").read_text())["verdicts"] == {"scene-1": "keep", "scene-2": "keep"}
    taken = [line for line in lines if "  scene-1_000" in line or "  scene-2_000" in line]
    assert len(taken) == 6
    assert all("] " in line and "% clipped" in line for line in taken)
    assert all(line.endswith(" left") for line in taken[:-1])
    assert not taken[-1].endswith(" left")
    # Nothing is taken by now, and so nothing is checked.
    assert rig.run_checked() == 0
    assert "keep" not in capsys.readouterr().out


def test_a_spoiled_scene_is_said_and_its_frame_taken_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = SceneRig(tmp_path, moved_px=6)
    assert rig.run_checked("--scene", "1", "--json", str(tmp_path / "run.json")) == 1
    output = capsys.readouterr().out
    assert json.loads((tmp_path / "run.json").read_text())["verdicts"] == {"scene-1": "shoot again"}
    assert "DemoAlpha scene-1: shoot again" in output
    assert "shift" in output
    assert "delete those of scene-1 that are spoiled, run the same command" in output
    rig.moved_px = 0
    rig.plan_again(rig.plan)
    (rig.shots / "scene-1_0002.dng").unlink()
    assert rig.run_checked("--scene", "1") == 0
    assert "DemoAlpha scene-1: keep" in capsys.readouterr().out


def test_another_aperture_than_the_plans_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = SceneRig(tmp_path)
    rig.f_number = Fraction("5.6")
    rig.plan_again(rig.plan.set_aperture("scene-1", Fraction(8)))
    assert rig.run_checked("--scene", "1") == 1
    output = capsys.readouterr().out
    assert "    aperture f/8" in output
    assert "DemoAlpha scene-1: keep" in output
    assert "scene-1_0002.dng (scene-1 frame 2): taken at f/5.6, where the plan has f/8" in output


def test_without_a_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = SceneRig(tmp_path, moved_px=6)
    assert rig.run("--scene", "1") == 0
    assert "shoot again" not in capsys.readouterr().out


def test_frames_that_cannot_be_checked_end_no_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The simulated frames of 24 x 32 pixels show nothing: that is said, and the next scene is taken."""
    rig = Rig(tmp_path, small_plan("1/8", "1/4"))
    assert main([one for one in rig.arguments() if one != "--no-check"]) == 1
    assert "AcmeNocturne scene-1: " in capsys.readouterr().out
    rig.check_whole()


# --- flats ------------------------------------------------------------------------------------------------------------


class FlatRig(Rig):
    """A surface that clips at some time at ISO 100, whatever the plan says."""

    def __init__(self, folder: Path, planned: str, clips_at_s: float, *, follows: bool = True) -> None:
        self.clips_at_s, self.follows = clips_at_s, follows
        levels = (Fraction(1, 10), Fraction(1, 2), Fraction(9, 10))
        frames = plan_calibration(CAMERA, 100, (100, 800), Fraction(planned), bias_frames=4, flat_levels=levels)
        super().__init__(folder, make_plan(CAMERA, CaptureProtocol(), {}, frames))
        for iso in (100, 800):
            for time in CAMERA.shutter.times:
                self.develop(f"{iso}_{time.dial.replace('/', '-')}.dng", Exposure(Fraction(iso), time.nominal_s))

    def level(self, iso: Fraction, exposure_s: Fraction) -> float:
        named = CAMERA.named(exposure_s)
        assert named is not None
        if not self.follows:
            return self.clips_at_s
        return min(1.0, named.true_s * float(iso) / 100 / self.clips_at_s)

    def develop(self, name: str, exposure: Exposure) -> None:
        level = self.level(exposure.iso or Fraction(0), exposure.exposure_s or Fraction(0))
        noise = np.random.default_rng(len(name)).normal(0, 5, (SENSOR.height, SENSOR.width))
        mosaic = np.clip(BLACK + level * RANGE + noise, 0, 16383).astype(np.uint16)
        write_dng(self.camera / "frames" / name, mosaic, SENSOR, exposure, taken=TAKEN)

    def flats_are_right(self) -> None:
        """Each flat of the plan's file is here, and at most what the plan allows off its level."""
        self.plan = Plan.load(self.file)
        assert self.plan.calibration is not None
        for shot in self.plan.calibration.shots:
            if shot.level is not None:
                path = self.shots / f"{CALIBRATION}_{shot.number:04d}.dng"
                exposure = read_header(path).exposure
                assert exposure.exposure_s == shot.setting.nominal_s
                share = self.level(Fraction(shot.iso), shot.setting.nominal_s) / float(shot.level)
                # The plan rounds down by up to a third of a stop, and half of one more counts as right.
                assert 2**-0.51 <= share <= 2**0.18
        assert {path.name for path in self.shots.glob("*.dng")} == {
            f"{CALIBRATION}_{shot.number:04d}.dng" for shot in self.plan.calibration.shots
        }


@pytest.mark.parametrize(
    ("planned", "clips_at_s", "asides"),
    [("1/4", 0.25, 0), ("1/4", 0.23, 0), ("1/4", 0.2, 1), ("1/4", 2.0, 1), ("1", 0.13, 1), ("4", 0.13, 2)],
)
def test_flats_are_exposed_until_they_are_right(
    tmp_path: Path, planned: str, clips_at_s: float, asides: int, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = FlatRig(tmp_path, planned, clips_at_s)
    before = rig.file.read_bytes()
    assert rig.run() == 0
    output = capsys.readouterr().out
    assert (rig.file.read_bytes() == before) == (asides == 0)
    assert output.count("The flats are planned again") == asides == len(rig.asides())
    assert "10 % is wanted, which is near enough" in output
    rig.flats_are_right()
    files = [str(path) for path in sorted(rig.shots.glob("*"))]
    csv = tmp_path / "mine.csv"
    assert main(["manifest", str(rig.file), *files, "-o", str(csv), "--copy-to", str(tmp_path / "mine")]) == 0
    assert "20 of 20 shots have a file; 20 files were given" in capsys.readouterr().out
    assert rig.run() == 0  # nothing is left, and the changed plan is the journal's
    assert "0 of them taken now" in capsys.readouterr().out


def test_flats_as_planned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = FlatRig(tmp_path, "1/4", 2.0)
    before = rig.file.read_bytes()
    assert rig.run("--flats-as-planned") == 0
    assert rig.file.read_bytes() == before
    assert "planned again" not in capsys.readouterr().out
    assert rig.asides() == []
    # They are here, and so stay what they are.
    assert rig.run() == 0
    assert rig.file.read_bytes() == before


@pytest.mark.parametrize(
    ("level", "words"),
    [
        (0.13, "the first flat was taken 6 times and never had the level that is wanted"),
        (0.5, "by its first flat the surface clips at 0.00984 s: the flat of 10 % at ISO 800 needs"),
    ],
)
def test_light_that_does_not_follow_the_time(
    tmp_path: Path, level: float, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = FlatRig(tmp_path, "1/4", level, follows=False)
    assert rig.run() == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert len(rig.frames()) in (8, 9)  # the bias frames


def test_steps_that_would_leave_another_number_of_flats() -> None:
    """In full stops, levels of a surface that clips at 1/4 s fall on three times, and at 0.35 s on four."""
    camera = replace(CAMERA, shutter=Shutter.between("1/8000", "30", Fraction(1)))
    levels = tuple(Fraction(tenths, 10) for tenths in (1, 3, 5, 7, 9))
    frames = plan_calibration(camera, 100, (100,), Fraction(1, 4), bias_frames=4, flat_levels=levels)
    plan = make_plan(camera, CaptureProtocol(), {}, frames)
    assert with_flats(plan, Fraction(1, 2)).calibration != frames
    with pytest.raises(TetherError, match="the camera's steps then leave 12 calibration frames where the plan has 10"):
        with_flats(plan, Fraction("0.35"))


@pytest.mark.parametrize("when", ["before the plan is written", "after it"])
def test_cut_off_while_flats_are_planned_again(tmp_path: Path, when: str, capsys: pytest.CaptureFixture[str]) -> None:
    rig = FlatRig(tmp_path, "1/4", 2.0)

    def cut_off(plan: Plan) -> None:
        if when == "after it":
            plan.save(rig.file)
        raise KeyboardInterrupt

    gphoto = Gphoto(str(rig.program), timeout_s=PATIENCE_S)
    with pytest.raises(KeyboardInterrupt):
        run_session(rig.plan, rig.shots, gphoto, ask=lambda _: None, say=lambda _: None, check=False, save=cut_off)
    assert rig.run() == 0
    rig.flats_are_right()
    assert "near enough" in capsys.readouterr().out


def test_flats_of_a_part_of_the_plan(tmp_path: Path) -> None:
    """With --scene calibration the whole plan is written, its scenes as they were."""
    rig = FlatRig(tmp_path, "1/4", 2.0)
    whole = replace(small_plan("1/8"), calibration=rig.plan.calibration)
    whole.save(rig.file)
    assert rig.run("--scene", "calibration") == 0
    after = Plan.load(rig.file)
    assert after.scenes == whole.scenes
    rig.flats_are_right()
