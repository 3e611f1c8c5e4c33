"""Dark shading: lines over ISO come back from bias frames of a sensor that this file alone simulates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.calibration import Finding, ShadingFit, calibrate, dark_shading
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import DarkShading
from tests.calibration.in_memory import stacked
from tests.calibration.simulation import Camera
from tests.calibration.trees import FrameTree, rewritten

CFA = ((1, 0), (2, 3))
SHAPE = (96, 128)
BLACK = (512.0, 511.5, 512.25, 512.0)
BLACK_DN = np.tile(np.array(BLACK)[np.array(CFA)], (SHAPE[0] // 2, SHAPE[1] // 2))
FRAMES = 9
SPEEDS = (100, 200, 400, 800, 1600, 3200, 6400)
STEP = 2000  # from here on another conversion gain


@dataclass(frozen=True)
class Truth:
    slope: NDArray[np.float64]  # (2, H, W), DN per ISO
    offset: NDArray[np.float64]  # (2, H, W), DN
    levels: dict[int, NDArray[np.float64]]  # DN, by CFA channel
    hot: NDArray[np.bool_]

    @staticmethod
    def sigma(iso: int) -> float:
        return 1.5 + iso / 800

    def shading(self, iso: int) -> NDArray[np.float64]:
        mode = int(iso >= STEP)
        level = np.tile(self.levels[iso][np.array(CFA)], (SHAPE[0] // 2, SHAPE[1] // 2))
        found: NDArray[np.float64] = self.slope[mode] * iso + self.offset[mode] + level
        return found

    def frame(self, iso: int, generator: np.random.Generator) -> NDArray[np.uint16]:
        noise = generator.normal(0.0, self.sigma(iso), SHAPE)
        return np.rint(BLACK_DN + self.shading(iso) + noise + 400.0 * self.hot).astype(np.uint16)


pattern_of = partial(stacked, Camera(cfa=CFA))


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Slopes that differ from pixel to pixel and across the frame, by 1 to 2 sigma; 12 hot pixels, two of them near."""
    generator = np.random.default_rng(16)
    across = np.linspace(-1, 1, SHAPE[1])[None, None] * np.array([1.0, -0.5])[:, None, None]
    hot = np.zeros(SHAPE, dtype=np.bool_)
    hot.ravel()[generator.choice(hot.size, 10, replace=False)] = True
    hot[40, 50] = hot[40, 52] = True
    return Truth(
        slope=2e-3 * across + generator.normal(0.0, 1e-3, (2, *SHAPE)),
        offset=across + generator.normal(0.0, 0.5, (2, *SHAPE)),
        levels={iso: generator.normal(0.0, 2.0, 4) for iso in SPEEDS},
        hot=hot,
    )


@pytest.fixture(scope="module")
def shading(truth: Truth) -> DarkShading:
    fit, generator = ShadingFit((STEP,)), np.random.default_rng(17)
    for iso in generator.permutation(SPEEDS).tolist():  # in any order
        fit.add(iso, pattern_of([truth.frame(iso, generator) for _ in range(FRAMES)]), BLACK, (0.1,) * 4)
    return fit.shading("Simulated", "a test")


def test_the_shading_comes_back_within_its_standard_errors(truth: Truth, shading: DarkShading) -> None:
    """Of 12276 sound pixels, the standard deviation of z is 1 +- 0.0064: five of these, and 1 % for what rounding adds.

    Hot pixels are masked, and stay. A frame's own level is that of its pixels, so the mean over the pixels is known to
    sigma / sqrt(9 x 12276).
    """
    assert np.array_equal(shading.hot, truth.hot)
    assert np.abs(shading.at(6400)[shading.hot]).max() < 40, "not the 400 DN that the pixel itself has"
    sound = ~shading.hot
    for iso in SPEEDS:
        off = (shading.at(iso) - truth.shading(iso))[sound]
        error = shading.error_dn(iso)
        assert off.std() / error == pytest.approx(1.0, abs=0.042), iso
        assert abs(off.mean()) < 5 * truth.sigma(iso) / np.sqrt(FRAMES * off.size) + 0.002, iso
        if iso < STEP:
            assert error < truth.sigma(iso) / 3, "five ISOs help each other"


def test_slopes_and_offsets_come_back(truth: Truth, shading: DarkShading) -> None:
    """Against numpy's own weighted line; a channel's level lies in BLE as far as no line over ISO can hold it."""
    place = np.array(CFA)[np.arange(SHAPE[0])[:, None] % 2, np.arange(SHAPE[1]) % 2]
    for mode, speeds in enumerate((SPEEDS[:5], SPEEDS[5:])):
        weights = np.array([np.sqrt(FRAMES) / truth.sigma(iso) for iso in speeds])  # polyfit squares them
        slope_of, offset_of = np.polyfit(speeds, np.stack([truth.levels[iso] for iso in speeds]), 1, w=weights)
        covariance = np.linalg.inv(np.einsum("i,ij,ik->jk", weights**2, *2 * [np.vander(speeds, 2)]))
        for name, found, true, error in (
            ("k", shading.slope_dn[mode], truth.slope[mode] + slope_of[place], np.sqrt(covariance[0, 0])),
            ("b", shading.offset_dn[mode], truth.offset[mode] + offset_of[place], np.sqrt(covariance[1, 1])),
        ):
            z = ((found - true) / error)[~shading.hot]
            assert z.std() == pytest.approx(1.0, abs=0.042), (mode, name)
            assert abs(z.mean()) < 5 / np.sqrt(z.size) + 0.01, (mode, name)
        for iso in speeds:
            over = truth.levels[iso] - slope_of * iso - offset_of
            tolerance = 5 * truth.sigma(iso) / np.sqrt(FRAMES * SHAPE[0] * SHAPE[1] / 4) + 0.01
            np.testing.assert_allclose(shading.measured(iso).level_error_dn, over, atol=tolerance)


def test_what_is_left_of_the_noise(truth: Truth) -> None:
    """Less the shading, a frame that it is from keeps 1 - h of its variance, another one 1 + h.

    Of 12288 pixels a variance is known to 1.3 %; weights by known frames: +- 5 of these, 6.5 %, where h is 0.1 or more.
    """
    generator = np.random.default_rng(18)
    fit, kept = ShadingFit(), {}
    for iso in (800, 1600):
        frames = [truth.frame(iso, generator) for _ in range(4)]
        fit.add(iso, pattern_of(frames), BLACK, (0.1,) * 4)
        kept[iso] = frames[0], truth.frame(iso, generator)
    shading = fit.shading("Simulated", "a test")
    for iso, (within, without) in kept.items():
        assert shading.leverage(iso) == pytest.approx(0.25)  # two ISOs, two parameters: a quarter of its own mean
        for frame, share in ((within, 0.75), (without, 1.25)):
            left = (frame - BLACK_DN - shading.at(iso))[~shading.hot]
            assert left.var() / (truth.sigma(iso) ** 2 + 1 / 12) == pytest.approx(share, rel=0.065), iso


def test_a_fit_refuses_what_does_not_go_together() -> None:
    generator = np.random.default_rng(3)

    small, other = (
        pattern_of(list(generator.normal(512, 3, (4, *shape)).astype(np.uint16))) for shape in ((32, 32), (32, 36))
    )
    fit = ShadingFit()
    with pytest.raises(DatasetError, match="Simulated: no ISO gives a dark shading: there are none"):
        fit.shading("Simulated", "a test")
    fit.add(100, small, BLACK, (0.1,) * 4)
    with pytest.raises(ArgumentError, match="ISO 200: the frames have"):
        fit.add(200, other, BLACK, (0.1,) * 4)
    alone = fit.shading("Simulated", "a test")
    assert not alone.slope_dn.any(), "one ISO has no slope"
    assert alone.error_dn(100) == pytest.approx(alone.isos[0].sigma_dn / 2)


def test_modes_and_isos_are_the_calibrations(tree: FrameTree) -> None:
    """Stated modes count; else those found, and what lies between two of them or has a withheld level is left out."""
    frames = tree.frames()
    found = calibrate(frames)
    (fitted_mode,) = found.modes
    stated = dark_shading(frames, found, modes=[400])
    assert [(one.iso, one.mode) for one in stated.isos] == [(100, 0), (400, 1), (1600, 1)]
    assert stated.notes == ()
    assert dark_shading(frames, found, modes=[400], workers=2).digest == stated.digest
    two = tuple(replace(fitted_mode, mode=replace(fitted_mode.mode, iso_range=(iso, iso))) for iso in (100.0, 1600.0))
    apart = dark_shading(frames, replace(found, modes=two))
    assert [(one.iso, one.mode) for one in apart.isos] == [(100, 0), (1600, 1)]
    assert apart.notes == ("ISO 400 was left out: it lies between two gain modes, and no K tells of which it is",)
    lit = Finding("light", ("colour bias",), "withheld", 9.0, 5.0, "brighter frames are noisier")
    isos = (replace(found.isos[0], findings=(lit,)), *found.isos[1:])
    dimmer = dark_shading(frames, replace(found, isos=isos))
    assert [one.iso for one in dimmer.isos] == [400, 1600]
    assert dimmer.notes == ("ISO 100 was left out: brighter frames are noisier",)
    assert dimmer.source.endswith("12 bias frames at 2 ISOs")
    accepted = (replace(found.isos[0], findings=(replace(lit, effect="wider", is_accepted=True),)), *found.isos[1:])
    assert dark_shading(frames, replace(found, isos=accepted)).notes == dimmer.notes
    with pytest.raises(DatasetError, match="no ISO gives a dark shading: ISO 100 was left out: brighter frames"):
        dark_shading(frames, replace(found, isos=isos[:1]))
    for path in tree.files("bias", 1600):  # as by a converter that subtracts black
        rewritten(path, mosaic=lambda dn: np.maximum(dn, 512) - np.uint16(512), black_level_dn=(0.0,) * 4)
    clipped = dark_shading(frames, found)
    assert [one.iso for one in clipped.isos] == [100, 400]
    assert clipped.notes == ("ISO 1600 was left out: black is clipped, so the mean of a pixel is not its level",)
    assert clipped.source.endswith("12 bias frames at 2 ISOs")
