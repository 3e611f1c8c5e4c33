"""LRID under PMN's protocol: against its published arithmetic (``published_code``); its class; its dark frames."""

from __future__ import annotations

import re
import zlib
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.calibration.camera import calibrate
from eldata.calibration.shading_fit import dark_shading
from eldata.datasets import CalibrationFrames, LRIDDataset
from eldata.evaluation import evaluate, save_prediction
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.verify import verify
from eldata.raw.reading import read_raw
from tests.evaluation.helpers import assert_equal
from tests.evaluation.published_code import BAYER
from tests.lrid_tree import DARK_MS, SENSOR, write_frames

if TYPE_CHECKING:
    from pathlib import Path


ROUTE = BAYER["pmn-lrid"]
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
            write_frames(root / "LRID", [record])
    return root


@pytest.mark.parametrize("protocol", ["pmn-lrid", "sony-lrid"])
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
    assert_equal(result, lambda pair: ROUTE.of_prediction(mosaics[pair.path], files / pair.reference))
    assert not any("taken for every file" in note for note in result.notes), "the card's levels are those"


def test_samples_are_what_the_published_loader_makes(lrid: Path) -> None:
    """R, G, B and the other G, as there."""
    dataset = LRIDDataset(lrid / "LRID", subset="outdoor-first")
    assert (len(dataset), dataset.levels, dataset.clip, dataset.amplification) == (18, "lrid", "none", "nominal")
    assert SENSOR.white_level_dn != 1023
    for sample in (dataset[0], dataset[17]):
        ratio = int(re.findall(r"/6400/(\d+)/", sample["path"])[0])
        mosaic = read_raw(lrid / "LRID" / sample["path"]).mosaic.astype(np.float32)
        clean = np.load(lrid / "LRID" / sample["reference"])
        given, target = (
            np.stack([one[0::2, 0::2], one[0::2, 1::2], one[1::2, 1::2], one[1::2, 0::2]]).astype(np.float32)
            for one in (mosaic, clean)
        )
        expected = (given - 64) / np.float32(959) * np.float32(ratio)
        np.testing.assert_allclose(sample["input"].numpy(), expected, rtol=2e-7, atol=1e-8)
        clipped = np.clip((target - 64) / np.float32(959), 0, 1)
        np.testing.assert_allclose(sample["target"].numpy(), clipped, rtol=2e-7, atol=1e-8)
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


def test_dark_frames_make_the_dark_shading(tmp_path: Path) -> None:
    """Those of the usual sensor alone, which come off the noisy frames of the set."""
    records = shipped_manifest("lrid").records
    pair = next(r for r in records if r.scene == "indoor_x5-004" and r.role == "noisy")
    wanted = [r for r in records if r.role == "bias" or r.path in (pair.path, pair.reference)]
    write_frames(tmp_path, wanted, replace(SENSOR, height=256, width=256))
    frames = CalibrationFrames(tmp_path, manifest="lrid")
    assert (frames.camera, frames.isos, len(frames)) == ("IMX686", (Fraction(6400),), len(DARK_MS))
    assert {record.path.partition("/")[0] for record in frames.records} == {"bias"}
    shading = dark_shading(frames, calibrate(frames))
    chosen: dict[str, Any] = {"split": "eval", "scenes": ["indoor_x5-004"], "ratios": [1]}
    plain, corrected = (
        LRIDDataset(tmp_path, dark_shading=one, **chosen)[0]["input"].numpy() * 959 for one in (None, shading)
    )
    whole = np.mean([frames[index]["mosaic"] for index in range(len(frames))], axis=0)
    assert np.corrcoef((plain - corrected)[0].mean(axis=0), whole[0::2, 0::2].mean(axis=0))[0, 1] > 0.99
