"""A store of the tree of files that the tests of datasets read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.sources.store.helpers import pack_tree

if TYPE_CHECKING:
    from pathlib import Path

    from tests.trees import Tree


@pytest.fixture(scope="session")
def store(pristine: Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its 24 pairs, packed. Not to be changed."""
    return pack_tree(pristine, tmp_path_factory.mktemp("store") / "eld.h5").store
