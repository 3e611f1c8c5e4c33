from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from eldata.metrics import psnr, rescale, rescale_factor

Image = npt.NDArray[np.floating[Any]]


def elds_factor(p: Image, g: Image) -> float:
    """Write the definition out with exactly rounded sums."""
    use = g.ravel() != 1.0
    p64 = np.clip(p.ravel()[use].astype(np.float64), 0, 1)
    g64 = g.ravel()[use].astype(np.float64)
    return math.fsum(p64 * g64) / math.fsum(p64 * p64)


def saturated_pair(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> tuple[Image, Image]:
    rng = np.random.default_rng(5)
    g = np.clip(rng.gamma(1.0, 0.4, shape), 0, 1).astype(dtype)
    p = (0.9 * g + rng.normal(0, 0.1, shape)).astype(dtype)
    assert (g == 1).mean() > 0.03
    assert p.min() < 0
    assert p.max() > 1
    return p, g


@pytest.mark.parametrize("shape", [(40, 50), (4, 33, 57), (2, 700, 513)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_factor_is_elds(shape: tuple[int, ...], dtype: npt.DTypeLike) -> None:
    p, g = saturated_pair(shape, dtype)
    assert rescale_factor(p, g) == pytest.approx(elds_factor(p, g), rel=1e-13)


def test_saturated_entries_are_left_out() -> None:
    g = np.full((10, 10), 0.25)
    p = np.full((10, 10), 0.5)
    g[0], p[0] = 1.0, 0.9
    g[1, 0] = np.nextafter(1.0, 0.0)  # just below: counts
    p[1, 0] = 0.0
    assert rescale_factor(p, g) == 0.5
    p[0, 0] = np.nan  # left out as well
    assert rescale_factor(p, g) == 0.5
    g[2, 0] = 1.5  # above, as where references are not clipped: counts
    assert rescale_factor(p, g) == pytest.approx(elds_factor(p, g), rel=1e-13) != 0.5


@pytest.mark.parametrize("dark", [0.0, -0.5])
def test_dark_prediction(dark: float) -> None:
    p, g = np.full((2, 9, 9), dark), np.full((2, 9, 9), 0.5)
    assert rescale_factor(p, g) == 1.0
    np.testing.assert_array_equal(rescale(p, g), np.zeros_like(p))


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.dtype(">f4")])
def test_rescale_numpy(dtype: npt.DTypeLike) -> None:
    p, g = saturated_pair((3, 30, 40), dtype)
    before = p.copy()
    result = rescale(p, g)
    assert isinstance(result, np.ndarray)
    assert result.dtype == np.dtype(dtype)
    expected = np.clip(rescale_factor(p, g) * np.clip(p.astype(np.float64), 0, 1), 0, 1).astype(dtype)
    np.testing.assert_array_equal(result, expected)
    np.testing.assert_array_equal(p, before)
    assert not np.shares_memory(result, p)
    assert psnr(result, g) > psnr(np.clip(p, 0, 1), g)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_rescale_torch(dtype: torch.dtype) -> None:
    p, g = (torch.from_numpy(image).to(dtype) for image in saturated_pair((3, 30, 40)))
    p = p.transpose(1, 2).contiguous().transpose(1, 2).requires_grad_()
    result = rescale(p, g)
    assert isinstance(result, torch.Tensor)
    assert (result.dtype, result.shape, result.device) == (p.dtype, p.shape, p.device)
    assert not result.requires_grad
    numpy_result = rescale(p.detach().double().numpy(), g.double().numpy())
    torch.testing.assert_close(result.double(), torch.from_numpy(numpy_result).to(dtype).double())
