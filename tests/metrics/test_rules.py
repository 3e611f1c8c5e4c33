"""Scores under any rules, against the same steps on whole float64 images."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from eldata.errors import ArgumentError
from eldata.metrics import score
from eldata.metrics.image_score import ScoringRules, as_compared, factor_by, score_by
from tests.metrics.test_similarity import oracle

Image = npt.NDArray[np.floating[Any]]


def images(dtype: npt.DTypeLike = np.float64) -> tuple[Image, Image]:
    rng = np.random.default_rng(7)
    g = np.clip(np.linspace(-0.1, 1.3, 70) * np.linspace(0.2, 1, 40)[:, None] + 0.05 * rng.random((3, 40, 70)), None, 1)
    g[..., -4:] *= 1.1  # references above white, which count for the factor
    p = 0.9 * g + rng.normal(0, 0.05, g.shape)  # a factor above 1, so that a clamp after it matters
    return p.astype(dtype), g.astype(dtype)


def treated(p: Image, g: Image, rules: ScoringRules) -> tuple[Image, Image, float]:
    """Both images as they are compared, and the factor."""
    p64, g64 = p.astype(np.float64), g.astype(np.float64)
    if rules.prediction_clamp != "none":
        p64 = np.clip(p64, 0, 1)
    factor = 1.0
    if rules.rescaling == "scalar":
        counts = g64 != 1
        factor = float((p64 * g64)[counts].sum() / (p64 * p64)[counts].sum())
    p64 = factor * p64
    if rules.prediction_clamp == "both":
        p64 = np.clip(p64, 0, 1)
    if rules.rounding != "none":
        half = 0.5 if rules.rounding == "8-bit" else 0.0
        p64, g64 = (np.clip(np.floor(x * 255 + half), 0, 255) / 255 for x in (p64, g64))
    return p64, g64, factor


def step_by_step(p: Image, g: Image, rules: ScoringRules) -> tuple[float, float, float]:
    p64, g64, factor = treated(p, g, rules)
    gaussian = rules.ssim_window == "gaussian-11"
    similarity = oracle(p64, g64, rules.data_range, gaussian=gaussian, covariance=rules.ssim_covariance)
    error = float(np.mean((p64 - g64) ** 2)) + rules.mse_offset
    return 10 * math.log10(rules.data_range**2 / error), similarity, factor


CASES = [
    ScoringRules(rescaling, clamp, rounding, offset, window, covariance, data_range)  # type: ignore[arg-type] # literals
    for rescaling, clamp, rounding, (data_range, offset), (window, covariance) in itertools.product(
        ("none", "scalar"),
        ("both", "before", "none"),
        ("none", "8-bit", "8-bit-truncated"),
        ((1.0, 0.0), (2.0, 1e-3)),
        (("uniform-7", "population"), ("gaussian-11", "sample")),
    )
]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_combination_equals_the_steps(dtype: npt.DTypeLike) -> None:
    p, g = images(dtype)
    distinct = set()
    for rules in CASES:
        found = score_by(p, g, rules)
        psnr_db, similarity, factor = step_by_step(p, g, rules)
        assert found.psnr_db == pytest.approx(psnr_db, abs=1e-9), rules
        assert found.ssim == pytest.approx(similarity, abs=1e-10), rules
        assert found.rescale == pytest.approx(factor, rel=1e-12), rules
        assert score_by(p, g, rules, factor=factor_by(p, g, rules)) == found
        distinct.add((found.psnr_db, found.ssim))
    assert len(distinct) > 40  # the rules matter here; clamps before rounding do not


def test_the_defaults_are_elds() -> None:
    p, g = images()
    assert score_by(p, g, ScoringRules()) == score(p, g, rescaling="scalar")
    assert score_by(p, g, ScoringRules(rescaling="none")) == score(p, g, rescaling="none")
    assert factor_by(p, g, ScoringRules(rescaling="none")) == 1.0


def test_rounding_of_codes_is_exact() -> None:
    """255 levels in float32 and back: code k stays k, whichever way it is rounded."""
    codes = np.arange(256.0).reshape(1, 16, 16)
    stored = (codes / 255).astype(np.float32)
    shifted = np.roll(codes, 1)
    rules = ScoringRules("none", rounding="8-bit")
    found = score_by(stored, (shifted / 255).astype(np.float32), rules)
    expected = 10 * math.log10(255**2 / np.mean((codes - shifted) ** 2))
    assert found.psnr_db == pytest.approx(expected, abs=1e-12)
    assert score_by(stored, stored, rules).psnr_db == math.inf


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rescaling": "affine"}, "rescaling must be one of"),
        ({"prediction_clamp": "after"}, "prediction_clamp must be one of"),
        ({"rounding": "10-bit"}, "rounding must be one of"),
        ({"ssim_window": "9"}, "window must be one of"),
        ({"data_range": 0.0}, "data_range"),
        ({"mse_offset": -1.0}, "mse_offset"),
        ({"mse_offset": math.nan}, "mse_offset"),
    ],
)
def test_refusals(change: dict[str, Any], said: str) -> None:
    p, g = images()
    for call in (score_by, factor_by):
        with pytest.raises(ArgumentError, match=said):
            call(p, g, replace(ScoringRules(), **change))


@pytest.mark.parametrize("rounding", ["none", "8-bit", "8-bit-truncated"])
@pytest.mark.parametrize("clamp", ["both", "before", "none"])
def test_images_as_they_are_compared(rounding: Any, clamp: Any) -> None:
    p, g = images(np.float32)
    rules = ScoringRules(rounding=rounding, prediction_clamp=clamp)
    expected = treated(p, g, rules)
    found = as_compared(p, g, rules, factor_by(p, g, rules))
    for image, other in zip(found, expected[:2], strict=True):
        assert image.dtype == (np.float64 if rounding == "none" else np.float32)
        np.testing.assert_allclose(image, other, rtol=1e-7, atol=1e-12)


PEAK = """
import resource, numpy as np
from eldata.metrics import Score, score
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
