"""A manifest of one's own raws, by EXIF and folders: as sets that others listed have it, and what it cannot know."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eldata.cli.main import main
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest import load_manifest, shipped_manifest, verify
from eldata.manifest.own import OwnSet, sort_own_set
from eldata.raw import write_dng
from eldata.records import Exposure, Sensor
from tests.sid_tree import build_sid_tree
from tests.trees import tree_in

SENSOR = Sensor("MAKER", "MODEL 3", ((0, 1), (3, 2)), (512.0,) * 4, 16300.0, 24, 32)
REFERENCE, NOISY = Exposure(Fraction(100), Fraction(4)), Exposure(Fraction(1600), Fraction(1, 400))


def shoot(path: Path, exposure: Exposure, sensor: Sensor = SENSOR, taken: datetime | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_dng(path, np.full((24, 32), 600, np.uint16), sensor, exposure, taken=taken)


def shoot_pair(folder: Path) -> None:
    shoot(folder / "clean.dng", REFERENCE)
    shoot(folder / "dark.dng", NOISY)


def told(found: OwnSet) -> dict[str, tuple[str, str, object, object]]:
    return {one.path: (one.role, one.scene, one.ratio, one.reference) for one in found.records}


def test_a_set_in_elds_layout_is_what_its_own_manifest_says(demo_tree: Path) -> None:
    """Factor 1 is exposed as the reference is, at a higher ISO; the nearest of four references is meant."""
    tree = tree_in(demo_tree)
    found = sort_own_set(tree.data, "mine")
    assert not found.problems
    assert found.records == tuple(replace(one, size_bytes=None, sha256=None) for one in tree.manifest.records)
    assert found.card.cameras == tree.manifest.card.cameras
    assert found.card.counts == tree.manifest.card.counts
    assert found.format_text().splitlines()[0] == (
        "DemoAlpha: 1 scene with 4 references and 12 noisy frames (3 x1, 3 x10, 3 x100, 3 x200); the first reference "
        "is DemoAlpha/scene-1/IMG_0001.dng (ISO 100, 4 s)"
    )


def test_sid_by_patterns(tmp_path: Path) -> None:
    """Its scenes lie across two folders, and its shutters round: 1/30 s for a factor of 300. A fifth of the scenes."""
    shipped = shipped_manifest("sid-sony")
    shipped = replace(shipped, records=tuple(one for one in shipped.records if one.scene.endswith(("3", "7"))))
    build_sid_tree(shipped, tmp_path)
    found = sort_own_set(tmp_path, "mine", reference="Sony/long/*", scene="Sony/*/{scene}_*")
    assert not found.problems
    listed = {one.path: one for one in shipped.records}
    assert {one.path for one in found.records} == set(listed)
    assert all(one.role == listed[one.path].role and one.scene == listed[one.path].scene for one in found.records)
    certain = [one for one in found.records if one.role == "noisy" and not listed[one.path].flags]
    assert len(certain) > 400
    assert {(one.ratio, listed[one.path].ratio) for one in certain} <= {(r, r) for r in (100, 250, 300)}
    assert all(one.reference == listed[one.path].reference for one in certain)


def test_what_is_written_verifies_and_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for scene in ("hall", "stairs"):
        shoot_pair(tmp_path / "MINE" / scene)
    csv = tmp_path / "mine.csv"
    command = ["manifest", str(tmp_path / "MINE"), "-o", str(csv), "--jobs", "1"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert f"eldata verify {csv} --root {tmp_path} --level metadata" in printed
    manifest = load_manifest(csv)
    assert verify([manifest], tmp_path, level="metadata").ok
    assert (manifest.card.title, manifest.card.protocol) == ("2 scenes taken with MODEL3", "raw")
    written = {path: path.read_bytes() for path in (csv, csv.with_suffix(".json"))}
    for ended in ((), (csv,), (csv.with_suffix(".json"),)):  # the same command again, and after one that was ended
        for path in ended:
            path.unlink()
        assert main(command) == 0
        assert {path: path.read_bytes() for path in written} == written
    csv.with_suffix(".json").write_text(csv.with_suffix(".json").read_text().replace("not stated", "CC0", 1))
    assert main(command) == 2
    assert f"{csv.with_suffix('.json')} is there already, with other content" in capsys.readouterr().err
    assert "CC0" in csv.with_suffix(".json").read_text()
    shoot(tmp_path / "MINE" / "hall" / "more.dng", replace(NOISY, iso=Fraction(3200)))
    assert main(command) == 2
    assert f"{csv} is there already, with other content" in capsys.readouterr().err
    assert csv.read_bytes() == written[csv]


def test_what_cannot_be_known_is_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "MINE"
    shoot_pair(folder / "sure")
    shoot(folder / "alike" / "a.dng", NOISY)
    shoot(folder / "alike" / "b.dng", NOISY)
    shoot(folder / "brighter" / "high-iso.dng", replace(REFERENCE, iso=Fraction(3200)))
    shoot(folder / "brighter" / "low-iso.dng", replace(NOISY, iso=Fraction(100)))
    shoot(folder / "unstated" / "a.dng", REFERENCE)
    shoot(folder / "unstated" / "b.dng", Exposure(Fraction(800)))
    (folder / "sure" / "cut.dng").write_bytes((folder / "sure" / "dark.dng").read_bytes()[:300])
    shoot(folder / "nameless" / "a.dng", REFERENCE, replace(SENSOR, model=""))
    found = sort_own_set(folder, "mine")
    assert sorted((one.path, one.field) for one in found.problems) == [
        ("alike", "reference"),
        ("brighter", "reference"),
        ("nameless/a.dng", "camera"),
        ("sure/cut.dng", "file"),
        ("unstated/b.dng", "exposure"),
    ]
    assert all("PATTERN" in one.advice for one in found.problems if one.field == "reference")
    assert main(["manifest", str(folder), "-o", str(tmp_path / "mine.csv"), "--jobs", "1"]) == 1
    assert "5 problems: nothing was written" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["MINE"]


def test_patterns_that_do_not_fit(tmp_path: Path) -> None:
    shoot(tmp_path / "a" / "1_long.dng", REFERENCE)
    shoot(tmp_path / "a" / "1_short.dng", NOISY)
    for wrong in ("*", "{scene}/{scene}_*"):
        with pytest.raises(ArgumentError, match="with one"):
            sort_own_set(tmp_path, "mine", scene=wrong)
    assert [one.field for one in sort_own_set(tmp_path, "mine", scene="{scene}_*").problems] == ["scene", "scene"]
    for reference in ("*long*/*", "*"):
        (problem,) = sort_own_set(tmp_path, "mine", reference=reference).problems
        assert (problem.path, problem.field) == ("a", "reference")
    found = sort_own_set(tmp_path, "mine", scene="a/{scene}_*", reference="*_long.dng")
    assert told(found)["a/1_short.dng"] == ("noisy", "1", 100, "a/1_long.dng")
    with pytest.raises(DatasetError, match="no such folder"):
        sort_own_set(tmp_path / "a" / "none", "mine")


def test_scenes_of_one_name_are_kept_apart_and_calibration_frames_are_told(tmp_path: Path) -> None:
    for night in ("first night", "second"):
        shoot_pair(tmp_path / night / "hall")
    shoot(tmp_path / "calibration" / "bias" / "ISO100" / "b.dng", Exposure(Fraction(100), Fraction(1, 8000)))
    found = sort_own_set(tmp_path, "mine")
    assert not found.problems
    assert {one.scene for one in found.records} == {"first-night-hall", "second-hall", ""}
    for name in ("a b", "a  b"):  # one name without spaces
        shoot_pair(tmp_path / name)
    assert [(one.path, one.field) for one in sort_own_set(tmp_path, "mine").problems] == [("a b", "scene")]
    assert told(found)["calibration/bias/ISO100/b.dng"] == ("bias", "", None, None)
    assert found.card.counts == {"bias": 1, "noisy": 2, "reference": 2}


@pytest.mark.parametrize("clock", [True, False])
def test_the_nearest_reference_is_by_the_clock_where_all_state_one(clock: bool, tmp_path: Path) -> None:
    """By names the first reference is nearest, by the clock the second; a clock that one file lacks tells nothing."""
    minutes = {"a-clean": 0, "b-dark": 50, "c-other": 55, "d-clean": 59}
    for name, minute in minutes.items():
        taken = datetime(2026, 1, 1, 0, minute) if clock or name != "c-other" else None  # noqa: DTZ001 # a camera's clock
        shoot(tmp_path / "hall" / f"{name}.dng", REFERENCE if "clean" in name else NOISY, taken=taken)
    found = sort_own_set(tmp_path, "mine")
    assert told(found)["hall/b-dark.dng"][3] == f"hall/{'d' if clock else 'a'}-clean.dng"


def test_one_frame_of_each_shot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """RAW and DNG, a copy, another spelling are named, not counted; no DNG beside its raw is a fault to verify."""
    folder = tmp_path / "MINE" / "hall"
    taken = datetime(2026, 1, 1, 0, 0, 1, 250_000)  # noqa: DTZ001 # a camera's clock
    shoot(folder / "IMG_1.dng", REFERENCE, taken=taken)
    shoot(folder / "IMG_2.DNG", NOISY, taken=taken)
    shoot(folder / "IMG_2 (1).DNG", Exposure(Fraction(800), Fraction(1, 400)), taken=taken)  # another shot
    shoot(folder / "IMG_1.NEF", REFERENCE, taken=taken.replace(microsecond=0))
    shutil.copy(folder / "IMG_2.DNG", folder / "IMG_2 (2).DNG")
    shutil.copy(folder / "IMG_2.DNG", folder / "img_2.dng")
    found = sort_own_set(tmp_path / "MINE", "mine")
    assert sorted(told(found)) == ["hall/IMG_1.NEF", "hall/IMG_2 (1).DNG", "hall/IMG_2.DNG"]
    assert dict(found.left_out) == {
        "hall/IMG_1.dng": "hall/IMG_1.NEF",
        "hall/IMG_2 (2).DNG": "hall/IMG_2.DNG",
        "hall/img_2.dng": "hall/IMG_2.DNG",
    }
    command = ["manifest", str(tmp_path / "MINE"), "-o", str(tmp_path / "mine.csv"), "--jobs", "1"]
    assert main(command) == 0
    assert "left out: hall/IMG_1.dng shows the shot of hall/IMG_1.NEF; 2 more alike" in capsys.readouterr().out
    report = verify(tmp_path / "mine.csv", tmp_path)
    assert [problem.path for problem in report.problems] == ["hall/IMG_2 (2).DNG", "hall/img_2.dng"]
    shoot(folder / "img_2.dng", Exposure(Fraction(3200), Fraction(1, 400)))
    (problem,) = sort_own_set(tmp_path / "MINE", "mine").problems
    assert (problem.path, problem.found) == ("hall/img_2.dng", "hall/IMG_2.DNG")
