"""Stores and shards that the tests of streaming read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from eldata.sources.shards import write_shards
from tests.sid_tree import build_small_tree
from tests.sources.store.helpers import pack_tree
from tests.trees import Tree, tree_in

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def pristine(demo_tree: Path) -> Tree:
    """24 pairs of two cameras, 64 x 96. Not to be changed."""
    return tree_in(demo_tree)


@pytest.fixture(scope="session")
def eld(pristine: Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of RGGB and GBRG pairs."""
    return pack_tree(pristine, tmp_path_factory.mktemp("store") / "eld.h5").store


@pytest.fixture(scope="session")
def fuji(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of X-Trans pairs."""
    tree = build_small_tree("sid-fuji", tmp_path_factory.mktemp("fuji"), ["10019"])
    return pack_tree(tree, tmp_path_factory.mktemp("store") / "fuji.h5").store


@pytest.fixture(scope="session")
def frames(eld: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whole frames: 24 samples in shards of 7, 7, 7 and 3. Not to be changed: copy it."""
    folder = tmp_path_factory.mktemp("shards") / "frames"
    write_shards(eld, folder, tile=None, samples_per_shard=7)
    return folder


@pytest.fixture(scope="session")
def tiles(eld: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tiles of 16: 144 samples in shards of 50, 50 and 44. Not to be changed: copy it."""
    folder = tmp_path_factory.mktemp("shards") / "tiles"
    write_shards(eld, folder, tile=16, samples_per_shard=50)
    return folder
