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
    build_published_tree(replace(published, records=tuple(rows)), tmp_path / "RawNIND")
    return save_manifest(tmp_path / "rawnind.csv", replace(published.card, counts=counts_of(rows)), rows)


def test_names_say_all_that_is_known() -> None:
    """Of dataset.yaml's counts by filter array, with 15 raws of three scenes that it lacks."""
    records = shipped_manifest("rawnind").records
    assert Counter(f"{row.camera} {row.role}" for row in records) == {
        "Bayer reference": 424, "Bayer noisy": 1739, "X-Trans reference": 132 + 3, "X-Trans noisy": 530 + 12,
    }  # fmt: skip
    assert len({row.scene for row in records if row.split == "test"}) == 10 + 6
    scene_of = {row.path: row.scene for row in records} | {None: None}
    for row in records:
        name = rf"src/{row.camera}/{row.scene}/(gt/)?{row.camera}_{row.scene}_(GT_)?ISO(.+)_sha1=[0-9a-f]{{40}}\.\w+"
        assert (said := re.fullmatch(name, row.path))
        assert said[3] == str(row.iso) if row.iso else said[3] in ("65535", "Hi 3200")
        assert (said[1] is None) == (said[2] is None) == (row.role == "noisy")
        assert scene_of[row.reference] == (None if row.role != "noisy" or row.path.endswith(".crw") else row.scene)


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
    for subset, flags in ((None, {}), ("all", {"misaligned": 1, "unaligned": 1})):
        result = evaluate(None, "rawnind", baseline="input", manifest=few.path, root=tmp_path, subset=subset)
        assert (result.protocol.name, result.scored) == ("raw", 11 + len(flags))
        assert result.provenance["included_flags"] == flags | {"uncertain-iso": 11 + len(flags)}


def test_what_a_copy_lacks_is_named(few: Manifest, tmp_path: Path) -> None:
    lost, half, *_ = (row.path for row in few.records if row.role == "noisy")
    root, nested = tmp_path / "nested", shutil.copytree(tmp_path / "RawNIND", tmp_path / "nested/RawNIND/RawNIND")
    assert verify([few], root, level="metadata").problems == ()
    (nested / lost).rename(nested / f"{lost}.arw")
    (nested / half).write_bytes((nested / half).read_bytes()[:-100])
    found = {problem.path: problem.field for problem in verify([few], root, level="metadata").problems}
    assert found == {lost: "file", f"{lost}.arw": "file", half: "content"}
    (flat := tmp_path / "flat/RawNIND/src/flat").mkdir(parents=True)
    for path in [*(tmp_path / "RawNIND").rglob("*.*")]:
        path.rename(flat / path.name)
    (problem,) = verify([few], tmp_path / "flat").problems
    assert problem.found == f"{lost} in another place, src/flat/{Path(lost).name}"
