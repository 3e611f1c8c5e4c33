"""``amplification="measured"``: the manifest's measured ratio, in every dataset of pairs and in every evaluation."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata import PackedStore, evaluate
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.datasets import DRVDataset, PairDataset, StreamedPairs
from eldata.errors import DatasetError
from eldata.manifest import load_manifest, save_records
from eldata.sources.shards import write_shards
from eldata.sources.store import build_store, source_of_dataset
from tests.drv_tree import write_raw_clip
from tests.evaluation.own_set import OwnSet, build_own_set

if TYPE_CHECKING:
    from pathlib import Path

MEASURED = {50: Fraction("51.5"), 100: Fraction(97)}
PROTOCOL = """
base = "eld-uncorrected"
name = "by-pixels"
title = "Amplified by the ratio that the pixels show"
amplification = "measured"
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """A set whose noisy frames were measured."""
    own = build_own_set(tmp_path_factory.mktemp("own"))
    records = load_manifest(own.manifest).records
    save_records(
        own.manifest,
        [replace(one, measured_ratio=MEASURED[int(one.ratio)]) if one.ratio is not None else one for one in records],
    )
    return own


def without(own: OwnSet, folder: Path) -> Path:
    """The same manifest with the frame at x100 not measured."""
    records = load_manifest(own.manifest).records
    (folder / "mine.json").write_bytes(own.manifest.with_suffix(".json").read_bytes())
    save_records(folder / "mine.csv", [replace(r, measured_ratio=None) if r.ratio == 100 else r for r in records])
    return folder / "mine.csv"


def test_every_dataset_of_pairs_multiplies_by_it(own: OwnSet, tmp_path: Path) -> None:
    options: dict[str, Any] = {"clip": "none", "levels": "metadata"}
    plain = {sample["path"]: sample for sample in PairDataset(own.files, own.manifest, **options)}
    store = tmp_path / "mine.h5"
    build_store(source_of_dataset("mine", root=own.root, manifest=own.manifest), store)
    write_shards(store, tmp_path / "shards", tile=None)
    datasets: list[Any] = [
        PairDataset(own.files, own.manifest, amplification="measured", **options),
        PackedStore(store, crop=None, augment=False, amplification="measured", **options),
        StreamedPairs(str(tmp_path / "shards"), augment=False, amplification="measured", **options),
    ]
    for dataset in datasets:
        samples = list(dataset)
        assert len(samples) == 2
        for sample in samples:
            of_exif, nominal = plain[sample["path"]], int(sample["nominal_ratio"])
            assert sample["ratio"] == float(MEASURED[nominal])
            assert of_exif["ratio"] == nominal
            times = sample["ratio"] / nominal
            np.testing.assert_allclose(sample["input"].numpy(), of_exif["input"].numpy() * times, rtol=1e-5, atol=1e-6)
        assert "amplification='measured'" in repr(dataset)


def test_a_pair_that_was_not_measured_is_refused_by_name(own: OwnSet, tmp_path: Path) -> None:
    manifest = without(own, tmp_path)
    dataset = PairDataset(own.files, manifest, amplification="measured")
    said = "s0/x100.dng: the manifest has no measured ratio for amplification 'measured'; capture check --write"
    by_path = {record.path: index for index, record in enumerate(dataset.records)}
    assert dataset[by_path["s0/x50.dng"]]["ratio"] == 51.5
    with pytest.raises(DatasetError, match=said):
        dataset[by_path["s0/x100.dng"]]
    (tmp_path / "by-pixels.toml").write_text(PROTOCOL, encoding="utf-8")
    protocol = str(tmp_path / "by-pixels.toml")
    result = evaluate(None, manifest=manifest, root=own.root, protocol=protocol, baseline="input")
    assert result.problems
    assert all(said in str(problem) for problem in result.problems)
    write_raw_clip(tmp_path / "DRV", "0007", 5)
    with pytest.raises(DatasetError, match="has no measured ratio"):
        DRVDataset(tmp_path / "DRV", form="raw", amplification="measured")[0]


def test_an_evaluation_amplifies_the_input_and_says_so(own: OwnSet, tmp_path: Path) -> None:
    """Without rescaling the score of the input itself is that of the dataset's own samples."""
    (tmp_path / "by-pixels.toml").write_text(PROTOCOL, encoding="utf-8")
    protocol = str(tmp_path / "by-pixels.toml")
    result = evaluate(None, manifest=own.manifest, root=own.root, protocol=protocol, baseline="input")
    assert result.as_dict()["protocol"]["amplification"] == "measured"
    assert result.provenance["equal_choices"]["amplification"] == ["measured"]
    samples = {s["path"]: s for s in PairDataset(own.files, own.manifest, levels="published", amplification="measured")}
    for score in result.scores:
        sample = samples[score.path]
        error = np.clip(sample["input"].numpy().astype(np.float64), 0, 1) - sample["target"].numpy()
        assert score.psnr_db == pytest.approx(-10 * np.log10(np.mean(error**2)), abs=1e-4)
    plain = evaluate(None, manifest=own.manifest, root=own.root, protocol="eld-uncorrected", baseline="input")
    assert [one.psnr_db for one in plain.scores] != [one.psnr_db for one in result.scores]
    # Predictions are made of the same input: a denoiser that changes nothing gets the input's score.
    options: dict[str, Any] = {"manifest": own.manifest, "root": own.root, "protocol": protocol}
    write_predictions(BaselineDenoiser("input"), "mine", tmp_path / "preds", **options)
    predicted = evaluate(tmp_path / "preds", manifest=own.manifest, root=own.root, protocol=protocol)
    for one, other in zip(predicted.scores, result.scores, strict=True):
        assert one.psnr_db == pytest.approx(other.psnr_db, abs=1e-4)
