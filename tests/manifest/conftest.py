"""The tree of files that the tests of manifests read, and a copy for those that damage it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.trees import Tree, copy_tree, tree_in

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def pristine(demo_tree: Path) -> Tree:
    """Not to be changed."""
    return tree_in(demo_tree)


@pytest.fixture
def tree(pristine: Tree, tmp_path: Path) -> Tree:
    """A copy that a test may change."""
    return copy_tree(pristine, tmp_path)
