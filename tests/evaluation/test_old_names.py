"""Names of version 0.1 work until 0.3, with a warning that says what took their place."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

import numpy as np
import pytest

import eldata.evaluation
import eldata.metrics
from eldata.datasets.drv import DRVDataset
from eldata.evaluation import evaluate, evaluate_video, save_clip_prediction
from tests.drv_tree import small_drv

if TYPE_CHECKING:
    from pathlib import Path


def test_evaluate_video(tmp_path: Path) -> None:
    drv = small_drv(tmp_path / "drv", ("0007",), 12)
    for record in DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records:
        save_clip_prediction(tmp_path / "preds", record, np.full((5, 3, 48, 56), 0.5, np.float32))
    with pytest.warns(
        DeprecationWarning, match=r"eldata.evaluate scores clips too; evaluate_video will be removed in version 0\.3"
    ):
        found = evaluate_video(tmp_path / "preds", manifest=drv.csv, root=drv.root, ids=["0007"])
    assert found == evaluate(tmp_path / "preds", manifest=drv.csv, root=drv.root, ids=["0007"])
    assert [window.scene for window in found.windows] == [video.scene for video in found.videos] == ["0007"]


def test_records() -> None:
    for old, new in (("ImageScore", "UnitScore"), ("VideoScore", "UnitScore"), ("VideoResult", "EvaluationResult")):
        with pytest.warns(DeprecationWarning, match=rf"eldata\.evaluation\.{old} is .*{new} now; .* version 0\.3"):
            assert getattr(eldata.evaluation, old) is getattr(eldata.evaluation, new)
    with pytest.raises(AttributeError, match="SavedResult"):
        getattr(eldata.evaluation, "Saved" + "Result")


@pytest.mark.skipif(importlib.util.find_spec("torchmetrics") is None, reason="needs eldata[torchmetrics]")
def test_modules_of_torchmetrics() -> None:
    from eldata.integrations import torchmetrics

    for name in ("PSNR", "SSIM", "ProtocolScore"):
        with pytest.warns(DeprecationWarning, match=rf"eldata\.metrics\.{name} is eldata\.integrations\.torchmetrics"):
            assert getattr(eldata.metrics, name) is getattr(torchmetrics, name)
