"""The tree of files that the tests of datasets read, and a copy for those that damage it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.trees import Tree, build_tree, copy_tree

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """Not to be changed."""
    return build_tree(tmp_path_factory.mktemp("pristine"))


@pytest.fixture
def tree(pristine: Tree, tmp_path: Path) -> Tree:
    """A copy of one's own."""
    return copy_tree(pristine, tmp_path)
