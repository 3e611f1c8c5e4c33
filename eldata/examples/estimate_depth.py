"""Depth as a task: how far what a network sees in a denoised frame is from what it sees in the reference.

    DEPTH_MODEL=midas.onnx eldata evaluate preds --dataset eld --task eldata.examples.estimate_depth:depth

The root mean square error of the paper's section 4.7 (K. Wei et al., TPAMI 2021), by any ONNX file that makes one map
of a picture, (1, 3, h, w) R, G, B in [0, 1], as the files of MiDaS do. Needs onnxruntime and scikit-image.
"""

import hashlib
import math
import os
from functools import cache
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from skimage.transform import resize

from eldata.evaluation import Task

Image = NDArray[np.float32]

MODEL = Path(os.environ.get("DEPTH_MODEL", "depth.onnx"))  # worker processes have it from here, too


@cache
def _session() -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # --jobs has the processors
    return onnxruntime.InferenceSession(str(MODEL), options, providers=["CPUExecutionProvider"])


def depth_of(image: Image) -> NDArray[np.float64]:
    """Return the map of an sRGB image (3, h, w) in [0, 1]; its size is the model's, or the image's if any will do."""
    (given,) = _session().get_inputs()
    size = tuple(
        stated if isinstance(stated, int) else side
        for stated, side in zip(given.shape[2:], image.shape[1:], strict=True)
    )
    shown = resize(image, (3, *size), anti_aliasing=True)[None].astype(np.float32)  # type: ignore[no-untyped-call]
    found = np.asarray(_session().run(None, {given.name: shown})[0], np.float64)
    if found.size != math.prod(size):
        raise ValueError(f"{MODEL.name} gives {found.shape}; expected one map of {size}")
    return found.reshape(size)


def depth_error(prediction: Image, reference: Image) -> float:
    """Return the RMSE of the prediction's map, as a share of what the reference's spans: networks scale as they like.

    Parameters
    ----------
    prediction, reference
        (3, h, w) sRGB in [0, 1].
    """
    expected = depth_of(reference)
    span = float(np.ptp(expected))
    if not span:
        raise ValueError(f"{MODEL.name} sees no depth in the reference")
    return float(np.sqrt(np.mean((depth_of(prediction) - expected) ** 2)) / span)


def __getattr__(name: str) -> Task:
    """Return the task ``depth``: the model's file has to be there only when it is asked for."""
    if name != "depth":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return Task(
        depth_error,
        images="srgb",
        higher_is_better=False,
        label="depth RMSE",
        version=f"{MODEL.name} sha256:{hashlib.sha256(MODEL.read_bytes()).hexdigest()}",
    )


if __name__ == "__main__":  # for evaluate: as a program it says what it is
    print(__doc__)
