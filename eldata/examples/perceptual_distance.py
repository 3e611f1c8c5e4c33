"""LPIPS as a task: the learned perceptual distance of torchmetrics, between renderings in sRGB.

    eldata evaluate preds --dataset sid-sony --protocol sid2018 --task eldata.examples.perceptual_distance:lpips

R. Zhang, P. Isola, A. A. Efros, E. Shechtman and O. Wang, "The Unreasonable Effectiveness of Deep Features as a
Perceptual Metric", CVPR 2018. Needs torchmetrics[image]; torchvision downloads AlexNet's weights as it is first called.
"""

from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torchmetrics.image import lpip

from eldata.evaluation import Task

Image = NDArray[np.float32]


@cache
def _load_network() -> Any:
    """Load LPIPS with AlexNet, for images in [0, 1]."""
    return lpip.LearnedPerceptualImagePatchSimilarity("alex", normalize=True)  # of images in [0, 1]


def perceptual_distance(prediction: Image, reference: Image) -> float:
    """Return LPIPS of two sRGB images (3, h, w) in [0, 1]: 0 for equal ones."""
    first, second = (torch.from_numpy(image)[None] for image in (prediction, reference))
    with torch.inference_mode():
        return float(_load_network()(first, second))


lpips = Task(
    perceptual_distance,
    images="srgb",
    higher_is_better=False,
    label="LPIPS",
    version=f"torchmetrics {version('torchmetrics')}, AlexNet",
)
