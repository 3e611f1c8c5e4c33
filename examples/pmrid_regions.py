"""Score predictions of PMRID as its benchmark does: PSNR and SSIM of regions of renderings in sRGB, their means.

    pip install opencv-python-headless scikit-image
    python examples/pmrid_regions.py PREDS data                # data/PMRID has the set, and its benchmark.json

The regions, white balance and matrix of each pair stand in ``benchmark.json``, in the download. Predictions are those
that ``eldata evaluate`` takes, made of inputs that nothing amplifies. Steps of the PMRID repository
(MegEngine/PMRID, commit 8ebb9e8, run_benchmark.py, utils.py): white balance, clip, whole numbers of 16 bits, OpenCV's
edge-aware demosaicing of the mosaic turned to RGGB, matrix, clip, gamma 2.2. Its SSIM is scikit-image's of floating
point numbers before version 0.20, which took their range to be 2.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import cv2  # type: ignore[import-not-found] # only who runs this needs it
import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata.errors import DatasetError, EldataError
from eldata.evaluation import scored_pairs
from eldata.manifest import shipped_manifest
from eldata.protocols import get_protocol
from eldata.raw import bayer_cfa, unpack

if TYPE_CHECKING:
    from numpy.typing import NDArray

psnr_of: Any = peak_signal_noise_ratio  # scikit-image has annotations in part only
ssim_of: Any = structural_similarity


def demosaic(packed: NDArray[Any], meta: dict[str, Any]) -> NDArray[np.uint16]:
    """Balance and demosaic a packed frame, (4, h, w) in [0, 1], of BGGR: linear colours, (H, W, 3) of 16 bits."""
    gains = np.array(meta["wb_gain"])[[0, 1, 2, 1], None, None]
    mosaic = unpack((packed[:, ::-1, ::-1] * gains).clip(0, 1), bayer_cfa("RGGB")).astype(np.float32)
    codes = np.round(mosaic * 65535).astype(np.uint16)
    colours: NDArray[np.uint16] = cv2.cvtColor(codes, cv2.COLOR_BAYER_BG2RGB_EA)
    return colours[::-1, ::-1]


def render(colours: NDArray[np.uint16], meta: dict[str, Any]) -> NDArray[np.float32]:
    """Render linear colours, (h, w, 3), in sRGB: of the same shape, in [0, 1]."""
    linear = colours.astype(np.float32) / 65535
    rendered: NDArray[np.float32] = (linear.dot(np.array(meta["CCM"]).T).clip(0, 1) ** (1 / 2.2)).astype(np.float32)
    return rendered


def score_regions(predictions: Path | str, root: Path | str) -> NDArray[np.float64]:
    """Return PSNR in dB and SSIM of each region, (regions, 2), of all pairs below a data root.

    Raises
    ------
    EldataError
        If a prediction is missing, a file cannot be used, or the regions of a pair are not known.
    """
    file = shipped_manifest("pmrid").folder(root) / "benchmark.json"
    try:
        listed = {str(PurePosixPath(one["input"])): one["meta"] for one in json.loads(file.read_bytes())}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise DatasetError(f"{file}: expected the set's list of pairs with their regions, found {error!r}") from error
    scores = []
    as_it_is = replace(get_protocol("raw"), rescaling="none", prediction_clamp="none")
    for prediction, reference, record in scored_pairs(predictions, "pmrid", root=root, protocol=as_it_is):
        if (meta := listed.get(record.path)) is None:
            raise DatasetError(f"{file}: expected the regions of {record.path}, found none; take the whole set")
        images = demosaic(reference, meta), demosaic(prediction, meta)
        for x0, y0, x1, y1 in meta["ROIs"]:
            patches = [render(image[y0:y1, x0:x1], meta) for image in images]
            scores.append((psnr_of(*patches, data_range=1), ssim_of(*patches, channel_axis=2, data_range=2)))
    return np.array(scores)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    try:
        measured = score_regions(*sys.argv[1:])
    except EldataError as problem:
        sys.exit(str(problem))
    print("{} regions: PSNR {:.2f} dB, SSIM {:.4f}".format(len(measured), *measured.mean(axis=0)))
