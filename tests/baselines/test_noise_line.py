"""The line of shot and read noise of a frame, against simulated cameras, which share no code with it."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.ndimage import convolve1d

from eldata.baselines.noise_line import noise_line
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError, DatasetError
from eldata.raw import pack

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.demo.camera import SimulatedCamera

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


def test_wrong_arguments_are_named() -> None:
    frame = packed(ALPHA, photograph(ALPHA, 1, 3200, 10))
    with pytest.raises(ArgumentError, match=r"floating numbers; found float32 \(192, 288\)"):
        noise_line(frame[0])
    with pytest.raises(ArgumentError, match="NaN or infinity"):
        noise_line(np.full_like(frame, np.nan))
    with pytest.raises(DatasetError, match="shows no noise"):
        noise_line(np.zeros_like(frame))
    with pytest.raises(DatasetError, match="too small"):
        noise_line(frame[:, :8, :8])


def test_no_unit_is_preferred() -> None:
    frame = packed(ALPHA, photograph(ALPHA, 1, 3200, 10))
    line, scaled = noise_line(frame), noise_line(frame / 1024)
    assert scaled.slope * 1024 == pytest.approx(line.slope, rel=1e-4)
    assert scaled.offset * 1024**2 == pytest.approx(line.offset, rel=1e-4)
