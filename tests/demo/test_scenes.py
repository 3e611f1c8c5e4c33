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


def test_same_number_gives_the_same_bytes_whatever_the_global_random_state() -> None:
    first = scenes.scene_radiance(6, 96, 128)
    np.random.seed(1)  # noqa: NPY002 - the global state is what must not matter
    assert scenes.scene_radiance(6, 96, 128).tobytes() == first.tobytes()


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


@in_one_test("number", [1, 5, 9, 13])
def test_patch_centres_hold_the_declared_colours_times_the_light(number: int) -> None:
    stage = scenes._painted(number, 256, 384)
    radiance = scenes.scene_radiance(number, 256, 384)
    declared = np.asarray(scenes.CHART_SRGB) / 255
    declared = np.where(declared <= 0.04045, declared / 12.92, ((declared + 0.055) / 1.055) ** 2.4)
    found = [colour for _, _, colour in stage.patches]
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(declared, axis=0), rtol=1e-6)
    for row, column, colour in stage.patches:
        np.testing.assert_allclose(radiance[:, row, column], colour * stage.light[:, row, column], rtol=1e-5)


def test_titles() -> None:
    titles = [scenes.scene_title(number) for number in range(1, 13)]
    assert titles[:4] == list(scenes.TITLES)
    assert len(set(titles)) == 12
    assert titles[4] == "Colour chart, variation 1"
