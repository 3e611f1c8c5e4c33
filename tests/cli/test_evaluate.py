"""`eldata evaluate A B C`, and `eldata evaluate` and `eldata compare` on clips, which have all that images have."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldata.datasets.published import DRVDataset
from eldata.evaluation import evaluate, load_result, save_clip_prediction
from eldata.manifest.table import save_records
from eldata.metrics.registry import CLIPS
from tests.cli.conftest import Cli
from tests.cli.test_usage import assert_one_line
from tests.drv_tree import SmallDrv, generator_of, small_drv, still_of
from tests.evaluation.helpers import Tree
from tests.reports.evaluations import result_data, written
from tests.reports.pages import assert_well_formed, checked

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
def soft(drv: SmallDrv, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return predict(drv, tmp_path_factory.mktemp("predictions") / "soft", 0.01)


def run(eldata: Cli, drv: SmallDrv, *arguments: object, code: int = 0) -> str:
    common = ("--manifest", drv.csv, "--root", drv.root, "--jobs", "1")
    outcome = eldata("evaluate", *map(str, (*arguments, *common)))
    assert outcome.code == code, outcome.err
    return outcome.err if code == 2 else outcome.out


# --- the numbers, in every form ---------------------------------------------------------------------------------------


def test_json_csv_tables_and_page(eldata: Cli, drv: SmallDrv, soft: Path, tmp_path: Path) -> None:
    files = ("--csv", tmp_path / "a.csv", "--json", tmp_path / "a.json", "--html", tmp_path / "a.html")
    text = run(eldata, drv, soft, *CHOSEN, *files)
    saved = load_result(tmp_path / "a.json")
    result = evaluate(soft, manifest=drv.csv, root=drv.root, ids=["0007", "0013"])
    assert saved.format_text() + "\n" == text == result.format_text() + "\n"
    assert saved.as_dict() == result.as_dict()
    assert text.startswith("drv, protocol drv-rgb: 2 of 2 videos, only 0007, 0013\n\nvideos  PSNR [dB]")
    with (tmp_path / "a.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == CLIPS.columns
    assert [float(row["st_rred"]) for row in rows] == [score.values["st_rred"] for score in result.scores]
    assert list(result.frame["scene"]) == ["0007", "0013"]
    numbers = [f"{result.psnr_db:.2f}", f"{result.ssim:.3f}", f"{result.whole.values['st_rred']:.3f}"]
    markdown = run(eldata, drv, soft, *CHOSEN, "--format", "markdown")
    assert [cell.strip() for cell in markdown.splitlines()[2].split("|")[1:-1]] == ["2", *numbers]
    assert "drv 1.0, protocol drv-rgb (sha256:b867dd6b): 2 of 2 videos, only 0007, 0013." in markdown
    latex = run(eldata, drv, soft, *CHOSEN, "--format", "latex")
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


# --- which clips ------------------------------------------------------------------------------------------------------


def test_cameras_and_flags(eldata: Cli, drv: SmallDrv, soft: Path, tmp_path: Path) -> None:
    shutil.copytree(drv.csv.parent, tmp_path / "manifests")
    own = SmallDrv(tmp_path / "manifests/drv.csv", drv.root)
    flagged = [
        replace(record, flags=("flicker",)) if record.scene == "0013" and record.role == "noisy" else record
        for record in own.manifest.records
    ]
    save_records(own.csv, flagged)
    text = run(eldata, own, soft, *CHOSEN, "--exclude", "flicker", "--camera", "SonyRX100M6")
    assert text.startswith(
        "drv, protocol drv-rgb: 1 of 1 videos, only SonyRX100M6, only 0007, 0013, without flicker (1)\n"
    )
    whole = run(eldata, own, soft, *CHOSEN)
    assert whole.startswith("drv, protocol drv-rgb: 2 of 2 videos, only 0007, 0013, flicker included (1)\n")
    for option, value, known in (("--camera", "Leica", "SonyRX100M6"), ("--exclude", "misaligned", "flicker")):
        message = run(eldata, own, soft, *CHOSEN, option, value, code=2)
        assert f"{value}; known are {known}" in message
        assert message.count("\n") == 1
    assert "no clip has all of" in run(eldata, own, soft, "--clip", "0013", "--exclude", "flicker", code=2)


# --- pages and comparisons --------------------------------------------------------------------------------------------


def test_compare(eldata: Cli, drv: SmallDrv, soft: Path, tmp_path: Path) -> None:
    worse = predict(drv, tmp_path / "worse", 0.05)
    run(eldata, drv, soft, *CHOSEN, "--json", tmp_path / "soft.json")
    run(eldata, drv, worse, *CHOSEN, "--json", tmp_path / "worse.json")
    paths = (tmp_path / "soft.json", tmp_path / "worse.json")
    outcome = eldata("compare", *paths, "--html", tmp_path / "c.html", "--json", tmp_path / "c.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("2 methods on 2 common videos of 2 scenes: drv, protocol drv-rgb (sha256:b867dd6b)\n")
    best, rough = (load_result(path) for path in paths)
    means = outcome.out.splitlines()[6].split()
    # Lower is better of ST-RRED, and the better method has all three stars.
    best_rred, rough_rred = (result.whole.values["st_rred"] for result in (best, rough))
    assert best_rred < rough_rred
    assert means[2:] == ["2", f"{best.psnr_db:.2f}*", f"{best.ssim:.3f}*", f"{best_rred:.3f}*",
                         f"{rough.psnr_db:.2f}", f"{rough.ssim:.3f}", f"{rough_rred:.3f}"]  # fmt: skip
    group = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["groups"][-1]
    assert group["gains"][0]["st_rred"]["interval"]["mean"] == pytest.approx(rough_rred - best_rred)
    page = checked((tmp_path / "c.html").read_text(encoding="utf-8")).text
    assert "Every video" in page
    assert "PSNR of 2 common videos" in page
    for form in ("markdown", "latex"):
        assert "ST-RRED" in eldata("compare", *paths, "--format", form).out
    refused = eldata("compare", written(tmp_path / "eld.json", result_data()), paths[0])
    assert refused.code == 2
    assert "eld has scores of images, soft of videos; these do not compare" in refused.err


# --- several folders in one pass --------------------------------------------------------------------------------------


@pytest.fixture
def several(predictions: Path, tmp_path: Path) -> list[Path]:
    """The same predictions twice, and once without those of one camera."""
    folders = [tmp_path / name for name in ("first", "second", "partly")]
    for folder in folders:
        shutil.copytree(predictions, folder)
    shutil.rmtree(folders[2] / "DemoBeta")
    return folders


def test_one_pass_writes_what_single_runs_write(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    """The one that lacks files is scored as it is alone: not; the exit code says so, and the others are compared."""
    outcome = eldata("evaluate", *several, *tree.arguments, "-o", tmp_path / "results")
    assert outcome.code == 1, outcome.err
    names = [*(f"{folder.name}.{kind}" for folder in several for kind in ("csv", "json")), "comparison.json"]
    assert sorted(path.name for path in (tmp_path / "results").iterdir()) == ["comparison.html", *sorted(names)]
    for folder in several:
        alone = tmp_path / "alone"
        code = eldata("evaluate", folder, *tree.arguments, "--json", f"{alone}.json", "--csv", f"{alone}.csv").code
        assert code == (1 if folder.name == "partly" else 0)
        for kind in ("json", "csv"):
            together = tmp_path / "results" / f"{folder.name}.{kind}"
            assert together.read_bytes() == alone.with_suffix(f".{kind}").read_bytes()
    compared = json.loads((tmp_path / "results" / "comparison.json").read_text())
    assert [method["name"] for method in compared["methods"]] == ["first", "second"]
    assert len(compared["common"]) == 12
    for name in ("first:", "second:", "partly:", "nothing was scored: ", "second minus first"):
        assert name in outcome.out


def test_suspect_predictions_are_problems(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    """Unless they are allowed; so says the last line."""
    for file in several[0].rglob("*.npy"):
        np.save(file, np.load(file)[[0, 1, 3, 2]])
    for arguments in ([several[0]], [*several[:2], "-o", tmp_path / "results"]):
        outcome = eldata("evaluate", *arguments, *tree.arguments)
        assert (outcome.code, "--allow-suspect makes this exit 0" in outcome.err) == (1, True), outcome.err
        assert "SUSPECT: as if packed R, G1, G2, B" in outcome.out
        assert eldata("evaluate", *arguments, *tree.arguments, "--allow-suspect").code == 0


def test_what_is_printed_draws_the_pictures(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    """And what compare prints of the results is what was printed with them."""
    out = tmp_path / "my results"
    named = ["--name", "ours", "--name", "theirs"]
    outcome = eldata("evaluate", *several[:2], *tree.arguments, *named, "-o", out)
    assert outcome.code == 0, outcome.err
    assert eldata("compare", out / "ours.json", out / "theirs.json").out.strip() in outcome.out
    asked, command = outcome.out.splitlines()[-1].split(": ", 1)
    assert asked == "to see every image beside each other"
    assert eldata(*shlex.split(command)[1:]).code == 0
    assert len(list((out / "pictures-pictures").iterdir())) >= 12
    assert "to see" not in eldata("evaluate", *several[:2], *tree.arguments, "--format", "latex", "-o", out).out
    next(several[1].rglob("*.npy")).write_bytes(b"")  # which stays a problem where missing ones are allowed
    assert eldata("evaluate", *several[:2], *tree.arguments, "--allow-missing").code == 1


def test_refusals(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for arguments, words in (
        ([several[0], several[1], "--json", tmp_path / "a.json"], "--json writes the result of one method"),
        ([several[0], tmp_path / "nowhere", "-o", tmp_path / "results"], "nowhere: there is no such folder"),
        ([several[0], several[1], "-o", tmp_path / "file"], "File exists"),
        ([several[0], several[1], "-o", tmp_path / "no" / "folder"], "No such file"),
        (["--baseline", "input", "-o", tmp_path / "results"], "-o and --name are for folders of predictions"),
    ):
        assert_one_line(eldata("evaluate", *arguments, *tree.arguments), words)
        assert not (tmp_path / "results").exists()
