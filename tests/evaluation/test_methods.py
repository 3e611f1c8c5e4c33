"""Several folders of predictions in one pass: each is scored as it is alone, whatever the others hold."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
import pytest

from eldata import evaluate
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation import evaluate_methods, load_prediction, score
from eldata.evaluation.methods import named_folders
from tests.evaluation.own_set import OwnSet, build_own_set, predict

if TYPE_CHECKING:
    from eldata.evaluation import EvaluationResult


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """Three scenes of a reference and two noisy frames. Not to be changed."""
    return build_own_set(tmp_path_factory.mktemp("own"), scenes=3)


@pytest.fixture(scope="module")
def folders(own: OwnSet, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A good method; one with its channels in another order; one that lacks a frame and has one of a wrong shape."""
    base = tmp_path_factory.mktemp("methods")
    made = {"good": predict(own, base / "good", 0.01), "swapped": predict(own, base / "swapped", 0.02, reverse=True)}
    made["broken"] = predict(own, base / "broken", 0.03)
    (made["broken"] / "s0" / "x50.npy").unlink()
    np.save(made["broken"] / "s1" / "x100.npy", np.zeros((4, 3, 3), np.float32))
    return made


def alone(own: OwnSet, folder: Path, **options: Any) -> EvaluationResult:
    return evaluate(folder, **own.where, **options)


def as_text(result: EvaluationResult) -> str:
    return json.dumps(result.as_dict(), sort_keys=True)


@pytest.mark.parametrize("allow_missing", [False, True])
def test_each_as_alone(own: OwnSet, folders: dict[str, Path], allow_missing: bool) -> None:
    """JSON equal in every byte; a folder that lacks frames costs the others nothing."""
    found = evaluate_methods(folders, **own.where, allow_missing=allow_missing)
    assert list(found) == ["good", "swapped", "broken"]
    for name, folder in folders.items():
        assert as_text(found[name]) == as_text(alone(own, folder, allow_missing=allow_missing)), name
    assert [found[name].scored for name in found] == [6, 6, 4 if allow_missing else 0]
    assert [len(of.suspicions) for of in found.values()] == [0, 1, 0]
    assert [len(of.problems) for of in found.values()] == [0, 0, 1]


def test_workers_change_nothing(own: OwnSet, folders: dict[str, Path]) -> None:
    expected = [as_text(result) for result in evaluate_methods(folders, **own.where).values()]
    with ThreadPoolExecutor(2) as executor:
        found = evaluate_methods(folders, **own.where, workers=executor)
    assert [as_text(result) for result in found.values()] == expected


def test_each_file_is_read_once(own: OwnSet, folders: dict[str, Path]) -> None:
    """However many folders there are; and no noisy frame that no prediction is looked at with."""
    from eldata.raw import reading

    decode, load, read = reading.read_raw, load_prediction, Counter[str]()

    def counted(path: Any, *arguments: Any, **options: Any) -> Any:
        read[Path(path).name] += 1
        return decode(path, *arguments, **options)

    def loaded(path: Path, *arguments: Any) -> Any:
        read[str(path)] += 1
        return load(path, *arguments)

    with patch.object(reading, "read_raw", counted), patch.object(score, "load_prediction", loaded):
        evaluate_methods({name: folders[name] for name in ("good", "swapped")}, **own.where)
    assert read["clean.dng"] == 3
    assert max(read[name] for name in ("x50.dng", "x100.dng")) <= 2 * 3  # one of each scene, for each folder
    assert [count for path, count in read.items() if path.endswith(".npy")] == [1] * 12


def test_a_unit_that_one_folder_loses(own: OwnSet, folders: dict[str, Path]) -> None:
    """It is scored again, folder by folder: the others have all of their scores."""
    read = score.read_prediction

    def failing(how: Any, pair: Any, path: str, file: Path | None, reference: Any) -> Any:
        if file is not None and file.parts[-3:] == ("swapped", "s1", "x50.npy"):
            raise OSError("the disk is gone")  # as a dead worker, it is no problem of one file
        return read(how, pair, path, file, reference)

    options: Any = own.where | {"allow_missing": True}
    with patch.object(score, "read_prediction", failing):
        found = evaluate_methods([folders["good"], folders["swapped"]], **options)
        expected = alone(own, folders["swapped"], allow_missing=True)
    assert as_text(found["good"]) == as_text(alone(own, folders["good"], allow_missing=True))
    assert as_text(found["swapped"]) == as_text(expected)
    assert (expected.scored, len(expected.problems)) == (4, 2)


def test_predictions_are_in_memory_one_at_a_time(tmp_path: Path) -> None:
    """Six folders take no more of numpy's memory at the peak than two, but for a tenth of a prediction each."""
    size = (300, 420)
    own = build_own_set(tmp_path, ratios=(50,), size=size)
    folder = tmp_path / "p0"
    packed = np.random.default_rng(1).uniform(0, 1, (4, size[0] // 2, size[1] // 2)).astype(np.float32)
    (folder / "s0").mkdir(parents=True)
    np.save(folder / "s0" / "x50.npy", packed)
    several = [folder, *(shutil.copytree(folder, tmp_path / f"p{number}") for number in range(1, 6))]

    def peak(chosen: list[Path]) -> int:
        tracemalloc.start()
        evaluate_methods(chosen, **own.where)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(several)  # what is loaded on first use
    assert peak(several) < peak(several[:2]) + 4 * packed.nbytes // 10


def test_names() -> None:
    here = Path.cwd()
    assert named_folders([here / "tests", here / "docs"]) == {"tests": here / "tests", "docs": here / "docs"}
    assert list(named_folders([here / "tests", here / "docs"], ["one", "two"])) == ["one", "two"]
    for chosen, names, words in (
        ([here / "tests", here / "docs"], ["one"], "1 for 2"),
        ([here / "tests", here / "tests"], [], "would both be called 'tests'"),
        ([here / "tests", here / "docs"], ["A", "a"], "would both be called 'a'"),
        ([here / "tests"], ["comparison"], "what the comparison is called"),
        ([here / "tests"], ["../up"], "cannot be the name of a file"),
        ([], [], "expected one folder"),
    ):
        with pytest.raises(ArgumentError, match=words):
            named_folders(chosen, names)
    with pytest.raises(EldataError, match="nowhere"):
        named_folders([here / "tests", here / "nowhere"])
