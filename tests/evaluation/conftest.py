from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drv_tree import SmallDrv, small_drv
from tests.evaluation.helpers import Tree, place, predict_clips
from tests.evaluation.own_set import OwnSet, build_own_set, predict
from tests.shared import made_once


@pytest.fixture(scope="session")
def tree(demo_tree: Path) -> Tree:
    """Two cameras, one scene. Not to be changed: copy it."""
    return Tree(demo_tree)


@pytest.fixture(scope="session")
def predictions(tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A prediction of each of the tree's twelve pairs. Not to be changed: copy it."""
    folder = tmp_path_factory.mktemp("predictions") / "preds"
    place(folder, tree)
    return folder


@pytest.fixture(scope="session")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OwnSet]:
    """Two scenes of a reference and two noisy frames, with predictions in ``preds``, and noisier ones in ``other``."""

    def make(folder: Path) -> None:
        own = build_own_set(folder, scenes=2)
        predict(own, folder / "preds", 0.02)
        predict(own, folder / "other", 0.1)

    with made_once(tmp_path_factory, "own", make) as folder:
        yield OwnSet(folder / "mine.csv", folder / "data")


@pytest.fixture(scope="session")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    """Two clips of DRV with predictions of their scored frames in ``preds`` beside them, and a third clip."""
    drv = small_drv(tmp_path_factory.mktemp("drv"), ("0007", "0013", "M0003"), 12)
    predict_clips(drv, drv.root / "preds")
    return drv
