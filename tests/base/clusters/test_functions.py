"""The functions that take an executor give what they give without one, to the bit."""

from __future__ import annotations

import json
from dataclasses import astuple
from typing import TYPE_CHECKING

import pytest

from eldata.calibration.camera import calibrate
from eldata.evaluation.evaluate import evaluate
from tests.calibration.trees import FrameTree, made_tree
from tests.evaluation.helpers import Tree, place

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from pathlib import Path


# What threads share, tests/base/clusters/test_executors.py shows; here the work goes where nothing is shared.
ELSEWHERE = pytest.mark.parametrize(
    "executor", ["processes", pytest.param("dask", marks=pytest.mark.dask)], indirect=True
)


@pytest.fixture(scope="module")
def tree(demo_tree: Path) -> Tree:
    return Tree(demo_tree)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> FrameTree:
    return made_tree(tmp_path_factory.mktemp("frames") / "demo", isos=(100, 1600))


@ELSEWHERE
def test_evaluate(tree: Tree, executor: Executor, tmp_path: Path) -> None:
    place(tmp_path, tree)
    alone = evaluate(tmp_path, manifest=tree.manifest, root=tree.root)
    there = evaluate(tmp_path, manifest=tree.manifest, root=tree.root, workers=executor)
    assert len(there.images) == 12
    assert [astuple(image) for image in there.images] == [astuple(image) for image in alone.images]
    assert there.table == alone.table


@ELSEWHERE
def test_calibrate(frames: FrameTree, executor: Executor, tmp_path: Path) -> None:
    alone, there = calibrate(frames.frames()), calibrate(frames.frames(), workers=executor)
    for number, found in enumerate((alone, there)):
        found.profile.save(tmp_path / f"{number}.json")
    assert (tmp_path / "0.json").read_bytes() == (tmp_path / "1.json").read_bytes()
    assert json.dumps(there.as_dict()) == json.dumps(alone.as_dict())
