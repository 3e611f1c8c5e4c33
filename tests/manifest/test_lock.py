"""Locking: sizes and hashes of a trusted copy go into the manifest, all or none."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from eldata.errors import FileError
from eldata.manifest.lock import lock
from eldata.manifest.verify import verify
from tests.trees import Tree, flip_compressed_byte, frame, scale_exposure


def contents(tree: Tree) -> dict[str, bytes]:
    """All that lies beside the manifest, itself included."""
    return {path.name: path.read_bytes() for path in tree.csv.parent.iterdir()}


@pytest.mark.parametrize("by_name", [False, True])
def test_sizes_and_hashes_are_filled_in(tree: Tree, by_name: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    before = tree.manifest.records
    monkeypatch.chdir(tree.csv.parent)
    report = lock(tree.csv.stem if by_name else tree.csv, tree.root)
    assert (report.files_locked, report.problems) == (32, ())
    assert report.checks.level == "metadata"
    for old, new in zip(before, tree.manifest.records, strict=True):
        content = (tree.data / new.path).read_bytes()
        assert new.size_bytes == len(content)
        assert new.sha256 == "sha256:" + hashlib.sha256(content).hexdigest()
        assert replace(new, size_bytes=None, sha256=None) == old, "nothing else changes"


@pytest.mark.parametrize(
    "harm",
    [
        lambda tree: os.truncate(tree.file(4), 3000),
        lambda tree: scale_exposure(tree.file(4), Fraction(2)),
        lambda tree: shutil.rmtree(tree.data),
    ],
)
def test_a_copy_with_a_problem_is_not_locked(tree: Tree, harm: Callable[[Tree], object]) -> None:
    """A hash of a damaged file would make the damage official."""
    before = contents(tree)
    harm(tree)
    report = lock(tree.csv, tree.root)
    assert not report.checks.ok
    assert report.files_locked == 0
    assert contents(tree) == before


def test_a_file_that_vanishes_while_it_is_hashed(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    def lose(path: Path) -> None:
        raise FileError(path, "No such file")

    before = contents(tree)
    monkeypatch.setattr(sys.modules[lock.__module__], "require_files", lose)
    problems = lock(tree.csv, tree.root).problems
    assert [problem.path for problem in problems] == [record.path for record in tree.manifest.records]
    assert {problem.field for problem in problems} == {"sha256"}
    assert contents(tree) == before
    monkeypatch.setattr("eldata.manifest.file_checks.require_files", lose)
    problems = verify([tree.manifest], tree.root, level="metadata").problems
    assert {(problem.field, problem.expected) for problem in problems} == {("check", "a finished check")}


def test_a_recorded_hash_is_not_overruled(tree: Tree) -> None:
    """Equal size, header and exposure, other pixels: two copies differ, and only people can say which is right."""
    lock(tree.csv, tree.root)
    before = contents(tree)
    recorded = tree.manifest.records
    flip_compressed_byte(tree.file(4))
    report = lock(tree.csv, tree.root)
    assert report.checks.ok
    assert report.files_locked == 0
    (problem,) = report.problems
    assert (problem.path, problem.field) == (frame(4), "sha256")
    assert problem.expected == next(record.sha256 for record in recorded if record.path == frame(4))
    assert "empty the row's" in problem.advice
    assert contents(tree) == before


def test_a_camera_at_a_time(tree: Tree) -> None:
    """Locking the second camera keeps what was recorded of the first."""
    beta = tree.data / "DemoBeta"
    aside = tree.root / "aside"
    beta.rename(aside)
    assert lock(tree.csv, tree.root, cameras=["DemoAlpha"]).files_locked == 16
    locked = {record.camera for record in tree.manifest.records if record.sha256 is not None}
    assert locked == {"DemoAlpha"}
    aside.rename(beta)
    assert lock(tree.csv, tree.root, cameras=["DemoBeta"]).files_locked == 16
    assert all(record.sha256 for record in tree.manifest.records)
