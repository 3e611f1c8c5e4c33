"""PMRID's regions in sRGB: examples/pmrid_regions.py against a rewrite of run_benchmark.py and utils.py.

OpenCV's demosaicing, which both call, is replaced by one that needs no OpenCV, unless that is installed.
"""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata.errors import DatasetError
from eldata.evaluation import save_prediction
from eldata.manifest.catalogue import shipped_manifest
from tests.pattern_trees import build_pmrid_tree

WB, CCM = (1.9, 1.0, 1.7), ((1.5, -0.4, -0.1), (-0.2, 1.4, -0.2), (0.0, -0.5, 1.5))
ROIS = [[[100, 60, 260, 200], [2001, 1501, 2101, 1581]], [[3900, 2900, 4000, 3000]]]
CASES = [f"Scene1/Dark/exposure-case{number}" for number in (1, 2)]
psnr_of: Any = peak_signal_noise_ratio  # scikit-image has annotations in part only
ssim_of: Any = structural_similarity


def demosaic(codes: Any, code: Any) -> Any:
    """An RGGB mosaic's colours, each from the block that it lies in, the greens by the order of rows."""
    assert (code, codes.dtype, codes.ndim) == (sys.modules["cv2"].COLOR_BAYER_BG2RGB_EA, np.uint16, 2)
    planes = codes[0::2, 0::2], codes[0::2, 1::2] // 4 * 3 + codes[1::2, 0::2] // 4, codes[1::2, 1::2]
    return np.stack([plane.repeat(2, 0).repeat(2, 1) for plane in planes], axis=-1)


def render_as_published(bggr: Any) -> Any:
    """utils.py's bggr2rggb, bayer2rgb and back, of a mosaic (H, W) in [0, 1]."""
    bayer = bggr[::-1, ::-1]
    height, width = bayer.shape
    rggb = bayer.reshape(height // 2, 2, width // 2, 2).transpose(0, 2, 1, 3).reshape(height // 2, width // 2, 4)
    rggb = (rggb * np.array(WB)[[0, 1, 1, 2]]).clip(0, 1)
    bayer = rggb.reshape(height // 2, width // 2, 2, 2).transpose(0, 2, 1, 3).reshape(height, width).astype(np.float32)
    codes = np.round(np.ascontiguousarray(bayer) * 65535).clip(0, 65535).astype(np.uint16)
    cv2: Any = sys.modules["cv2"]
    rgb = cv2.cvtColor(codes, cv2.COLOR_BAYER_BG2RGB_EA).astype(np.float32) / 65535
    rgb = rgb.dot(np.array(CCM).T).clip(0, 1) ** (1 / 2.2)
    return rgb.astype(np.float32)[::-1, ::-1]


def test_regions_are_scored_as_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "cv2" not in sys.modules:
        stand_in: Any = ModuleType("cv2")
        stand_in.COLOR_BAYER_BG2RGB_EA, stand_in.cvtColor = object(), demosaic
        monkeypatch.setitem(sys.modules, "cv2", stand_in)
    score_regions = runpy.run_path(str(Path(__file__).parents[2] / "examples/pmrid_regions.py"))["score_regions"]
    folder = tmp_path / "data/PMRID"
    build_pmrid_tree(shipped_manifest("pmrid"), folder)
    expected = []
    for case, rois in zip(CASES, ROIS, strict=True):
        gt = np.fromfile(folder / case / "gt.raw", np.uint16).reshape(3000, 4000).astype(np.float32) / 65535
        noise = np.random.default_rng(len(rois)).normal(0, 0.02, gt.shape)
        predicted = (gt + noise).astype(np.float32)
        save_prediction(tmp_path / "preds", f"{case}/input.raw", predicted)
        truth, shown = render_as_published(gt), render_as_published(predicted)
        for x0, y0, x1, y1 in rois:
            patches = truth[y0:y1, x0:x1], shown[y0:y1, x0:x1]
            psnr = psnr_of(*patches, data_range=1)
            expected.append((psnr, ssim_of(*patches, channel_axis=2, data_range=2)))
    entries = [
        {"input": f"{case}/input.raw", "gt": f"{case}/gt.raw", "meta": {"wb_gain": WB, "CCM": CCM, "ROIs": rois}}
        for case, rois in zip(CASES, ROIS, strict=True)
    ]
    (folder / "benchmark.json").write_text(json.dumps(entries[:1]))
    with pytest.raises(DatasetError, match=r"benchmark.json: expected the regions of .*case2/input.raw, found none"):
        score_regions(tmp_path / "preds", tmp_path / "data")
    (folder / "benchmark.json").write_text(json.dumps(entries))
    assert np.abs(score_regions(tmp_path / "preds", tmp_path / "data") - np.array(expected)).max() < 1e-6
