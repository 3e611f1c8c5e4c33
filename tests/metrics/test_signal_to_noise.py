from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from skimage.metrics import peak_signal_noise_ratio

from eldata.metrics import psnr
from tests.cases import in_one_test


@in_one_test("shape", [(1, 1), (7, 7), (4, 33, 57), (2, 600, 259), (3, 5, 2000)])
@in_one_test("dtype", [np.float32, np.float64])
@in_one_test("data_range", [1.0, 255.0, 0.3])
def test_equals_scikit_image(shape: tuple[int, ...], dtype: npt.DTypeLike, data_range: float) -> None:
    rng = np.random.default_rng(1)
    g = (data_range * rng.random(shape)).astype(dtype)
    p = (g + data_range * rng.normal(0.01, 0.2, shape)).astype(dtype)
    expected = peak_signal_noise_ratio(  # type: ignore[no-untyped-call]
        g.astype(np.float64), p.astype(np.float64), data_range=data_range
    )
    assert psnr(p, g, data_range=data_range) == pytest.approx(expected, abs=1e-9)


def test_known_values() -> None:
    g = np.full((3, 8, 8), 0.5)
    assert psnr(g + 0.125, g) == pytest.approx(20 * math.log10(8), abs=1e-12)
    assert psnr(g, g) == math.inf
    assert psnr(g + 1e-12, g) < 241
    assert psnr(g + 1.5, g) == pytest.approx(-20 * math.log10(1.5), abs=1e-12)  # nothing is clipped
    assert psnr(g + np.inf, g) == -math.inf
