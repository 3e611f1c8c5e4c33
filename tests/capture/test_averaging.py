"""`capture average`: means of references, held against LibRaw and numpy, in sets that go on growing."""

from __future__ import annotations

import hashlib
import json
import shutil
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
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError
from eldata.manifest import load_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated import CAMERA, START, Nights, shoot, whole_plan
from tests.capture.simulated_scenes import moved, write_scenes
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
    assert nights.add(plan, card, options=()) == 0
    return nights


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Nights:
    """Not to be changed: copy it."""
    return photographed(tmp_path_factory.mktemp("taken"))


@pytest.fixture
def nights(taken: Nights, tmp_path: Path) -> Nights:
    for name in ("data", "manifests"):
        shutil.copytree(taken.folder / name, tmp_path / name)
    return Nights(tmp_path)


def average(nights: Nights, *options: str) -> int:
    return main(["average", str(nights.csv), "--root", str(nights.folder / "data"), "--jobs", "1", *options])


def rows(nights: Nights) -> dict[str, FrameRecord]:
    return {record.path.rpartition("/")[2]: record for record in load_manifest(nights.csv).records}


def values(path: Path) -> NDArray[np.float64]:
    with rawpy.imread(str(path)) as raw:
        return raw.raw_image_visible.astype(np.float64)


def test_means_are_those_of_libraw_and_numpy(
    nights: Nights, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = nights.data / "DemoAlpha" / "scene-1"
    assert average(nights, "--jobs", "2", "--json", str(tmp_path / "means.json")) == 0
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


def test_again_and_after_a_kill_it_comes_to_the_same(nights: Nights, monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing is left beside the frames, nor where temporary files go."""
    monkeypatch.setattr(tempfile, "tempdir", str(nights.folder / "nowhere"))  # no scratch can be made
    card = nights.csv.with_suffix(".json")
    listed = nights.csv.read_bytes(), card.read_bytes()
    assert average(nights) == 0
    scene = nights.data / "DemoAlpha" / "scene-1"

    def content() -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in [nights.csv, card, *sorted(scene.iterdir())]}

    whole = content()
    assert average(nights) == 0
    assert content() == whole
    # Killed after the first mean, when that had its name and still the other one, and between card and manifest.
    (scene / "IMG_0007-0010.dng").unlink()
    (scene / ".IMG_0001-0004.dng.eldata.part").hardlink_to(scene / "IMG_0001-0004.dng")
    nights.csv.write_bytes(listed[0])
    assert average(nights) == 0
    assert content() == whole
    nights.csv.write_bytes(listed[0])
    card.write_bytes(listed[1])
    assert average(nights) == 0
    assert content() == whole


def test_what_was_measured_against_a_single_one_is_removed(nights: Nights) -> None:
    checked = ["check", str(nights.csv), "--root", str(nights.folder / "data"), "--jobs", "1", "--write"]
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


def test_what_cannot_be_averaged(nights: Nights, tmp_path: Path) -> None:
    one = write_scenes(tmp_path / "one", ids=(1, 2, 6), size=(64, 96))
    with pytest.raises(ArgumentError, match="has no scene in which two references IMG_<nnnn> follow each other"):
        average_references(one.path, tmp_path / "one" / "data")

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
