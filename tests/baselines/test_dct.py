from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.baselines.classical import SignalNoise, dct_thresholded, noise_of_image
from eldata.demo.camera import CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_radiance
from eldata.raw.cfa import pack

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIZE = (192, 288)


def denoise(packed: NDArray[np.float32]) -> NDArray[np.float32]:
    return dct_thresholded(packed, noise_of_image(packed))


def psnr(image: NDArray[Any], clean: NDArray[Any]) -> float:
    return float(-10 * np.log10(np.mean((np.clip(image, 0, 1) - np.clip(clean, 0, 1)) ** 2)))


def noisy_and_clean(
    camera: SimulatedCamera, number: int, factor: int
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """An amplified frame, and the noise-free signal that it was made from."""
    shot, iso = camera.with_size(*SIZE), 1600
    radiance = scene_radiance(number, *SIZE)
    exposure = Fraction(100, iso * factor)
    black = np.array(shot.sensor.black_level_dn)[:, None, None]
    span = shot.sensor.white_level_dn - black
    mosaic = shot.photograph(radiance, exposure, iso, np.random.default_rng(number))
    amplified = (pack(mosaic, shot.sensor.cfa) - black) / span * factor
    signal = pack(shot.electrons(radiance, exposure), shot.sensor.cfa) * shot.gain_dn_per_e(iso)
    return amplified.astype(np.float32), signal / span * factor


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
@pytest.mark.parametrize(("number", "factor"), [(1, 100), (2, 200), (3, 100), (4, 200)])
def test_gains_more_than_3_db_over_the_amplified_input(camera: SimulatedCamera, number: int, factor: int) -> None:
    amplified, clean = noisy_and_clean(camera, number, factor)
    denoised = denoise(amplified)
    assert denoised.shape == amplified.shape
    assert denoised.dtype == np.float32
    assert psnr(denoised, clean) > psnr(amplified, clean) + 3
    assert psnr(denoised, clean) > psnr(np.broadcast_to(amplified.mean((1, 2), keepdims=True), clean.shape), clean) + 3


@pytest.mark.parametrize("values", [(0.3, 0.3, 0.3, 0.3), (0.1, 0.5, 0.25, 0.45), (0, 0, 0, 0), (-0.01, 0, 0.02, 1)])
@pytest.mark.parametrize("size", [(32, 48), (33, 47), (16, 16)])
def test_constant_images_stay_as_they_are(values: tuple[float, ...], size: tuple[int, int]) -> None:
    image = np.broadcast_to(np.array(values, np.float32)[:, None, None], (4, *size))
    assert np.abs(dct_thresholded(image, SignalNoise(0.01, 1e-3)) - image).max() < 1e-5


def test_mean_brightness_is_kept() -> None:
    amplified, _ = noisy_and_clean(CAMERAS[0], 1, 100)
    assert denoise(amplified).mean() == pytest.approx(amplified.mean(), rel=0.01)


def test_input_is_not_changed() -> None:
    amplified, _ = noisy_and_clean(CAMERAS[0], 2, 100)
    before = amplified.copy()
    denoise(amplified)
    assert np.array_equal(amplified, before)
