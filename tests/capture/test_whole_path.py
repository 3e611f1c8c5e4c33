"""From plan to evaluated set, as a photographer goes; repeated frames, other apertures."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from capture.camera import CameraDescription, Shutter
from capture.check import check
from capture.cli import main as capture
from capture.plan import Plan, make_plan
from capture.protocol import CaptureProtocol
from capture.shots import ScenePlan
from eldata.cli.main import main as eldata
from eldata.datasets import PairDataset
from eldata.demo.camera import CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_radiance
from eldata.manifest import load_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated import CAMERA, START, Nights, run_capture, shoot, whole_plan
from tests.shared import there

PROTOCOL = CaptureProtocol(noisy_isos=(800,), low_light_factors=(10, 100), repeats=3, references=2)
LRID = make_plan(CAMERA, PROTOCOL, {"scene-1": Fraction(4)})
HALF = Fraction(1, 2)
SIZE = (384, 576)
NIGHT = datetime(2026, 11, 21, 22)  # noqa: DTZ001 # a camera's clock


def description(camera: SimulatedCamera) -> CameraDescription:
    shutter = Shutter.between("1/8000", "30", Fraction(1, 3))
    return CameraDescription(camera.name, (camera.sensor.model,), ".dng", (100, 800, 1600, 3200), 100, shutter)


def photograph(card: Path, camera: SimulatedCamera, scene: ScenePlan, start: datetime, told: CameraDescription) -> None:
    """Take a scene's frames: what the shutter gives, and what the camera writes that it gave."""
    card.mkdir(parents=True, exist_ok=True)
    number = len(list(card.iterdir()))
    light = scene_radiance(int(scene.name.removeprefix("scene-")), *SIZE)
    camera = camera.with_size(*SIZE)
    for shot in scene.shots:
        number += 1
        start += timedelta(seconds=10)
        # More light through the same gain is a faster sensor.
        share = Fraction(shot.setting.true_s / scene.shots[0].setting.true_s) * told.speed(shot.iso) / shot.iso
        mosaic = camera.photograph(light, share, shot.iso, np.random.default_rng([number, start.hour]))
        exposure = Exposure(Fraction(shot.iso), shot.setting.nominal_s, scene.aperture)
        write_dng(card / f"DSC{number:05d}.dng", mosaic, camera.sensor, exposure, taken=start, compression="none")


def test_from_plan_to_scores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def run(line: str, code: int = 0) -> str:
        program, *arguments = line.split()
        assert (capture if program == "capture" else eldata)(arguments) == code, line
        output, errors = capsys.readouterr()
        assert errors == ""
        return output

    files = "-o manifests/mine.csv --copy-to data/Mine --jobs 1"
    for index, camera in enumerate(CAMERAS):
        name, plan = camera.name, f"{camera.name}.json"
        description(camera).save(f"{name}-camera.json")
        run(f"capture plan --camera {name}-camera.json --scenes 2 --metered 4 --protocol paper -o {plan}")
        # The second scene meters at 2 s; there is a backup of the card.
        assert "scene-2: metered at 2 s" in run(f"capture plan {plan} --remeter scene-2=2")
        card = tmp_path / f"card-{index}"
        for hour, scene in enumerate(Plan.load(plan).scenes):
            photograph(card, camera, scene, NIGHT + timedelta(hours=hour), description(camera))
        shutil.copytree(card, tmp_path / f"backup-{index}")
        again = "--append" if index else ""
        output = run(f"capture manifest {plan} {card} backup-{index} {files} {again}")
        assert "nor are 19 others alike" in output
        assert "20 of 20 shots have a file; 40 files were given" in output

    assert "2 scenes taken with DemoAlpha and DemoBeta" in (tmp_path / "manifests" / "mine.json").read_text()
    assert "40 files" in run("eldata verify manifests/mine.csv --root data --level full --jobs 1")
    # The names of the times are rounded, which the pixels show.
    output = run("capture check manifests/mine.csv --root data --jobs 1 --json check.json --sheet sheet.html", code=1)
    assert "EXIF has the rounded names of the shutter's times" in output
    assert "shoot again" not in output
    assert "6 pairs" in (tmp_path / "sheet.html").read_text()
    checked = json.loads((tmp_path / "check.json").read_text())["groups"]
    for group, scene in zip(checked, Plan.load("DemoAlpha.json").scenes, strict=False):
        for pair, shot in zip(group["pairs"], (shot for shot in scene.shots if shot.factor), strict=True):
            measured = pair["measured"]["EXIF ratio"]
            assert measured["value"] == pytest.approx(there(shot.true_ratio), abs=5 * measured["standard_error"])
            assert measured["standard_error"] < 0.02 * measured["value"]
    output = run(
        "eldata evaluate --baseline input --manifest manifests/mine.csv --root data --jobs 1 --json scores.json"
    )
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["protocol"]["name"] == "raw", "which the card names"
    assert "saturate" not in output, "each is divided by its own white level"
    # Two cameras, two scenes, three ISOs, two factors.
    assert len(scores["images"]) == 24
    assert {image["camera"] for image in scores["images"]} == {"DemoAlpha", "DemoBeta"}
    by_ratio = {
        ratio: np.mean([image["psnr_db"] for image in scores["images"] if image["ratio"] == ratio])
        for ratio in (100, 200)
    }
    assert by_ratio[100] > by_ratio[200] > 10  # twice the light is less noise
    assert "DemoAlpha" in output


# --- speeds of ISOs ---------------------------------------------------------------------------------------------------


def test_the_pixels_have_the_ratio_of_the_true_speeds(tmp_path: Path) -> None:
    """A camera whose ISO 800 is ISO 672: the plan's ratio is the pixels', EXIF's is not; every repeat is checked."""
    speeds = ((100, Fraction(100)), (800, Fraction(672)), (1600, Fraction(1600)), (3200, Fraction(3200)))
    told = replace(description(CAMERAS[0]), true_isos=speeds)
    plan = make_plan(told, CaptureProtocol(100, (800,), (10,), 3, 2), {"scene-1": Fraction(4)})
    plan = plan.set_aperture("scene-1", Fraction(8))
    photograph(tmp_path / "card", CAMERAS[0], plan.scenes[0], START, told)
    nights = Nights(tmp_path)
    nights.add(plan, tmp_path / "card", options=())
    report = check(nights.csv, tmp_path / "data")
    pairs = report.groups[0].pairs
    noisy = [shot for shot in plan.scenes[0].shots if shot.role == "noisy"]
    assert [pair[-8:-4] for pair in pairs] == [f"{shot.number:04d}" for shot in noisy] == ["0003", "0004", "0005"]
    for pair, shot in zip(pairs, noisy, strict=True):
        ratio = report.groups[0].row(pair)["ratio"]
        true_ratio, named_ratio = there(shot.true_ratio), float(there(shot.named_ratio))
        # Standard errors are 5 to 10 % too small (docs/capture.md).
        assert abs(ratio.value - true_ratio) < 1.1 * 5 * ratio.standard_error
        assert abs(named_ratio / true_ratio - 1) > 0.1
    # The manifest says that the names of ISOs are not to be trusted here, and the set can be used by the plan's ratios.
    assert nights.problems() == []
    assert [row.flags for row in load_manifest(nights.csv).records if row.role == "noisy"] == [("uncertain-iso",)] * 3
    output = run_capture("check", nights.csv, "--root", tmp_path / "data", "--jobs", "1", code=1)
    assert "DemoAlpha scene-1: look" in output
    assert 'EXIF has the names of ISOs, whose measured speeds are others: amplification="nominal"' in output
    dataset = PairDataset(nights.data, nights.csv, amplification="nominal")
    assert [sample["ratio"] for sample in dataset] == [10.0] * 3


# --- apertures --------------------------------------------------------------------------------------------------------


def test_apertures_are_compared(tmp_path: Path) -> None:
    nights = Nights(tmp_path)
    plan = LRID.set_aperture("scene-1", Fraction(8))
    texts = ["8", "8", "8", "7.9", "8", "5.6", "8", "8", None, "8"]
    known = [None if text is None else Fraction(text) for text in texts]
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
