"""LRID under PMN's protocol: against its published arithmetic (``published_code``); its class; its dark frames."""

from __future__ import annotations

import re
import zlib
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.datasets import LRIDDataset
from eldata.evaluation import evaluate, save_prediction
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.verify import verify
from eldata.raw.reading import read_raw
from tests.evaluation.helpers import assert_equal
from tests.evaluation.published_code import BAYER
from tests.lrid_tree import SENSOR, write_frames

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
