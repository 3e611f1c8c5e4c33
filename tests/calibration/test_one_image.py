"""Gain and read noise of one photograph, against simulated cameras of known noise, which share no code with it."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.ndimage import convolve1d

from eldata.base.console import Parser, add_module, run
from eldata.calibration import estimate_profile, noise_line
from eldata.cli import profile as command
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import CameraProfile
from eldata.raw import pack, write_dng
from eldata.records import Exposure, RawFrame
from tests.raw.helpers import write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

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


def frame_of(camera: SimulatedCamera, mosaic: NDArray[np.uint16], path: Path, iso: int = 3200) -> RawFrame:
    return RawFrame(path, mosaic, camera.sensor, Exposure(iso=Fraction(iso)))


def test_the_line_is_the_cameras_within_its_errors() -> None:
    """16 deviations in standard errors: each within 5 (6e-7 by chance), the sum of their squares within 1.8 and 54."""
    deviations = []
    for camera in (ALPHA, BETA):
        for scene in (1, 3):
            for iso, ratio in ((3200, 10), (3200, 100)):
                gain = camera.gain_dn_per_e(iso)
                line = noise_line(packed(camera, photograph(camera, scene, iso, ratio)))
                assert line.slope_error < 0.12 * gain
                assert not line.channels_differ
                deviations.append((line.slope - gain) / line.slope_error)
                deviations.append((line.offset - true_offset(camera, iso)) / line.offset_error)
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
    assert line.smooth_share < 0.5
    assert abs(line.slope - 2) < 5 * line.slope_error < 0.8
    assert abs(line.offset - 16) < 5 * line.offset_error < 16


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


def test_what_is_clipped_at_black_is_left_out() -> None:
    """Black at 0, as some cameras write: half of the noise is missing where there is no light."""
    generator = np.random.default_rng(6)
    signal = np.linspace(0, 300, 288) * np.ones((4, 192, 1))
    cut = np.maximum(2 * generator.poisson(signal / 2) + np.rint(generator.normal(0, 12, signal.shape)), 0)
    line, without = noise_line(cut, cut > 0), noise_line(cut)
    assert abs(line.slope - 2) < 5 * line.slope_error < 0.6
    assert abs(line.offset - 144 - 1 / 12) < 5 * line.offset_error < 144
    assert without.offset < 144 - 5 * without.offset_error, "the mask would be for nothing"


def test_channels_of_another_gain_are_named(tmp_path: Path) -> None:
    mosaic = photograph(ALPHA, 1, 3200, 10)
    black = int(ALPHA.sensor.black_level_dn[0])
    amplified = mosaic.astype(np.float64)
    amplified[::2, ::2] = black + 1.5 * (amplified[::2, ::2] - black)  # the red sites
    found = estimate_profile(frame_of(ALPHA, np.rint(amplified).astype(np.uint16), tmp_path / "none.dng"))
    assert found.line is not None
    assert found.line.channels_differ
    assert any("K of the packed channels differs" in remark for remark in found.remarks)
    assert found.line.slope_error > noise_line(packed(ALPHA, mosaic)).slope_error


@pytest.mark.parametrize(
    ("level", "words"), [(0.0, "too little light to show it"), (9000.0, "has no dark smooth parts")]
)
def test_a_figure_that_a_photograph_does_not_show_makes_no_profile(level: float, words: str, tmp_path: Path) -> None:
    """No light at all, and an even grey whose brightness varies by a tenth."""
    generator = np.random.default_rng(7)
    light = level * np.linspace(0.95, 1.05, SIZE[1]) / 3 * np.ones((SIZE[0], 1))
    mosaic = np.rint(512 + 3 * generator.poisson(light) + generator.normal(0, 5, SIZE)).astype(np.uint16)
    found = estimate_profile(frame_of(ALPHA, mosaic, tmp_path / "none.dng"))
    assert found.profile is None
    assert [words in problem for problem in found.problems] == [True]


def test_the_profile_has_one_row_and_says_what_it_does_not_know(tmp_path: Path) -> None:
    path = tmp_path / "IMG_1.dng"
    write_dng(path, photograph(BETA, 3, 3200, 10), BETA.sensor, Exposure(iso=Fraction(3200)))
    found = estimate_profile(path)
    assert (found.source, found.problems) == ("pixels", ())
    assert found.profile is not None
    found.profile.save(tmp_path / "camera.json")
    profile = CameraProfile.load(tmp_path / "camera.json")
    assert profile == found.profile
    (row,) = profile.rows
    assert (row.iso, row.sigma_row_dn, profile.black_level_dn) == (3200, None, 2049)
    assert any("row noise and colour bias are not known and 0 here" in note for note in profile.notes)
    parameters = profile.sample(np.random.default_rng(0), iso=3200)
    measured = found.measured
    assert measured is not None
    gain = BETA.gain_dn_per_e(3200)
    assert abs(parameters.gain_dn_per_e - gain) < 5 * measured.gain_error  # type: ignore[operator] # pixels have one
    sigma = float(np.hypot(gain * BETA.sigma_read_e, BETA.sigma_quantiser_dn))
    assert abs(parameters.sigma_gauss_dn - sigma) < 5 * measured.sigma_error  # type: ignore[operator]
    assert measured.sigma_error < 0.1 * sigma  # type: ignore[operator]


def tagged(path: Path, *numbers: float) -> Path:
    """A file of 16000 DN above black whose gain is 2 DN/e- and whose read noise is 5 DN, and a NoiseProfile."""
    generator = np.random.default_rng(9)
    light = np.linspace(0, 600, SIZE[1]) * np.ones((SIZE[0], 1))
    mosaic = np.rint(500 + 2 * generator.poisson(light / 2) + generator.normal(0, 5, SIZE)).clip(0).astype(np.uint16)
    value = struct.pack(f"<{len(numbers)}d", *numbers)
    tags: Any = ((50714, "I", 1, 500, True), (51041, "d", len(numbers), value, True))
    write_plain_dng(path, mosaic, ("RG", "GB"), *tags, white=16500)
    return path


@pytest.mark.parametrize(
    ("numbers", "gain", "variance"),
    [
        ((2 / 16000, 25 / 16000**2), 2.0, 25.0),
        ((1 / 16000, 40 / 16000**2, 2 / 16000, 80 / 16000**2, 3 / 16000, 120 / 16000**2), 2.0, 80.0),  # green twice
    ],
)
def test_a_noise_profile_is_taken_and_held_against_the_pixels(
    numbers: tuple[float, ...], gain: float, variance: float, tmp_path: Path
) -> None:
    found = estimate_profile(tagged(tmp_path / "a.dng", *numbers))
    assert (found.source, found.problems) == ("tag", ())
    assert found.stated is not None
    assert found.stated.gain_dn_per_e == pytest.approx(gain)
    assert found.stated.variance_dn2 == pytest.approx(variance - 1 / 12)
    off = [remark for remark in found.remarks if "standard errors off what the pixels show" in remark]
    assert len(off) == (variance != 25)
    assert any("slopes differ by colour, 200%" in remark for remark in found.remarks) == (len(numbers) == 6)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((1e-4, 1e-8, 1e-4), "has 3 numbers"),
        ((-1e-4, 1e-8), "is not one of a camera"),
        ((1e300, 1e-8), "is not one of a camera"),
        ((float("nan"), 1e-8), "has no NoiseProfile"),
    ],
)
def test_a_noise_profile_that_cannot_be_is_not_taken(numbers: tuple[float, ...], words: str, tmp_path: Path) -> None:
    path = tagged(tmp_path / "a.dng", *numbers)
    found = estimate_profile(path, source="tag")
    assert found.profile is None
    assert words in found.problems[0]
    assert estimate_profile(path).source == "pixels"


def test_wrong_arguments_are_named(tmp_path: Path) -> None:
    frame = packed(ALPHA, photograph(ALPHA, 1, 3200, 10))
    with pytest.raises(ArgumentError, match=r"floating numbers; found float32 \(192, 288\)"):
        noise_line(frame[0])
    with pytest.raises(ArgumentError, match="usable has the frame's shape"):
        noise_line(frame, frame[0] > 0)
    with pytest.raises(ArgumentError, match="NaN or infinity"):
        noise_line(np.full_like(frame, np.nan))
    with pytest.raises(DatasetError, match="shows no noise"):
        noise_line(np.zeros_like(frame))
    with pytest.raises(DatasetError, match="too small"):
        noise_line(frame[:, :8, :8])
    with pytest.raises(ArgumentError, match="source must be one of"):
        estimate_profile(frame_of(ALPHA, photograph(ALPHA, 1, 3200, 10), tmp_path), source="exif")  # type: ignore[arg-type]


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    camera = replace(ALPHA, sensor=replace(ALPHA.sensor, model="Demo\nAlpha"))
    write_dng(tmp_path / "a.dng", photograph(ALPHA, 1, 3200, 100), camera.sensor, Exposure(iso=Fraction(3200)))
    write_dng(tmp_path / "dark.dng", np.full(SIZE, 600, dtype=np.uint16), ALPHA.sensor, Exposure())

    def estimate(*arguments: str) -> int:
        parser = Parser(prog="eldata")
        add_module(parser.add_subparsers(), command)
        return run(parser, ["profile", "estimate", *arguments])

    assert estimate("a.dng", "-o", "camera.json", "--json", "found.json") == 0
    assert "pixels        K " in capsys.readouterr().out
    assert CameraProfile.load("./camera.json").iso_range == (3200, 3200)
    assert json.loads((tmp_path / "found.json").read_text())["source"] == "pixels"
    assert estimate("dark.dng", "-o", "none.json") == 1
    shown = capsys.readouterr().out
    assert "no profile: the frame shows no noise" in shown
    assert "none.json was not written" in shown
    assert not (tmp_path / "none.json").exists()


def test_no_unit_is_preferred() -> None:
    frame = packed(ALPHA, photograph(ALPHA, 1, 3200, 10))
    line, scaled = noise_line(frame), noise_line(frame / 1024)
    assert scaled.windows == line.windows
    assert scaled.slope * 1024 == pytest.approx(line.slope, rel=1e-4)
    assert scaled.offset * 1024**2 == pytest.approx(line.offset, rel=1e-4)
