"""`evaluate` on SID: the published subsets on trees with the published names, which pairs, and the table."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.evaluation import EvaluationResult, evaluate, save_prediction
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.pairs import Choice
from eldata.raw import packed_shape, read_raw
from tests.sid_tree import frames_of, write_frames

if TYPE_CHECKING:
    from pathlib import Path


SUBSETS = {"sid-sony": "eval-first", "sid-fuji": "test-first"}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the subsets need, and no others."""
    folder = tmp_path_factory.mktemp("data")
    for name, subset in SUBSETS.items():
        manifest = shipped_manifest(name)
        pairs = Choice(subset=subset).pairs(manifest.records, manifest.card.subsets)
        write_frames(name, folder / "SID", frames_of(manifest, {pair.path for pair in pairs}))
    return folder


@pytest.fixture(scope="module")
def predictions(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, generator = tmp_path_factory.mktemp("predictions"), np.random.default_rng(2)
    for name, subset in SUBSETS.items():
        manifest = shipped_manifest(name)
        for pair in Choice(subset=subset).pairs(manifest.records, manifest.card.subsets):
            sensor = read_raw(root / "SID" / pair.reference).sensor
            shape = packed_shape((sensor.height, sensor.width), sensor.cfa)
            save_prediction(folder / name, pair.path, generator.random(shape, np.float32))
    return folder


@pytest.fixture(scope="module")
def results(root: Path, predictions: Path) -> dict[str, EvaluationResult]:
    return {name: evaluate(predictions / name, name, root=root) for name in SUBSETS}


@pytest.mark.parametrize(("name", "counts"), [("sid-sony", (40, 40, 49)), ("sid-fuji", (41, 27, 26))])
def test_the_table_has_the_means_of_each_factor(
    name: str, counts: tuple[int, ...], results: dict[str, EvaluationResult]
) -> None:
    """Each score is held against the published code in ``test_every_protocol``."""
    result = results[name]
    assert (result.protocol.name, result.provenance["subset"]) == ("sid", SUBSETS[name])
    assert len(result.scores) == len(result.units) == sum(counts)
    factors = (100, 250, 300)
    assert [(row.ratio, row.pairs) for row in result.table] == [
        *zip(factors, counts, strict=True),
        (None, sum(counts)),
    ]
    for row in result.table:
        members = [image for image in result.scores if row.ratio in (None, image.ratio)]
        for value in ("psnr_db", "ssim"):
            assert row.values[value] == pytest.approx(np.mean([one.values[value] for one in members]), rel=1e-12)


def test_the_table_says_which_pairs(results: dict[str, EvaluationResult]) -> None:
    first = {name: result.format_text().splitlines()[0] for name, result in results.items()}
    assert first == {
        "sid-sony": "sid-sony, protocol sid: 129 of 129 pairs, subset eval-first, misaligned included (5)",
        "sid-fuji": ("sid-fuji, protocol sid: 94 of 94 pairs, subset test-first, misaligned-unconfirmed included (3)"),
    }


def test_misaligned_scenes_can_be_left_out(root: Path, predictions: Path, results: dict[str, EvaluationResult]) -> None:
    found = evaluate(predictions / "sid-sony", "sid-sony", root=root, exclude_flags=["misaligned"])
    bad = {pair.path for pair in found.units if pair.scene in ("10034", "10045", "10172")}
    assert bad == set()
    kept = [image for image in results["sid-sony"].scores if image.scene not in ("10034", "10045", "10172")]
    assert list(found.scores) == kept
    assert [row.pairs for row in found.table] == [38, 38, 48, 124]
    assert found.provenance["excluded_flags"] == {"misaligned": 5}
    assert "124 of 124 pairs, subset eval-first, without misaligned (5)" in found.format_text()
    assert "5 predictions" in found.notes[0], "theirs are not scored, and not extra"


# --- one folder for both cameras ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def both(predictions: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("both") / "preds"
    for name in SUBSETS:
        shutil.copytree(predictions / name, folder, dirs_exist_ok=True, copy_function=os.link)
    return folder


@pytest.mark.parametrize(("name", "other", "count"), [("sid-sony", "sid-fuji", 94), ("sid-fuji", "sid-sony", 129)])
def test_predictions_of_the_other_camera_are_noted_and_left_out(
    name: str, other: str, count: int, root: Path, both: Path, results: dict[str, EvaluationResult]
) -> None:
    found = evaluate(both, name, root=root)
    assert not found.problems
    assert found.scores == results[name].scores
    assert set(found.notes) - set(results[name].notes) == {
        f"{count} predictions of {other} are there too; not scored here"
    }


def test_the_other_camera_alone_is_one_message(root: Path, predictions: Path) -> None:
    (problem,) = evaluate(predictions / "sid-fuji", "sid-sony", root=root).problems
    assert problem.path == str(predictions / "sid-fuji")
    assert problem.reason.startswith("found 94 files, none of them where expected (the prediction of Sony/short/")
    assert problem.reason.endswith("; it holds predictions of other data, 94 of them of sid-fuji (--dataset sid-fuji)")
