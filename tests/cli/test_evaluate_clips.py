"""`eldata evaluate` and `eldata compare` on clips: everything that datasets of images have."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.base.arrays import read_rgb16
from eldata.datasets.published import DRVDataset
from eldata.evaluation import evaluate, load_result, save_clip_prediction
from eldata.manifest.table import save_records
from eldata.metrics.registry import CLIPS
from tests.drv_tree import SmallDrv, generator_of, small_drv, still_of
from tests.reports.evaluations import result_data, written
from tests.reports.pages import assert_well_formed, checked

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.conftest import Cli

SIZE = (48, 56)
CHOSEN = ("--clip", "0007", "--clip", "0013")


@pytest.fixture(scope="module")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    return small_drv(tmp_path_factory.mktemp("drv"), ("0007", "0013"), 12, size=SIZE)


def predict(drv: SmallDrv, folder: Path, noise: float) -> Path:
    for record in DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records:
        still = still_of(record.scene, SIZE).transpose(2, 0, 1) / 65535
        frames = 1.1 * still + generator_of(record.scene).normal(0, noise, (5, *still.shape))
        save_clip_prediction(folder, record, frames.astype(np.float32))
    return folder


@pytest.fixture(scope="module")
def predictions(drv: SmallDrv, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return predict(drv, tmp_path_factory.mktemp("predictions") / "soft", 0.01)


def run(eldata: Cli, drv: SmallDrv, *arguments: object, code: int = 0) -> str:
    common = ("--manifest", drv.csv, "--root", drv.root, "--jobs", "1")
    outcome = eldata("evaluate", *map(str, (*arguments, *common)))
    assert outcome.code == code, outcome.err
    return outcome.err if code == 2 else outcome.out


# --- the numbers, in every form ---------------------------------------------------------------------------------------


def test_json_csv_tables_and_page(eldata: Cli, drv: SmallDrv, predictions: Path, tmp_path: Path) -> None:
    files = ("--csv", tmp_path / "a.csv", "--json", tmp_path / "a.json", "--html", tmp_path / "a.html")
    text = run(eldata, drv, predictions, *CHOSEN, *files)
    saved = load_result(tmp_path / "a.json")
    result = evaluate(predictions, manifest=drv.csv, root=drv.root, ids=["0007", "0013"])
    assert saved.scores == result.scores
    assert saved.format_text() + "\n" == text == result.format_text() + "\n"
    assert saved.as_dict() == result.as_dict()
    assert text.startswith("drv, protocol drv-rgb: 2 of 2 videos, only 0007, 0013\n\nvideos  PSNR [dB]")
    with (tmp_path / "a.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == CLIPS.columns
    assert [float(row["st_rred"]) for row in rows] == [score.values["st_rred"] for score in result.scores]
    assert list(result.frame["scene"]) == ["0007", "0013"]
    numbers = [f"{result.psnr_db:.2f}", f"{result.ssim:.3f}", f"{result.whole.values['st_rred']:.3f}"]
    markdown = run(eldata, drv, predictions, *CHOSEN, "--format", "markdown")
    assert [cell.strip() for cell in markdown.splitlines()[2].split("|")[1:-1]] == ["2", *numbers]
    assert "drv 1.0, protocol drv-rgb (sha256:b867dd6b): 2 of 2 videos, only 0007, 0013." in markdown
    latex = run(eldata, drv, predictions, *CHOSEN, "--format", "latex")
    assert f"2 & {' & '.join(numbers)} \\\\" in latex
    assert r"\label{tab:drv-drv-rgb}" in latex

    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert_well_formed(page)
    text = checked(page).text
    for words in ("soft on drv", "Complete: 2 of 2 videos", "ST-RRED by camera", "Every video", "Rescaling that was"):
        assert words in text
    for words in ("ISO", "Every image", "pairs"):
        assert words not in text.rpartition("Where the numbers come from")[0]
    # Two clips are two scenes: both are among the worst. Of each, the frame with the lowest PSNR is shown.
    assert text.count("the frame with the lowest PSNR") == 2
    assert page.count('data-layer="input"') == page.count('data-layer="error"') == 2


def test_the_noisy_input(eldata: Cli, drv: SmallDrv, tmp_path: Path) -> None:
    """It equals the score of the frames themselves, saved as predictions."""
    for record in DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records:
        frames = np.stack([read_rgb16(drv.data / path) for path in record.frames]).transpose(0, 3, 1, 2)
        save_clip_prediction(tmp_path / "own", record, frames)
    text = run(eldata, drv, "--baseline", "input", *CHOSEN, "--html", tmp_path / "b.html")
    assert text == run(eldata, drv, tmp_path / "own", *CHOSEN)
    assert "The input itself on drv" in (tmp_path / "b.html").read_text(encoding="utf-8")
    baseline = evaluate(None, manifest=drv.csv, root=drv.root, ids=["0007", "0013"], baseline="input")
    assert baseline.provenance["predictions"] == "none: the input itself"


# --- which clips ------------------------------------------------------------------------------------------------------


def test_cameras_and_flags(eldata: Cli, drv: SmallDrv, predictions: Path, tmp_path: Path) -> None:
    shutil.copytree(drv.csv.parent, tmp_path / "manifests")
    own = SmallDrv(tmp_path / "manifests/drv.csv", drv.root)
    flagged = [
        replace(record, flags=("flicker",)) if record.scene == "0013" and record.role == "noisy" else record
        for record in own.manifest.records
    ]
    save_records(own.csv, flagged)
    text = run(eldata, own, predictions, *CHOSEN, "--exclude", "flicker", "--camera", "SonyRX100M6")
    assert text.startswith(
        "drv, protocol drv-rgb: 1 of 1 videos, only SonyRX100M6, only 0007, 0013, without flicker (1)\n"
    )
    whole = run(eldata, own, predictions, *CHOSEN)
    assert whole.startswith("drv, protocol drv-rgb: 2 of 2 videos, only 0007, 0013, flicker included (1)\n")
    for option, value, known in (("--camera", "Leica", "SonyRX100M6"), ("--exclude", "misaligned", "flicker")):
        message = run(eldata, own, predictions, *CHOSEN, option, value, code=2)
        assert f"{value}; known are {known}" in message
        assert message.count("\n") == 1
    assert "no clip has all of" in run(eldata, own, predictions, "--clip", "0013", "--exclude", "flicker", code=2)


# --- pages and comparisons --------------------------------------------------------------------------------------------


def test_compare(eldata: Cli, drv: SmallDrv, predictions: Path, tmp_path: Path) -> None:
    worse = predict(drv, tmp_path / "worse", 0.05)
    run(eldata, drv, predictions, *CHOSEN, "--json", tmp_path / "soft.json")
    run(eldata, drv, worse, *CHOSEN, "--json", tmp_path / "worse.json")
    paths = (tmp_path / "soft.json", tmp_path / "worse.json")
    outcome = eldata("compare", *paths, "--html", tmp_path / "c.html", "--json", tmp_path / "c.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("2 methods on 2 common videos of 2 scenes: drv, protocol drv-rgb (sha256:b867dd6b)\n")
    soft, rough = (load_result(path) for path in paths)
    means = outcome.out.splitlines()[6].split()
    # Lower is better of ST-RRED, and the better method has all three stars.
    soft_rred, rough_rred = (result.whole.values["st_rred"] for result in (soft, rough))
    assert soft_rred < rough_rred
    assert means[2:] == ["2", f"{soft.psnr_db:.2f}*", f"{soft.ssim:.3f}*", f"{soft_rred:.3f}*",
                         f"{rough.psnr_db:.2f}", f"{rough.ssim:.3f}", f"{rough_rred:.3f}"]  # fmt: skip
    group = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["groups"][-1]
    assert group["gains"][0]["st_rred"]["interval"]["mean"] == pytest.approx(rough_rred - soft_rred)
    page = checked((tmp_path / "c.html").read_text(encoding="utf-8")).text
    assert "Every video" in page
    assert "PSNR of 2 common videos" in page
    for form in ("markdown", "latex"):
        assert "ST-RRED" in eldata("compare", *paths, "--format", form).out
    refused = eldata("compare", written(tmp_path / "eld.json", result_data()), paths[0])
    assert refused.code == 2
    assert "eld has scores of images, soft of videos; these do not compare" in refused.err
