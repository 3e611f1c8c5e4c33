"""The functions that take an executor give what they give without one, to the bit."""

from __future__ import annotations

import json
import socket
from concurrent.futures import Executor
from dataclasses import astuple
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest

from eldata.calibration.camera import calibrate
from eldata.datasets.published.clips import DRVDataset
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import FileError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.predictions import save_clip_prediction
from eldata.manifest.lock import lock
from eldata.manifest.verify import verify
from eldata.noise.profile import CameraProfile
from eldata.sources.store.build import build_store, verify_store
from eldata.sources.store.sources import source_of_dataset
from tests import trees
from tests.calibration.trees import FrameTree, made_tree
from tests.drv_tree import small_drv
from tests.evaluation.helpers import Tree, place
from tests.sources.store.helpers import contents, write_clean

if TYPE_CHECKING:
    from concurrent.futures import Future
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
def test_lock(executor: Executor, tmp_path: Path) -> None:
    made = trees.build_tree(tmp_path / "made")
    made.change_rows(sha256=None, size_bytes=None)
    other = trees.copy_tree(made, tmp_path / "other")
    assert lock(made.csv, made.root).files_locked == 32
    assert lock(other.csv, other.root, workers=executor).files_locked == 32
    assert other.csv.read_bytes() == made.csv.read_bytes()


@ELSEWHERE
def test_evaluate(tree: Tree, executor: Executor, tmp_path: Path) -> None:
    place(tmp_path, tree)
    alone = evaluate(tmp_path, manifest=tree.manifest, root=tree.root)
    there = evaluate(tmp_path, manifest=tree.manifest, root=tree.root, workers=executor)
    assert len(there.images) == 12
    assert [astuple(image) for image in there.images] == [astuple(image) for image in alone.images]
    assert there.table == alone.table


@ELSEWHERE
def test_evaluate_clips(executor: Executor, tmp_path: Path) -> None:
    drv = small_drv(tmp_path / "drv", ("0007", "0013"), 12, size=(48, 56))
    for record in DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records:
        generator = np.random.default_rng(int(record.scene))
        save_clip_prediction(tmp_path / "preds", record, generator.random((5, 3, 48, 56), np.float32))
    options: dict[str, Any] = {"manifest": drv.csv, "root": drv.root, "ids": ["0007", "0013"]}
    alone = evaluate(tmp_path / "preds", **options)
    there = evaluate(tmp_path / "preds", **options, workers=executor)
    assert len(there.videos) == 2
    assert there.videos == alone.videos


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


class Vanishing(Executor):
    """Another executor, from which files vanish as soon as it gets work: as if its machines did not have them."""

    def __init__(self, executor: Executor, *paths: Path) -> None:
        self._executor, self._paths = executor, paths

    def submit(self, call: Any, /) -> Future[Any]:  # type: ignore[override] # all that is used
        for path in self._paths:
            path.unlink(missing_ok=True)
        return self._executor.submit(call)


def unseen(path: Path) -> str:
    error = FileError(
        path,
        f"No such file or directory on {socket.gethostname()}; every machine that takes part must see the same files "
        "under the same paths",
    )
    return str(error)


@pytest.mark.dask
def test_verify_names_the_files_that_workers_do_not_see(tree: Tree, dask: Executor, tmp_path: Path) -> None:
    own = tree.copy(tmp_path / "own")
    gone = sorted(own.files.glob("*/*/*.dng"))[3]
    report = verify(own.manifest, own.root, level="full", workers=Vanishing(dask, gone))
    (problem,) = (one for one in report.problems if one.field == "check")
    assert (problem.path, problem.found) == (gone.relative_to(own.files).as_posix(), unseen(gone))


@pytest.mark.dask
def test_pack_names_the_file_that_workers_do_not_see(tree: Tree, dask: Executor, tmp_path: Path) -> None:
    own = tree.copy(tmp_path / "own")
    source = source_of_dataset("eld-demo", root=own.root, manifest=own.manifest)
    gone = own.files / source.files[5][0]
    with pytest.raises(FileError) as raised:
        build_store(source, tmp_path / "store.h5", workers=Vanishing(dask, gone))
    assert str(raised.value) == unseen(gone)
