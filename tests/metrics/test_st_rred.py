"""ST-RRED: against scikit-video (golden/st_rred_generate.py says how its values were made), and its properties."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.errors import ArgumentError
from eldata.metrics import PEAK_8_BIT, PEAK_ELD, raw_to_grey, st_rred
from eldata.metrics.st_rred import StRred, coarse_band
from tests.metrics.golden.st_rred_clips import BAND_IMAGE, CASES, Case, Clip, drop, noise, packed, scene, still, uniform

GOLDEN: dict[str, Any] = json.loads((Path(__file__).parent / "golden" / "st_rred.json").read_text(encoding="utf-8"))

PAIRS = ("spatial_pairs", "temporal_pairs")


# Against others' implementations


def test_band_is_that_of_the_pyramid() -> None:
    expected = np.array(GOLDEN["band"])
    band = coarse_band(BAND_IMAGE)
    assert band.shape == expected.shape == (10, 12)
    np.testing.assert_allclose(band, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_scores_are_those_of_scikit_video(case: Case) -> None:
    expected = GOLDEN["cases"][case.name]
    scores = st_rred(*case.make(), peak=case.peak)
    for field in PAIRS:
        np.testing.assert_allclose(getattr(scores, field), expected[field], rtol=1e-8)
    assert scores.st_rred == pytest.approx(expected["st_rred"], rel=1e-8, abs=0)
    # The package as it is rounds to float32, which small clips of few blocks feel.
    assert scores.st_rred == pytest.approx(expected["st_rred_float32"], rel=1e-2, abs=0)


# What the numbers mean


@pytest.mark.parametrize("clip", [scene(4, 160, 176), still(4, 160, 176)], ids=["moving", "still"])
def test_identical_clips_score_exactly_zero(clip: Clip) -> None:
    scores = st_rred(clip, clip.copy())
    assert scores == StRred((0.0, 0.0), (0.0, 0.0))
    assert scores.spatial == scores.temporal == scores.st_rred == 0


def test_frozen_second_frames_leave_the_product_at_zero() -> None:
    # The quirk that a pair's spatial part is that of its first frame alone: look at ``temporal`` too.
    clip = scene(4, 64, 64)
    scores = st_rred(drop(clip), clip)
    assert scores.temporal > 0
    assert scores.spatial == scores.st_rred == 0


# Invariances


def test_pairs_are_independent() -> None:
    p, g = noise(scene(6, 64, 80), 0.1), scene(6, 64, 80)
    scores = st_rred(p, g)
    order = [4, 5, 0, 1, 2, 3]
    shuffled = st_rred(p[order], g[order])
    for field in PAIRS:
        assert getattr(scores, field) == tuple(getattr(shuffled, field)[i] for i in (1, 2, 0))
    assert scores.spatial == np.mean(scores.spatial_pairs)
    assert scores.st_rred == scores.spatial * scores.temporal


def test_last_of_an_odd_number_of_frames_is_not_looked_at() -> None:
    p, g = noise(scene(5, 64, 80), 0.1), scene(5, 64, 80)
    expected = st_rred(p[:4], g[:4])
    p[4] = np.nan
    assert st_rred(p, g) == expected
    assert len(expected.spatial_pairs) == 2


def test_only_the_ratio_of_peak_and_data_range_counts() -> None:
    clip = scene(4, 64, 80)
    p = noise(clip, 0.1)
    expected = st_rred(p, clip)
    assert st_rred(255 * p, 255 * clip, data_range=255).st_rred == pytest.approx(expected.st_rred, rel=1e-9)
    assert st_rred(p, clip, data_range=2, peak=510) == expected
    assert st_rred(p, clip, peak=PEAK_ELD).st_rred < expected.st_rred / 10


@pytest.mark.parametrize("peak", [PEAK_8_BIT, PEAK_ELD])
@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_degenerate_frames_have_finite_scores(peak: float, value: float) -> None:
    flat = np.full((4, 64, 80), value)
    ramp = np.broadcast_to(np.linspace(0, 1, 64)[np.newaxis, :, np.newaxis] ** 2, flat.shape)  # K has rank 3 at most
    textured = scene(4, 64, 80)
    brighter = flat + np.arange(4)[:, np.newaxis, np.newaxis] / 7  # flat as well, but not still
    assert st_rred(flat, brighter, peak=peak).st_rred == 0
    for other in (ramp, textured):
        scores = st_rred(flat, other, peak=peak)
        assert np.isfinite(scores.st_rred)
        assert scores.spatial > 0
    swaying = ramp * np.array([1, 0.9, 1, 0.9])[:, np.newaxis, np.newaxis]
    assert 0 < st_rred(swaying, textured, peak=peak).st_rred < np.inf


def test_rank_deficient_frames_do_not_amplify_rounding() -> None:
    ramp = np.broadcast_to(np.linspace(0, 1, 64)[np.newaxis, :, np.newaxis] ** 2, (2, 64, 80))
    textured = scene(2, 64, 80)
    jitter = 1e-15 * uniform(3, *ramp.shape)
    assert st_rred(ramp + jitter, textured).spatial == pytest.approx(st_rred(ramp, textured).spatial, rel=1e-6)


# What is accepted


def test_threads_do_not_change_a_bit() -> None:
    p, g = noise(scene(5, 150, 171), 0.1), scene(5, 150, 171)
    assert st_rred(p, g, threads=1) == st_rred(p, g, threads=3) == st_rred(p, g)
    with pytest.raises(ArgumentError, match="threads must be at least 1"):
        st_rred(p, g, threads=0)


@pytest.mark.memory
def test_memory_does_not_grow_by_whole_frames() -> None:
    frame = 8 * 400 * 500

    def peak(frames: int) -> int:
        p = np.broadcast_to(scene(1, 400, 500).astype(np.float32), (frames, 400, 500))
        g = np.zeros_like(p)
        tracemalloc.start()
        try:
            st_rred(p, g, threads=1)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(2)  # compiles
    few, many = peak(2), peak(34)
    assert few < 10 * frame
    assert many - few < 32 * 2 * frame / 64 * 1.5  # a band each


# Grey


def test_grey_of_packed_bayer() -> None:
    r, g1, b, g2 = planes = uniform(5, 4, 6, 7)
    expected = 0.2989 * r + 0.5870 * (g1 + g2) / 2 + 0.1140 * b
    np.testing.assert_allclose(raw_to_grey(planes), expected, rtol=1e-15)
    np.testing.assert_allclose(raw_to_grey(torch.from_numpy(planes)), expected, rtol=1e-15)
    np.testing.assert_array_equal(raw_to_grey(planes[[0, 1, 2]]), raw_to_grey(planes[[0, 1, 2, 1]]))
    assert raw_to_grey(planes.astype(np.float32)).dtype == np.float64
    for grey in (planes[0], planes[:1]):
        result = raw_to_grey(grey)
        np.testing.assert_array_equal(result, r)
        assert not np.shares_memory(result, planes)


def test_clip_of_raw_frames_is_reduced_frame_by_frame() -> None:
    p, g = packed(noise(scene(4, 100, 130), 0.1)), packed(scene(4, 100, 130))
    grey_p, grey_g = (np.stack([raw_to_grey(frame) for frame in clip]) for clip in (p, g))
    assert st_rred(p, g) == st_rred(grey_p, grey_g) == st_rred(grey_p[:, np.newaxis], grey_g[:, np.newaxis])


def test_xtrans_is_refused_with_advice() -> None:
    with pytest.raises(ArgumentError, match=r"the image of shape \(9, 50, 50\) has 9 channels: .*pass a grey clip"):
        raw_to_grey(np.zeros((9, 50, 50)))
    clip = np.zeros((2, 9, 50, 50))
    with pytest.raises(ArgumentError, match=r"the prediction of shape \(2, 9, 50, 50\) has 9 channels"):
        st_rred(clip, clip)


# What is refused

GOOD = np.zeros((2, 50, 60))


@pytest.mark.parametrize(
    ("prediction", "message"),
    [
        (np.zeros((2, 50, 61)), r"differ in shape: \(2, 50, 61\) against \(2, 50, 60\)"),
        (torch.zeros(3, 50, 60), r"differ in shape: \(3, 50, 60\) against \(2, 50, 60\)"),
        (np.zeros((1, 50, 60)), r"the prediction has 1 frame, of shape \(1, 50, 60\): .* in pairs"),
        (np.zeros((50, 60)), r"must be one clip \(T, H, W\) or \(T, C, h, w\), not of shape \(50, 60\)"),
        (np.zeros((1, 2, 1, 50, 60)), "must be one clip"),
        (np.zeros((2, 40, 60)), r"the prediction of shape \(2, 40, 60\) is too small: .* at least 41 x 41"),
        (np.zeros((2, 4, 60, 0)), "too small"),
        (np.zeros((2, 50, 60), np.uint8), r"the prediction holds integers \(uint8\)"),
        (np.zeros((2, 50, 60), bool), "must be float16, bfloat16, float32 or float64, not bool"),
        ([[0.0]], "must be a numpy array or a torch tensor, not list"),
    ],
)
def test_bad_clips(prediction: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        st_rred(prediction, GOOD)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("threads", [1, 4])
def test_values_that_are_no_numbers(value: float, threads: int) -> None:
    clip = scene(4, 50, 60)
    bad = clip.copy()
    bad[3, 10, 10] = value
    with pytest.raises(ArgumentError, match="frame 3 of the prediction holds NaN or infinity"):
        st_rred(bad, clip, threads=threads)
    with pytest.raises(ArgumentError, match="frame 3 of the reference holds NaN or infinity"):
        st_rred(clip, bad, threads=threads)
