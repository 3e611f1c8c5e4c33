from __future__ import annotations

import math
import subprocess
import sys
import tracemalloc
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata.errors import ArgumentError
from eldata.metrics import Score, score
from tests.cases import in_one_test

Image = npt.NDArray[np.floating[Any]]
Rescaling = Literal["none", "scalar"]


def eld_protocol(p: Image, g: Image, rescaling: Rescaling) -> tuple[float, float, float]:
    """ELD's evaluation, step by step on whole float64 images, with scikit-image's metrics."""
    p64, g64 = np.clip(p.astype(np.float64), 0, 1), g.astype(np.float64)
    factor = 1.0
    if rescaling == "scalar":
        use = g64 != 1
        factor = float((p64[use] * g64[use]).sum() / (p64[use] ** 2).sum())
    p64 = np.clip(p64 * factor, 0, 1)
    return (
        float(peak_signal_noise_ratio(g64, p64, data_range=1)),  # type: ignore[no-untyped-call]
        float(structural_similarity(g64, p64, data_range=1, channel_axis=0)),  # type: ignore[no-untyped-call]
        factor,
    )


def noisy_pair(shape: tuple[int, ...], dtype: npt.DTypeLike, gain: float = 0.8) -> tuple[Image, Image]:
    rng = np.random.default_rng(7)
    ramp = np.linspace(0, 1.2, shape[-1]) * np.linspace(0.2, 1, shape[-2])[:, None]
    g = np.clip(ramp + 0.05 * rng.random(shape), 0, 1).astype(dtype)
    p = (gain * g + rng.normal(0, 0.05, shape)).astype(dtype)
    return p, g


@in_one_test("shape", [(1, 7, 7), (4, 33, 57), (2, 530, 519), (3, 263, 8)])
@in_one_test("dtype", [np.float32, np.float64])
@in_one_test("rescaling", ["none", "scalar"])
@in_one_test("gain", [0.8, 1.3])
def test_equals_the_protocol(shape: tuple[int, ...], dtype: npt.DTypeLike, rescaling: Rescaling, gain: float) -> None:
    p, g = noisy_pair(shape, dtype, gain)
    result = score(p, g, rescaling=rescaling)
    psnr_db, similarity, factor = eld_protocol(p, g, rescaling)
    assert result.psnr_db == pytest.approx(psnr_db, abs=1e-9)
    assert result.ssim == pytest.approx(similarity, abs=1e-11)
    assert result.rescale == pytest.approx(factor, rel=1e-12)
    tensors = score(torch.from_numpy(p).requires_grad_(), torch.from_numpy(g), rescaling=rescaling)
    assert tensors == result


def test_identical() -> None:
    _, g = noisy_pair((4, 60, 50), np.float32)
    assert score(g, g, rescaling="scalar") == Score(psnr_db=math.inf, ssim=1.0, rescale=1.0)


def test_dark_prediction_scores_alike() -> None:
    _, g = noisy_pair((2, 40, 40), np.float32)
    dark = np.full_like(g, -0.25)
    assert score(dark, g, rescaling="scalar") == score(dark, g, rescaling="none")
    assert score(dark, g, rescaling="none").psnr_db == pytest.approx(
        -10 * math.log10((g.astype(np.float64) ** 2).mean()), abs=1e-9
    )


def test_saturated_reference() -> None:
    g = np.ones((2, 20, 20), np.float32)
    p = np.full_like(g, 0.75)
    result = score(p, g, rescaling="scalar")
    assert result.rescale == 1.0
    assert result.psnr_db == pytest.approx(20 * math.log10(4), abs=1e-12)
    assert result.ssim == pytest.approx((1.5 + 1e-4) / (1.5625 + 1e-4), abs=1e-12)


def test_refusals() -> None:
    image = np.zeros((9, 9), np.float32)
    with pytest.raises(ArgumentError, match="rescaling must be one of 'none', 'scalar'; found 'affine'"):
        score(image, image, rescaling="affine")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="at least 7 x 7"):
        score(image[:6], image[:6], rescaling="none")


@pytest.mark.memory
@pytest.mark.parametrize("contiguous", [True, False])
def test_memory_of_a_full_frame(contiguous: bool) -> None:
    shape = (4, 1416, 2120)
    p = np.full(shape, 0.25, np.float32)
    g = np.full(shape if contiguous else (*shape[1:], 4), 0.5, np.float32)
    g = g if contiguous else g.transpose(2, 0, 1)
    score(p[:, :9, :9], g[:, :9, :9], rescaling="scalar")  # compiles
    tracemalloc.start()
    score(p, g, rescaling="scalar", threads=4)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < (1e6 if contiguous else 20e6)  # one image is 48 MB


PEAK = """
import resource, numpy as np
from eldata.metrics import score
shape = (4, 1416, 2120)
p, g = np.full(shape, 0.25, np.float32), np.full(shape, 0.5, np.float32)
score(p[:, :9, :9], g[:, :9, :9], rescaling="scalar")
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
score(p, g, rescaling="scalar", threads=4)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.memory
def test_peak_of_a_process() -> None:
    """What the kernels allocate themselves does not show in tracemalloc."""
    child = subprocess.run([sys.executable, "-c", PEAK], capture_output=True, text=True, check=True)
    assert int(child.stdout) < 20_000  # kB


def test_torch_is_not_imported_for_numpy() -> None:
    code = (
        "import sys, numpy as np; from eldata.metrics import psnr; psnr(np.zeros((9, 9)), np.ones((9, 9)));"
        "print('torch' in sys.modules)"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert child.stdout.strip() == "False"
