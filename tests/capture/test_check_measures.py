"""The measures of `capture check` on simulated mosaics: what they find is what was put in, within their own errors."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.check.calibration import PATCHES, measure_patches, measure_unevenness
from capture.check.frames import Cells, find_saturation_dn, luminance, reduce_to_cells
from capture.check.ratio import fit_ratio, measure_brightness
from capture.check.result import Measure, MeasureKind
from capture.check.shift import cut_moved_tiles, make_tiles, measure_focus, measure_shift
from eldata.raw.levels import XTRANS_CFA, bayer_cfa, pack
from eldata.records import Exposure, Sensor
from tests.capture.planted_faults import Mishap, lit, moved, picture
from tests.capture.simulated_scenes import ALPHA, BETA, SIZE, Shot, radiance
from tests.shared import there

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.check.shift import Shift, Tiles
    from eldata.demo.camera import SimulatedCamera


def photographed(
    light: NDArray[np.float32], seed: int, *, iso: int = 100, ratio: int = 1, camera: SimulatedCamera = ALPHA
) -> NDArray[np.uint16]:
    body = camera.with_size(*light.shape[1:])
    return body.photograph(light, Fraction(100, iso * ratio), iso, np.random.default_rng([seed, iso, ratio]))


def cells_of(mosaic: NDArray[np.uint16], camera: SimulatedCamera = ALPHA) -> Cells:
    return reduce_to_cells(mosaic, camera.sensor, pack(mosaic, camera.sensor.cfa))


def cells_at(light: NDArray[np.float32], seed: int, *, camera: SimulatedCamera = ALPHA, **settings: int) -> Cells:
    return cells_of(photographed(light, seed, camera=camera, **settings), camera)


def grey_of(mosaic: NDArray[np.uint16], camera: SimulatedCamera = ALPHA) -> NDArray[np.float32]:
    packed = pack(mosaic, camera.sensor.cfa)
    return luminance(packed, reduce_to_cells(mosaic, camera.sensor, packed))


def shift_of(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[Tiles, Tiles, Shift]:
    """Tiles of two luminances that lie on the same pixels, and what is left of a shift between them."""
    tiles = make_tiles(first)
    cut = there(None if tiles is None else cut_moved_tiles(tiles, second))
    assert cut[2] == (0, 0)
    shift = there(measure_shift(cut[0], cut[1]))
    return cut[0], cut[1], shift


# --- cells --------------------------------------------------------------------------------------------------------


def test_cells_are_the_means_over_black() -> None:
    mosaic = photographed(radiance(1), 1, camera=BETA)
    cells = cells_of(mosaic, BETA)
    packed = pack(mosaic, BETA.sensor.cfa).astype(np.float64)
    expected = packed.reshape(4, 48, 4, 72, 4).mean(axis=(2, 4)) - np.array([2047, 2048, 2049, 2048])[:, None, None]
    np.testing.assert_allclose(cells.mean_dn, expected, rtol=1e-5, atol=1e-2)
    assert cells.colours == ("R", "G", "B", "G")
    assert not cells.clipped.any()


@pytest.mark.parametrize(
    ("cfa", "colours", "mean_dn"),
    [
        (XTRANS_CFA, "RGBRBGGGG", [400, 399, 398, 400, 398, 399, 399, 399, 399]),
        (bayer_cfa("BGGR", block=2), "RRRRGGGGBBBBGGGG", [400] * 4 + [399] * 4 + [398] * 4 + [397] * 4),
    ],
)
def test_cells_of_other_patterns_and_of_odd_sizes(cfa: Any, colours: str, mean_dn: list[int]) -> None:
    black_dn = tuple(100.0 + channel for channel in range(1 + max(map(max, cfa))))
    sensor = Sensor("", "", cfa, black_dn, 1000.0, 61, 80)
    mosaic = np.full((61, 80), 500, dtype=np.uint16)
    mosaic[0, 0] = 1000
    cells = reduce_to_cells(mosaic, sensor, pack(mosaic, sensor.cfa))
    assert "".join(cells.colours) == colours
    assert cells.mean_dn[:, 1, 1].tolist() == mean_dn
    assert int(cells.clipped.sum()) == 1
    assert cells.clipped_share == pytest.approx(1 / mosaic.size, rel=0.1)


def test_saturation_below_the_recorded_white_level_is_seen() -> None:
    """A Canon at ISO 100 clips at 13583 where its files say 15303, with some spread from pixel to pixel."""
    light = radiance(2) * np.float32(2)
    body = BETA.with_size(*SIZE)
    mosaic = photographed(light, 1, camera=BETA)
    level = np.random.default_rng(0).normal(13583, 2, mosaic.shape)
    clipped = np.minimum(mosaic, np.rint(level)).astype(np.uint16)
    assert find_saturation_dn(photographed(radiance(1), 1, camera=BETA), body.sensor) == body.sensor.white_level_dn
    found = find_saturation_dn(clipped, body.sensor)
    assert 13560 < found <= 13583
    true_share = np.count_nonzero(mosaic >= 13583) / mosaic.size
    assert true_share > 0.01
    assert cells_of(clipped, BETA).clipped_share == pytest.approx(true_share, rel=0.05)


# --- drift --------------------------------------------------------------------------------------------------------


def test_drift_to_a_tenth_of_a_percent() -> None:
    """Ten scenes, four channels, drifts of -5 to 5 %: accurate, and within the standard errors as normal errors are."""
    off = []
    for scene, percent in zip(range(1, 11), (-5, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 5), strict=True):
        camera = (ALPHA, BETA)[scene % 2]
        first = cells_at(radiance(scene), 1, camera=camera)
        light = radiance(scene) * np.float32(1 + percent / 100)
        second = cells_at(light, 2, camera=camera)
        ratios = [one for one in measure_brightness(first, second) if one is not None]
        assert len(ratios) >= 3
        assert [one.value for one in ratios] == pytest.approx([1 + percent / 100] * len(ratios), abs=1e-3)
        off += [(one.value - 1 - percent / 100) / one.standard_error for one in ratios]
    # Some 40 values: 95.4 % within two, less four standard deviations of the share.
    assert np.mean(np.abs(off) < 2) > 0.954 - 4 * (0.954 * 0.046 / len(off)) ** 0.5


# --- shift and focus ----------------------------------------------------------------------------------------------


def test_the_shift_of_unmoved_frames_is_within_its_error() -> None:
    off = []
    for scene in range(1, 5):
        first = grey_of(photographed(radiance(scene), 1))
        for seed in range(2, 7):
            _, _, shift = shift_of(first, grey_of(photographed(radiance(scene), seed)))
            off += [one.value / one.standard_error for one in shift]
    # 40 values, in groups of five with one first frame: 68 % within one; four standard deviations are 30 %.
    assert 0.38 < np.mean(np.abs(off) < 1) < 0.98
    assert max(np.abs(off)) < 5


def test_a_picture_without_detail_has_no_shift() -> None:
    even = np.full((3, *SIZE), 0.3, dtype=np.float32)
    tiles = there(make_tiles(grey_of(photographed(even, 1))))
    cut = cut_moved_tiles(tiles, grey_of(photographed(even, 2)))
    assert cut is None or measure_shift(cut[0], cut[1]) is None
    assert make_tiles(np.zeros((20, 20), dtype=np.float32)) is None


@pytest.mark.parametrize(("sigma", "least", "most"), [(0.5, 0.90, 0.99), (2.0, 0.3, 0.8)])
def test_focus_falls_with_blur_and_noise_does_not_matter(sigma: float, least: float, most: float) -> None:
    light = radiance(2)
    blurred = Shot(light, 100, Fraction(1), Exposure()).blurred(sigma).radiance
    values = []
    for iso in (100, 3200):  # the latter with some thirty times the noise's variance
        found = shift_of(grey_of(photographed(light, 1, iso=iso)), grey_of(photographed(blurred, 2, iso=iso)))
        focus = there(measure_focus(*found, 1.0))
        values.append(focus.value)
    assert least < values[0] < most
    assert values[1] == pytest.approx(values[0], abs=0.02)


# --- ratio --------------------------------------------------------------------------------------------------------


@pytest.mark.study
def test_the_ratio_is_within_its_standard_error() -> None:
    off, of_black = [], []
    for camera, (iso, ratio) in product((ALPHA, BETA), ((800, 1), (800, 100), (3200, 10), (3200, 200))):
        black_dn = camera.gain_dn_per_e(iso) * np.mean(camera.colour_bias_e)
        for index in range(5):
            light = radiance(1 + index % 4)
            reference = cells_at(light, 100 + index, camera=camera)
            fit = there(fit_ratio(reference, cells_at(light, index, iso=iso, ratio=ratio, camera=camera)))
            off.append((fit.slope.value * ratio - 1) / (fit.slope.standard_error * ratio))
            of_black.append((fit.black.value - black_dn) / fit.black.standard_error)
            assert fit.match.value == pytest.approx(1, abs=max(0.001, 5 * fit.match.standard_error))
    # Of 40 values 68 % within one, 95 % within two; less four standard deviations of the shares.
    for errors in (off, of_black):
        assert 0.38 < np.mean(np.abs(errors) < 1) < 0.98
        assert np.mean(np.abs(errors) < 2) > 0.82


@pytest.mark.parametrize("added_dn", [0, 8])
@pytest.mark.parametrize("mishap", [lit(0), lit(20), moved(3), lambda shot: shot.blurred(4)], ids=range(4))
def test_what_moved_or_was_lit_otherwise_has_no_other_black(mishap: Mishap, added_dn: int) -> None:
    """Bars and small print at ISO 1600 and x100, where 8 DN are 5 % of the range, and the colour bias is 0.3 %."""
    light = picture(3, SIZE)
    shot = mishap(Shot(light, 1600, Fraction(1), Exposure()))
    mosaic = photographed(shot.radiance, 2, iso=1600, ratio=100) + np.uint16(added_dn)
    reference = cells_at(light, 1)
    black = there(fit_ratio(reference, cells_of(mosaic), 100)).black
    value, error = (100 * one / reference.range_dn for one in (black.value, black.standard_error))
    assert (value > 0.01 + 5 * error) == bool(added_dn)


def test_black_that_is_off_and_hot_pixels_do_not_bend_the_ratio() -> None:
    reference = cells_at(radiance(1), 1)
    mosaic = photographed(radiance(1), 2, iso=1600, ratio=200) + np.uint16(12)
    generator = np.random.default_rng(3)
    hot = generator.random(mosaic.shape) < 3e-4
    mosaic[hot] += generator.integers(200, 3000, int(hot.sum()), dtype=np.uint16)
    fit = there(fit_ratio(reference, cells_of(mosaic)))
    ratio = there(fit.ratio)
    assert ratio.value == pytest.approx(200, abs=4 * ratio.standard_error)
    assert ratio.standard_error < 4
    assert fit.offset_dn == pytest.approx([12] * 4, abs=2)


def test_black_that_is_clipped_has_no_ratio() -> None:
    mosaic = photographed(radiance(1), 2, iso=3200, ratio=200)
    clipped = np.maximum(mosaic, 512) - np.uint16(512)
    sensor = Sensor("", "", ALPHA.sensor.cfa, (0.0,) * 4, 15871.0, *SIZE)
    cells = reduce_to_cells(clipped.astype(np.uint16), sensor, pack(clipped, sensor.cfa))
    assert cells.zero_share > 0.1
    assert fit_ratio(cells_at(radiance(1), 1), cells) is None


# --- bias and flats -----------------------------------------------------------------------------------------------


def test_patches_have_the_errors_that_they_state() -> None:
    dark = np.zeros((3, *SIZE), dtype=np.float32)
    levels = [measure_patches(cells_at(dark, seed, iso=1600)) for seed in range(20)]
    stack = np.stack([level for level, _ in levels])
    stated = float(np.mean([error for _, error in levels]))
    assert stack.shape == (20, PATCHES, PATCHES)
    found = float(stack.std(axis=0, ddof=1).mean())
    assert 0.7 * found < stated < 1.7 * found  # an error that is stated too large costs power, no false alarm


def test_unevenness_of_a_ramp() -> None:
    ramp = np.broadcast_to(np.linspace(0.2, 0.6, SIZE[1], dtype=np.float32), (3, *SIZE))
    # From the first to the last of 18 columns of blocks: 17/18 of 0.4, over the median 0.4.
    assert measure_unevenness(cells_at(np.ascontiguousarray(ramp), 1)) == pytest.approx(17 / 18, abs=0.01)


# --- verdicts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "error", "verdict"),
    [
        (0.9, 0.0, "keep"),
        (1.1, 0.0, "look"),
        (-1.1, 0.0, "look"),
        (2.1, 0.1, "shoot again"),
        (2.1, 0.5, "keep"),  # within five standard errors
        (float("nan"), 0.1, "keep"),
    ],
)
def test_a_value_is_beyond_a_limit_if_it_cannot_be_chance(value: float, error: float, verdict: str) -> None:
    measure = Measure(MeasureKind("drift", "%", 1.0, 2.0, "test", "advice"), "a.dng", "text", value, error)
    assert measure.verdict == verdict
