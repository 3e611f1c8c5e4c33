"""The example of a task (``eldata.examples``): LPIPS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.demo.tree import make_tree
from eldata.evaluation import evaluate

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation import EvaluationResult


def on_the_demo(folder: Path, task: str) -> EvaluationResult:
    """Evaluate the noisy input of the set that the demo made in a folder."""
    manifest, root = folder / "manifests" / "eld-demo.csv", folder / "data"
    return evaluate(None, manifest=manifest, root=root, baseline="input", cameras=["DemoAlpha"], task=task)


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
