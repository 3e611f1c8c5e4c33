"""Calibration frames in files, made once for all tests of the room."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.calibration.trees import FrameTree, make_tree
from tests.shared import made_once


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FrameTree]:
    """Three ISOs, six bias frames and three pairs of flats each. Not to be changed."""
    with made_once(tmp_path_factory, "calibration-frames", make_tree) as folder:
        yield FrameTree(folder)


@pytest.fixture
def tree(pristine: FrameTree, tmp_path: Path) -> FrameTree:
    """A copy that a test may change."""
    return pristine.copy(tmp_path / "tree")
