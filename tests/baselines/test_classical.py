"""Denoisers without training on scenes of known signal and Poisson-Gaussian noise."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.stats import t as student

from eldata.baselines.classical import BASELINES, SignalNoise, noise_of_parameters
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError, EldataError
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from numpy.typing import NDArray

LINES = {"shot noise": SignalNoise(0.02, 0.005**2), "read noise too": SignalNoise(0.05, 0.05**2)}


def scene_signal(number: int, repeat: int = 2, size: tuple[int, int] = (64, 96)) -> NDArray[np.float64]:
    """A scene's packed signal, 1 where it is brightest."""
    scene = scene_radiance(number, size[0] * repeat, size[1] * repeat)[1]
    sites = [(y, x) for y in range(repeat) for x in range(repeat)]
    return np.asarray(np.stack([scene[y::repeat, x::repeat] for y, x in sites]) / scene.max(), np.float64)


def noisy_and_clean(
    number: int, line: SignalNoise, repeat: int = 2, size: tuple[int, int] = (64, 96)
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    signal, generator = scene_signal(number, repeat, size), np.random.default_rng(number)
    normal = generator.standard_normal(signal.shape)
    noisy = line.slope * generator.poisson(signal / line.slope) + np.sqrt(line.offset) * normal
    return noisy.astype(np.float32), signal


def psnr(image: NDArray[Any], clean: NDArray[Any]) -> float:
    return float(-10 * np.log10(np.mean((np.clip(image, 0, 1) - clean) ** 2)))


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_what_knows_the_noise_is_better_than_the_input(number: int, name: str) -> None:
    """Errors of 24,576 values, alike within 8 x 8, are 384: a mean square scatters by 7 %, 0.31 dB, two by 0.44."""
    noisy, clean = noisy_and_clean(number, LINES[name])
    scores = {key: psnr(BASELINES[key].denoise(noisy, LINES[name]), clean) for key in ("input", "wavelet", "dct")}
    assert scores["dct"] > scores["wavelet"] + 1
    assert scores["wavelet"] > scores["input"] + 1


@pytest.mark.parametrize("name", ["bm3d", "anscombe-bm3d"])
def test_bm3d_is_better_than_the_input(name: str) -> None:
    """On 64 errors, which scatter by 18 % or 0.77 dB; two images' difference on the same noise by less.

    Its order is a study's: BM3D takes seconds for any image.
    """
    pytest.importorskip("bm3d")
    noisy, clean = noisy_and_clean(3, LINES["shot noise"], size=(32, 32))
    assert psnr(BASELINES[name].denoise(noisy, LINES["shot noise"]), clean) > psnr(noisy, clean) + 1


@pytest.mark.study
def test_the_order_at_every_iso_of_a_camera() -> None:
    """The SonyA7S2's K and read noise at a factor of 100, four scenes, two draws of the noise.

    What a difference scatters by from draw to draw, pooled over ISOs and scenes, says what the mean of an ISO's eight
    scatters by; of six means that are no difference, one in 100,000 would pass Student's bound by chance.
    """
    pytest.importorskip("bm3d")
    profile, isos, scenes, draws = CameraProfile.load("SonyA7S2-PMN"), (800, 1600, 3200), (1, 2, 3, 4), 2
    scores = np.empty((3, len(isos), len(scenes), draws))
    for place, (iso, scene, draw) in zip(
        np.ndindex(scores.shape[1:]), product(isos, scenes, range(draws)), strict=True
    ):
        figures = replace(profile.measured(iso), sigma_row_dn=0.0)
        scale, gain = 100 / 15871, figures.gain_dn_per_e
        clean, generator = scene_signal(scene), np.random.default_rng([iso, scene, draw])
        dn = gain * generator.poisson(clean / scale / gain) + generator.normal(0, figures.sigma_gauss_dn, clean.shape)
        noisy, line = (np.rint(dn) * scale).astype(np.float32), noise_of_parameters(figures, ratio=100, range_dn=15871)
        for index, key in enumerate(("input", "bm3d", "anscombe-bm3d")):
            scores[(index, *place)] = psnr(BASELINES[key].denoise(noisy, line), clean)
    for less, more in ((0, 1), (1, 2)):
        gain_db = scores[more] - scores[less]
        scatter = float(np.sqrt(gain_db.var(axis=-1, ddof=1).mean()))
        bound = student.isf(1e-5 / 6, len(isos) * len(scenes) * (draws - 1)) * scatter / np.sqrt(len(scenes) * draws)
        means = gain_db.mean(axis=(1, 2))
        print(f"{less} to {more}: {np.round(means, 2)} dB at ISO {isos}, each above {bound:.2f}")
        assert (means > bound).all()


@pytest.mark.parametrize("name", ["gaussian", "wavelet", "dct"])
def test_xtrans_has_nine_channels(name: str) -> None:
    noisy, clean = noisy_and_clean(1, LINES["read noise too"], 3)
    before = noisy.copy()
    found = BASELINES[name].denoise(noisy, LINES["read noise too"])
    assert found.shape == noisy.shape == (9, 64, 96)
    assert psnr(found, clean) > psnr(noisy, clean) + 1
    assert np.array_equal(noisy, before)


def test_mean_brightness_is_kept_in_the_dark() -> None:
    """Where a value holds one electron or two, plain inversion of the root loses a sixth of it.

    The scatter that is left in the denoised values, through a convex inverse, adds some 4 %.
    """
    line = SignalNoise(0.01, 0.005**2)
    signal = np.full((4, 96, 96), 0.015)
    generator = np.random.default_rng(0)
    noisy = 0.01 * generator.poisson(signal / 0.01) + 0.005 * generator.standard_normal(signal.shape)
    found = BASELINES["wavelet"].denoise(noisy.astype(np.float32), line)
    assert found.mean() == pytest.approx(0.015, rel=0.06)


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    noisy, _ = noisy_and_clean(1, LINES["shot noise"])
    with pytest.raises(ArgumentError, match="needs the line of the frame's noise"):
        BASELINES["dct"].denoise(noisy, None)
    for name, package, extra in (("wavelet", "pywt", "baselines"), ("bm3d", "bm3d", "bm3d")):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(EldataError, match=rf"pip install 'eldata\[{extra}\]'"):
            BASELINES[name].denoise(noisy, LINES["shot noise"])
