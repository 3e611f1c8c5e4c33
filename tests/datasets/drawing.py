"""A data set for worker processes, in a module that imports as little as they need: each of them imports it."""

from __future__ import annotations

import random

import numpy as np
import torch
from torch.utils.data import Dataset


class Drawing(Dataset[tuple[float, ...]]):
    """Draws from every global generator, as transforms of other people do."""

    def __len__(self) -> int:
        return 8

    def __getitem__(self, index: int) -> tuple[float, ...]:
        return torch.rand(()).item(), random.random(), np.random.random()  # noqa: S311, NPY002 # as they do
