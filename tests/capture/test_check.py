"""`capture check` on simulated scenes written as DNG: every mishap found by its own measure, nothing on clean ones."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.check import CheckedGroup, CheckReport, Measure, check
from capture.check.result import Estimate, MeasureKind
from capture.cli import main
from eldata.records import Exposure
from tests.capture.simulated_scenes import ALPHA, Shot, radiance, write_scenes
from tests.reports.pages import checked as checked_page

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


FEW = (1, 4, 5, 6, 14, 15, 16)  # references, and noisy frames at x100 and x200 of ISO 800 and 3200


def checked(folder: Path, mishaps: dict[int, Callable[[Shot], Shot]], scene: int = 1) -> CheckedGroup:
    """Check one scene of few frames; mishaps are by frame number."""
    manifest = write_scenes(
        folder, {(scene, number): mishap for number, mishap in mishaps.items()}, scenes=(scene,), ids=FEW
    )
    (group,) = check(manifest, folder / "data").groups
    return group


def named(group: CheckedGroup) -> set[tuple[str, int]]:
    """Names and frame numbers of the measures that are beyond their limits."""
    return {(one.name, int(one.path[-8:-4])) for one in group.reasons if isinstance(one, Measure)}


def value(group: CheckedGroup, name: str, number: int) -> Measure:
    (found,) = (one for one in group.measures if one.name == name and one.path.endswith(f"{number:04d}.dng"))
    return found


# --- references ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("percent", "verdict"), [(1, "look"), (2, "shoot again")])
def test_a_drifting_lamp(tmp_path: Path, percent: float, verdict: str) -> None:
    """The lamp drifts evenly over the sixteen frames."""

    def lit(number: int) -> Callable[[Shot], Shot]:
        return lambda shot: shot.lit(1 + percent / 100 * (number - 1) / 15)

    group = checked(tmp_path, {number: lit(number) for number in FEW})
    assert ("drift", 16) in named(group)
    assert {name for name, _ in named(group)} == {"drift"}
    assert group.verdict == verdict
    assert value(group, "drift", 16).value == pytest.approx(percent, abs=0.1)
    assert value(group, "drift", 6).value == pytest.approx(percent / 3, abs=0.1)


@pytest.mark.parametrize(("pixels", "verdict", "scene"), [(0.3, "look", 1), (5.0, "shoot again", 2)])
def test_a_moved_tripod(tmp_path: Path, pixels: float, verdict: str, scene: int) -> None:
    """Between the second reference and the rest."""
    group = checked(tmp_path, dict.fromkeys((14, 15, 16), lambda shot: shot.moved(pixels * 0.6, -pixels * 0.8)), scene)
    assert named(group) == {("shift", 16)}
    assert group.verdict == verdict
    assert value(group, "shift", 16).value == pytest.approx(pixels, abs=0.1)


@pytest.mark.parametrize(("sigma", "verdict", "scene"), [(0.6, "look", 1), (1.5, "shoot again", 2)])
def test_a_change_of_focus(tmp_path: Path, sigma: float, verdict: str, scene: int) -> None:
    group = checked(tmp_path, dict.fromkeys((14, 15, 16), lambda shot: shot.blurred(sigma)), scene)
    assert named(group) == {("focus", 16)}
    assert group.verdict == verdict
    assert value(group, "focus", 16).value < 0


def test_something_in_the_scene_moves(tmp_path: Path) -> None:
    def elsewhere(shot: Shot) -> Shot:
        light = shot.radiance.copy()
        light[:, 130:250, 150:300] = np.roll(light[:, 130:250, 150:300], (6, 5), axis=(1, 2))
        return replace(shot, radiance=light)

    group = checked(tmp_path, {16: elsewhere}, scene=2)
    # Noisy frames 14 and 15 are pairs of reference 16.
    assert named(group) == {("movement", 16), ("movement", 14), ("movement", 15)}
    assert group.verdict == "look"


def test_clipped_references(tmp_path: Path) -> None:
    group = checked(tmp_path, dict.fromkeys(FEW, lambda shot: shot.lit(2.5)), scene=2)
    assert named(group) == {("clipped", number) for number in (1, 6, 16)}
    assert group.verdict == "shoot again"


def test_underexposed_references(tmp_path: Path) -> None:
    group = checked(tmp_path, dict.fromkeys(FEW, lambda shot: shot.lit(0.1)))
    assert ("brightness", 1) in named(group)
    assert group.verdict == "look"


# --- noisy frames -------------------------------------------------------------------------------------------------


def test_swapped_noisy_frames_whose_exif_shows_it(tmp_path: Path) -> None:
    """The files of numbers 4 and 5 changed places."""
    seconds = {4: Fraction(1, 200), 5: Fraction(1, 400)}

    def as_other(number: int) -> Callable[[Shot], Shot]:
        other = seconds[9 - number]
        return lambda shot: replace(shot, exposure_s=other, exif=Exposure(shot.exif.iso, other))

    group = checked(tmp_path, {4: as_other(4), 5: as_other(5)})
    assert named(group) == {("ratio", 4), ("ratio", 5)}
    assert group.verdict == "shoot again"
    assert "it fits IMG_0005.dng (x200): swapped?" in value(group, "ratio", 4).kind.advice
    assert "EXIF says the same" in value(group, "ratio", 4).kind.advice
    assert value(group, "EXIF ratio", 4).verdict == "keep"


def test_swapped_noisy_frames_whose_exif_hides_it(tmp_path: Path) -> None:
    seconds = {14: Fraction(1, 1600), 15: Fraction(1, 800)}

    def as_other(number: int) -> Callable[[Shot], Shot]:
        return lambda shot: replace(shot, exposure_s=seconds[number])

    group = checked(tmp_path, {14: as_other(14), 15: as_other(15)})
    assert named(group) == {(name, number) for name in ("ratio", "EXIF ratio") for number in (14, 15)}
    assert "EXIF does not show it; it fits IMG_0014.dng (x100): swapped?" in value(group, "ratio", 15).kind.advice


def test_a_frame_of_another_scene(tmp_path: Path) -> None:
    """Right settings in EXIF, wrong scene: only the pixels tell."""
    group = checked(tmp_path, {5: lambda shot: replace(shot, radiance=radiance(2))})
    assert named(group) == {("match", 5)}
    assert group.verdict == "shoot again"


def test_exif_that_is_wrong(tmp_path: Path) -> None:
    group = checked(tmp_path, {5: lambda shot: replace(shot, exif=Exposure(Fraction(800), Fraction(1, 100)))})
    assert named(group) == {("EXIF ratio", 5)}
    assert value(group, "ratio", 5).verdict == "keep"
    assert value(group, "EXIF ratio", 5).kind.expected == 50


def test_the_ratio_of_a_frame_with_noise_only(tmp_path: Path) -> None:
    group = checked(tmp_path, {15: lambda shot: shot.lit(0)})
    assert group.verdict == "shoot again"
    assert named(group) == {("signal", 15)}


# --- files --------------------------------------------------------------------------------------------------------


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    manifest = write_scenes(tmp_path, ids=FEW)
    folder = tmp_path / "data" / "MY" / ALPHA.name / "scene-1"
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


def test_a_frame_of_another_size_is_named(tmp_path: Path) -> None:
    manifest = write_scenes(tmp_path, ids=FEW)
    write_scenes(tmp_path / "small", ids=FEW, size=(192, 288))
    name = f"data/MY/{ALPHA.name}/scene-1/IMG_0005.dng"
    (tmp_path / name).write_bytes((tmp_path / "small" / name).read_bytes())
    (group,) = check(manifest, tmp_path / "data").groups
    (reason,) = group.reasons
    assert str(reason) == (
        f"{ALPHA.name}/scene-1/IMG_0005.dng: size (288, 192), where {ALPHA.name}/scene-1/IMG_0001.dng has (576, 384); "
        "take all frames with one camera and raw format"
    )


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
    links = [attributes["href"][1:] for attributes in page.all("a")]
    assert set(links) <= names
    assert {"group-1", "group-2", *(f"picture-{scene}-{number}" for scene in (1, 2) for number in range(1, 5))} <= set(
        links
    )
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--scene", "7"), "no frame has scene scene-7; known are scene-1, scene-2"),
        (("--camera", "Other"), "no frame has camera Other; known are DemoAlpha"),
        (("--sheet", "sheet.gif"), "expected a name that ends in .html"),
        (("--root", "nowhere"), "no folder nowhere/MY: --root names the folder that holds MY"),
    ],
)
def test_wrong_usage_is_one_line(
    two_scenes: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    assert run(two_scenes, *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1


def test_the_result_does_not_depend_on_the_number_of_jobs(two_scenes: Path) -> None:
    csv, data = two_scenes / "manifests" / "my.csv", two_scenes / "data"
    assert check(csv, data, workers=1) == check(csv, data, workers=2)
    assert run(two_scenes, "--scene", "scene-1", "--camera", ALPHA.name) == run(two_scenes, "--scene", "1") == 0
