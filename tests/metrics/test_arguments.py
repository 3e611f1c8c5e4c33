"""What every metric accepts and refuses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from eldata import metrics
from eldata.errors import ArgumentError
from eldata.metrics import _images

Metric = Callable[..., Any]

GAUSSIAN = pytest.param(partial(metrics.ssim, window="gaussian-11"), id="ssim, Gaussian")  # of arrays alone
METRICS = [
    pytest.param(metrics.psnr, id="psnr"),
    pytest.param(metrics.ssim, id="ssim"),
    GAUSSIAN,
    pytest.param(metrics.rescale_factor, id="rescale_factor"),
    pytest.param(lambda p, g, **k: metrics.score(p, g, rescaling="scalar", **k), id="score"),
]
OF_TENSORS = [metric for metric in METRICS if metric is not GAUSSIAN]
OF_CLIPS_TOO = [*OF_TENSORS, pytest.param(metrics.st_rred, id="st_rred")]


def agree(found: Any, expected: Any) -> bool:
    """To the bit, or where torch computed to 1e-12 of the number."""
    is_tensor = isinstance(found, torch.Tensor)
    return abs(float(found) - expected) <= 1e-12 * abs(expected) if is_tensor else bool(found == expected)


def images(*shape: int, seed: int = 0) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    rng = np.random.default_rng(seed)
    reference = rng.random(shape, np.float32)
    prediction = 0.8 * reference + rng.normal(0, 0.05, shape).astype(np.float32)
    return prediction, reference


@pytest.mark.parametrize("metric", OF_CLIPS_TOO)
@pytest.mark.parametrize("as_tensor", [False, True])
def test_layout_does_not_matter(metric: Metric, as_tensor: bool) -> None:
    p, g = images(3, 44, 50)
    expected = metric(p, g)
    wide = np.zeros((44, 100, 6), np.float32)  # HWC, every other column of every other channel
    wide[:, ::2, ::2] = p.transpose(1, 2, 0)
    strided = wide[:, ::2, ::2].transpose(2, 0, 1)
    swapped = g.transpose(0, 2, 1).copy().transpose(0, 2, 1)
    if as_tensor:
        # torch knows no negative strides
        strided_t, swapped_t = torch.from_numpy(strided), torch.from_numpy(swapped)
        assert not strided_t.is_contiguous()
        assert agree(metric(strided_t, swapped_t), expected)
        assert metric(p, swapped_t) == expected
    else:
        reverse = g[:, ::-1].copy()[:, ::-1]
        assert reverse.strides[1] < 0
        assert metric(strided, swapped) == expected
        assert metric(strided, reverse) == expected
        assert metric(p.astype(">f4"), g) == expected
        read_only = p.copy()
        read_only.flags.writeable = False
        assert metric(read_only, g) == expected
        shifted = np.frombuffer(b"\0" + p.tobytes(), np.uint8)[1:].view(np.float32).reshape(p.shape)
        assert not shifted.flags.aligned
        assert metric(shifted, g) == expected


@pytest.mark.parametrize("metric", OF_CLIPS_TOO)
def test_precisions_are_taken_exactly(metric: Metric) -> None:
    p, g = images(2, 42, 43)
    assert metric(p.astype(np.float64), g) == metric(p, g)
    assert metric(p, g.astype(np.float64)) == metric(p, g)
    half = p.astype(np.float16)
    assert metric(half, g) == metric(half.astype(np.float32), g)
    reference = torch.from_numpy(g)
    assert agree(metric(torch.from_numpy(half), reference), metric(half, g))
    brain = torch.from_numpy(p).bfloat16()
    assert metric(brain, reference) == metric(brain.float(), reference)
    assert not agree(metric(brain, reference), metric(p, g))


@pytest.mark.parametrize("metric", METRICS)
def test_plane_is_one_channel_and_stays_as_it_is(metric: Metric) -> None:
    p, g = images(1, 20, 21)
    assert metric(p[0], g[0]) == metric(p, g)
    for image, before in zip((p, g), images(1, 20, 21), strict=True):
        np.testing.assert_array_equal(image, before)
        assert image.flags.writeable


@pytest.mark.parametrize("metric", METRICS)
def test_a_reference_on_another_scale_is_refused(metric: Metric) -> None:
    """Images of 0 to 255 on data range 1 got -48 dB, or a factor of a prediction that was clamped to 1."""
    p, g = images(2, 42, 43)
    with pytest.raises(ArgumentError, match=r"the reference reaches 25[45].*, and data_range is 1: divide"):
        metric(255 * p, 255 * g)
    assert metric(p, 1.9 * g) is not None


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("shape", [(4, 611, 331), (3, 260, 257)])
def test_threads_do_not_change_a_bit(metric: Metric, shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    p, g = images(*shape)
    expected = metric(p, g)  # small images are done in this thread
    used = set()
    helped = threading.Event()
    blocks = _images.Pair.blocks

    def spy(pair: _images.Pair, band: _images.Band) -> tuple[_images.Block, _images.Block]:
        used.add(threading.current_thread().name)
        if threading.current_thread().name.startswith("eldata"):
            helped.set()
        else:
            helped.wait(10)  # or this thread may be done before another has begun
        return blocks(pair, band)

    monkeypatch.setattr(_images.Pair, "blocks", spy)
    monkeypatch.setattr(_images, "_LEAST_FOR_THREADS", 0)
    monkeypatch.setattr(_images, "_LEAST_FOR_THREADS_WINDOWED", 0)
    for threads in (2, 3, 4, 64, None):
        assert metric(p, g, threads=threads) == expected
    assert helped.is_set()
    used.clear()
    assert metric(p, g, threads=1) == expected
    assert used == {threading.current_thread().name}


@pytest.mark.parametrize("metric", [*METRICS, partial(metrics.ssim, window="gaussian-11-volume")])
def test_nan_gives_nan(metric: Metric) -> None:
    for at in (0, 1):
        pair = images(2, 30, 31)
        pair[at][1, 3, 4] = np.nan
        result = metric(*pair)
        numbers = [result.psnr_db, result.ssim] if isinstance(result, metrics.Score) else [result]
        assert np.isnan(numbers).all()


@pytest.mark.parametrize("metric", METRICS)
def test_refusals(metric: Metric) -> None:
    p, g = images(2, 30, 31)
    with pytest.raises(ArgumentError, match=r"\(2, 30, 31\) against \(2, 31, 30\)"):
        metric(p, g.reshape(2, 31, 30))
    with pytest.raises(ArgumentError, match=r"\(30, 31\) against \(1, 30, 31\)"):
        metric(p[0], g[:1])
    with pytest.raises(ArgumentError, match=r"batch of shape \(1, 2, 30, 31\).*loop"):
        metric(p[None], g[None])
    with pytest.raises(ArgumentError, match=r"batch of shape \(1, 2, 30, 31\)"):
        metric(p[None], torch.from_numpy(g))
    with pytest.raises(ArgumentError, match=r"\(C, h, w\) or \(h, w\), not of shape \(31,\)"):
        metric(p[0, 0], g[0, 0])
    with pytest.raises(ArgumentError, match="empty"):
        metric(p[:0], g[:0])
    with pytest.raises(ArgumentError, match="not list"):
        metric(p.tolist(), g)
    for threads in (0, -1):
        with pytest.raises(ArgumentError, match="threads"):
            metric(p, g, threads=threads)


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
@pytest.mark.parametrize("name", ["data_range", "peak"])
def test_bad_numbers(name: str, value: float) -> None:
    of_images = (metrics.psnr, metrics.ssim) if name == "data_range" else ()
    for metric in (metrics.st_rred, *of_images):
        with pytest.raises(ArgumentError, match=f"{name} must be positive and finite, not"):
            metric(np.zeros((2, 50, 60)), np.zeros((2, 50, 60)), **{name: value})


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize(
    ("dtype", "words"),
    [
        *((dtype, r"the prediction holds integers.*\[0, 1\].*65535") for dtype in (np.uint8, np.uint16, np.int64)),
        *((dtype, "must be float16, bfloat16, float32 or float64") for dtype in (bool, np.complex64, np.longdouble)),
    ],
)
def test_other_types_are_refused(metric: Metric, dtype: npt.DTypeLike, words: str) -> None:
    g = np.ones((2, 30, 31), np.float32)
    with pytest.raises(ArgumentError, match=words):
        metric(g.astype(dtype), g)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("metric", OF_TENSORS)
def test_other_devices(metric: Metric) -> None:
    p, g = images(2, 30, 31)
    assert agree(metric(torch.from_numpy(p).cuda().requires_grad_(), torch.from_numpy(g).cuda()), metric(p, g))


# --- batches of tensors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("metric", [metrics.psnr, metrics.ssim, partial(metrics.ssim, covariance="population")])
def test_a_batch_has_the_score_of_each_image_and_its_gradient(metric: Metric) -> None:
    """Scores of arrays, which are compared with scikit-image's; gradients of differences, in float64."""
    p, g = images(5, 3, 30, 41)
    found = metric(torch.from_numpy(p), torch.from_numpy(g))
    assert (found.shape, found.dtype) == ((5,), torch.float64)
    assert found.tolist() == pytest.approx([metric(*pair) for pair in zip(p, g, strict=True)], rel=1e-12)
    tensors = [torch.from_numpy(image[:2, :2, :9, :8]).double().requires_grad_() for image in (p, g)]
    assert torch.autograd.gradcheck(metric, tensors)
    weights = torch.from_numpy(p).requires_grad_()
    (-metric(weights, torch.from_numpy(g)).mean()).backward()
    assert weights.grad is not None
    assert (weights.grad.dtype, bool(weights.grad.isfinite().all())) == (torch.float32, True)


def test_tensors_that_are_refused() -> None:
    p, g = map(torch.from_numpy, images(2, 3, 30, 41))
    wrong: list[tuple[Metric, tuple[Any, Any], str]] = [
        (metrics.psnr, (255 * p, 255 * g), "the reference reaches 25.*, and data_range is 1: divide"),
        (metrics.ssim, (p, g.numpy()), "the prediction is a tensor, the reference ndarray"),
        (metrics.ssim, (p[..., :6], g[..., :6]), "at least 7 x 7"),
        (metrics.psnr, (p, (255 * g).byte()), "the reference holds integers"),
        (metrics.psnr, (p[None], g[None]), r"not of shape \(1, 2, 3, 30, 41\)"),
        (partial(metrics.ssim, window="gaussian-11"), (p, g), "window of tensors must be one of 'uniform-7'"),
    ]
    for metric, pair, words in wrong:
        with pytest.raises(ArgumentError, match=words):
            metric(*pair)
    assert metrics.psnr(255 * p, 255 * g, data_range=255.0).tolist() == pytest.approx(metrics.psnr(p, g).tolist())
