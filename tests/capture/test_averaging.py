"""`capture average`: means of references, held against LibRaw and numpy, in sets that go on growing."""

from __future__ import annotations

import hashlib
import json
import tempfile
from dataclasses import replace
from datetime import timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rawpy

from capture.capture_errors import MappingError
from capture.check import average_references, check
from capture.cli import main
from capture.plan import make_plan
from capture.protocol import CaptureProtocol
from eldata.datasets import PairDataset
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError
from eldata.manifest import load_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated import CAMERA, START, shoot, whole_plan
from tests.capture.simulated_scenes import moved, write_scenes
from tests.capture.test_append import Nights
from tests.capture.test_whole_path import description

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import FrameRecord

BLOCKS = CaptureProtocol(100, (800,), (10,), repeats=2, references=4)  # frames 1 to 4, 5 and 6, 7 to 10
SIZE = (384, 576)


def photographed(folder: Path, moved_px: Mapping[int, float] = {}) -> Nights:
    """A set of one scene with blocks of four references."""
    camera = CAMERAS[0].with_size(*SIZE)
    plan = make_plan(description(CAMERAS[0]), BLOCKS, {"scene-1": Fraction(4)})
    plan.save(folder / "plan.json")
    card = folder / "card"
    card.mkdir()
    seen = scene_radiance(1, *SIZE)
    for shot in plan.scenes[0].shots:
        share = shot.setting.nominal_s / 4
        radiance = moved(seen, moved_px[shot.number], 0) if shot.number in moved_px else seen
        mosaic = camera.photograph(radiance, share, shot.iso, np.random.default_rng(shot.number))
        if shot.number == 2:
            mosaic[100, 200] = 16383  # a cosmic ray
        exposure = Exposure(Fraction(shot.iso), shot.setting.nominal_s)
        taken = START + timedelta(seconds=10 * shot.number)
        write_dng(card / f"DSC{shot.number:04d}.dng", mosaic, camera.sensor, exposure, taken=taken, compression="none")
    nights = Nights(folder)
    command = ["manifest", str(folder / "plan.json"), str(card), "-o", str(nights.csv), "--copy-to", str(nights.data)]
    assert main([*command, "--jobs", "1"]) == 0
    return nights


def average(nights: Nights, *options: str) -> int:
    return main(["average", str(nights.csv), "--root", str(nights.folder / "data"), "--jobs", "1", *options])


def rows(nights: Nights) -> dict[str, FrameRecord]:
    return {record.path.rpartition("/")[2]: record for record in load_manifest(nights.csv).records}


def values(path: Path) -> NDArray[np.float64]:
    with rawpy.imread(str(path)) as raw:
        return raw.raw_image_visible.astype(np.float64)


def test_means_are_those_of_libraw_and_numpy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nights = photographed(tmp_path)
    scene = nights.data / "DemoAlpha" / "scene-1"
    assert average(nights, "--json", str(tmp_path / "means.json")) == 0
    output = capsys.readouterr().out
    where = "DemoAlpha/scene-1"
    for first, last in (("0001", "0004"), ("0007", "0010")):
        line = (
            f"DemoAlpha scene-1: 4 references, {where}/IMG_{first}.dng to {where}/IMG_{last}.dng: "
            f"mean in {where}/IMG_{first}-{last}.dng, for 1 noisy frame"
        )
        assert line in output
    told = json.loads((tmp_path / "means.json").read_text())["blocks"]
    assert [one["mean"][-17:] for one in told] == ["IMG_0001-0004.dng", "IMG_0007-0010.dng"]

    singles = np.stack([values(scene / f"IMG_{number:04d}.dng") for number in (1, 2, 3, 4)])
    mean = values(scene / "IMG_0001-0004.dng")
    white = CAMERAS[0].sensor.white_level_dn
    saturated = np.asarray((singles >= white).any(axis=0))
    assert saturated[100, 200]
    assert (singles[:, 100, 200] < white).sum() == 3
    assert (mean[saturated] == white).all()
    np.testing.assert_array_equal(mean[~saturated], np.rint(singles.mean(axis=0))[~saturated])

    # The manifest compares the noisy frames with them, knows their content, and is a whole set.
    found = rows(nights)
    assert found["IMG_0005.dng"].reference == f"{where}/IMG_0001-0004.dng"
    assert found["IMG_0006.dng"].reference == f"{where}/IMG_0007-0010.dng"
    digest = hashlib.sha256((scene / "IMG_0001-0004.dng").read_bytes()).hexdigest()
    assert found["IMG_0001-0004.dng"].sha256 == f"sha256:{digest}"
    assert nights.problems() == []
    assert "the mean of the references" in nights.csv.with_suffix(".json").read_text()
    assert [group.verdict for group in check(nights.csv, tmp_path / "data").groups] == ["keep"]


def test_a_mean_has_a_quarter_of_the_variance_of_one_frame(tmp_path: Path) -> None:
    """By the difference of the two blocks, whose expectations are equal: twice the variance of either."""
    nights = photographed(tmp_path)
    assert average(nights) == 0
    scene = nights.data / "DemoAlpha" / "scene-1"
    single = values(scene / "IMG_0001.dng") - values(scene / "IMG_0007.dng")
    mean = values(scene / "IMG_0001-0004.dng") - values(scene / "IMG_0007-0010.dng")
    dark = values(scene / "IMG_0001-0004.dng") < 8000  # far from saturation
    # The frames' own rounding is in their variance; the mean's adds 1/12 DN² to each of the two.
    expected = single[dark].var() / 4 + 2 / 12
    # Variances of n pixels, whose own variances differ by the light: relative error sqrt(m4 / m2² - 1) / sqrt(n) each,
    # of both added, five times.
    spread = [np.sqrt(np.mean(one[dark] ** 4) / np.mean(one[dark] ** 2) ** 2 - 1) for one in (single, mean)]
    tolerance = 5 * np.hypot(*spread) / np.sqrt(dark.sum())
    assert dark.sum() > 100_000
    assert mean[dark].var() == pytest.approx(expected, rel=tolerance)


def test_datasets_take_the_mean_as_target(tmp_path: Path) -> None:
    nights = photographed(tmp_path)
    before = PairDataset(nights.data, nights.csv)[0]
    assert average(nights) == 0
    after = PairDataset(nights.data, nights.csv)[0]
    assert after["ratio"] == before["ratio"]
    np.testing.assert_array_equal(after["input"], before["input"])
    assert 0 < float((after["target"] - before["target"]).abs().mean()) < 0.01


def test_again_and_after_a_kill_it_comes_to_the_same(tmp_path: Path) -> None:
    nights = photographed(tmp_path)
    listed = nights.csv.read_bytes(), nights.csv.with_suffix(".json").read_bytes()
    assert average(nights) == 0
    scene = nights.data / "DemoAlpha" / "scene-1"

    def content() -> dict[str, bytes]:
        files = [nights.csv, nights.csv.with_suffix(".json"), *sorted(scene.iterdir())]
        return {path.name: path.read_bytes() for path in files}

    whole = content()
    assert average(nights) == 0
    assert content() == whole
    # Killed after the first mean, and again between card and manifest.
    (scene / "IMG_0007-0010.dng").unlink()
    nights.csv.write_bytes(listed[0])
    assert average(nights) == 0
    assert content() == whole
    nights.csv.write_bytes(listed[0])
    nights.csv.with_suffix(".json").write_bytes(listed[1])
    assert average(nights) == 0
    assert content() == whole


def test_nothing_is_left_beside_the_frames_or_where_temporary_files_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a run that was killed when the mean had its name, and still the other one, too: the next one removes it."""
    nights = photographed(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))  # no scratch can be made
    assert average(nights) == 0
    scene = nights.data / "DemoAlpha" / "scene-1"
    there = sorted(path.name for path in scene.iterdir())
    (scene / ".IMG_0001-0004.dng.eldata.part").hardlink_to(scene / "IMG_0001-0004.dng")
    assert average(nights) == 0
    assert sorted(path.name for path in scene.iterdir()) == there


def test_what_was_measured_against_a_single_one_is_removed(tmp_path: Path) -> None:
    nights = photographed(tmp_path)
    checked = ["check", str(nights.csv), "--root", str(tmp_path / "data"), "--jobs", "1", "--write"]
    assert main(checked) == 0
    assert rows(nights)["IMG_0005.dng"].measured_ratio is not None
    assert average(nights) == 0
    assert rows(nights)["IMG_0005.dng"].measured_ratio is None
    assert main(checked) == 0
    measured = rows(nights)["IMG_0005.dng"]
    assert measured.measured_ratio is not None
    assert average(nights) == 0  # nothing new, so what was measured stays
    assert rows(nights)["IMG_0005.dng"] == measured


def test_references_among_which_the_camera_moved_are_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nights = photographed(tmp_path, {3: 4.0})
    assert average(nights) == 1
    output = capsys.readouterr().out
    assert "IMG_0001.dng to DemoAlpha/scene-1/IMG_0004.dng: not averaged" in output
    assert "IMG_0003.dng: shift" in output
    assert "mean in DemoAlpha/scene-1/IMG_0007-0010.dng" in output
    found = rows(nights)
    assert found["IMG_0005.dng"].reference == "DemoAlpha/scene-1/IMG_0004.dng"
    assert "IMG_0001-0004.dng" not in found
    assert nights.problems() == []


def test_a_set_that_grows_says_that_its_means_are_to_be_made_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nights = Nights(tmp_path)
    plan = make_plan(CAMERA, BLOCKS, {"scene-1": Fraction(4)})
    card = tmp_path / "card"
    files = shoot(card, whole_plan(plan))
    late = files[3].rename(tmp_path / files[3].name)
    assert nights.add(plan, card, options=("--allow-gaps", "--yes")) == 0
    assert average(nights) == 0
    assert rows(nights)["IMG_0005.dng"].reference == "AcmeNocturne/scene-1/IMG_0002-0004.dng"
    capsys.readouterr()
    late.rename(files[3])
    assert nights.add(plan, card, options=("--append", "--yes")) == 0
    assert "2 noisy frames of the set compared with single references again: capture average" in capsys.readouterr().out
    assert rows(nights)["IMG_0005.dng"].reference == "AcmeNocturne/scene-1/IMG_0004.dng"
    assert average(nights) == 0
    assert rows(nights)["IMG_0005.dng"].reference == "AcmeNocturne/scene-1/IMG_0001-0004.dng"
    assert nights.problems() == []


def test_what_cannot_be_averaged(tmp_path: Path) -> None:
    one = write_scenes(tmp_path / "one", ids=(1, 2, 6), size=(64, 96))
    with pytest.raises(ArgumentError, match="has no scene in which two references IMG_<nnnn> follow each other"):
        average_references(one.path, tmp_path / "one" / "data")

    nights = photographed(tmp_path)
    scene = nights.data / "DemoAlpha" / "scene-1"
    listed = nights.csv.read_bytes()
    (scene / "IMG_0007-0010.dng").write_bytes(b"mine")
    with pytest.raises(MappingError, match=r"IMG_0007-0010\.dng is there already with another content"):
        average_references(nights.csv, tmp_path / "data")
    assert (scene / "IMG_0007-0010.dng").read_bytes() == b"mine"
    assert nights.csv.read_bytes() == listed

    camera = CAMERAS[0].with_size(*SIZE)
    other = replace(camera.sensor, white_level_dn=16000.0)
    mosaic = values(scene / "IMG_0008.dng").astype(np.uint16).clip(max=16000)
    write_dng(scene / "IMG_0008.dng", mosaic, other, Exposure(Fraction(100), Fraction(4)))
    with pytest.raises(MappingError, match=r"IMG_0008\.dng: white level 16000\.0, expected 16383\.0 as in"):
        average_references(nights.csv, tmp_path / "data")
