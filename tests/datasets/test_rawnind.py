"""RawNIND: what its loader reads, which pairs are scored, copies that are not whole."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rawpy

from eldata import evaluate
from eldata.datasets import RawNINDDataset
from eldata.manifest.card import counts_of
from eldata.manifest.catalogue import Manifest, save_manifest, shipped_manifest
from eldata.manifest.verify import verify
from tests.trees import build_published_tree

SCENES = ("LeslieMountains", "MuseeL-sol-C500D")


@pytest.fixture
def few(tmp_path: Path) -> Manifest:
    """A copy of the two scenes with an alignment; the small files are not of the published sizes."""
    published = shipped_manifest("rawnind")
    rows = [replace(row, size_bytes=None) for row in published.records if row.scene in SCENES]
    card = replace(published.card, counts=counts_of(rows), cameras={"Bayer": published.card.cameras["Bayer"]})
    build_published_tree(replace(published, records=tuple(rows)), tmp_path / "RawNIND")
    return save_manifest(tmp_path / "rawnind.csv", card, rows)


def test_names_say_all_that_is_known() -> None:
    """Of dataset.yaml's two counts by filter array, with 15 raws of three scenes that it lacks."""
    records = shipped_manifest("rawnind").records
    assert Counter((row.camera, row.role) for row in records) == {
        ("Bayer", "reference"): 435 - 11, ("Bayer", "noisy"): 1739,
        ("X-Trans", "reference"): 132 + 3, ("X-Trans", "noisy"): 531 - 1 + 12,
    }  # fmt: skip
    assert len({row.scene for row in records if row.split == "test"}) == 10 + 6
    by_path = {row.path: row for row in records}
    for row in records:
        said = re.fullmatch(r".*/(?:Bayer|X-Trans)_(.+?)_(?:GT_)?ISO(\d+|Hi 3200)_sha1=[0-9a-f]{40}\.\w+", row.path)
        assert said is not None
        assert (said[1], said[2]) == (row.scene, "Hi 3200" if "Hi" in said[2] else str(row.iso or 65535))
        assert ("/gt/" in row.path) == ("_GT_" in row.path) == (row.role == "reference")
        if row.reference is not None:
            assert by_path[row.reference].scene == row.scene
        else:
            assert row.role == "reference" or row.path.endswith(".crw")


def test_rawnind_is_what_its_loader_reads(few: Manifest, tmp_path: Path) -> None:
    """raw.py and shift_images: the visible area less black, by white, R, G1, G2, B; a shift of (0, 0) cuts nothing."""
    dataset = RawNINDDataset(tmp_path / "RawNIND", manifest=few.path, subset="aligned", clip="none")
    for record, sample in zip(dataset.records, dataset, strict=True):
        for tensor, path in ((sample["input"], record.path), (sample["target"], record.reference)):
            with rawpy.imread(str(tmp_path / "RawNIND" / path)) as raw:
                black, white = np.float32(raw.black_level_per_channel[0]), np.float32(raw.white_level or 0)
                mono = (raw.raw_image_visible.astype(np.float32) - black) / (white - black)
            planes = [mono[0::2, 0::2], mono[0::2, 1::2], mono[1::2, 1::2], mono[1::2, 0::2]]
            assert np.abs(tensor.numpy() - np.stack(planes)).max() < 1e-6


def test_pairs_that_may_lie_apart_are_not_scored_unless_asked_for(few: Manifest, tmp_path: Path) -> None:
    result = evaluate(None, "rawnind", baseline="input", manifest=few.path, root=tmp_path)
    assert (result.protocol.name, result.scored) == ("raw", 11)
    assert set(result.provenance["included_flags"]) == {"uncertain-iso"}
    every = evaluate(None, "rawnind", baseline="input", manifest=few.path, root=tmp_path, subset="all")
    assert every.scored == 13
    assert every.provenance["included_flags"] == {"misaligned": 1, "unaligned": 1, "uncertain-iso": 13}


def test_what_a_copy_lacks_is_named(few: Manifest, tmp_path: Path) -> None:
    folder, noisy = tmp_path / "RawNIND", [row.path for row in few.records if row.role == "noisy"]
    assert verify([few], tmp_path, level="metadata").problems == ()
    shutil.move(folder, tmp_path / "moved")
    shutil.move(tmp_path / "moved", folder / "RawNIND")
    assert verify([few], tmp_path, level="metadata").problems == ()
    (folder / "RawNIND" / noisy[0]).rename(folder / "RawNIND" / noisy[0].replace("Bayer_", "bayer-"))
    half = (folder / "RawNIND" / noisy[1]).read_bytes()[:-100]
    (folder / "RawNIND" / noisy[1]).unlink()
    (folder / "RawNIND" / noisy[1]).write_bytes(half)
    found = {problem.path: problem.field for problem in verify([few], tmp_path, level="metadata").problems}
    renamed = noisy[0].replace("Bayer_", "bayer-")
    assert found == {noisy[0]: "file", renamed: "file", noisy[1]: "content"}
    sizes = verify([shipped_manifest("rawnind")], tmp_path, cameras=["Bayer"]).problems
    assert ("size_bytes", noisy[2]) in {(problem.field, problem.path) for problem in sizes}
