"""A function of the user's own beside the scores of a protocol: in every output, refused in one sentence; LPIPS."""

from __future__ import annotations

import csv
import hashlib
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.evaluation import EvaluationResult, Task, evaluate, load_result, save_prediction
from eldata.evaluation.comparison import compare
from eldata.reports.comparison import write_comparison_page
from eldata.reports.evaluation import write_evaluation_page
from tests.drv_tree import SmallDrv, still_of
from tests.evaluation import oracle, published_code
from tests.evaluation.helpers import Tree, predicted_clip
from tests.evaluation.own_set import OwnSet, build_own_set


def worst_error(prediction: NDArray[Any], reference: NDArray[Any]) -> float:
    assert prediction.dtype == reference.dtype == np.float32
    error = float(np.abs(prediction - reference).max())
    prediction[:], reference[:] = 0, 0  # they are its own
    return error


def gap_of_means(prediction: NDArray[Any], reference: NDArray[Any]) -> float:
    return float(prediction.astype(float).mean() - reference.astype(float).mean())


def failing(prediction: NDArray[Any], reference: NDArray[Any]) -> float:
    raise ValueError("no\nedges")


def unknown(prediction: NDArray[Any], reference: NDArray[Any]) -> float:
    return math.nan


def worded(prediction: NDArray[Any], reference: NDArray[Any]) -> Any:
    return "good"


worst = Task(worst_error, higher_is_better=False, label="worst error")
HERE = "tests.evaluation.test_tasks"


def scored(own: OwnSet, name: str = "preds", **options: Any) -> EvaluationResult:
    return evaluate(own.root.parent / name, **{"protocol": "eld"} | own.where | options)


def test_it_stands_beside_the_scores_everywhere(own: OwnSet, tmp_path: Path) -> None:
    plainly = scored(own)
    result = scored(own, task=f"{HERE}:worst")
    assert not result.problems
    assert result.digest == plainly.digest
    for image, plain in zip(result.scores, plainly.scores, strict=True):
        made = np.load((own.predictions / image.path).with_suffix(".npy")).astype(float)
        target = oracle.reference(own.files / image.scene / "clean.dng")
        expected = np.abs(np.clip(np.clip(made, 0, 1) * image.rescale, 0, 1) - target).max()
        assert image.values["task"] == pytest.approx(expected, abs=1e-6)
        assert {name: value for name, value in image.values.items() if name != "task"} == plain.values
    mean = np.mean([image.values["task"] for image in result.scores])
    assert result.whole.values["task"] == pytest.approx(mean, rel=1e-12)
    stated = result.provenance["task"]
    assert stated == {
        "callable": f"{HERE}:worst_error",
        "source_sha256": f"sha256:{hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}",
        "version": None,
        "label": "worst error",
        "images": "compared",
        "higher_is_better": False,
    }
    result.write_json(tmp_path / "result.json")
    back = load_result(tmp_path / "result.json")
    assert (back.scores, back.table, back.as_dict()) == (result.scores, result.table, result.as_dict())
    assert f"worst error: {HERE}:worst_error (sha256:" in result.format("text")
    write_evaluation_page(result, tmp_path / "page.html", dataset_folder=own.files, predictions=own.predictions)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"{result.scores[0].values['task']:.4f}" in page
    assert "lower is better" in page
    assert "task" not in plainly.provenance


def test_renderings_are_those_of_the_published_code(tmp_path: Path) -> None:
    own = build_own_set(tmp_path / "large", ratios=(100,), size=(1040, 1066))
    target = oracle.reference(own.files / "s0/clean.dng")
    made = (1.1 * target + np.random.default_rng(3).normal(0, 0.02, target.shape)).astype(np.float32)
    save_prediction(own.predictions, "s0/x100.dng", made)
    first, second, factor = published_code.eld_shown(made, target, own.files / "s0/clean.dng")
    gap = first.mean(dtype=float) - second.mean(dtype=float)
    # A code may differ by one where a value lies on the edge of two: of a mean, 1e-7 for each of a few pixels.
    assert scored(own, protocol="sid-srgb", task=gap_of_means).scores[0].values["task"] == pytest.approx(gap, abs=1e-6)
    packed = scored(own, protocol="sid-srgb", task=Task(gap_of_means, "packed")).scores[0].values["task"]
    centre = published_code.centre
    expected = np.clip(np.clip(centre(made), 0, 1) * factor, 0, 1).mean(dtype=float) - centre(target).mean(dtype=float)
    assert packed == pytest.approx(expected, abs=1e-6)


def test_a_protocol_of_raw_values_is_rendered_for_a_task(own: OwnSet) -> None:
    image = scored(own, task=Task(gap_of_means, "srgb")).scores[0]
    made = np.load((own.predictions / image.path).with_suffix(".npy"))
    file = own.files / image.scene / "clean.dng"
    target = oracle.reference(file)
    rescaled = np.clip(np.clip(made, 0, 1) * image.rescale, 0, 1)
    first, second = (published_code.eld_rendered(array, file) for array in (rescaled, target))
    # One of 3780 values, a code of 255 off where it lies on the edge of two, moves the mean by 1.04e-6.
    assert image.values["task"] == pytest.approx(first.mean(dtype=float) - second.mean(dtype=float), abs=5e-6)


def test_methods_are_compared_by_the_task_that_they_share(own: OwnSet, tmp_path: Path) -> None:
    first, other = scored(own, task=worst), scored(own, "other", task=worst)
    both = compare({"fine": first, "noisy": other})
    assert [metric.name for metric in both.kind.metrics] == ["psnr_db", "ssim", "task"]
    assert both.whole.gains[0]["task"].interval.mean > 0  # of noise; lower is better
    assert not both.warnings
    write_comparison_page(both, tmp_path / "page.html")
    assert "worst error" in (tmp_path / "page.html").read_text(encoding="utf-8")
    without = compare({"fine": first, "noisy": scored(own, "other")})
    assert [metric.name for metric in without.kind.metrics] == ["psnr_db", "ssim"]
    assert not without.warnings
    changed = other.provenance | {"task": other.provenance["task"] | {"source_sha256": "sha256:00"}}
    (warning,) = compare({"fine": first, "noisy": replace(other, provenance=changed)}).warnings
    assert "fine and noisy may not compare: task source sha256: sha256:" in warning
    unlike = compare({"fine": first, "noisy": scored(own, "other", task=gap_of_means)})
    assert [metric.name for metric in unlike.kind.metrics] == ["psnr_db", "ssim"]
    assert any("task label" in warning for warning in unlike.warnings)


@pytest.mark.parametrize(
    ("task", "reason"),
    [
        (failing, rf"the task {HERE}:failing raised ValueError: no\\nedges \(test_tasks.py, line \d+\)"),
        (unknown, rf"the task {HERE}:unknown returned nan; expected a finite number"),
        (worded, rf"the task {HERE}:worded returned '.*'; expected a finite number"),
    ],
)
def test_frames_without_a_value_are_named(task: Any, reason: str, own: OwnSet) -> None:
    found = scored(own, task=task)
    assert not found.scores
    assert [problem.path for problem in found.problems] == ["s0/x100.dng", "s0/x50.dng", "s1/x100.dng", "s1/x50.dng"]
    for problem in found.problems:
        assert re.fullmatch(reason, problem.reason), problem.reason


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "no_such_module:f"}, "no_such_module:f: cannot be imported: ModuleNotFoundError: No module"),
        ({"task": f"{HERE}:absent"}, f"{HERE}:absent: cannot be imported: AttributeError: "),
        ({"task": "matched"}, "'matched' names nothing in a module; expected package.module:name"),
        ({"task": f"{HERE}:HERE"}, "a task is a function of .*or a Task of one"),
        ({"task": Task(worst_error, "packed"), "protocol": "sid2018"}, "wants packed raw images, which .*'sid2018'"),
        ({"task": lambda *_: 0.0, "workers": 2}, "cannot be sent to worker processes .*: define it at the top level"),
    ],
)
def test_what_it_does_not_go_with_is_refused(options: dict[str, Any], words: str, own: OwnSet) -> None:
    with pytest.raises(ArgumentError, match=words):
        scored(own, **options)


def test_the_command(
    own: OwnSet, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine_of_test_tasks.py").write_text("def zero(p, g):\n    return 0\n1 / (__name__ == 'x')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [path for path in sys.path if path])
    given = ["evaluate", str(own.predictions), *own.arguments, "--protocol", "eld"]
    given += ["--csv", str(tmp_path / "scores.csv")]
    assert main([*given, "--task", "mine_of_test_tasks:zero"]) == 2
    assert ": cannot be imported: ZeroDivisionError: division by zero\n" in capsys.readouterr().err
    (tmp_path / "mine_of_test_tasks.py").write_text("def zero(p, g):\n    return 0\n")
    assert main([*given, "--task", "mine_of_test_tasks:zero"]) == 0
    assert "zero: mine_of_test_tasks:zero (sha256:" in capsys.readouterr().out
    rows = list(csv.reader((tmp_path / "scores.csv").read_text().splitlines()))
    assert rows[0][-1] == "task"
    assert {row[-1] for row in rows[1:]} == {"0"}


# --- of clips ---------------------------------------------------------------------------------------------------------


def test_a_clip_has_the_mean_over_its_frames_as_the_published_code_corrects_them(drv: SmallDrv) -> None:
    given: dict[str, Any] = {"manifest": drv.csv, "root": drv.root, "ids": ["0007", "0013"]}
    result = evaluate(drv.root / "preds", task=gap_of_means, **given)
    assert [video.scene for video in result.scores] == ["0007", "0013"]
    for video in result.scores:
        still = (still_of(video.scene).transpose(2, 0, 1) / 65535).astype(np.float32)
        _, shown = published_code.eld_clip(predicted_clip(video.scene), still, correct=True)
        assert video.values["task"] == pytest.approx(shown.mean(dtype=float) - still.mean(dtype=float), abs=1e-6)
    both = compare({"one": result, "other": result})
    assert [metric.name for metric in both.kind.metrics] == ["psnr_db", "ssim", "st_rred", "task"]


# --- the example of a task (eldata.examples) --------------------------------------------------------------------------


def test_the_example_hands_renderings_to_torchmetrics_lpips(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its network, whose weights would be downloaded, is replaced by the mean absolute difference."""
    lpip = pytest.importorskip("torchmetrics.image.lpip")
    made: list[tuple[object, ...]] = []
    seen: list[NDArray[np.float32]] = []

    def network(net_type: str, *, normalize: bool) -> Any:
        made.append((net_type, normalize))

        def distance(first: Any, second: Any) -> Any:
            seen.extend(image.numpy() for image in (first, second))
            return (first - second).abs().mean()

        return distance

    monkeypatch.setattr(lpip, "LearnedPerceptualImagePatchSimilarity", network)
    task = "eldata.examples.perceptual_distance:lpips"
    found = evaluate(None, **tree.where, baseline="input", cameras=["DemoAlpha"], task=task)
    assert not found.problems
    assert made == [("alex", True)]  # once, and of images in [0, 1]
    assert len(seen) == 2 * len(found.scores)
    for image, first, second in zip(found.scores, seen[::2], seen[1::2], strict=True):
        for pixels in (first, second):
            assert pixels.shape == (1, 3, 32, 48)
            codes = 255 * pixels.astype(np.float64)
            np.testing.assert_allclose(codes, np.round(codes), atol=1e-4)
            assert (pixels.min() >= 0, pixels.max() <= 1) == (True, True)
        assert image.values["task"] == pytest.approx(np.abs(first - second).mean(), rel=1e-5)
    (metric,) = (metric for metric in found.kind.metrics if metric.name == "task")
    assert (metric.label, metric.better) == ("LPIPS", "lower")
    assert found.provenance["task"]["version"].startswith("torchmetrics ")
