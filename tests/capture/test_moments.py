"""Video sets, moment by moment: from the plan to ST-RRED, and what goes wrong between two moments."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rawpy

from capture.capture_errors import PlanError
from capture.check import check
from capture.checklist import FORMATS, load_progress
from capture.cli import main as capture
from capture.matching import match
from capture.observed import observe
from capture.plan import Plan
from capture.shots import MOVE_S, duration_of
from eldata import evaluate
from eldata.cli.main import main as eldata
from eldata.datasets import DRVRawDataset
from eldata.evaluation import save_clip_prediction
from eldata.manifest import load_manifest
from eldata.metrics import st_rred
from eldata.metrics.st_rred import PEAK_ELD
from tests.capture.films import film, film_plan, seen, shifted
from tests.capture.test_checklist import written
from tests.capture.test_progress import ticked
from tests.evaluation import published_code

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from capture.check.result import CheckedGroup, CheckReport

MOMENTS = 4
MANIFEST = "manifests/mine.csv"


def names(*moments: int, scene: int = 1) -> list[str]:
    return [f"scene-{scene}-moment-{moment}" for moment in moments]


def set_of(folder: Path, plan: Plan, *options: str) -> Path:
    """Make the set of a card's files; return its manifest."""
    plan.save(folder / "plan.json")
    target = folder / MANIFEST
    arguments = ["manifest", str(folder / "plan.json"), str(folder / "card"), "-o", str(target)]
    assert capture([*arguments, "--copy-to", str(folder / "data" / "Mine"), "--jobs", "1", *options]) == 0
    return target


# --- from plan to score -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of four moments, two noisy frames of each setting, planned on the command line."""
    folder = tmp_path_factory.mktemp("film")
    film_plan(1).camera.save(folder / "cam.json")
    line = "--scenes 2 --metered 4 --isos 800 --factors 1 100 --moments 4 --repeats 2"
    assert capture(["plan", "--camera", str(folder / "cam.json"), *line.split(), "-o", str(folder / "plan.json")]) == 0
    film(folder / "card", Plan.load(folder / "plan.json"))
    set_of(folder, Plan.load(folder / "plan.json"))
    return folder


def test_from_plan_to_st_rred(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert eldata(["verify", MANIFEST, "--root", "data", "--level", "full", "--jobs", "1"]) == 0
    dataset = DRVRawDataset(made / "data" / "Mine", manifest=MANIFEST, window=MOMENTS)
    assert len(dataset) == 2 * 2 * 2  # sequences, factors, repeats
    scores = tmp_path / "scores.json"
    score = ["evaluate", "--protocol", "sequences", "--manifest", MANIFEST, "--root", "data", "--jobs", "1"]
    assert eldata([*score, "--baseline", "input", "--json", str(scores)]) == 0
    assert "ST-RRED" in capsys.readouterr().out
    content = json.loads(scores.read_text())
    assert {row["ratio"]: row["count"] if "count" in row else row.get("videos") for row in content["table"]}
    videos = {video["scene"]: video for video in content["videos"]}
    assert len(videos) == 8
    assert content["coverage"]["missing"] == []
    for record in dataset.records:
        video = videos[record.scene]
        assert video["frames"] == MOMENTS
        compare_with_the_published_code(video, made / "data" / "Mine", record.paths, record.references)
    by_factor = {f: np.mean([v["st_rred"] for s, v in videos.items() if f"-x{f}" in s]) for f in (1, 100)}
    assert by_factor[1] < by_factor[100]


def compare_with_the_published_code(
    video: dict[str, object], folder: Path, frames: Sequence[str], references: Sequence[str]
) -> None:
    """Each frame with its own reference by the ELD code's metrics, and ST-RRED of the two films."""
    shown, truth, found = [], [], []
    for frame, reference in zip(frames, references, strict=True):
        with rawpy.imread(str(folder / frame)) as dark, rawpy.imread(str(folder / reference)) as bright:
            still = published_code.eld_frame(bright, white=None)
            noisy = published_code.eld_frame(dark, white=None)
        ratio = exposure(folder / reference) / exposure(folder / frame)
        (one,), (corrected,) = published_code.eld_clip(np.clip(noisy * float(ratio), 0, 1)[None], still, correct=True)
        found.append((one.psnr_db, one.ssim))
        shown.append(corrected)
        truth.append(still)
    assert (video["psnr_db"], video["ssim"]) == pytest.approx(tuple(np.mean(found, axis=0)), abs=1e-4)
    rred = st_rred(
        published_code.eld_grey(np.stack(shown)), published_code.eld_grey(np.stack(truth)), data_range=1.0, peak=PEAK_ELD
    )
    assert rred.st_rred > 0
    assert video["st_rred"] == pytest.approx(rred.st_rred, rel=1e-3)


def exposure(path: Path) -> Fraction:
    from eldata.raw.reading import read_header

    found = read_header(path).exposure
    assert found.iso is not None
    assert found.exposure_s is not None
    return found.iso * found.exposure_s
