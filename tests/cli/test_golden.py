"""What the commands print, word for word. ELDATA_UPDATE_GOLDEN=1 rewrites the files: read the difference."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from tests.cli.conftest import Cli, Outcome, assert_golden, normalised
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


def test_verify(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    outcome = eldata("verify", tree.manifest.parent, "--root", tree.root, "--level", "metadata", "--jobs", "1")
    check("verify-ok", outcome, 0, tree=tree.folder)
    outcome = eldata("verify", tree.manifest, "--root", tree.root, "--level", "full", "--jobs", "1")
    check("verify-full", outcome, 0, tree=tree.folder)
    check("verify-absent", eldata("verify", tree.manifest, "--root", tmp_path / "empty"), 1, tmp=tmp_path)


def test_lock(eldata: Cli, own: Tree) -> None:
    check("lock-ok", eldata("lock", *own.arguments[1:]), 0, tree=own.folder)


def test_problems(eldata: Cli, own: Tree) -> None:
    spoil(own)
    before = own.manifest.read_bytes()
    check("verify-problems-metadata", eldata("verify", *own.arguments[1:], "--level", "metadata"), 1, tree=own.folder)
    check("lock-problems", eldata("lock", *own.arguments[1:]), 1, tree=own.folder)
    assert own.manifest.read_bytes() == before


def test_evaluate(eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    scoring = tree.arguments
    check("evaluate-ok", eldata("evaluate", predictions, *scoring), 0, tree=tree.folder)

    folder = shutil.copytree(predictions, tmp_path / "preds")
    scene = folder / "DemoAlpha" / "scene-1"
    (scene / "IMG_0004.npy").unlink()
    np.savez(scene / "IMG_0005.npz", np.zeros(3))
    (scene / "IMG_0009.npy").rename(scene / "IMG_0099.npy")
    np.save(scene / "IMG_0002.npy", np.zeros(3))
    check("evaluate-problems", eldata("evaluate", folder, *scoring), 1, predictions=folder)


def test_evaluate_allow_missing(eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(predictions, tmp_path / "preds")
    (folder / "DemoAlpha" / "scene-1" / "IMG_0004.npy").unlink()
    shutil.rmtree(folder / "DemoBeta")
    command = ("evaluate", folder, *tree.arguments, "--allow-missing")
    check("evaluate-allow-missing", eldata(*command), 0, predictions=folder)
    (folder / "DemoAlpha" / "scene-1" / "IMG_0005.npy").write_bytes(b"")
    assert eldata(*command).code == 1  # an unusable prediction stays a problem
