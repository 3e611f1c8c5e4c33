"""An evaluation of corrected inputs: the baseline less a dark shading, and what results say of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.errors import ArgumentError, EldataError, ShadingError
from eldata.evaluation import EvaluationResult, evaluate, load_result, save_prediction
from eldata.evaluation.comparison import compare
from eldata.evaluation.looking import images_of
from eldata.metrics import psnr
from eldata.noise import DarkShading
from eldata.protocols import get_protocol
from eldata.raw import read_raw
from tests.drv_tree import SmallDrv
from tests.evaluation.helpers import Tree, small_tree
from tests.planted_shading import plant, shading_of

CAMERA = "DemoBeta"


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    return small_tree(tmp_path_factory.mktemp("clean"))


@pytest.fixture(scope="module")
def planted(clean: Tree, tmp_path_factory: pytest.TempPathFactory) -> tuple[Tree, Path]:
    """The same tree with a pattern in the noisy frames of one camera, and the file of what takes it off."""
    folder = tmp_path_factory.mktemp("planted")
    tree = clean.copy(folder / "tree")
    files = [tree.files / pair.path for pair in tree.pairs if pair.camera == CAMERA]
    shading_of(read_raw(files[0]).sensor, sorted(plant(files))).save(folder / "beta.npz")
    return tree, folder / "beta.npz"


def scored(tree: Tree, predictions: Path | None = None, **options: Any) -> EvaluationResult:
    given: dict[str, Any] = {"protocol": "eld", "cameras": [CAMERA], **options}
    baseline: Any = None if predictions else "input"
    return evaluate(predictions, **tree.where, baseline=baseline, **given)


def test_the_baseline_is_corrected_and_the_result_says_so(
    clean: Tree, planted: tuple[Tree, Path], tmp_path: Path
) -> None:
    tree, file = planted
    digest = DarkShading.load(file).digest
    for protocol in ("eld", "led-eld"):  # one white level, and LibRaw's of each channel
        before, corrected = scored(clean, protocol=protocol), scored(tree, protocol=protocol, dark_shading=file)
        assert corrected.scores == before.scores
        assert scored(tree, protocol=protocol).psnr_db < before.psnr_db - 0.5
    corrected = scored(tree, dark_shading=str(file))
    assert before.digest == get_protocol("led-eld").digest, "of inputs as they are, it stays"
    assert corrected.digest != get_protocol("eld").digest
    assert corrected.protocol.as_dict()["dark_shading"] == corrected.provenance["dark_shading"] == digest
    corrected.write_json(tmp_path / "r.json")
    read = load_result(tmp_path / "r.json")
    for result in (corrected, read):
        words = f"input less dark shading {digest[:15]}"
        assert words in result.caption
        for form in ("text", "markdown"):
            text = " ".join(result.format(form).split())  # lines are broken for the terminal
            assert words in text
            assert "the input was scored less the dark shading of Planted, sha256:" in text.replace("\\", "")
    assert read.digest == corrected.digest
    plain = scored(tree)
    assert corrected.scored_unlike(plain) == [f"dark shading off: {digest} against none"]
    (warning,) = compare({"a": corrected, "b": plain}).warnings[:1]
    assert "dark shading" in warning


def test_of_predictions_it_is_stated(planted: tuple[Tree, Path], tmp_path: Path) -> None:
    tree, file = planted
    for pair in tree.pairs:
        if pair.camera == CAMERA:
            save_prediction(tmp_path / "preds", pair.path, np.full((4, 32, 48), 0.2, np.float32))
    plain, stated = scored(tree, tmp_path / "preds"), scored(tree, tmp_path / "preds", dark_shading=file)
    assert stated.scores == plain.scores
    assert stated.digest != plain.digest
    assert "predictions are, as stated with --dark-shading, of inputs less the dark shading of" in stated.notes[0]
    assert stated.scored_unlike(plain) == [], "the same scores of given predictions; comparisons name the inputs"
    assert any("dark shading" in words for words in compare({"a": plain, "b": stated}).warnings)


def test_predictions_are_made_of_corrected_inputs(clean: Tree, planted: tuple[Tree, Path], tmp_path: Path) -> None:
    tree, file = planted
    given: dict[str, Any] = {"cameras": [CAMERA], "clip": "none", "subset": None}
    for name, of, shading in (("clean", clean, None), ("corrected", tree, file)):
        report = write_predictions(
            BaselineDenoiser("input"), "", tmp_path / name, **of.where, dark_shading=shading, **given
        )
        assert report.written > 0
        assert not report.problems
    found = sorted(path.relative_to(tmp_path / "clean") for path in (tmp_path / "clean").rglob("*.npy"))
    assert found
    for path in found:
        assert (tmp_path / "clean" / path).read_bytes() == (tmp_path / "corrected" / path).read_bytes()
    made = tmp_path / "corrected"
    right = scored(tree, made, dark_shading=file)
    assert right.notes[0].startswith("the predictions are, as predictions.json says, of inputs less the dark shading")
    with pytest.raises(ArgumentError, match=r"predictions.json says .* less the dark shading sha256:\w+, and none was"):
        scored(tree, made)
    with pytest.raises(ArgumentError, match=r"are of inputs as they are, and .* is sha256:\w+: leave --dark-shading"):
        scored(tree, tmp_path / "clean", dark_shading=file)
    settings = (made / "predictions.json").read_bytes()
    (made / "predictions.json").write_text("[]")  # another program's
    assert scored(tree, made).scores == right.scores
    (made / "predictions.json").write_bytes(settings)
    with pytest.raises(EldataError, match="was started with dark shading"):  # not continued with inputs as they are
        write_predictions(BaselineDenoiser("input"), "", tmp_path / "corrected", **tree.where, **given)


def test_a_shading_that_is_not_of_these_inputs(planted: tuple[Tree, Path], drv: SmallDrv, tmp_path: Path) -> None:
    tree, file = planted
    right = DarkShading.load(file)
    sensor = read_raw(tree.files / tree.pairs[-1].path).sensor

    def saved(name: str, shading: DarkShading) -> Path:
        shading.save(tmp_path / name)
        return tmp_path / name

    with pytest.raises(ArgumentError, match=r"Planted is of one body, and 2 cameras are scored: DemoAlpha, DemoBeta"):
        scored(tree, cameras=None, dark_shading=file)
    with pytest.raises(ArgumentError, match="was not measured at ISO 3200"):
        scored(tree, dark_shading=saved("isos.npz", shading_of(sensor, (800, 1600))))
    with pytest.raises(ShadingError, match="cannot be read"):
        scored(tree, dark_shading=tmp_path / "none.npz")
    with pytest.raises(ArgumentError, match=r"is of inputs less the dark shading sha256:0+, and none was given"):
        scored(tree, protocol=replace(get_protocol("eld"), dark_shading="sha256:" + "0" * 64))
    with pytest.raises(ArgumentError, match="dark_shading must be 'none' or the digest of one"):
        scored(tree, protocol=replace(get_protocol("eld"), dark_shading="mine"))
    other = saved("other.npz", replace(right, model="Other 7"))
    found = scored(tree, dark_shading=other)
    assert not found.scores
    assert all("but the dark shading of Planted is of a Other 7" in problem.reason for problem in found.problems)
    save_prediction(tmp_path / "preds", tree.pairs[-1].path, np.zeros((4, 32, 48), np.float32))
    found = scored(tree, tmp_path / "preds", dark_shading=other, allow_missing=True)
    assert any("is of a Other 7" in problem.reason for problem in found.problems)
    with pytest.raises(ArgumentError, match="'drv-rgb' scores preprocessed RGB, whose dark shading nobody can take"):
        evaluate(None, manifest=drv.csv, root=drv.root, ids=["0007"], baseline="input", dark_shading=file)


def test_pictures_are_of_what_each_result_states(planted: tuple[Tree, Path], tmp_path: Path) -> None:
    """Of one method the input is corrected, of the other it is as the camera gave it: each as it was scored."""
    tree, file = planted
    methods = {"corrected": scored(tree, dark_shading=file), "plain": scored(tree)}
    comparison = compare(methods)
    images = images_of(
        list(methods.values()), comparison.images, dataset_folder=tree.files, predictions=[None] * 2, dark_shading=file
    )
    seen = images[0].decoded()
    for values, method, scores in zip(seen.predictions, methods, comparison.images[0], strict=True):
        assert psnr(values, seen.reference) == pytest.approx(scores.psnr_db, abs=1e-4), method
    shading_of(read_raw(tree.files / tree.pairs[-1].path).sensor, (800,)).save(tmp_path / "other.npz")
    for other, words in ((None, "no file is none"), (tmp_path / "other.npz", "is sha256:")):
        with pytest.raises(ArgumentError, match=f"less the dark shading sha256:[0-9a-f]+, and .*{words}"):
            replace(images[0], dark_shading=other).decoded()
