"""From plan to evaluated set, as a photographer goes: two cameras, two scenes, a backup."""

from __future__ import annotations

import json
import shutil
from datetime import datetime, timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.camera import CameraDescription, Shutter
from capture.cli import main as capture
from capture.plan import Plan
from eldata.cli.main import main as eldata
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.shared import there

if TYPE_CHECKING:
    from pathlib import Path

    from capture.shots import ScenePlan
    from eldata.demo.camera import SimulatedCamera

SIZE = (384, 576)
NIGHT = datetime(2026, 11, 21, 22)  # noqa: DTZ001 # a camera's clock


def description(camera: SimulatedCamera) -> CameraDescription:
    shutter = Shutter.between("1/8000", "30", Fraction(1, 3))
    return CameraDescription(camera.name, (camera.sensor.model,), ".dng", (100, 800, 1600, 3200), 100, shutter)


def shoot(card: Path, camera: SimulatedCamera, scene: ScenePlan, start: datetime, told: CameraDescription) -> None:
    """Take a scene's frames: what the shutter gives, and what the camera writes that it gave."""
    card.mkdir(parents=True, exist_ok=True)
    number = len(list(card.iterdir()))
    seen = scene_radiance(int(scene.name.removeprefix("scene-")), *SIZE)
    camera = camera.with_size(*SIZE)
    for shot in scene.shots:
        number += 1
        start += timedelta(seconds=10)
        # More light through the same gain is a faster sensor.
        share = Fraction(shot.setting.true_s / scene.shots[0].setting.true_s) * told.speed(shot.iso) / shot.iso
        mosaic = camera.photograph(seen, share, shot.iso, np.random.default_rng([number, start.hour]))
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
            shoot(card, camera, scene, NIGHT + timedelta(hours=hour), description(camera))
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
            assert measured["value"] == pytest.approx(float(there(shot.true_ratio)), abs=5 * measured["standard_error"])
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
