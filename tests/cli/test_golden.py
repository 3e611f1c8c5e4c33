"""What the commands print, word for word. ELDATA_UPDATE_GOLDEN=1 rewrites the files: read the difference."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np

from tests.cli.conftest import Cli, Outcome, assert_golden, normalised

if TYPE_CHECKING:
    from pathlib import Path

    from tests.evaluation.helpers import Tree


def check(name: str, outcome: Outcome, code: int, **paths: Path) -> None:
    text = f"exit code {outcome.code}\n--- stdout\n{outcome.out}--- stderr\n{outcome.err}"
    assert_golden(name, normalised(text, **paths))
    assert outcome.code == code


def spoil(tree: Tree) -> None:
    """Spoil a tree in several ways."""
    folder = tree.files / "DemoAlpha" / "scene-1"
    (folder / "IMG_0003.dng").unlink()
    (folder / "IMG_0004.dng").write_bytes(b"")
    (folder / "IMG_0005.dng").rename(folder / "IMG_0005.DNG")
    shutil.copy(folder / "IMG_0008.dng", folder / "IMG_0020.dng")
    beta = tree.files / "DemoBeta" / "scene-1"
    (beta / "IMG_0006.dng").rename(beta / "x")
    (beta / "IMG_0007.dng").rename(beta / "IMG_0006.dng")
    (beta / "x").rename(beta / "IMG_0007.dng")
    shutil.copy(folder / "IMG_0016.dng", beta / "IMG_0016.dng")


def test_verify_ok(eldata: Cli, tree: Tree) -> None:
    outcome = eldata("verify", tree.manifest.parent, "--root", tree.root, "--level", "metadata", "--jobs", "1")
    check("verify-ok", outcome, 0, tree=tree.folder)
    outcome = eldata("verify", tree.manifest, "--root", tree.root, "--level", "full", "--jobs", "1")
    check("verify-full", outcome, 0, tree=tree.folder)


def test_verify_problems_metadata(eldata: Cli, own: Tree) -> None:
    spoil(own)
    outcome = eldata("verify", own.manifest, "--root", own.root, "--level", "metadata", "--jobs", "2")
    check("verify-problems-metadata", outcome, 1, tree=own.folder)


def test_verify_absent(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    outcome = eldata("verify", tree.manifest, "--root", tmp_path / "empty")
    check("verify-absent", outcome, 1, tmp=tmp_path)


def test_lock_ok_then_verify_finds_a_changed_byte(eldata: Cli, own: Tree) -> None:
    locked = eldata("lock", own.manifest, "--root", own.root, "--jobs", "1")
    check("lock-ok", locked, 0, tree=own.folder)
    path = own.files / "DemoBeta" / "scene-1" / "IMG_0002.dng"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    found = eldata("verify", own.manifest, "--root", own.root, "--level", "full", "--jobs", "1")
    assert found.code == 1
    assert "DemoBeta/scene-1/IMG_0002.dng: sha256" in found.out


def test_lock_problems(eldata: Cli, own: Tree) -> None:
    spoil(own)
    before = own.manifest.read_bytes()
    outcome = eldata("lock", own.manifest, "--root", own.root, "--jobs", "1")
    check("lock-problems", outcome, 1, tree=own.folder)
    assert own.manifest.read_bytes() == before


def test_evaluate_ok(eldata: Cli, tree: Tree, predictions: Path) -> None:
    outcome = eldata("evaluate", predictions, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
    check("evaluate-ok", outcome, 0, tree=tree.folder)


def test_evaluate_problems(eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    folder = tmp_path / "preds"
    shutil.copytree(predictions, folder)
    scene = folder / "DemoAlpha" / "scene-1"
    (scene / "IMG_0004.npy").unlink()
    np.savez(scene / "IMG_0005.npz", np.zeros(3))
    (scene / "IMG_0009.npy").rename(scene / "IMG_0099.npy")
    np.save(scene / "IMG_0002.npy", np.zeros(3))
    outcome = eldata("evaluate", folder, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
    check("evaluate-problems", outcome, 1, predictions=folder)


def test_evaluate_allow_missing(eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    folder = tmp_path / "preds"
    shutil.copytree(predictions, folder)
    (folder / "DemoAlpha" / "scene-1" / "IMG_0004.npy").unlink()
    shutil.rmtree(folder / "DemoBeta")
    arguments = ("evaluate", folder, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1", "--allow-missing")
    check("evaluate-allow-missing", eldata(*arguments), 0, predictions=folder)
    (folder / "DemoAlpha" / "scene-1" / "IMG_0005.npy").write_bytes(b"")
    assert eldata(*arguments).code == 1  # an unusable prediction stays a problem
