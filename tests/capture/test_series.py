"""Frames beside the usual ones, with real files: repeated ones, other apertures, a warm sensor."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

from capture.check import check
from capture.plan import Plan, make_plan
from capture.protocol import CaptureProtocol
from capture.shots import plan_calibration
from eldata import CalibrationFrames
from eldata.datasets import PairDataset
from eldata.demo.camera import CAMERAS
from eldata.manifest import load_manifest
from tests.capture.simulated import CAMERA, START, Nights, as_planned, run_capture, shoot, whole_plan
from tests.capture.test_whole_path import description
from tests.capture.test_whole_path import shoot as shoot_scene

if TYPE_CHECKING:
    from pathlib import Path

PROTOCOL = CaptureProtocol(noisy_isos=(800,), low_light_factors=(10, 100), repeats=3, references=2)
LRID = make_plan(CAMERA, PROTOCOL, {"scene-1": Fraction(4)})
HALF = Fraction(1, 2)


# --- speeds of ISOs ---------------------------------------------------------------------------------------------------


def test_the_pixels_have_the_ratio_of_the_true_speeds(tmp_path: Path) -> None:
    """A camera whose ISO 800 is ISO 672: the plan's ratio is the pixels', EXIF's is not; every repeat is checked."""
    speeds = ((100, Fraction(100)), (800, Fraction(672)), (1600, Fraction(1600)), (3200, Fraction(3200)))
    told = replace(description(CAMERAS[0]), true_isos=speeds)
    plan = make_plan(told, CaptureProtocol(100, (800,), (10,), 3, 2), {"scene-1": Fraction(4)})
    plan = plan.set_aperture("scene-1", Fraction(8))
    plan.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json") == plan
    shots = plan.scenes[0].shots
    shoot_scene(tmp_path / "card", CAMERAS[0], plan.scenes[0], START, told)
    nights = Nights(tmp_path)
    nights.add(plan, tmp_path / "card", options=())
    report = check(nights.csv, tmp_path / "data")
    pairs = report.groups[0].pairs
    noisy = [shot for shot in shots if shot.role == "noisy"]
    assert [pair[-8:-4] for pair in pairs] == [f"{shot.number:04d}" for shot in noisy] == ["0003", "0004", "0005"]
    for pair, shot in zip(pairs, noisy, strict=True):
        ratio = report.groups[0].row(pair)["ratio"]
        assert shot.true_ratio is not None
        assert shot.named_ratio is not None
        # Standard errors are 5 to 10 % too small (docs/capture.md).
        assert abs(ratio.value - float(shot.true_ratio)) < 1.1 * 5 * ratio.standard_error
        assert abs(float(shot.named_ratio) / float(shot.true_ratio) - 1) > 0.1
    # The manifest says that the names of ISOs are not to be trusted here, and the set can be used by the plan's ratios.
    assert nights.problems() == []
    assert [record.flags for record in load_manifest(nights.csv).records if record.role == "noisy"] == [
        ("uncertain-iso",)
    ] * 3
    output = run_capture("check", nights.csv, "--root", tmp_path / "data", "--jobs", "1", code=1)
    assert "DemoAlpha scene-1: look" in output
    assert 'EXIF has the names of ISOs, whose measured speeds are others: amplification="nominal"' in output
    dataset = PairDataset(nights.data, nights.csv, amplification="nominal")
    assert [sample["ratio"] for sample in dataset] == [10.0] * 3


# --- apertures --------------------------------------------------------------------------------------------------------


def test_apertures_are_compared(tmp_path: Path) -> None:
    nights = Nights(tmp_path)
    plan = LRID.set_aperture("scene-1", Fraction(8))
    given = ["8", "8", "8", "7.9", "8", "5.6", "8", "8", None, "8"]
    known = [None if text is None else Fraction(text) for text in given]
    taken = [replace(press, f_number=f_number) for press, f_number in zip(whole_plan(plan), known, strict=True)]
    files = shoot(nights.folder / "card", taken)
    output = nights.add(plan, nights.folder / "card", options=(), code=1)  # to be confirmed
    assert f"{files[5].name} (scene-1 frame 6): taken at f/5.6, where the plan has f/8: take the scene again" in output
    assert output.count("taken at f/") == 1
    nights.add(plan, nights.folder / "card", options=("--yes",))
    report = check(nights.csv, nights.folder / "data")
    found = [str(remark) for remark in report.groups[0].remarks if "EXIF states" in remark.text]
    assert len(found) == 1
    assert "IMG_0006.dng: EXIF states f/5.6, expected f/8 as in IMG_0001.dng" in found[0]
    assert report.groups[0].verdict == "shoot again"
    # Repeated frames are pairs of the nearest reference.
    rows = load_manifest(nights.csv).records
    noisy = [(row.path[-8:-4], row.ratio, (row.reference or "")[-8:-4]) for row in rows if row.role == "noisy"]
    assert noisy == [
        *[(f"{n:04d}", Fraction(10), "0002") for n in (3, 4, 5)],
        *[(f"{n:04d}", Fraction(100), "0009") for n in (6, 7, 8)],
    ]
    assert "3 noisy frames of each, 2 references before and after" in nights.csv.with_suffix(".json").read_text()


# --- a warm sensor ----------------------------------------------------------------------------------------------------


def test_bias_frames_of_a_warm_sensor(tmp_path: Path) -> None:
    """They are where eldata calibrate takes them from, and the usual frames are as if there were no other."""
    nights = Nights(tmp_path)
    frames = plan_calibration(CAMERA, 100, (800,), Fraction(1), bias_frames=4, flat_levels=(HALF,), warm=True)
    plan, shots = replace(LRID, calibration=frames), frames.shots
    assert [shot.number for shot in shots] == list(range(1, 4 + 2 + 4 + 1))
    usual = plan_calibration(CAMERA, 100, (800,), Fraction(1), bias_frames=4, flat_levels=(HALF,)).shots
    assert shots[:6] == usual
    assert {shot.series for shot in shots[6:]} == {"warm"}
    order = (shots[:6], plan.scenes[0].shots, shots[6:])  # the cold frames before the scene, the warm ones after it
    shoot(nights.folder / "card", [one for some in order for one in as_planned(some)])
    output = nights.add(plan, nights.folder / "card", options=())
    assert "bias frames of ISO 800 (warm)" in output
    assert "20 of 20 shots have a file" in output
    assert nights.problems() == []
    folder = nights.data / CAMERA.name
    for series in ("", "warm"):
        placed = CalibrationFrames(folder / series)
        times_s = [placed.read(record).exposure.exposure_s for record in placed.of("bias", 800)]
        assert times_s == [Fraction(1, 8000)] * 4
    rows = CalibrationFrames(nights.data, manifest=nights.csv).records
    assert [row.path for row in rows] == [
        row.path for row in load_manifest(nights.csv).records if row.role in ("bias", "flat") and not row.flags
    ]
    assert len(rows) == 6
    flags = {row.path.rpartition("/bias/")[0]: row.flags for row in load_manifest(nights.csv).records}
    assert flags[CAMERA.name] == ()
    assert flags[f"{CAMERA.name}/warm"] == ("warm-sensor",)
    manifest = load_manifest(nights.csv)
    bias = tuple(row for row in manifest.records if row.role == "bias")  # flats are too small
    names = [group.name for group in check(replace(manifest, records=bias), nights.folder / "data").groups]
    assert names == ["AcmeNocturne bias ISO 800", "AcmeNocturne bias ISO 800 warm-sensor"]
