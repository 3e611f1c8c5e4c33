"""What several tests of datasets read: a store of the demo's tree, some clips of DRV."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drv_tree import SmallDrv, small_drv
from tests.shared import made_once
from tests.sources.store.helpers import pack_tree
from tests.trees import Tree

CLIPS, FRAMES = ("0007", "0013", "M0003"), 13


@pytest.fixture(scope="session")
def store(pristine: Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its 24 pairs, RGGB and GBRG, packed. Not to be changed."""
    return pack_tree(pristine, tmp_path_factory.mktemp("store") / "eld.h5").store


@pytest.fixture(scope="session")
def drv(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SmallDrv]:
    """Three clips of 13 preprocessed frames, of which M0003 has no reference. Not to be changed."""
    with made_once(tmp_path_factory, "drv", lambda folder: small_drv(folder, CLIPS, FRAMES)) as folder:
        yield SmallDrv(folder / "manifests" / "drv.csv", folder / "data")
