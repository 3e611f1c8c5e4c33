"""SID, LRD and LRID: published subsets on trees with the published names, which pairs, the table; LRID's arithmetic."""

from __future__ import annotations

import math
import os
import re
import shutil
import zlib
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from eldata.datasets import LRIDDataset
from eldata.evaluation import EvaluationResult, evaluate, save_prediction
from eldata.evaluation.scores import list_groups
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.pairs import Choice
from eldata.manifest.verify import verify
from eldata.raw import packed_shape, read_raw
from tests import lrd_tree, lrid_tree
from tests.evaluation.helpers import assert_equal
from tests.evaluation.published_code import BAYER, lrid_frame
from tests.sid_tree import frames_of, write_frames

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


@pytest.mark.parametrize(
    ("name", "counts", "words"),
    [
        ("sid-sony", (40, 40, 49), "subset eval-first, misaligned included (5)"),
        ("sid-fuji", (41, 27, 26), "subset test-first, misaligned-unconfirmed included (3)"),
    ],
)
def test_the_table_has_the_means_of_each_factor(
    name: str, counts: tuple[int, ...], words: str, results: dict[str, EvaluationResult]
) -> None:
    """Each score is held against the published code in ``test_every_protocol``."""
    result = results[name]
    assert (result.protocol.name, result.provenance["subset"]) == ("sid", SUBSETS[name])
    assert len(result.scores) == len(result.units) == sum(counts)
    factors = (100, 250, 300)
    assert [(row.ratio, row.pairs) for row in result.table] == [*zip(factors, counts, strict=True), (None, sum(counts))]
    assert (
        result.format_text().splitlines()[0] == f"{name}, protocol sid: {sum(counts)} of {sum(counts)} pairs, {words}"
    )
    for row in result.table:
        members = [image for image in result.scores if row.ratio in (None, image.ratio)]
        for value in ("psnr_db", "ssim"):
            assert row.values[value] == pytest.approx(np.mean([one.values[value] for one in members]), rel=1e-12)


def test_misaligned_scenes_can_be_left_out(root: Path, predictions: Path, results: dict[str, EvaluationResult]) -> None:
    found = evaluate(predictions / "sid-sony", "sid-sony", root=root, exclude_flags=["misaligned"])
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


# --- LRD, whose arithmetic is held against the published code in test_every_protocol ----------------------------------


def test_the_first_subset_is_scored_in_one_group(tmp_path: Path) -> None:
    """That of the published code's default; nearly every pair has a factor of its own, which make no groups."""
    records = [record for record in shipped_manifest("lrd").records if record.split == "test"]
    lrd_tree.write_frames(tmp_path / "LRD", records)
    generator = np.random.default_rng(3)
    shape = 4, lrd_tree.SENSOR.height // 2, lrd_tree.SENSOR.width // 2
    for record in (record for record in records if record.role == "noisy"):
        save_prediction(tmp_path / "preds", record.path, generator.random(shape, np.float32))
    result = evaluate(tmp_path / "preds", "lrd", root=tmp_path)
    assert (result.protocol.name, len(result.scores), result.problems) == ("lrd-lrd", 60, ())
    assert {pair.path.split("_")[1] for pair in result.units} == {"03"}
    assert len({pair.ratio for pair in result.units}) == 27  # datalist/LRD_test_list.txt, -3EV
    (row,) = result.table
    assert (row.camera, row.ratio, row.pairs) == (None, None, 60)
    mean = math.fsum(image.psnr_db for image in result.scores) / 60
    assert row.values["psnr_db"] == pytest.approx(mean, rel=1e-12)


def test_up_to_twelve_factors_are_groups() -> None:
    twelve = [("A", float(ratio)) for ratio in range(1, 13)]
    assert list_groups(twelve) == [*twelve, (None, None)]
    assert list_groups([*twelve, ("A", 13.0)]) == [(None, None)]
    assert list_groups([*twelve, ("B", 13.0)]) == [("A", None), ("B", None), (None, None)]


# --- LRID under PMN's protocol: its published arithmetic, its class, its dark frames ----------------------------------


COUNTS = {"indoor-first": 45, "outdoor-first": 18}


@pytest.fixture(scope="module")
def lrid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data root with the first two frames of each scored burst, their references, and the dark frames."""
    root = tmp_path_factory.mktemp("lrid")
    seen: Counter[str] = Counter()
    for record in shipped_manifest("lrid").records:
        seen[folder := record.path.rpartition("/")[0]] += 1
        scored = record.split in ("eval", "test") and (record.role == "reference" or seen[folder] <= 2)
        if scored or record.role == "bias":
            lrid_tree.write_frames(root / "LRID", [record])
    return root


@pytest.mark.parametrize("protocol", ["pmn-lrid", "sony-lrid", "two-shots-lrid"])
@pytest.mark.parametrize("subset", COUNTS)
def test_the_input_has_the_scores_of_the_published_arithmetic(subset: str, protocol: str, lrid: Path) -> None:
    result = evaluate(None, "lrid", root=lrid, baseline="input", subset=subset, protocol=protocol)
    assert len(result.scores) == COUNTS[subset]
    files = lrid / "LRID"
    assert_equal(result, lambda pair: BAYER[protocol].of_input(files / pair.path, files / pair.reference))
    assert any("black 64, white 1023 was taken for every file" in note for note in result.notes), "not the file's"
    gains = (1, 2, 4, 8, 16) if subset == "indoor-first" else (1, 2, 4)
    assert [row.ratio for row in result.table if row.ratio is not None] == list(gains)


def test_predictions_have_the_scores_of_the_published_arithmetic(lrid: Path) -> None:
    files, mosaics = lrid / "LRID", {}
    for record in LRIDDataset(files, subset="indoor-first").records:
        clean = (np.load(files / record.reference) - 64) / 959
        generator = np.random.default_rng(zlib.crc32(record.path.encode()))
        mosaics[record.path] = (1.1 * clean + generator.normal(-0.01, 0.03, clean.shape)).astype(np.float32)
        save_prediction(lrid / "preds", record.path, mosaics[record.path])
    result = evaluate(lrid / "preds", "lrid", root=lrid)
    assert result.protocol.name == "pmn-lrid"
    assert len(result.scores) == COUNTS["indoor-first"], "the first subset is that of --mode eval"
    assert_equal(result, lambda pair: BAYER["pmn-lrid"].of_prediction(mosaics[pair.path], files / pair.reference))
    assert not any("taken for every file" in note for note in result.notes), "the card's levels are those"


def test_samples_are_what_the_published_loader_makes(lrid: Path) -> None:
    """R, G, B and the other G, as there."""
    dataset = LRIDDataset(lrid / "LRID", subset="outdoor-first")
    assert (len(dataset), dataset.levels, dataset.clip, dataset.amplification) == (18, "lrid", "none", "nominal")
    assert lrid_tree.SENSOR.white_level_dn != 1023
    for sample in (dataset[0], dataset[17]):
        ratio = int(re.findall(r"/6400/(\d+)/", sample["path"])[0])
        mosaics = (read_raw(lrid / "LRID" / sample["path"]).mosaic, np.load(lrid / "LRID" / sample["reference"]))
        noisy, clean = (SimpleNamespace(raw_image_visible=mosaic) for mosaic in mosaics)
        np.testing.assert_allclose(sample["input"].numpy(), lrid_frame(noisy, ratio), rtol=2e-7, atol=1e-8)
        np.testing.assert_allclose(sample["target"].numpy(), lrid_frame(clean), rtol=2e-7, atol=1e-8)
        assert (sample["ratio"], sample["iso"]) == (ratio, 6400)
    assert "warm-sensor" in {flag for record in dataset.records for flag in record.flags}
    assert len(LRIDDataset(lrid / "LRID", subset="outdoor-first", exclude_flags=["warm-sensor"])) == 12


def test_files_verify_but_for_those_that_are_not_there(lrid: Path) -> None:
    """At every level: references as mosaics of the card, dark frames by their pattern."""
    report = verify([shipped_manifest("lrid")], lrid, level="full")
    assert {(problem.field, problem.found) for problem in report.problems} <= {
        ("folder", "no such folder"),
        ("file", "nothing"),
    }
