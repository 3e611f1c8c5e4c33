"""Scores of frames that a store holds: those of the raw files to the bit, or a refusal that says why not."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest
import torch

from eldata import evaluate, evaluate_all
from eldata.datasets import PackedStore
from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation import evaluate_methods
from eldata.integrations.torchmetrics import ProtocolScore
from eldata.manifest.catalogue import load_manifest
from eldata.manifest.table import save_records
from eldata.sources.store import build_store, open_store, source_of_dataset
from tests.evaluation.own_set import GBRG, OwnSet, build_own_set, predict

if TYPE_CHECKING:
    from collections.abc import Callable

    from eldata.evaluation import EvaluationResult


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """Two scenes of a reference and two noisy frames. Not to be changed."""
    return build_own_set(tmp_path_factory.mktemp("own"), scenes=2)


@pytest.fixture(scope="module")
def store(own: OwnSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "mine.h5"
    build_store(source_of_dataset("mine", root=own.root, manifest=own.manifest), path, compression="lz4")
    return path


@pytest.fixture(scope="module")
def preds(own: OwnSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return predict(own, tmp_path_factory.mktemp("preds") / "ours", 0.01)


def without_store(result: EvaluationResult) -> str:
    found = result.as_dict()
    found["provenance"].pop("store", None)
    return json.dumps(found, sort_keys=True)


def test_scores_are_those_of_the_files(own: OwnSet, store: Path, preds: Path, tmp_path: Path) -> None:
    """Under every protocol, with the files away; the store is named, by what it holds."""
    files = evaluate_all(preds, **own.where)
    stored = evaluate_all(preds, manifest=own.manifest, root=tmp_path / "nowhere", store=store)
    assert len(files.results) > 1
    for one, other in zip(files.results, stored.results, strict=True):
        assert without_store(one) == without_store(other)
        assert one.digest == other.digest
        assert other.provenance["store"]["digest"] == open_store(store).digest
        assert other.provenance["store"]["decoded_by"].startswith("LibRaw 0.")
    refused = {one.protocol: one.reason for one in stored.not_scored}
    assert "renderings of the raw files, which a store does not hold" in refused["sid2018"]
    for protocol in ("led-eld", "lrd-eld", "pmn-eld"):  # with levels of each channel, of the file, of the literature
        one, other = (evaluate(preds, **own.where, protocol=protocol, store=of) for of in (None, store))
        assert without_store(one) == without_store(other)


def test_the_input_and_several_methods(own: OwnSet, store: Path, preds: Path) -> None:
    scored = evaluate(None, **own.where, baseline="input", store=store)
    assert without_store(scored) == without_store(evaluate(None, **own.where, baseline="input"))
    (found,) = evaluate_methods([preds], **own.where, store=store, workers=2).values()
    assert without_store(found) == without_store(evaluate(preds, **own.where))


def test_protocol_score_over_a_store(own: OwnSet, store: Path) -> None:
    """A validation loop of torch gives the mean that the command prints, to the bit."""
    dataset = PackedStore(store, crop=None, augment=False)
    metric = ProtocolScore("raw")
    for item in dataset:
        metric.update(item["input"], item["target"])
    scored = evaluate(None, manifest=own.manifest, baseline="input", store=store)
    found = metric.compute()
    assert isinstance(found["psnr_db"], torch.Tensor)
    assert (float(found["psnr_db"]), float(found["ssim"])) == (scored.psnr_db, scored.ssim)


def damage(store: Path, path: str, change: Callable[[h5py.File, str], None]) -> None:
    key = next(frame.key for frame in open_store(store).frames if frame.path == path)
    with h5py.File(store, "r+", locking=False) as file:
        change(file, key)


def other_pixels(file: h5py.File, key: str) -> None:
    file["frames"][key][3, 5] += 1


def floats(file: h5py.File, key: str) -> None:
    kept = file["frames"][key][...].astype(np.float32)
    del file["frames"][key]
    file["frames"][key] = kept


def crop(file: h5py.File, key: str) -> None:
    kept = file["frames"][key][:40, :40]
    del file["frames"][key]
    file["frames"][key] = kept


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (floats, "expected uint16 (60, 84), found float32 (60, 84)"),
        (crop, "expected uint16 (60, 84), found uint16 (40, 40)"),
    ],
)
def test_what_it_holds_is_refused(
    own: OwnSet, store: Path, preds: Path, tmp_path: Path, change: Callable[[h5py.File, str], None], words: str
) -> None:
    copy = Path(shutil.copy(store, tmp_path / "copy.h5"))
    damage(copy, "s1/x50.dng", change)
    with pytest.raises(DatasetError) as raised:
        evaluate(preds, manifest=own.manifest, store=copy)
    assert words in str(raised.value)
    assert "s1/x50.dng" in str(raised.value)


def test_changed_pixels_are_a_problem_of_their_pairs(own: OwnSet, store: Path, preds: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(store, tmp_path / "copy.h5"))
    damage(copy, "s1/clean.dng", other_pixels)
    found = evaluate(preds, manifest=own.manifest, store=copy, allow_missing=True)
    assert [score.scene for score in found.scores] == ["s0", "s0"]
    assert all("pixels are not those that were packed" in problem.reason for problem in found.problems)
    assert [problem.path for problem in found.problems] == ["s1/x100.dng", "s1/x50.dng"]


def test_a_store_of_other_files_is_refused(own: OwnSet, store: Path, preds: Path, tmp_path: Path) -> None:
    records = load_manifest(own.manifest).records
    shutil.copy(own.manifest.with_suffix(".json"), tmp_path / "mine.json")
    first = next(record for record in records if record.path == "s0/x50.dng")
    for fields, words in (
        ({"sha256": f"sha256:{'0' * 64}"}, "sha256"),
        ({"size_bytes": 7}, "expected 7 bytes"),
        ({"iso": first.iso and first.iso * 2}, "iso"),
        ({"width": 86}, "width"),
    ):
        save_records(tmp_path / "mine.csv", [replace(one, **fields) if one == first else one for one in records])
        with pytest.raises(DatasetError, match="is not of the files that the manifest lists") as raised:
            evaluate(preds, manifest=tmp_path / "mine.csv", store=store)
        assert words in str(raised.value)


def test_a_file_that_was_replaced_since_is_noticed(own: OwnSet, store: Path, preds: Path, tmp_path: Path) -> None:
    shutil.copytree(own.root, tmp_path / "data")
    with (tmp_path / "data" / "MINE" / "s0" / "x50.dng").open("ab") as file:
        file.write(b"more")
    with pytest.raises(DatasetError, match="is another since it was packed"):
        evaluate(preds, manifest=own.manifest, root=tmp_path / "data", store=store)


def test_a_store_of_a_part_is_refused(own: OwnSet, preds: Path, tmp_path: Path) -> None:
    part = source_of_dataset("mine", root=own.root, manifest=own.manifest)
    build_store(replace(part, files=part.files[:2]), tmp_path / "part.h5")
    with pytest.raises(DatasetError, match=r"lacks 4 of the 6 frames .* such as s0/x50.dng"):
        evaluate(preds, manifest=own.manifest, store=tmp_path / "part.h5")


def test_what_a_store_cannot_give(own: OwnSet, store: Path, preds: Path) -> None:
    with pytest.raises(ArgumentError, match="LibRaw's renderings of the raw files, which a store does not hold"):
        evaluate(preds, manifest=own.manifest, protocol="sid2018", store=store)
    with pytest.raises(ArgumentError, match="clips are scored from their files"):
        evaluate(preds, "drv", store=store)
    assert open_store(store).frames[0].sensor.cfa == GBRG
