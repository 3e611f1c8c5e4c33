"""The functions that take an executor give what they give without one, to the bit."""

from __future__ import annotations

import json
from dataclasses import astuple
from typing import TYPE_CHECKING

import h5py
import pytest

from eldata.calibration.camera import calibrate
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.evaluation.evaluate import evaluate
from eldata.noise.profile import CameraProfile
from eldata.sources.store.write import build_store, source_of_dataset, verify_store
from tests.calibration.trees import FrameTree, made_tree
from tests.evaluation.helpers import Tree, place
from tests.sources.store.helpers import contents, write_clean

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
    assert len(there.scores) == 12
    assert [astuple(image) for image in there.scores] == [astuple(image) for image in alone.scores]
    assert there.table == alone.table


@ELSEWHERE
def test_calibrate(frames: FrameTree, executor: Executor, tmp_path: Path) -> None:
    alone, there = calibrate(frames.frames()), calibrate(frames.frames(), workers=executor)
    for number, found in enumerate((alone, there)):
        found.profile.save(tmp_path / f"{number}.json")
    assert (tmp_path / "0.json").read_bytes() == (tmp_path / "1.json").read_bytes()
    assert json.dumps(there.as_dict()) == json.dumps(alone.as_dict())


@ELSEWHERE
def test_pack_and_its_check(tree: Tree, executor: Executor, tmp_path: Path) -> None:
    source = source_of_dataset("eld-demo", root=tree.root, manifest=tree.manifest)
    build_store(source, tmp_path / "alone.h5")
    build_store(source, tmp_path / "there.h5", workers=executor)
    assert contents(tmp_path / "there.h5") == contents(tmp_path / "alone.h5")
    with h5py.File(tmp_path / "there.h5") as store:
        pixels = store["frames/000001"]
        middle = pixels.id.get_offset() + pixels.nbytes // 2
    with (tmp_path / "there.h5").open("r+b") as file:
        file.seek(middle)
        file.write(bytes(range(200)))
    alone = verify_store(tmp_path / "there.h5", level="full")
    assert not alone.ok
    assert verify_store(tmp_path / "there.h5", level="full", workers=executor) == alone


@ELSEWHERE
def test_synthesize(executor: Executor, tmp_path: Path) -> None:
    clean = write_clean(tmp_path / "clean", 3)
    recipe = Recipe(profile=CameraProfile.load("SonyA7S2"), seed=1)
    synthesize(clean, tmp_path / "alone" / "set", recipe)
    synthesize(clean, tmp_path / "there" / "set", recipe, workers=executor)
    found = [
        {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
        for folder in (tmp_path / "alone", tmp_path / "there")
    ]
    assert len(found[0]) == 9
    assert found[1] == found[0]


# --- what workers see -------------------------------------------------------------------------------------------------
