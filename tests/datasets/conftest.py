"""The tree of files that the tests of datasets read, and a copy for those that damage it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.sources.store.helpers import pack_tree
from tests.trees import Tree, copy_tree, tree_in

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def pristine(demo_tree: Path) -> Tree:
    """Not to be changed."""
    return tree_in(demo_tree)


@pytest.fixture(scope="session")
def store(pristine: Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its 24 pairs, packed. Not to be changed."""
    return pack_tree(pristine, tmp_path_factory.mktemp("store") / "eld.h5").store


@pytest.fixture
def tree(pristine: Tree, tmp_path: Path) -> Tree:
    """A copy of one's own."""
    return copy_tree(pristine, tmp_path)
