"""`capture check` on simulated files: every mishap is found by its own measure, nothing on what is clean."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import dataclass, replace
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
from eldata.demo.calibration_frames import make_calibration_frames
from eldata.errors import EldataError
from eldata.manifest import Manifest, load_manifest
from eldata.raw import read_raw, write_dng
from eldata.records import Exposure
from tests.capture.planted_faults import FAULTS, ORDER, Mishap, clean, lit, moved, verdicts
from tests.capture.simulated import run_capture
from tests.capture.simulated_scenes import ALPHA, Shot, radiance, write_scenes
from tests.cases import in_one_test
from tests.reports.pages import checked as checked_page

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


FEW = (1, 4, 5, 6, 14, 15, 16)  # references, and noisy frames at x100 and x200 of ISO 800 and 3200


def checked(folder: Path, mishaps: dict[int, Mishap], scene: int = 1) -> CheckedGroup:
    """Check one scene of few frames; mishaps are by frame number."""
    manifest = write_scenes(folder, {(scene, at): mishap for at, mishap in mishaps.items()}, scenes=(scene,), ids=FEW)
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
    "focus": (dict.fromkeys(LATE, lambda shot: shot.blurred(0.6)), 1, {("focus", 16)}, "look"),
    "focus, more": (dict.fromkeys(LATE, lambda shot: shot.blurred(1.5)), 2, {("focus", 16)}, "shoot again"),
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
    mishaps = {5: exposed("1/200", stated=False), 6: lit(2), 16: moved(5), 15: exposed("1/800", stated=True)}
    group = checked(tmp_path, mishaps, 2)
    assert value(group, "drift", 6).value == pytest.approx(2, abs=0.1)
    assert value(group, "shift", 16).value == pytest.approx(5, abs=0.1)
    assert value(group, "ratio", 5).value == pytest.approx(102, rel=0.05)
    assert "EXIF does not show it; it fits IMG_0004.dng (x100): swapped?" in value(group, "ratio", 5).kind.advice
    assert "EXIF says the same" in value(group, "ratio", 15).kind.advice
    assert value(group, "EXIF ratio", 15).kind.expected == 100


def test_black_beyond_a_hundredth_of_full_scale(tmp_path: Path) -> None:
    """Amplified by 100, 2 DN are 1.4 %; in frame 14, of ISO 3200, 1 DN is beyond 1 % by less than its error."""
    added: Any = {4: lambda dn: dn + np.uint16(2), 14: lambda dn: dn + np.uint16(1)}
    manifest = write_scenes(tmp_path, ids=(1, 4, 6, 14, 16), seed=1, digital=added)
    (group,) = check(manifest, tmp_path / "data").groups
    assert named(group) == {("offset", 4)}
    assert value(group, "offset", 4).value == pytest.approx(1.4, abs=0.1)
    assert value(group, "offset", 14).value > 1


# --- faults planted into four kinds of scenes -------------------------------------------------------------------------

# Those nearest to a limit, and the farthest of one kind: what lies between is in the table of docs/capture.md.
BETWEEN = ("by 3 px", "-5 %", "5 %", "6 %", "1/3")
TRIED = [number for number, fault in enumerate(FAULTS) if not any(word in fault.name for word in BETWEEN)]


@pytest.mark.study
@pytest.mark.parametrize("number", TRIED, ids=lambda number: FAULTS[number].name)
def test_what_lies_above_its_limit_is_found(number: int) -> None:
    """In one kind of scene, in turn."""
    fault = FAULTS[number]
    in_one_kind = replace(fault, kinds=(fault.kinds[number % len(fault.kinds)],))
    ((_, verdict, names),) = verdicts(in_one_kind, 1)
    assert ORDER.index(verdict) >= ORDER.index(fault.verdict), names


@pytest.mark.study
def test_clean_scenes_are_kept() -> None:
    """16 scenes of all sixteen frames. At 1 % false alarms, more than 1 of 16 has a probability of 1.1 %."""
    assert len([found for found in clean(16) if found[1] != "keep"]) <= 1


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


def run(folder: Path, *arguments: object, code: int = 0) -> str:
    return run_capture(
        "check", folder / "manifests/my.csv", "--root", folder / "data", "--jobs", 1, *arguments, code=code
    )


def test_the_command_lists_and_exits_with_1(two_scenes: Path, tmp_path: Path) -> None:
    sheet, file = tmp_path / "sheet.html", tmp_path / "check.json"
    lines = run(two_scenes, "--sheet", sheet, "--json", file, code=1).splitlines()
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
    assert run(two_scenes, "--scene", "scene-1", "--camera", ALPHA.name) == run(two_scenes, "--scene", "1")


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


# --- bias frames and flats -----------------------------------------------------------------------------------------

SMALL = (256, 384)


@dataclass(frozen=True, slots=True)
class Set:
    """Calibration frames of ISO 1600: six bias frames, IMG_0001 to 0006, and three pairs of flats, to 0012."""

    folder: Path
    manifest: Manifest

    def change(self, number: int, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        role = "bias" if number <= 6 else "flat"
        path = self.folder / "data" / "calibration" / "DemoGamma" / role / "ISO1600" / f"IMG_{number:04d}.dng"
        frame = read_raw(path)
        mosaic = np.clip(np.rint(change(frame.mosaic.astype(np.float64))), 0, frame.sensor.white_level_dn)
        write_dng(path, mosaic.astype(np.uint16), frame.sensor, frame.exposure, compression="none")

    def check(self) -> tuple[CheckedGroup, CheckedGroup]:
        bias, flat = check(self.manifest, self.folder / "data").groups
        assert (bias.name, flat.name) == ("DemoGamma bias ISO 1600", "DemoGamma flat ISO 1600")
        return bias, flat


def make_set(folder: Path, seed: int = 4, isos: tuple[int, ...] = (1600,)) -> Manifest:
    return make_calibration_frames(folder, isos=isos, bias_frames=6, flat_levels=3, size=SMALL, seed=seed)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("frames")
    make_set(folder)
    return folder


@pytest.fixture
def frames(pristine: Path, tmp_path: Path) -> Set:
    shutil.copytree(pristine, tmp_path, dirs_exist_ok=True)
    return Set(tmp_path, load_manifest(tmp_path / "manifests" / "calibration-demo.csv"))


@pytest.mark.study
def test_nothing_is_found_on_clean_frames(tmp_path: Path) -> None:
    """Fixed pattern, hot pixels, shading and vignetting of the demo's camera included; five ISOs."""
    manifest = make_set(tmp_path, seed=0, isos=(100, 400, 1600, 6400, 25600))
    report = check(manifest, tmp_path / "data")
    assert [str(reason) for group in report.groups for reason in group.reasons] == []
    assert [group.verdict for group in report.groups] == ["keep"] * 10
    run_capture("check", manifest.path, "--root", tmp_path / "data", "--jobs", 1)


def test_a_light_leak_in_one_corner(frames: Set) -> None:
    down, right = np.ogrid[-1 : 1 : SMALL[0] * 1j, -1 : 1 : SMALL[1] * 1j]
    frames.change(3, lambda dn: dn + 3 * np.exp(-((down + 1) ** 2 + (right - 1) ** 2) / 0.5))
    bias, flat = frames.check()
    assert ("leak", 3) in named(bias)
    assert {number for _, number in named(bias)} == {3}
    assert bias.verdict == "shoot again"
    assert "top right" in bias.format_text()
    assert flat.verdict == "keep"


@pytest.mark.parametrize(
    ("numbers", "change", "name", "verdict"),
    [
        pytest.param(range(1, 7), lambda dn: np.maximum(dn - 512, 0), "black", "shoot again", id="clipped black"),
        pytest.param(range(1, 7), lambda dn: dn + np.linspace(0, 12, SMALL[0])[:, None], "shading", "look", id="leak"),
        pytest.param((5,), lambda dn: dn + 4, "level", "shoot again", id="a leak over the whole frame"),
        pytest.param((11, 12), lambda dn: dn * 1.6, "saturation", "shoot again", id="saturated flats"),
        pytest.param(
            range(7, 13), lambda dn: 512 + (dn - 512) * np.linspace(0.3, 1, SMALL[1]), "evenness", "look", id="uneven"
        ),
        pytest.param((10,), lambda dn: 512 + (dn - 512) * 1.08, "pair", "shoot again", id="an unequal pair"),
    ],
)
def test_what_is_found(
    frames: Set, numbers: Sequence[int], change: Callable[[NDArray[np.float64]], NDArray[np.float64]], name: str,
    verdict: str,
) -> None:  # fmt: skip
    """It, and nothing else, in the frames that have it."""
    for number in numbers:
        frames.change(number, change)
    group = frames.check()[numbers[0] > 6]
    assert named(group) == {(name, 0 if name == "shading" else number) for number in numbers}
    assert group.verdict == verdict
    for pair in (one for one in group.measures if one.name == name == "pair" and one.path.endswith("0010.dng")):
        assert pair.value == pytest.approx(8, abs=0.5)


def test_a_flat_without_a_partner(frames: Set) -> None:
    path = "data/calibration/DemoGamma/flat/ISO1600/IMG_0012.dng"
    frame = read_raw(frames.folder / path)
    exposure = type(frame.exposure)(frame.exposure.iso, Fraction(3), frame.exposure.f_number)
    write_dng(frames.folder / path, frame.mosaic, frame.sensor, exposure, compression="none")
    _, flat = frames.check()
    assert flat.verdict == "look"
    assert flat.format_text().count("has no partner") == 2


def test_what_cannot_be_compared(frames: Set) -> None:
    """One bias frame alone, and a pair of flats without light."""
    for number in (11, 12):
        frames.change(number, lambda dn: 512 + (dn - 512) / 1000)
    few = [record for record in frames.manifest.records if record.path.endswith(("01.dng", "11.dng", "12.dng"))]
    bias, flat = check(replace(frames.manifest, records=tuple(few)), frames.folder / "data").groups
    assert "IMG_0001.dng: is the only bias frame of this ISO" in bias.format_text()
    assert "IMG_0012.dng: too dark, or too much of it saturated, to compare it with its partner" in flat.format_text()
    assert bias.verdict == flat.verdict == "look"
