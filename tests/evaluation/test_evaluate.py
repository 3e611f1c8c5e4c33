from __future__ import annotations

import csv
import inspect
import json
import math
import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import pytest

from eldata import __version__
from eldata.base.files import sha256_of
from eldata.baselines import write_predictions
from eldata.errors import DatasetError
from eldata.evaluation import EvaluationResult, evaluate, evaluate_methods, scored_pairs
from eldata.evaluation.results import saved_result
from eldata.evaluation.scores import UnitScore
from eldata.manifest.card import load_card, save_card
from eldata.protocols import PROTOCOLS
from tests.evaluation import oracle
from tests.evaluation.helpers import Tree, place

if TYPE_CHECKING:
    from collections.abc import Callable

COLUMNS = ["path", "camera", "scene", "iso", "ratio", "psnr_db", "ssim", "rescale"]


def strict(text: str) -> Any:
    """Parse JSON that must not use NaN or Infinity."""

    def refuse(constant: str) -> NoReturn:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def result(tree: Tree, predictions: Path) -> EvaluationResult:
    return evaluate(predictions, **tree.where)


@pytest.fixture
def incomplete(predictions: Path, tmp_path: Path) -> Path:
    """Without two of DemoAlpha's predictions of factor 100 and all of DemoBeta's of factor 200."""
    shutil.copytree(predictions, tmp_path / "preds")
    for name in ("DemoAlpha/scene-1/IMG_0004", "DemoAlpha/scene-1/IMG_0009", *(
        f"DemoBeta/scene-1/IMG_{number:04d}" for number in (5, 10, 15)
    )):  # fmt: skip
        (tmp_path / "preds" / name).with_suffix(".npy").unlink()
    return tmp_path / "preds"


# --- the numbers ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "protocol"), [(0.0, "eld"), (-0.5, "eld"), (0.0, "eld-uncorrected")])
def test_all_dark_predictions_are_scored_as_black(value: float, protocol: str, tree: Tree, tmp_path: Path) -> None:
    place(tmp_path, tree, lambda target, _: np.full_like(target, value))
    found = evaluate(tmp_path, protocol=protocol, **tree.where)
    references = {pair.path: pair.reference for pair in tree.pairs}
    for image in found.scores:
        target = oracle.reference(tree.files / references[image.path])
        assert image.rescale == 1.0
        assert image.psnr_db == pytest.approx(10 * math.log10(1 / np.mean(target**2)), abs=1e-5)
        assert 0 <= image.ssim < 1


# --- coverage -------------------------------------------------------------------------------------------------


def test_allow_missing_shows_its_coverage(
    tree: Tree, incomplete: Path, result: EvaluationResult, tmp_path: Path
) -> None:
    found = evaluate(incomplete, **tree.where, allow_missing=True)
    assert not found.problems
    assert len(found.missing) == 5
    kept = [image for image in result.scores if image.path not in found.missing]
    assert list(found.scores) == kept

    rows = {(row.camera, row.ratio): row for row in found.table}
    assert (rows["DemoAlpha", 100].scored, rows["DemoAlpha", 100].pairs) == (1, 3)
    assert (rows["DemoBeta", 200].scored, rows["DemoBeta", 200].pairs) == (0, 3)
    assert (rows[None, None].scored, rows[None, None].pairs) == (7, 12)
    assert rows[None, None].psnr_db == pytest.approx(np.mean([image.psnr_db for image in kept]), rel=1e-12)

    found.write_json(tmp_path / "r.json")
    data = strict((tmp_path / "r.json").read_text())
    assert data["coverage"] == {"pairs": 12, "scored": 7, "missing": list(found.missing)}
    empty = next(row for row in data["table"] if (row["camera"], row["ratio"]) == ("DemoBeta", 200))
    assert empty["psnr_db"] is None
    assert empty["ssim"] is None


# --- the dataset ----------------------------------------------------------------------------------------------


@pytest.fixture
def own(tree: Tree, tmp_path: Path) -> Tree:
    return tree.copy(tmp_path / "tree")


def refused(tree: Tree, predictions: Path, **arguments: Any) -> str:
    with pytest.raises(DatasetError) as caught:
        evaluate(predictions, **tree.where, **arguments)
    return str(caught.value)


@pytest.mark.parametrize("number", ["0011", "0004"])  # a reference, and a noisy frame, which predictions do not need
def test_missing_frame(own: Tree, predictions: Path, number: str) -> None:
    (own.files / f"DemoBeta/scene-1/IMG_{number}.dng").unlink()
    message = refused(own, predictions, allow_missing=True)
    assert f"DemoBeta/scene-1/IMG_{number}.dng" in message
    assert "expected a file, found nothing" in message


# --- names ----------------------------------------------------------------------------------------------------


def test_cameras(own: Tree, predictions: Path, result: EvaluationResult) -> None:
    shutil.rmtree(own.files / "DemoAlpha")  # a part of the dataset is enough for its own scores
    found = evaluate(predictions, **own.where, cameras=["DemoBeta"])
    assert found.scores == tuple(image for image in result.scores if image.camera == "DemoBeta")
    assert found.provenance["cameras"] == ["DemoBeta"]
    assert "only DemoBeta" in found.format_text()
    assert [(row.camera, row.ratio) for row in found.table] == [("DemoBeta", 100), ("DemoBeta", 200), (None, None)]
    assert any(note.endswith("leaves their frames out: 6 predictions") for note in found.notes)  # of the other camera


CHOICE: dict[str, Any] = dict.fromkeys(("protocol", "root", "manifest", "cameras", "subset", "ids", "dark_shading"))
CHOICE["exclude_flags"] = ()
SCORED: dict[str, Any] = CHOICE | {"dataset": "eld", "allow_missing": False}
HOW: dict[str, Any] = SCORED | {"strict": False, "task": None, "workers": 1}
SIGNATURES: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (evaluate, HOW | {"baseline": None}),
    (evaluate_methods, HOW),
    (scored_pairs, SCORED | {"baseline": None}),
    (write_predictions, CHOICE | {"clip": None, "dtype": "float32", "workers": 1}),
]


@pytest.mark.parametrize(("shown", "defaults"), SIGNATURES, ids=lambda value: getattr(value, "__name__", None))
def test_every_keyword_stands_there_with_its_default(shown: Callable[..., Any], defaults: dict[str, Any]) -> None:
    parameters = inspect.signature(shown).parameters.values()
    assert {one.name: one.default for one in parameters if one.default is not one.empty} == defaults
    with pytest.raises(TypeError, match="got an unexpected keyword argument 'colour'"):
        shown(colour=1)


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
    assert provenance["dataset"] == "eld-demo"
    assert provenance["manifest_version"] == "1.0"
    assert provenance["manifest_sha256"] == sha256_of(tree.manifest)
    assert provenance["protocol_digest"] == PROTOCOLS["eld"].digest
    assert provenance["cameras"] == "all"
    assert provenance["predictions"] == str(predictions)
    assert provenance["eldata"] == __version__
    for name in ("numpy", "numba", "rawpy"):
        assert provenance[name] == version(name)
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
        reader = csv.DictReader(file)
        rows = list(reader)
        assert list(reader.fieldnames or ()) == COLUMNS
    assert [row["path"] for row in rows] == [image.path for image in result.scores]
    for row, image in zip(rows, result.scores, strict=True):
        for column in ("iso", "ratio", "psnr_db", "ssim", "rescale"):
            assert float(row[column]) == getattr(image, column)
        assert (row["camera"], row["scene"]) == (image.camera, image.scene)
    assert rows[0]["iso"] == "800"
    assert [row["ratio"] for row in rows[-3:]] == ["250", "300", "33.3125"]
