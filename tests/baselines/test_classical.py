"""Denoisers without training, the lines of noise, on known signals and on simulated cameras, which share no code."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.stats import t as student

from eldata.baselines.classical import (
    BASELINES,
    SignalNoise,
    apply_anscombe,
    invert_anscombe,
    noise_of_parameters,
    threshold_dct,
)
from eldata.baselines.noise_line import noise_line
from eldata.baselines.noisy_frames import estimate_line
from eldata.demo.camera import CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.parameters import NoiseParameters
from eldata.noise.profile import CameraProfile
from eldata.raw import pack

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
@pytest.mark.parametrize("number", [1, 4])
def test_what_knows_the_noise_is_better_than_the_input(number: int, name: str) -> None:
    """Errors of 24,576 values, alike within 8 x 8, are 384: a mean square scatters by 7 %, 0.31 dB, two by 0.44."""
    noisy, clean = noisy_and_clean(number, LINES[name])
    scores = {key: psnr(BASELINES[key].denoise(noisy, LINES[name]), clean) for key in ("input", "dct")}
    assert scores["dct"] > scores["input"] + 2


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
    """The SonyA7S2's K and read noise at a factor of 100, a frame of four scenes side by side, twice with other noise.

    What a difference scatters by from draw to draw, pooled over ISOs and scenes, says what the mean of an ISO's eight
    scatters by; of six means that are no difference, one in 100,000 would pass Student's bound by chance.
    """
    pytest.importorskip("bm3d")
    profile, isos, scenes, draws = CameraProfile.load("SonyA7S2-PMN"), (800, 1600, 3200), (1, 2, 3, 4), 2
    clean = np.concatenate([scene_signal(scene, size=(48, 48)) for scene in scenes] * draws, axis=-1)
    scores = np.empty((3, len(isos), draws, len(scenes)))
    for place, iso in enumerate(isos):
        figures = replace(profile.measured(iso), sigma_row_dn=0.0)
        scale, gain, generator = 100 / 15871, figures.gain_dn_per_e, np.random.default_rng(iso)
        dn = gain * generator.poisson(clean / scale / gain) + generator.normal(0, figures.sigma_gauss_dn, clean.shape)
        noisy, line = (np.rint(dn) * scale).astype(np.float32), noise_of_parameters(figures, ratio=100, range_dn=15871)
        for index, key in enumerate(("input", "bm3d", "anscombe-bm3d")):
            found = BASELINES[key].denoise(noisy, line)
            parts = zip(*(np.split(image, draws * len(scenes), axis=-1) for image in (found, clean)), strict=True)
            scores[index, place] = np.reshape([psnr(part, truth) for part, truth in parts], (draws, len(scenes)))
    for less, more in ((0, 1), (1, 2)):
        gain_db = scores[more] - scores[less]
        scatter = float(np.sqrt(gain_db.var(axis=1, ddof=1).mean()))
        bound = student.isf(1e-5 / 6, len(isos) * len(scenes) * (draws - 1)) * scatter / np.sqrt(len(scenes) * draws)
        means = gain_db.mean(axis=(1, 2))
        print(f"{less} to {more}: {np.round(means, 2)} dB at ISO {isos}, each above {bound:.2f}")
        assert (means > bound).all()


def test_xtrans_has_nine_channels() -> None:
    noisy, clean = noisy_and_clean(1, LINES["read noise too"], 3)
    before = noisy.copy()
    found = BASELINES["dct"].denoise(noisy, LINES["read noise too"])
    assert found.shape == noisy.shape == (9, 64, 96)
    assert psnr(found, clean) > psnr(noisy, clean) + 1
    assert np.array_equal(noisy, before)


def test_mean_brightness_is_kept_in_the_dark() -> None:
    """Where a value holds one electron or two, plain inversion of the root loses a sixth of it.

    The mean of 36,864 stabilised values scatters by 1 / 192, and what is inverted by 0.5 % of the signal.
    """
    line = SignalNoise(0.01, 0.005**2)
    signal = np.full((4, 96, 96), 0.015)
    generator = np.random.default_rng(0)
    noisy = 0.01 * generator.poisson(signal / 0.01) + 0.005 * generator.standard_normal(signal.shape)
    mean = apply_anscombe(noisy, line).mean(keepdims=True)
    assert invert_anscombe(mean, line).item() == pytest.approx(0.015, rel=0.025)
    assert 0.01 * (mean.item() ** 2 / 4 - 3 / 8 - 0.25) < 0.9 * 0.015  # so the bound above can fail


def test_a_missing_line_is_named() -> None:
    noisy, _ = noisy_and_clean(1, LINES["shot noise"])
    with pytest.raises(ArgumentError, match="needs the line of the frame's noise"):
        BASELINES["dct"].denoise(noisy, None)


# --- the line of the noise ------------------------------------------------------------------------------------------


LINE_SIZE = (512, 768)


@pytest.mark.parametrize(("gain", "sigma"), [(0.002, 0.01), (0.01, 0.05), (0.0, 0.02)])
@pytest.mark.parametrize(("number", "within"), [(1, 0.15), (2, 0.3)])
def test_the_line_of_a_scene_is_that_of_its_noise(gain: float, sigma: float, number: int, within: float) -> None:
    """Scene 2 has fine texture in all bright parts. By chance, 5 of 100: a group's quantile of 192 windows has 4 %."""
    generator = np.random.default_rng(3)
    scene = scene_radiance(number, *LINE_SIZE)[1]
    signal = np.stack([scene[y::2, x::2] for y in (0, 1) for x in (0, 1)]) / scene.max()
    shot = gain * generator.poisson(signal / gain) if gain else signal
    line = estimate_line((shot + sigma * generator.standard_normal(signal.shape)).astype(np.float32))
    for level in (0.02, 0.1, 0.5):
        assert line.variance(np.array(level)) == pytest.approx(gain * level + sigma**2, rel=within)


def test_the_line_of_figures() -> None:
    """ISO 1600 of a camera with K = 2 DN/e-, at a ratio of 100: variance in electrons, then amplified."""
    parameters = NoiseParameters(2.0, 0.0, 2.0, 4.0, 3.0)
    line = noise_of_parameters(parameters, ratio=100.0, range_dn=15000.0)
    electrons = 30.0
    signal = electrons * 2.0 * 100 / 15000
    expected = (electrons * 2.0**2 + 4.0**2 + 3.0**2 + 1 / 12) * (100 / 15000) ** 2
    assert line.variance(np.array(signal)) == pytest.approx(expected)
    assert line.variance(np.array(-1.0)) == line.offset


# --- stabilising ----------------------------------------------------------------------------------------------------


DRAWS = 400_000


@pytest.mark.parametrize("sigma", [0.3, 1.5, 20.0])
@pytest.mark.parametrize(("gain", "counts"), [(0.01, 0.3), (1.0, 2.0), (0.01, 20.0), (1.0, 190.0), (0.01, 300.0)])
def test_the_mean_of_stabilised_values_leads_back(gain: float, sigma: float, counts: float) -> None:
    """400,000 values: their mean has a standard error of s / 632, which d y / d f = f / 2 turns into counts."""
    generator = np.random.default_rng(17)
    line = SignalNoise(slope=gain, offset=(gain * sigma) ** 2)
    values = gain * (generator.poisson(counts, DRAWS) + sigma * generator.standard_normal(DRAWS))
    seen = apply_anscombe(values, line)
    if counts > 10 or sigma > 10:
        assert seen.std() == pytest.approx(1.0, abs=0.01)
    error = float(seen.std() / np.sqrt(DRAWS) * seen.mean() / 2)
    back = float(invert_anscombe(np.array([seen.mean()]), line)[0]) / gain
    assert abs(back - counts) < 4.5 * error + 2e-3
    around = 2 * np.sqrt(200 + 3 / 8 + sigma**2) + np.linspace(-1, 1, 2001)  # the table ends there, without a step
    assert np.diff(invert_anscombe(around, line)).max() < 0.05 * gain  # steps of 0.014 to 0.025 of its own


# --- thresholding ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("values", [(0.3, 0.3, 0.3, 0.3), (0.1, 0.5, 0.25, 0.45), (0, 0, 0, 0), (-0.01, 0, 0.02, 1)])
@pytest.mark.parametrize("size", [(32, 48), (33, 47), (16, 16)])
def test_constant_images_stay_as_they_are(values: tuple[float, ...], size: tuple[int, int]) -> None:
    image = np.broadcast_to(np.array(values, np.float32)[:, None, None], (4, *size))
    assert np.abs(threshold_dct(image, SignalNoise(0.01, 1e-3)) - image).max() < 1e-5


# --- the line of a photograph ---------------------------------------------------------------------------------------


SIZE = (384, 576)
ALPHA, BETA = (camera.with_size(*SIZE) for camera in CAMERAS)


@cache
def photograph(camera: SimulatedCamera, scene: int, iso: int, ratio: int) -> NDArray[np.uint16]:
    generator = np.random.default_rng([scene, iso, ratio])
    return camera.photograph(scene_radiance(scene, *SIZE), Fraction(100, iso * ratio), iso, generator)


def packed(camera: SimulatedCamera, mosaic: NDArray[np.uint16]) -> NDArray[np.float32]:
    black = np.array([camera.sensor.black_level_dn]).reshape(4, 1, 1)
    return np.asarray(pack(mosaic, camera.sensor.cfa) - black, dtype=np.float32)


def true_offset(camera: SimulatedCamera, iso: int) -> float:
    """Variance without light where the recorded black has it: the colour bias shifts the line along the signal."""
    gain = camera.gain_dn_per_e(iso)
    read = (gain * camera.sigma_read_e) ** 2 + camera.sigma_quantiser_dn**2
    return read + 1 / 12 - gain**2 * float(np.mean(camera.colour_bias_e))


ERRORS = {
    (0, 1, 10): (0.056, 1.53), (0, 1, 100): (0.093, 0.53), (0, 3, 10): (0.083, 1.45), (0, 3, 100): (0.088, 0.55),
    (1, 1, 10): (0.109, 3.6), (1, 1, 100): (0.365, 1.83), (1, 3, 10): (0.123, 3.29), (1, 3, 100): (0.311, 1.6),
}  # fmt: skip
"""Standard errors of slope and offset by camera, scene and ratio: of leaving out each of 24 parts of the frame."""


def test_the_line_is_the_cameras_within_its_errors() -> None:
    """16 deviations in standard errors: each within 5 (6e-7 by chance), the sum of their squares within 1.8 and 54."""
    deviations = []
    for number, camera in enumerate((ALPHA, BETA)):
        for scene in (1, 3):
            for iso, ratio in ((3200, 10), (3200, 100)):
                gain = camera.gain_dn_per_e(iso)
                line = noise_line(packed(camera, photograph(camera, scene, iso, ratio)))
                of_slope, of_offset = ERRORS[number, scene, ratio]
                deviations.append((line.slope - gain) / of_slope)
                deviations.append((line.offset - true_offset(camera, iso)) / of_offset)
    assert np.abs(deviations).max() < 5
    assert 1.8 < np.square(deviations).sum() < 54  # 5e-6 of chi^2 each: errors are neither too small nor too large


def test_texture_in_most_of_the_frame_stays_out_of_it() -> None:
    """Stripes and blobs of ten times the noise's variance over half of it, up to the middle frequencies."""
    generator = np.random.default_rng(5)
    y, x = np.mgrid[: SIZE[0] // 2, : SIZE[1] // 2]
    signal = 20 + np.round(x / 32) * 20.0 + np.zeros((4, 1, 1))
    signal[:, y > 96] *= 1 + 0.3 * np.sin(1.1 * x + 0.7 * y)[y > 96]
    frame = 2 * generator.poisson(signal / 2) + generator.normal(0, 4, signal.shape)
    line = noise_line(frame)
    assert abs(line.slope - 2) < 5 * 0.033
    assert abs(line.offset - 16) < 5 * 2.35


@pytest.mark.parametrize(
    ("kernel", "words"),
    [
        ((0.1, 0.8, 0.1), "share their noise, as after noise reduction"),
        ((-0.15, 1.3, -0.15), "was sharpened or compressed"),
    ],
)
def test_filtered_raws_are_refused(kernel: tuple[float, ...], words: str) -> None:
    frame = packed(BETA, photograph(BETA, 1, 3200, 100))
    for axis in (1, 2):
        frame = convolve1d(frame, kernel, axis=axis)
    with pytest.raises(DatasetError, match=words):
        noise_line(np.rint(frame))


def test_frames_that_tell_nothing_are_named() -> None:
    frame = packed(ALPHA, photograph(ALPHA, 1, 3200, 10))
    for array, kind, words in (
        (frame[0], ArgumentError, r"floating numbers; found float32 \(192, 288\)"),
        (np.full_like(frame, np.nan), ArgumentError, "NaN or infinity"),
        (np.zeros_like(frame), DatasetError, "shows no noise"),
        (frame[:, :8, :8], DatasetError, "too small"),
        (np.zeros((4, 16, 16), np.float32), DatasetError, "too little of its noise: 16 windows .*, where 64 are"),
    ):
        with pytest.raises(kind, match=words):
            noise_line(array)


def test_no_unit_is_preferred() -> None:
    frame = packed(ALPHA, photograph(ALPHA, 1, 3200, 10))
    line, scaled = noise_line(frame), noise_line(frame / 1024)
    assert scaled.slope * 1024 == pytest.approx(line.slope, rel=1e-4)
    assert scaled.offset * 1024**2 == pytest.approx(line.offset, rel=1e-4)
