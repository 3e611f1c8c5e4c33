"""The images and weights of lpips.json, which numpy alone makes again anywhere, from the raw bits of PCG64."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tests.metrics.golden.st_rred_clips import blur, uniform

if TYPE_CHECKING:
    from collections.abc import Callable

Image = npt.NDArray[np.float64]
State = dict[str, npt.NDArray[np.float32]]

KERNELS = {
    "features.0": (64, 3, 11, 11),
    "features.3": (192, 64, 5, 5),
    "features.6": (384, 192, 3, 3),
    "features.8": (256, 384, 3, 3),
    "features.10": (256, 256, 3, 3),
}


def backbone_state() -> State:
    """Weights of AlexNet's convolutions under torchvision's names: uniform, of He's variance, so that none dies."""
    state: State = {}
    for seed, (name, shape) in enumerate(KERNELS.items(), start=100):
        limit = math.sqrt(6.0 / math.prod(shape[1:]))
        state[f"{name}.weight"] = (limit * (2.0 * uniform(seed, *shape) - 1.0)).astype(np.float32)
        state[f"{name}.bias"] = (0.2 * uniform(seed + 100, shape[0]) - 0.1).astype(np.float32)
    return state


def linear_state() -> State:
    """Weights of the linear layers under the names of the package lpips; not negative, as the published ones."""
    return {
        f"lin{index}.model.1.weight": uniform(300 + index, 1, shape[0], 1, 1).astype(np.float32)
        for index, shape in enumerate(KERNELS.values())
    }


def texture(height: int, width: int, seed: int = 0) -> Image:
    """Coloured blocks of two sizes and fine grain, (3, h, w) in [0, 1]."""
    coarse, fine = (
        np.kron(uniform(seed + scale, 3, -(-height // scale), -(-width // scale)), np.ones((1, scale, scale)))[
            :, :height, :width
        ]
        for scale in (16, 4)
    )
    return 0.5 * coarse + 0.3 * fine + 0.2 * uniform(seed + 1, 3, height, width)


def noisy(image: Image, sigma: float, seed: int = 50) -> Image:
    return np.clip(image + sigma * math.sqrt(12.0) * (uniform(seed, *image.shape) - 0.5), 0.0, 1.0)


@dataclass(frozen=True)
class Case:
    """A prediction and its reference, float64; scored as float32."""

    name: str
    make: Callable[[], tuple[Image, Image]]


def _pair(height: int, width: int, change: Callable[[Image], Image]) -> tuple[Image, Image]:
    reference = texture(height, width)
    return change(reference), reference


CASES = [
    Case("noise", lambda: _pair(64, 48, lambda image: noisy(image, 0.1))),
    Case("little-noise", lambda: _pair(64, 48, lambda image: noisy(image, 0.005))),
    Case("blur", lambda: _pair(63, 101, lambda image: blur(image, 2))),
    Case("smallest", lambda: _pair(31, 31, lambda image: noisy(image, 0.1))),
    Case("odd", lambda: _pair(34, 75, lambda image: image**1.2)),
    Case("swapped-colours", lambda: _pair(48, 64, lambda image: image[::-1])),
    Case("black-and-white", lambda: (np.zeros((3, 40, 40)), np.ones((3, 40, 40)))),
]
