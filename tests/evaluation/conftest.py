from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.evaluation.helpers import Tree, place

if TYPE_CHECKING:
    from pathlib import Path


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
