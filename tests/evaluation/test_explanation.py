"""Why a score is what it is: every other choice against an evaluation under a protocol that makes it, and the words."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.cli.main import main
from eldata.datasets.published.clips import DRVDataset
from eldata.errors import ArgumentError
from eldata.evaluation import evaluate, explain, save_clip_prediction
from eldata.manifest.drv import scan_raw
from eldata.protocols import PROTOCOLS
from eldata.protocols.digests import CHOOSING
from eldata.protocols.kinds import IMAGES
from eldata.protocols.words import FIELDS
from eldata.sources.store import build_store, source_of_dataset
from tests.drv_tree import SENSOR, generator_of, small_drv, still_of, write_raw_clip
from tests.evaluation.helpers import Tree, place
from tests.evaluation.own_set import build_own_set
from tests.reports.pages import assert_well_formed

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.explanation import Explanation

FRAME = "DemoBeta/scene-1/IMG_0009.dng"


def check_each(found: Explanation, protocol: str, predictions: Path | None, **options: Any) -> list[str]:
    """Hold the score, and each choice's, against evaluations; return the fields that have scores."""
    base = PROTOCOLS[protocol]
    (own,) = [one for one in evaluate(predictions, protocol=base, **options).scores if one.path == found.score.path]
    assert found.score == own
    assert found.numbers == own.values
    for one in found.alternatives:
        changed = replace(base, name="changed", **{one.name: one.value})
        if one.group == "alone":
            with pytest.raises(ArgumentError):
                changed.check()
        if one.numbers:
            scores = evaluate(predictions, protocol=changed, **options).scores
            (score,) = [other for other in scores if other.path == own.path]
            assert one.numbers == score.values, one
            assert one.like or one.value not in {getattr(p, one.name, None) for p in PROTOCOLS.values()}
        else:
            assert one.reason
    return [one.name for one in found.alternatives if one.numbers]


@pytest.mark.parametrize("protocol", ["eld", "led-eld", "eld-srgb"])
def test_each_choice_scores_as_a_protocol_that_makes_it(protocol: str, tree: Tree, predictions: Path) -> None:
    found = explain(predictions, frame=FRAME, protocol=protocol, **tree.where)
    fields = check_each(found, protocol, predictions, **tree.where)
    assert {"levels", "reference_clip", "rescaling", "ssim_window"} <= set(fields)


def test_of_the_input_what_it_was_made_with_counts(tree: Tree) -> None:
    options: dict[str, Any] = tree.where | {"baseline": "input"}
    found = explain(None, frame=FRAME, **options)
    assert {"input_clip", "amplification"} <= set(check_each(found, "eld", None, **options))


def test_no_value_of_a_shipped_protocol_is_dropped(tree: Tree, predictions: Path) -> None:
    found = explain(predictions, **tree.where)
    shipped = [protocol for protocol in PROTOCOLS.values() if protocol.kind is IMAGES]
    for name in FIELDS:
        if hasattr(PROTOCOLS["eld"], name) and name not in (*CHOOSING, "psnr", "ssim", "pixels", "dark_shading"):
            other = {getattr(protocol, name) for protocol in shipped} - {getattr(PROTOCOLS["eld"], name)}
            assert {one.value for one in found.alternatives if one.name == name} >= other, name


def test_raw_clips(tmp_path: Path) -> None:
    write_raw_clip(tmp_path / "DRV", "0013", 12)
    manifest = scan_raw(tmp_path / "DRV").save(tmp_path / "drv-raw.csv")
    dataset = DRVDataset(tmp_path / "DRV", form="raw", split="test", frames="evaluation")
    shape = (5, 4, SENSOR.height // 2, SENSOR.width // 2)
    frames = np.random.default_rng(0).uniform(-0.1, 1.1, shape).astype(np.float32)
    save_clip_prediction(tmp_path / "preds", dataset.records[0], frames)
    options: dict[str, Any] = {"manifest": manifest.path, "root": tmp_path, "ids": ["0013"]}
    found = explain(tmp_path / "preds", protocol="drv-raw", **options)
    assert {"levels", "reference_clip", "region"} <= set(check_each(found, "drv-raw", tmp_path / "preds", **options))


def test_clips_as_their_authors_prepared_them(tmp_path: Path) -> None:
    size = (48, 56)
    drv = small_drv(tmp_path / "drv", ("0007", "0013"), 12, size=size)
    predictions = tmp_path / "predictions"
    for record in DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records:
        still = still_of(record.scene, size).transpose(2, 0, 1) / 65535
        frames = 1.1 * still + generator_of(record.scene).normal(0, 0.01, (5, *still.shape))
        save_clip_prediction(predictions, record, frames.astype(np.float32))
    options: dict[str, Any] = {"manifest": drv.csv, "root": drv.root, "ids": ["0007", "0013"]}
    found = explain(predictions, frame="0013", **options)
    assert {"rescaling", "region", "ssim_window"} <= set(check_each(found, "drv-rgb", predictions, **options))
    assert found.score.name == "0013"
    assert {one.name for one in found.alternatives if one.group == "here"} >= {"frames", "frame_count", "pixels"}
    assert dict(found.steps)["clip"].startswith("5 frames")


def test_a_store_and_other_processes_tell_the_same(tmp_path: Path) -> None:
    own = build_own_set(tmp_path, scenes=2)
    store = tmp_path / "mine.h5"
    build_store(source_of_dataset("mine", root=own.root, manifest=own.manifest), store, compression="lz4")
    options: dict[str, Any] = own.where | {"baseline": "input"}
    found = explain(None, **options)
    assert explain(None, store=store, **options) == found
    assert explain(None, workers=2, **options) == found


# --- does it show what is wrong? --------------------------------------------------------------------------------------


def test_a_prediction_that_is_too_bright_is_seen(tree: Tree, tmp_path: Path) -> None:
    place(tmp_path / "bright", tree, lambda target, _: 1.1 * target)
    found = explain(tmp_path / "bright", protocol="eld-uncorrected", **tree.where)
    (factor,) = [one for one in found.alternatives if one.name == "rescaling"]
    assert factor.numbers["rescale"] == pytest.approx(1 / 1.1, rel=0.01)  # some of it is clamped
    assert factor.numbers["psnr_db"] > found.numbers["psnr_db"] + 10
    assert f"here {factor.numbers['rescale']:.4g}" in " ".join(found.text.split())
    assert dict(explain(tmp_path / "bright", **tree.where).steps)["factor"].startswith("0.9")


def test_a_prediction_that_was_clipped_is_seen(tree: Tree, tmp_path: Path) -> None:
    place(tmp_path / "clipped", tree, lambda target, _: np.clip(target, 0, np.quantile(target, 0.75)))
    found = explain(tmp_path / "clipped", **tree.where)
    ends = dict(found.steps)["prediction has"]
    assert "and 25." in ends
    assert "and 25." not in dict(found.steps)["reference has"]


def test_a_wrong_ratio_is_seen(tmp_path: Path) -> None:
    """The manifest says 52, the files 50."""
    own = build_own_set(tmp_path, ratios=(50,))
    table = own.manifest.read_text(encoding="utf-8")
    own.manifest.write_text(table.replace(",50,", ",52,"), encoding="utf-8")
    found = explain(None, **own.where, baseline="input", protocol="eld-uncorrected")
    assert "50 by the files' exposures, 52 by the manifest" in dict(found.steps)["exposure ratio"]
    (nominal,) = [one for one in found.alternatives if one.name == "amplification" and one.value == "nominal"]
    assert nominal.numbers["psnr_db"] != found.numbers["psnr_db"]


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_prints_writes_and_shows_it(
    tree: Tree, predictions: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = [str(predictions), *tree.arguments]
    saved, page = tmp_path / "result.json", tmp_path / "page.html"
    assert main(["evaluate", *common, "--explain", "--json", str(saved), "--html", str(page)]) == 0
    told = capsys.readouterr().out
    data = json.loads(saved.read_text(encoding="utf-8"))
    worst = min(data["images"], key=lambda one: one["psnr_db"])
    explanation = told[told.index(f"{worst['path']}, the worst of 12") :]
    assert repr(worst["psnr_db"]) in explanation
    assert max(len(line) for line in explanation.splitlines() if str(predictions) not in line) <= 80
    first, median = data["explanations"]
    assert first["score"] == worst
    assert sorted(one["psnr_db"] for one in data["images"])[5] == median["score"]["psnr_db"]
    text = page.read_text(encoding="utf-8")
    assert_well_formed(text)
    assert text.count("<summary>Demo") == 2

    assert main(["evaluate", *common, "--explain", worst["path"], "--format", "latex", "--html", str(page)]) == 0
    out, err = capsys.readouterr()
    assert "step by step" not in out
    assert "step by step" in err
    assert main(["evaluate", *common, "--html", str(page)]) == 0
    assert "step by step" not in "".join(capsys.readouterr())
    assert page.read_text(encoding="utf-8").count("<summary>Demo") == 2


def test_what_cannot_be_explained_is_refused(tree: Tree, predictions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = tree.arguments
    assert main(["evaluate", str(predictions), *common, "--explain", FRAME.replace("9", "8")]) == 2
    out, err = capsys.readouterr()
    assert "12 of 12 pairs" in out, "the evaluation is not lost"
    assert "did you mean" in err
    assert main(["evaluate", str(predictions), str(predictions), *common, "--explain"]) == 2
    with pytest.raises(ArgumentError, match="2 images are called so"):
        explain(predictions, frame="IMG_0009.dng", **tree.where)
