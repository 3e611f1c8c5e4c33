"""Results of `evaluate`: scores, coverage, provenance, files; read back, or refused in a line; several methods."""

from __future__ import annotations

import csv
import json
import shutil
import tracemalloc
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from eldata import __version__
from eldata.base.files import sha256_of
from eldata.base.tables import FORMATS
from eldata.errors import ArgumentError, DatasetError, FileError
from eldata.evaluation import EvaluationResult, evaluate, evaluate_methods, load_prediction, score
from eldata.evaluation.evaluate import compare_methods, name_folders
from eldata.evaluation.results import load_result, saved_result
from eldata.evaluation.scores import UnitScore
from eldata.manifest.card import load_card, save_card
from eldata.protocols import PROTOCOLS
from eldata.protocols.protocol import StatedProtocol
from tests.evaluation.helpers import Tree
from tests.evaluation.own_set import OwnSet, build_own_set, predict
from tests.reports.evaluations import result_data, written


@pytest.fixture(scope="module")
def result(tree: Tree, predictions: Path) -> EvaluationResult:
    return evaluate(predictions, **tree.where)


# --- coverage -------------------------------------------------------------------------------------------------


def test_allow_missing_shows_its_coverage(
    tree: Tree, predictions: Path, result: EvaluationResult, tmp_path: Path
) -> None:
    """Without two of DemoAlpha's predictions of factor 100 and all of DemoBeta's of factor 200."""
    shutil.copytree(predictions, tmp_path / "preds")
    for camera, number in (("Alpha", 4), ("Alpha", 9), ("Beta", 5), ("Beta", 10), ("Beta", 15)):
        (tmp_path / "preds" / f"Demo{camera}/scene-1/IMG_{number:04d}.npy").unlink()
    found = evaluate(tmp_path / "preds", **tree.where, allow_missing=True)
    assert not found.problems
    assert len(found.missing) == 5
    kept = [image for image in result.scores if image.path not in found.missing]
    assert list(found.scores) == kept

    rows = {(row.camera, row.ratio): row for row in found.table}
    assert (rows["DemoAlpha", 100].scored, rows["DemoAlpha", 100].pairs) == (1, 3)
    assert (rows["DemoBeta", 200].scored, rows["DemoBeta", 200].pairs) == (0, 3)
    assert (rows[None, None].scored, rows[None, None].pairs) == (7, 12)
    assert rows[None, None].psnr_db == pytest.approx(np.mean([image.psnr_db for image in kept]), rel=1e-12)

    data = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert data["coverage"] == {"pairs": 12, "scored": 7, "missing": list(found.missing)}
    empty = next(row for row in data["table"] if (row["camera"], row["ratio"]) == ("DemoBeta", 200))
    assert (empty["psnr_db"], empty["ssim"]) == (None, None)


# --- the dataset ----------------------------------------------------------------------------------------------


@pytest.fixture
def copied(tree: Tree, tmp_path: Path) -> Tree:
    return tree.copy(tmp_path / "tree")


@pytest.mark.parametrize("number", ["0011", "0004"])  # a reference, and a noisy frame, which predictions do not need
def test_missing_frame(tree: Tree, copied: Tree, predictions: Path, result: EvaluationResult, number: str) -> None:
    """Or a damaged one: nothing is scored, unless the rest is asked for."""
    missing, damaged = f"DemoBeta/scene-1/IMG_{number}.dng", "DemoAlpha/scene-1/IMG_0005.dng"
    (copied.files / missing).unlink()
    (copied.files / damaged).write_bytes((copied.files / damaged).read_bytes()[:3000])
    with pytest.raises(DatasetError, match=r"IMG_0005\.dng: content: .* \(and 1 more: "):
        evaluate(predictions, **copied.where)
    allowed = evaluate(predictions, **copied.where, allow_missing=True)
    assert [problem.path for problem in allowed.problems] == [damaged, missing]
    left = {pair.path for pair in tree.pairs if {missing, damaged} & {pair.path, pair.reference}}
    assert set(allowed.missing) == left
    assert allowed.scores == tuple(score for score in result.scores if score.path not in left)


# --- names ----------------------------------------------------------------------------------------------------


def test_cameras(copied: Tree, predictions: Path, result: EvaluationResult) -> None:
    shutil.rmtree(copied.files / "DemoAlpha")  # a part of the dataset is enough for its own scores
    found = evaluate(predictions, **copied.where, cameras=["DemoBeta"])
    assert found.scores == tuple(image for image in result.scores if image.camera == "DemoBeta")
    assert found.provenance["cameras"] == ["DemoBeta"]
    assert "only DemoBeta" in found.format_text()
    assert [(row.camera, row.ratio) for row in found.table] == [("DemoBeta", 100), ("DemoBeta", 200), (None, None)]
    assert any(note.endswith("leaves their frames out: 6 predictions") for note in found.notes)  # of the other camera


# --- what is written ------------------------------------------------------------------------------------------


def test_the_card_says_whether_cameras_share_their_scenes(tree: Tree, result: EvaluationResult, tmp_path: Path) -> None:
    """Two cameras and one scene's name; the result, and what was saved of it, count scenes as the card has them."""
    manifest = Path(shutil.copy(tree.manifest, tmp_path / "mine.csv"))
    card = load_card(tree.manifest.with_suffix(".json"))
    save_card(manifest.with_suffix(".json"), replace(card, scenes_shared=False))
    apart = evaluate(None, manifest=manifest, root=tree.root, baseline="input")
    for found, shared, scenes in ((result, True, 1), (apart, False, 2)):
        again = saved_result(found.as_dict(), "test")
        for one in (found, again):
            assert one.scenes_shared is one.provenance["scenes_shared"] is shared
            assert [one.interval(row, "psnr_db").scenes for row in one.table] == [1] * 4 + [scenes] * 3


def test_provenance(tree: Tree, predictions: Path, result: EvaluationResult) -> None:
    provenance = result.provenance
    assert provenance.items() >= {
        "dataset": "eld-demo", "manifest_version": "1.0", "manifest_sha256": sha256_of(tree.manifest),
        "protocol_digest": PROTOCOLS["eld"].digest, "cameras": "all", "predictions": str(predictions),
        "eldata": __version__, **{name: version(name) for name in ("numpy", "numba", "rawpy")},
    }.items()  # fmt: skip
    assert provenance["libraw"].count(".") == 2
    assert provenance["python"].startswith("3.")


def test_csv(result: EvaluationResult, tmp_path: Path) -> None:
    """With every digit, of unusual numbers too."""
    values = {"psnr_db": 0.1 + 0.2, "ssim": 1 / 3, "rescale": 2 / 3}
    unusual = [(3280000.0, 250.0), (409600.0, 300.0), (50.0, 33.3125)]
    odd = tuple(UnitScore('odd, "name".dng', "C", "s", iso, ratio, values) for iso, ratio in unusual)
    result = replace(result, scores=(*result.scores, *odd))
    result.write_csv(tmp_path / "scores.csv")
    content = (tmp_path / "scores.csv").read_bytes()
    assert content.startswith(b"path,camera,scene,iso,ratio,psnr_db,ssim,rescale\n")
    assert b"\r" not in content
    with (tmp_path / "scores.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["path"] for row in rows] == [image.path for image in result.scores]
    for row, image in zip(rows, result.scores, strict=True):
        for column in ("iso", "ratio", "psnr_db", "ssim", "rescale"):
            assert float(row[column]) == getattr(image, column)
        assert (row["camera"], row["scene"]) == (image.camera, image.scene)
    assert rows[0]["iso"] == "800"
    assert [row["ratio"] for row in rows[-3:]] == ["250", "300", "33.3125"]


# --- what was saved ---------------------------------------------------------------------------------------------------


def test_what_evaluate_wrote_is_read_back(tree: Tree, predictions: Path, tmp_path: Path) -> None:
    """One that lacks a prediction, and cannot use another: all but its pairs, with its protocol as it states itself."""
    shutil.copytree(predictions, tmp_path / "preds")
    first, second, *_ = (tmp_path / "preds" / pair.path for pair in tree.pairs)
    first.with_suffix(".npy").unlink()
    second.with_suffix(".npy").write_bytes(b"")
    result = evaluate(tmp_path / "preds", **tree.where, allow_missing=True)
    assert [problem.path for problem in result.problems] == [str(second.with_suffix(".npy"))]
    assert (len(result.missing), result.expected) == (2, 12)
    assert result.notes
    result.write_json(tmp_path / "a.json")
    saved = load_result(tmp_path / "a.json")
    stated = StatedProtocol(result.kind, result.protocol.as_dict())
    assert saved == replace(result, protocol=stated, units=(), source=str(tmp_path / "a.json"))
    for form in FORMATS:
        assert saved.format(form) == result.format(form)
    assert saved.as_dict() == result.as_dict()
    assert (saved.dataset, saved.protocol.name, saved.digest) == ("eld-demo", "eld", result.protocol.digest)
    assert saved.scores[0].place == ("DemoAlpha", "scene-1")


# --- what cannot be used ------------------------------------------------------------------------------------------


def changed(*keys: str | int, to: object) -> dict[str, Any]:
    data = result_data(scenes=1)
    place: Any = data
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = to
    return data


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (changed("images", 3, "psnr_db", to="high"), ["images[3].psnr_db", '"inf"', "'high'"]),
        (changed("images", 3, "psnr_db", to=10**400), ["images[3].psnr_db", "finite"]),
        (changed("images", 2, "ratio", to=-1), ["images[2].ratio", "-1"]),
        (changed("images", 0, "path", to=7), ["images[0].path", "text", "7"]),
        (changed("images", 1, "path", to="SonyA7S2/scene-1/IMG_0002.ARW"), ["images[1].path", "another image"]),
        (changed("coverage", "scored", to=11), ["coverage.scored", "12", "11"]),
        (changed("coverage", "pairs", to=3), ["coverage.pairs", "12 or more", "3"]),
        (changed("provenance", to="eld"), ["field provenance", "object", "'eld'"]),
        (changed("provenance", "scenes_shared", to=None), ["provenance.scenes_shared", "true or false", "null"]),
        (changed("provenance", "eldata", to="99.0.0"), ["provenance.eldata", "99.0.0", __version__, "update"]),
        (changed("protocol", "name", to=3), ["protocol.name", "text"]),
        # An edited field would be taken for how the scores were made.
        (changed("protocol", "region", to="border-2"), ["protocol_digest: expected the digest of the fields"]),
        (changed("problems", to=[{"path": "a"}]), ["problems[0].reason", "nothing"]),
        ({"problems": [], "ok": True}, ["not a result of eldata evaluate", "provenance", "missing"]),
        ([], ["expected an object", "[]"]),
    ],
)
def test_a_bad_field_is_named(data: object, words: list[str], tmp_path: Path) -> None:
    path = written(tmp_path / "bad.json", data)
    with pytest.raises(FileError) as caught:
        load_result(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for word in words:
        assert word in message


# --- several folders in one pass: each is scored as it is alone -------------------------------------------------------


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
    assert [found[name].scored for name in found] == [4, 4, 2 if allow_missing else 0]
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

    decode, load, read = reading.open_frame, load_prediction, Counter[str]()

    def counted(path: Any, *arguments: Any, **options: Any) -> Any:
        read[Path(path).name] += 1
        return decode(path, *arguments, **options)

    def loaded(path: Path, *arguments: Any) -> Any:
        read[str(path)] += 1
        return load(path, *arguments)

    with patch.object(reading, "open_frame", counted), patch.object(score, "load_prediction", loaded):
        evaluate_methods({name: folders[name] for name in ("good", "swapped")}, **own.where)
    assert read["clean.dng"] == 2
    assert max(read[name] for name in ("x50.dng", "x100.dng")) <= 2 * 2  # one of each scene, for each folder
    assert [count for path, count in read.items() if path.endswith(".npy")] == [1] * 8


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
    assert (expected.scored, len(expected.problems)) == (2, 2)


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
    assert name_folders([here / "tests", here / "docs"]) == {"tests": here / "tests", "docs": here / "docs"}
    assert list(name_folders([here / "tests", here / "docs"], ["one", "two"])) == ["one", "two"]
    for chosen, names, words in (
        ([here / "tests", here / "docs"], ["one"], "1 for 2"),
        ([here / "tests", here / "tests"], [], "would both be called 'tests'"),
        ([here / "tests", here / "docs"], ["A", "a"], "would both be called 'a'"),
        ([here / "tests"], ["Comparison"], "the comparison and .* would both be called"),
        ([here / "tests"], ["../up"], "cannot be the name of a file"),
        ([], [], "expected one folder"),
    ):
        with pytest.raises(ArgumentError, match=words):
            name_folders(chosen, names)


def test_what_cannot_be_compared_says_why(own: OwnSet, folders: dict[str, Path]) -> None:
    good, other = (alone(own, folders[name]) for name in ("good", "swapped"))
    none = replace(other, scores=())
    assert compare_methods({"a": good}) == (None, "")
    assert compare_methods({"a": good, "b": none}) == (None, "there is nothing to compare: a alone has scores")
    assert compare_methods({"a": none, "b": none}) == (None, "there is nothing to compare: no method has scores")
    apart = replace(other, scores=tuple(replace(score, path=f"x/{score.path}") for score in other.scores))
    assert compare_methods({"a": good, "b": apart})[1].startswith("no image is common to the results (a: 4 of mine")
