"""SSIM with every window and either covariance, against scikit-image and scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import correlate1d
from skimage.metrics import structural_similarity

from eldata.errors import ArgumentError
from eldata.metrics import _images, ssim

Image = npt.NDArray[np.float64]


def oracle(
    p: npt.ArrayLike, g: npt.ArrayLike, data_range: float = 1.0, *, gaussian: bool = False, covariance: str = "sample"
) -> float:
    p64, g64 = np.asarray(p, np.float64), np.asarray(g, np.float64)
    windows: dict[str, Any] = {"gaussian_weights": True, "sigma": 1.5} if gaussian else {}
    axis = 0 if p64.ndim == 3 else None
    shared = {"data_range": data_range, "channel_axis": axis, "use_sample_covariance": covariance == "sample"}
    return float(structural_similarity(g64, p64, **shared, **windows))  # type: ignore[no-untyped-call]


def direct(p: Image, g: Image) -> float:
    """Two-pass statistics of each window of a (h, w) image, without any sliding sum."""
    x = np.lib.stride_tricks.sliding_window_view(p, (7, 7)).reshape(-1, 49)
    y = np.lib.stride_tricks.sliding_window_view(g, (7, 7)).reshape(-1, 49)
    ux, uy = x.mean(1), y.mean(1)
    dx, dy = x - ux[:, None], y - uy[:, None]
    vx, vy, vxy = ((a * b).sum(1) / 48 for a, b in ((dx, dx), (dy, dy), (dx, dy)))
    c1, c2 = 0.01**2, 0.03**2
    index = (2 * ux * uy + c1) * (2 * vxy + c2) / ((ux**2 + uy**2 + c1) * (vx + vy + c2))
    return float(index.mean())


def images(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float64) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    rng = np.random.default_rng(2)
    g = rng.random(shape).astype(dtype)
    return (0.7 * g + rng.normal(0.1, 0.1, shape)).astype(dtype), g


# By the window: sizes on either side of one band of rows and one strip of columns, 262 x 262 or 266 x 266 values. Odd
# and even heights: Gaussian windows are taken two at a time.
SHAPES = {
    "uniform-7": [
        *((7, 7), (1, 7, 7), (3, 7, 40), (3, 40, 7), (2, 8, 13), (4, 33, 57), (262, 262), (263, 263)),
        *((2, 530, 519), (3, 9, 2000), (1, 1300, 11)),
    ],
    "gaussian-11": [(11, 11), (1, 12, 40), (3, 40, 11), (2, 266, 266), (2, 267, 267), (1, 541, 530), (4, 33, 57)],
}


@pytest.mark.parametrize(("window", "shape"), [(window, shape) for window in SHAPES for shape in SHAPES[window]])
@pytest.mark.parametrize("covariance", ["population", "sample"])
def test_equals_scikit_image(window: Any, shape: tuple[int, ...], covariance: Any) -> None:
    for dtype in (np.float32, np.float64):
        p, g = images(shape, dtype)
        expected = oracle(p, g, gaussian=window == "gaussian-11", covariance=covariance)
        assert ssim(p, g, window=window, covariance=covariance) == pytest.approx(expected, abs=1e-12)
        assert ssim(g, g, window=window, covariance=covariance) == 1.0
    if window == "uniform-7" and covariance == "sample":
        assert ssim(p, g) == ssim(p, g, window=window, covariance=covariance)


def hard_cases() -> dict[str, tuple[Image, Image]]:
    rng = np.random.default_rng(4)
    shape = (600, 300)
    step = np.where(np.arange(600)[:, None] < 150, 1.0, 1e-4) * np.ones(shape)  # bright, then dark rows
    spikes = np.full(shape, 1e-3)
    spikes[::50, ::50] = 1.0
    flat = np.full(shape, 0.5)
    faint = rng.normal(0, 1, shape)
    return {
        "flat": (flat + 2e-4 * faint, flat + 2e-4 * rng.normal(0, 1, shape)),
        "flat, same noise": (flat + 2e-4 * faint, flat + 1e-4 * faint),
        "flat at 1": (np.ones(shape) - 1e-6 * abs(faint), np.ones(shape)),
        "bright and dark": (step * (1 + 1e-3 * faint), step),
        "spikes": (spikes + 1e-5 * faint, spikes),
        "anticorrelated": (flat + 0.1 * faint, flat - 0.1 * faint),
    }


@pytest.mark.parametrize("name", hard_cases())
def test_cancellation_and_drift(name: str) -> None:
    """The sums slide over 262 rows; compare with statistics computed window by window about their mean."""
    p, g = hard_cases()[name]
    assert ssim(p, g) == pytest.approx(direct(p, g), abs=2e-12)


# --- Gaussian windows -----------------------------------------------------------------------------------------------


def in_volume(p: Image, g: Image) -> float:
    """What MATLAB's ssim does with colour: a Gaussian over all three axes, edges replicated, mean of the whole map."""
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()

    def smooth(values: Image) -> Image:
        for axis in range(3):
            values = correlate1d(values, taps, axis=axis, mode="nearest")
        return values

    ux, uy = smooth(p), smooth(g)
    vx, vy, vxy = smooth(p * p) - ux**2, smooth(g * g) - uy**2, smooth(p * g) - ux * uy
    c1, c2 = 0.01**2, 0.03**2
    return float(np.mean((2 * ux * uy + c1) * (2 * vxy + c2) / ((ux**2 + uy**2 + c1) * (vx + vy + c2))))


@pytest.mark.parametrize("shape", [(3, 11, 12), (3, 256, 266), (3, 257, 267), (3, 600, 40), (1, 40, 50), (4, 40, 50)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_volume_equals_scipy(shape: tuple[int, ...], dtype: npt.DTypeLike) -> None:
    p, g = images(shape, dtype)
    found = ssim(p, g, window="gaussian-11-volume", covariance="population")
    assert found == pytest.approx(in_volume(p.astype(np.float64), g.astype(np.float64)), abs=1e-12)
    assert abs(found - ssim(p, g, window="gaussian-11", covariance="population")) > 1e-4


@pytest.mark.parametrize("window", ["gaussian-11", "gaussian-11-volume"])
def test_cancellation_in_gaussian_windows(window: Any) -> None:
    """Bright, nearly flat images: the variance is a small difference of large sums."""
    rng = np.random.default_rng(6)
    g = 1.0 - 1e-6 * rng.random((3, 300, 150))
    p = g + 1e-6 * rng.normal(0, 1, g.shape)
    expected = in_volume(p, g) if window.endswith("volume") else oracle(p, g, gaussian=True, covariance="population")
    assert ssim(p, g, window=window, covariance="population") == pytest.approx(expected, abs=1e-11)


def test_threads_do_not_change_a_bit_of_a_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_images, "_LEAST_FOR_THREADS_WINDOWED", 0)
    p, g = images((3, 600, 150), np.float32)
    assert len({ssim(p, g, window="gaussian-11-volume", threads=threads) for threads in (1, 2, 3, None)}) == 1


def test_refusals() -> None:
    windows: dict[Any, int] = {"uniform-7": 7, "gaussian-11": 11, "gaussian-11-volume": 11}
    for window, side in windows.items():
        for shape in ((side - 1, side), (side, side - 1), (3, side - 1, 100), (3, 100, 1)):
            with pytest.raises(ArgumentError, match=f"at least {side} x {side}"):
                ssim(np.zeros(shape), np.zeros(shape), window=window)
    image = np.zeros((3, 10, 12))
    with pytest.raises(ArgumentError, match="window must be one of 'uniform-7'"):
        ssim(image, image, window="7x7")  # type: ignore[call-overload]
    with pytest.raises(ArgumentError, match="covariance must be one of 'sample'"):
        ssim(image, image, covariance="both")  # type: ignore[call-overload]
