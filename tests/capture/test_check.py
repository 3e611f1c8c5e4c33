"""`capture check` on simulated scenes written as DNG: every mishap found by its own measure, nothing on clean ones."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.check import CheckedGroup, CheckReport, Measure, check
from capture.check.frames import empty_share
from capture.check.result import (
    BEST_PSNR_DB,
    LIGHT_AGAIN,
    LIGHT_LOOK,
    LOOK_DB,
    SHIFT_AGAIN_PX,
    SHIFT_LOOK_PX,
    Estimate,
    MeasureKind,
)
from capture.cli import main
from eldata.errors import EldataError
from eldata.records import Exposure
from tests.capture.planted_faults import lit, moved
from tests.capture.simulated_scenes import ALPHA, Shot, radiance, write_scenes
from tests.cases import in_one_test
from tests.reports.pages import checked as checked_page

if TYPE_CHECKING:
    from pathlib import Path

    from tests.capture.planted_faults import Mishap

FEW = (1, 4, 5, 6, 14, 15, 16)  # references, and noisy frames at x100 and x200 of ISO 800 and 3200


def checked(folder: Path, mishaps: dict[int, Mishap], scene: int = 1) -> CheckedGroup:
    """Check one scene of few frames; mishaps are by frame number."""
    manifest = write_scenes(
        folder, {(scene, number): mishap for number, mishap in mishaps.items()}, scenes=(scene,), ids=FEW
    )
    (group,) = check(manifest, folder / "data").groups
    return group


def named(group: CheckedGroup) -> set[tuple[str, int]]:
    """Names and frame numbers of the measures that are beyond their limits; 0 for a folder's."""
    measures = [reason for reason in group.reasons if isinstance(reason, Measure)]
    return {(measure.name, int(measure.path[-8:-4]) if "IMG_" in measure.path else 0) for measure in measures}


def value(group: CheckedGroup, name: str, number: int) -> Measure:
    (found,) = (one for one in group.measures if one.name == name and one.path.endswith(f"{number:04d}.dng"))
    return found


# --- mishaps ------------------------------------------------------------------------------------------------------


LATE = (14, 15, 16)  # between the second reference and the rest


def blurred(sigma: float) -> Mishap:
    return lambda shot: shot.blurred(sigma)


def lamp(percent: float) -> dict[int, Mishap]:
    """Let the light drift evenly over the sixteen frames."""
    return {number: lit(percent * (number - 1) / 15) for number in FEW}


def something_moves(shot: Shot) -> Shot:
    light = shot.radiance.copy()
    light[:, 130:250, 150:300] = np.roll(light[:, 130:250, 150:300], (6, 5), axis=(1, 2))
    return replace(shot, radiance=light)


def exposed(seconds: str, *, stated: bool) -> Mishap:
    """Expose for another time, which EXIF states or hides."""
    time = Fraction(seconds)
    return lambda shot: replace(shot, exposure_s=time, exif=Exposure(shot.exif.iso, time) if stated else shot.exif)


EVERY, NONE = dict.fromkeys(FEW, lit(150)), dict.fromkeys(FEW, lit(-90))
SHOWN = {4: exposed("1/400", stated=True), 5: exposed("1/200", stated=True)}
HIDDEN = {14: exposed("1/1600", stated=False), 15: exposed("1/800", stated=False)}
SCENE_2 = {5: lambda shot: replace(shot, radiance=radiance(2))}
WRONG_EXIF = {5: lambda shot: replace(shot, exif=Exposure(Fraction(800), Fraction(1, 100)))}
# What happens to which frames of which scene, what is found in which frames, and the verdict.
MISHAPS: dict[str, tuple[dict[int, Mishap], int, set[tuple[str, int]], str]] = {
    "lamp": (lamp(1), 1, {("drift", 16)}, "look"),
    "lamp, more": (lamp(2), 1, {("drift", 6), ("drift", 16)}, "shoot again"),
    "tripod": (dict.fromkeys(LATE, moved(0.3)), 1, {("shift", 16)}, "look"),
    "tripod, more": (dict.fromkeys(LATE, moved(5)), 2, {("shift", 16)}, "shoot again"),
    "focus": (dict.fromkeys(LATE, blurred(0.6)), 1, {("focus", 16)}, "look"),
    "focus, more": (dict.fromkeys(LATE, blurred(1.5)), 2, {("focus", 16)}, "shoot again"),
    # Noisy frames 14 and 15 are pairs of reference 16.
    "movement": ({16: something_moves}, 2, {("movement", number) for number in (14, 15, 16)}, "look"),
    "overexposed": (EVERY, 2, {("clipped", number) for number in (1, 6, 16)}, "shoot again"),
    "underexposed": (NONE, 1, {("brightness", 1)}, "look"),
    "swapped, as EXIF shows": (SHOWN, 1, {("ratio", 4), ("ratio", 5)}, "shoot again"),
    "swapped, as EXIF hides": (HIDDEN, 1, {(f"{e}ratio", n) for e in ("", "EXIF ") for n in (14, 15)}, "shoot again"),
    "another scene": (SCENE_2, 1, {("match", 5)}, "shoot again"),
    "wrong EXIF": (WRONG_EXIF, 1, {("EXIF ratio", 5)}, "shoot again"),
    "lens capped": ({15: lit(-100)}, 1, {("signal", 15)}, "shoot again"),
    # Nearer to the ratio of the shutter's true times, 101.6, than to EXIF's 100, and near neither.
    "other light": ({4: lit(-3)}, 1, {("EXIF ratio", 4)}, "shoot again"),
    # An eighth longer: beyond the tenth by which a ratio may be off its nominal one.
    "longer": ({5: exposed("1/350", stated=False)}, 1, {("ratio", 5), ("EXIF ratio", 5)}, "shoot again"),
}


@pytest.mark.parametrize("name", MISHAPS)
def test_a_mishap_is_found_by_its_own_measure(tmp_path: Path, name: str) -> None:
    mishaps, scene, found, verdict = MISHAPS[name]
    group = checked(tmp_path, mishaps, scene)
    assert named(group) == found
    assert group.verdict == verdict


def test_measures_have_the_values_that_were_planted(tmp_path: Path) -> None:
    """Each mishap of another frame, in one scene."""
    mishaps = {
        5: exposed("1/200", stated=False),
        6: lit(2),
        16: moved(5),
        15: exposed("1/800", stated=True),
    }
    group = checked(tmp_path, mishaps, 2)
    assert value(group, "drift", 6).value == pytest.approx(2, abs=0.1)
    assert value(group, "shift", 16).value == pytest.approx(5, abs=0.1)
    assert value(group, "ratio", 5).value == pytest.approx(102, rel=0.05)
    assert "EXIF does not show it; it fits IMG_0004.dng (x100): swapped?" in value(group, "ratio", 5).kind.advice
    assert "EXIF says the same" in value(group, "ratio", 15).kind.advice
    assert value(group, "EXIF ratio", 15).kind.expected == 100


def test_black_beyond_a_hundredth_of_full_scale(tmp_path: Path) -> None:
    """Amplified by 100, 2 DN are 1.4 %; in frame 14, of ISO 3200, 1 DN is beyond 1 % by less than its error."""
    added = {4: 2, 14: 1}
    manifest = write_scenes(
        tmp_path, ids=(1, 4, 6, 14, 16), seed=1, digital=lambda _, number, dn: dn + np.uint16(added.get(number, 0))
    )
    (group,) = check(manifest, tmp_path / "data").groups
    assert named(group) == {("offset", 4)}
    assert value(group, "offset", 4).value == pytest.approx(1.4, abs=0.1)
    assert value(group, "offset", 14).value > 1


# --- files --------------------------------------------------------------------------------------------------------


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    manifest = write_scenes(tmp_path, ids=FEW)
    folder = tmp_path / "data" / "MY" / ALPHA.name / "scene-1"
    write_scenes(tmp_path / "small", ids=FEW, size=(192, 288))
    shutil.copy(tmp_path / "small" / folder.relative_to(tmp_path) / "IMG_0005.dng", folder)
    (folder / "IMG_0006.dng").unlink()
    (folder / "IMG_0015.dng").write_bytes(b"no raw file")
    (folder / "IMG_0014.dng").write_bytes(b"\xff\xd8\xff\xe0" + b"\0" * 5000)
    (group,) = check(manifest, tmp_path / "data").groups
    assert group.verdict == "shoot again"
    text = group.format_text()
    assert "IMG_0006.dng: cannot be read" in text
    assert "IMG_0015.dng: cannot be read" in text
    assert "IMG_0014.dng: a JPEG picture whatever its name says; use the raw file that the camera wrote" in text
    assert "IMG_0004.dng: its reference IMG_0006.dng cannot be used" in text
    assert "IMG_0005.dng: size (288, 192), where DemoAlpha/scene-1/IMG_0001.dng has (576, 384); take all fr" in text


# --- the command --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The second with a drifting lamp."""
    folder = tmp_path_factory.mktemp("scenes")
    write_scenes(folder, {(2, 16): lambda shot: shot.lit(1.03)}, scenes=(1, 2), ids=(1, 5, 6, 16))
    return folder


def run(folder: Path, *arguments: str) -> int:
    return main(["check", str(folder / "manifests" / "my.csv"), "--root", str(folder / "data"), *arguments])


def test_the_command_lists_and_exits_with_1(
    two_scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet, file = tmp_path / "sheet.html", tmp_path / "check.json"
    assert run(two_scenes, "--jobs", "1", "--sheet", str(sheet), "--json", str(file)) == 1
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines[0] == f"{ALPHA.name} scene-2: shoot again"
    assert lines[1].startswith(f"    shoot again: {ALPHA.name}/scene-2/IMG_0016.dng: drift: change of brightness (")
    assert "since IMG_0001.dng: 3.0" in lines[1]
    assert lines[-2:] == ["my: 1 keep, 1 shoot again", f"contact sheet: {sheet}"]
    content = json.loads(file.read_text())
    assert content["ok"] is False
    assert [group["verdict"] for group in content["groups"]] == ["keep", "shoot again"]
    (drift,) = [m for m in content["groups"][1]["measures"] if m["name"] == "drift" and m["verdict"] != "keep"]
    assert drift["value"] == pytest.approx(3, abs=0.1)
    assert drift["look_from"] == pytest.approx(0.5, abs=0.01)
    assert "46.5 dB" in drift["limits_from"]
    page = checked_page(sheet.read_text())
    assert len(page.all("img")) == 2 * 4  # first, last, their difference, one noisy frame
    # The summary, an index that leads to both scenes, and a picture that each thumbnail leads to.
    shown = " ".join(page.text.split())
    assert "my: contact sheet 1 keep 1 shoot again scene or set" in shown
    names = {attributes["id"] for _, attributes in page.elements if "id" in attributes}
    links = {attributes["href"][1:] for attributes in page.all("a")}
    assert {"group-1", "group-2", "picture-1-1", "picture-2-4"} <= links <= names
    assert "http" not in sheet.read_text()


def test_ratios_that_are_off_alike_are_one_line_and_a_count() -> None:
    """64 frames at 80 %, one at 60 %; each keeps its own line in the JSON."""

    def scene(number: int) -> CheckedGroup:
        group = CheckedGroup(f"A scene-{number}", 16)
        for frame in range(16):
            text = "exposure ratio"
            kind = MeasureKind("ratio", "", 10.0, 26.0, "source", "shoot it again", expected=100.0, text=text)
            share = 60.0 if (number, frame) == (2, 5) else 80.0 + 0.1 * (frame % 3)
            group.measure(kind, f"A/scene-{number}/IMG_{frame:04d}.dng", Estimate(share, 0.2))
        return group

    report = CheckReport("mine", tuple(map(scene, range(1, 6))))
    lines = report.format_text().splitlines()
    assert len(lines) == 5 * 2 + 1 + 1 + 1
    assert lines[0:2] == ["A scene-1: look", "    16 measures that are off alike in many files: see below"]
    (own,) = [line for line in lines if "IMG_0005.dng: ratio: exposure ratio: 60.0" in line]
    assert own.startswith("    shoot again: A/scene-2")
    assert lines[-2] == (
        "look: 79 files alike, such as A/scene-1/IMG_0000.dng: ratio: by the pixels it is 80 % of what it should be "
        "(80.0 to 80.2 %); shoot it again"
    )
    assert sum(len(group["reasons"]) for group in report.as_dict()["groups"]) == 80


@in_one_test(
    "chosen, message",
    [
        ({"scenes": ["7"]}, "no frame has scene scene-7; known are scene-1, scene-2"),
        ({"cameras": ["Other"]}, "no frame has camera Other; known are DemoAlpha"),
        ({"root": "nowhere"}, "no folder nowhere/MY: --root names the folder that holds MY"),
    ],
)
def test_what_is_not_there_is_refused(two_scenes: Path, chosen: dict[str, Any], message: str) -> None:
    with pytest.raises(EldataError) as caught:
        check(two_scenes / "manifests" / "my.csv", **{"root": two_scenes / "data"} | chosen)
    assert message in str(caught.value)


def test_the_result_does_not_depend_on_the_number_of_jobs(two_scenes: Path) -> None:
    csv, data = two_scenes / "manifests" / "my.csv", two_scenes / "data"
    assert check(csv, data, workers=1) == check(csv, data, workers=2)
    assert run(two_scenes, "--scene", "scene-1", "--camera", ALPHA.name) == run(two_scenes, "--scene", "1") == 0


# --- limits and ratios ----------------------------------------------------------------------------------------------


def test_the_limits_are_those_of_a_perfect_denoiser() -> None:
    """docs/capture.md derives them with an rms of 0.3 and a slope of 0.01 per pixel: light and shift cost the same."""
    errors = (LIGHT_AGAIN * 0.3, SHIFT_AGAIN_PX * 0.01, LIGHT_LOOK * 0.3, SHIFT_LOOK_PX * 0.01)
    expected_db = [BEST_PSNR_DB, BEST_PSNR_DB, LOOK_DB, LOOK_DB]
    assert [-20 * math.log10(error) for error in errors] == pytest.approx(expected_db)


def test_gaps_of_values_by_their_share() -> None:
    """White noise of 8 DN, of 200,000 pixels: no gap as it is, a half of the values without the lowest bit."""
    mosaic = np.rint(np.random.default_rng(5).normal(512, 8, (400, 500))).astype(np.uint16)
    assert empty_share(mosaic) == 0
    assert empty_share(mosaic // 2 * 2) == pytest.approx(0.5, abs=0.05)
    assert empty_share(np.full((8, 8), 512, np.uint16)) == 0
    # Nine tenths at one value, the others far apart below it: what does not occur between them is no gap.
    mosaic = np.random.default_rng(6).integers(600, 12_000, (400, 500)).astype(np.uint16)
    mosaic[:, :450] = 16383
    assert empty_share(mosaic) == 0
