"""The examples of tasks (``eldata.examples``): matches, LPIPS, optical flow between frames, depth by a model's file."""

from __future__ import annotations

import hashlib
import importlib
import math
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.demo.tree import make_tree
from eldata.errors import ArgumentError
from eldata.evaluation import Task, evaluate, save_prediction
from tests.evaluation import oracle
from tests.onnx_file import onnx_network
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation import EvaluationResult


def on_the_demo(folder: Path, task: str | Task) -> EvaluationResult:
    """Evaluate the noisy input of the set that the demo made in a folder."""
    manifest, root = folder / "manifests" / "eld-demo.csv", folder / "data"
    return evaluate(None, manifest=manifest, root=root, baseline="input", cameras=["DemoAlpha"], task=task)


def test_the_example_finds_the_flow_of_a_camera_that_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = importlib.import_module("eldata.examples.estimate_flow")
    # Whole pixels of one texture, so that motion and error are known.
    wide = example.scene_radiance(3, 160, 224)
    at = [wide[:, top : top + 128, left : left + 192] for top, left in ((0, 0), (1, 3), (1, 0), (3, 4))]
    np.testing.assert_allclose(example.motion(at[:2]).mean(axis=(1, 2)), [-1, -3], atol=0.05)
    assert example.endpoint_error(at[1:3], at[1:3]) == 0
    # (0, 3) in place of (-1, -3), and (-2, -4) in place of (0, 3): TV-L1 was within 0.04 px of each on the mean.
    assert example.endpoint_error(at[1:3], at[:2]) == pytest.approx(math.hypot(1, 6), abs=0.1)
    assert example.endpoint_error(at[2:], at[1:3]) == pytest.approx(math.hypot(2, 7), abs=0.1)

    manifest = example.photograph(tmp_path / "set", scenes=1, moments=3, size=(192, 288))
    given: dict[str, Any] = {
        "manifest": manifest,
        "root": tmp_path / "set",
        "task": "eldata.examples.estimate_flow:flow",
    }
    noisy = evaluate(None, baseline="input", **given)
    assert not noisy.problems
    (video,) = noisy.videos
    assert len(video.frames) == 3
    for moment in (1, 2, 3):
        name = f"scene-1-moment-{moment}"
        clean = oracle.reference(tmp_path / "set/moving" / name / "clean.dng")
        save_prediction(tmp_path / "preds", f"{name}/noisy.dng", clean.astype(np.float32))
    perfect = evaluate(tmp_path / "preds", **given)
    assert perfect.videos[0].task < 0.01 < 0.1 < video.task < math.hypot(1, 3)
    with pytest.raises(ArgumentError, match="protocol 'raw' scores single images of 'moving'"):
        evaluate(tmp_path / "preds", protocol="raw", **given)
    alone = example.photograph(tmp_path / "alone", scenes=1, moments=1, size=(128, 192))
    with pytest.raises(ArgumentError, match="x100: protocol 'sequences' scores 1 frame of it, and the task"):
        evaluate(None, baseline="input", **given | {"manifest": alone, "root": tmp_path / "alone"})


def test_the_example_runs_a_network_of_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network whose depth is the mean of R, G and B."""
    pytest.importorskip("onnxruntime")
    (tmp_path / "mean.onnx").write_bytes(onnx_network("Conv", np.full((1, 3, 1, 1), 1 / 3)))
    monkeypatch.setenv("DEPTH_MODEL", str(tmp_path / "mean.onnx"))
    monkeypatch.delitem(sys.modules, "eldata.examples.estimate_depth", raising=False)
    make_tree(tmp_path, scenes=1, size=(64, 96))
    found = on_the_demo(tmp_path, "eldata.examples.estimate_depth:depth")
    digest = hashlib.sha256((tmp_path / "mean.onnx").read_bytes()).hexdigest()
    assert found.provenance["task"]["version"] == f"mean.onnx sha256:{digest}"
    seen: list[float] = []

    def rewritten(prediction: NDArray[Any], reference: NDArray[Any]) -> float:
        first, second = (image.astype(float).sum(axis=0) / 3 for image in (prediction, reference))
        seen.append(math.sqrt(((first - second) ** 2).mean()) / (second.max() - second.min()))
        return seen[-1]

    on_the_demo(tmp_path, Task(rewritten, images="srgb"))
    assert [image.task for image in found.images] == pytest.approx(seen, rel=1e-5)
    (tmp_path / "mean.onnx").write_bytes(onnx_network())
    sys.modules["eldata.examples.estimate_depth"]._session.cache_clear()
    (problem, *_) = on_the_demo(tmp_path, "eldata.examples.estimate_depth:depth").problems
    assert "gives (1, 3, 32, 48); expected one map of (32, 48)" in problem.reason


def test_the_example_matches_features_of_the_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_tree(tmp_path, scenes=1, size=(192, 288))
    found = on_the_demo(tmp_path, "eldata.examples.match_features:matches")
    assert not found.problems
    of = {row.ratio: row.task for row in found.table}
    assert 1 > of[100.0] > of[200.0] > 0  # more noise, fewer matches
    share = sys.modules["eldata.examples.match_features"].matched_share
    picture = np.random.default_rng(0).random((3, 12, 16)).repeat(8, axis=1).repeat(8, axis=2).astype(np.float32)
    assert share(picture, picture) == 1
    assert share(np.roll(picture, 16, axis=2), picture) < 0.1  # found, but elsewhere
    assert share(np.zeros_like(picture), picture) == 0
    with pytest.raises(ValueError, match="the reference has no keypoints"):
        share(picture, np.zeros_like(picture))


def test_the_example_hands_renderings_to_torchmetrics_lpips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    make_tree(tmp_path, scenes=1, size=(64, 96))
    found = on_the_demo(tmp_path, "eldata.examples.perceptual_distance:lpips")
    assert not found.problems
    assert made == [("alex", True)]  # once, and of images in [0, 1]
    assert len(seen) == 2 * len(found.images)
    for image, first, second in zip(found.images, seen[::2], seen[1::2], strict=True):
        for pixels in (first, second):
            assert pixels.shape == (1, 3, 32, 48)
            codes = 255 * pixels.astype(np.float64)
            np.testing.assert_allclose(codes, np.round(codes), atol=1e-4)
            assert (pixels.min() >= 0, pixels.max() <= 1) == (True, True)
        assert image.task == pytest.approx(np.abs(first - second).mean(), rel=1e-5)
    (metric,) = (metric for metric in found.kind.metrics if metric.name == "task")
    assert (metric.label, metric.better) == ("LPIPS", "lower")
    assert found.provenance["task"]["version"].startswith("torchmetrics ")


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "eldata.examples.score_model", "none", "preds"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "there is no such folder" in done.stderr
    assert list(tmp_path.iterdir()) == []
