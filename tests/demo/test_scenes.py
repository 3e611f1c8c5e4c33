from __future__ import annotations

import itertools

import numpy as np

from eldata.demo import scenes
from tests.cases import in_one_test

BASE = (1, 2, 3, 4)
NUMBERS = (*BASE, 5, 6, 7, 8, 1001)
SIZES = ((64, 64), (65, 97), (256, 384), (301, 200), (64, 301))


@in_one_test("number", NUMBERS)
@in_one_test("height, width", SIZES)
def test_radiance_is_finite_float32_between_0_and_1(number: int, height: int, width: int) -> None:
    radiance = scenes.scene_radiance(number, height, width)
    assert radiance.shape == (3, height, width)
    assert radiance.dtype == np.float32
    assert np.isfinite(radiance).all()
    assert radiance.min() >= 0
    assert radiance.max() <= 1


@in_one_test("number", NUMBERS)
def test_scene_has_dark_and_bright_regions_and_small_highlights(number: int) -> None:
    radiance = scenes.scene_radiance(number, 256, 384)
    assert np.percentile(radiance, 1) < 5e-3
    assert np.percentile(radiance, 99.5) > 0.4
    assert 0 < (radiance == 1).mean() < 1e-3  # a glint may saturate, a surface may not


def test_scenes_and_their_variations_differ() -> None:
    pictures = {number: scenes.scene_radiance(number, 64, 96) for number in range(1, 13)}
    for one, other in itertools.combinations(pictures, 2):
        difference = np.abs(np.sqrt(pictures[one]) - np.sqrt(pictures[other])).mean()
        assert difference > 0.02, (one, other)


def test_a_scene_looks_the_same_at_two_sizes() -> None:
    for number in BASE:
        large = scenes.scene_radiance(number, 256, 384).reshape(3, 64, 4, 96, 4).mean((2, 4))
        small = scenes.scene_radiance(number, 64, 96)
        assert np.abs(np.sqrt(large) - np.sqrt(small)).mean() < 0.02, number


def test_patches_hold_the_declared_colours_times_the_light() -> None:
    stage, radiance = scenes._Stage(1, 256, 384), scenes.scene_radiance(1, 256, 384)
    declared = np.asarray(scenes.CHART_SRGB).reshape(4, 6, 3) / 255
    declared = np.where(declared <= 0.04045, declared / 12.92, ((declared + 0.055) / 1.055) ** 2.4)
    for row, column in np.ndindex(4, 6):
        right, down = map(int, stage.pixel(-0.40 + 0.282 * (column - 2.5), -0.04 + 0.282 * (row - 1.5)))
        light = stage.light[:, down, right]
        np.testing.assert_allclose(radiance[:, down, right], declared[row, column] * light, rtol=1e-5)
