"""Intervals over scenes: against scipy where scenes are balanced, how often they hold the truth, and at the edges."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray

from eldata.errors import ArgumentError
from eldata.evaluation.scores import UnitScore
from eldata.evaluation.statistics import (
    FEWEST_SCENES,
    interval_of_mean,
    interval_of_scores,
    list_clusters,
    paired_difference,
    sign_flip_p_value,
)

IMAGES = 6  # of a scene, as in ELD
SCENE_SIGMA, IMAGE_SIGMA = 3.0, 1.0  # dB; scenes differ by more than images of one do


def scores(generator: np.random.Generator, scenes: int, mean: float = 40.0) -> tuple[NDArray[np.float64], list[int]]:
    """Scores of images that share their scene's level, and the scene of each."""
    levels = generator.normal(mean, SCENE_SIGMA, scenes)
    values = np.repeat(levels, IMAGES) + generator.normal(0, IMAGE_SIGMA, scenes * IMAGES)
    return values, list(np.repeat(np.arange(scenes), IMAGES))


# --- several cameras on the same scenes ---------------------------------------------------------------------------

CAMERAS, SCENES = 4, 10
SETS = 4000  # the standard error of a share of 95 % is 0.34 %


def of_cameras(values: NDArray[np.float64], *, named_apart: bool = False) -> list[UnitScore]:
    """Scores (cameras, scenes, images), of scenes that have the same names for each camera, or names of their own."""

    def score(c: int, s: int, i: int) -> UnitScore:
        scene = f"{c if named_apart else ''}scene-{s}"
        return UnitScore(f"{c}/{s}/{i}", f"camera-{c}", scene, 800, 100, {"psnr_db": float(values[c, s, i])})

    return [score(*place) for place in np.ndindex(values.shape)]


def differences(generator: np.random.Generator, shared: float) -> NDArray[np.float64]:
    """Differences between two methods (cameras, scenes, images) of mean 0, 0.3 dB from scene to scene.

    ``shared`` is the share of that variance which all cameras have in common on a scene; the rest is each camera's.
    """
    of_scene = math.sqrt(shared) * generator.normal(0, 0.3, (1, SCENES, 1))
    of_camera = math.sqrt(1 - shared) * generator.normal(0, 0.3, (CAMERAS, SCENES, 1))
    return of_scene + of_camera + generator.normal(0, 0.1, (CAMERAS, SCENES, IMAGES))


@pytest.mark.study
@pytest.mark.parametrize("shared", [0.0, 0.9])
@pytest.mark.parametrize("each", [[4] * 10, [1, 2, 3, 4, 1, 2, 3, 4, 1, 2]])  # how many cameras photographed a scene
def test_intervals_over_cameras_hold_the_truth_and_equal_methods_are_seldom_called_different(
    shared: float, each: list[int]
) -> None:
    """4000 sets of 4 cameras and 10 scenes, 0.25 dB apart: 0.95 +- 4 x 0.0034, within 0.93 to 0.965.
    Of scenes that fewer cameras photographed than others, intervals hold it in 0.94: 2.7 standard errors above 0.93.

    Of equal methods 5 % are called different: by intervals that leave out 0, and by p-values of 0.05 and less, which
    are multiples of 2 / 1024. Bounds of 0.04 and 0.065 are 2.7 and 4.5 standard errors from the largest below, 0.0488.
    """
    generator = np.random.default_rng([14, round(10 * shared)])
    there = (np.arange(CAMERAS)[:, None] < each).repeat(IMAGES)
    every = list_clusters(of_cameras(differences(generator, shared)), scenes_shared=True)
    scenes = [scene for scene, kept in zip(every, there, strict=True) if kept]
    within = different = apart = 0
    for _ in range(SETS):
        equal, first = differences(generator, shared).ravel()[there], np.full(len(scenes), 40.0)
        found = paired_difference(first, first + 0.25 + equal, scenes).interval
        within += found.low <= 0.25 <= found.high
        null = paired_difference(first, first + equal, scenes)
        different += null.p_value <= 0.05
        apart += null.interval.sign != 0
    assert 0.93 <= within / SETS <= 0.965
    for share in (different / SETS, apart / SETS):
        assert 0.04 <= share <= 0.065


def test_what_counts_as_one_scene() -> None:
    values = differences(np.random.default_rng(16), 0.5)
    same, own = of_cameras(values), of_cameras(values, named_apart=True)
    together, apart, named = (
        interval_of_scores(of, "psnr_db", scenes_shared=shared)
        for of, shared in ((same, True), (same, False), (own, True))
    )
    assert (together.scenes, apart.scenes, named.scenes) == (SCENES, CAMERAS * SCENES, CAMERAS * SCENES)
    assert named == apart, "scenes of other names are other scenes, whatever the card says"
    theirs = scipy.stats.ttest_1samp(values.mean(axis=(0, 2)), 0).confidence_interval(0.95)
    assert (together.low, together.high) == pytest.approx((theirs.low, theirs.high), rel=1e-9)


# --- against scipy ------------------------------------------------------------------------------------------------


def test_as_scipys_students_interval_of_scene_means_where_scenes_are_balanced() -> None:
    """Which holds the truth of normal scores as often as it says."""
    values, scenes = scores(np.random.default_rng(8), 15)
    mine = interval_of_mean(values, scenes)
    theirs = scipy.stats.ttest_1samp(values.reshape(15, IMAGES).mean(axis=1), 0).confidence_interval(0.95)
    assert mine.mean == pytest.approx(values.mean(), rel=1e-14)
    assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high), rel=1e-12)
    others, _ = scores(np.random.default_rng(9), 15)
    means = [each.reshape(15, IMAGES).mean(axis=1) for each in (others, values)]
    theirs = scipy.stats.ttest_rel(*means).confidence_interval(0.95)
    mine = paired_difference(values, others, scenes).interval
    assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high), rel=1e-12)


def test_scenes_of_unequal_size_are_left_out_one_by_one() -> None:
    """The jackknife, written plainly: the mean over the images of all scenes but one, for each of them."""
    generator = np.random.default_rng(13)
    sizes = [1, 2, 3, 4, 5, 6, 7, 30]
    of = [list(generator.normal(level, 1, size)) for level, size in zip(generator.normal(40, 3, 8), sizes, strict=True)]
    values, scenes = [v for one in of for v in one], [n for n, size in enumerate(sizes) for _ in range(size)]
    without = [np.mean([v for n, one in enumerate(of) if n != left for v in one]) for left in range(8)]
    deviation = math.sqrt(7 / 8 * sum((mean - np.mean(values)) ** 2 for mean in without))
    half = float(scipy.stats.t.ppf(0.975, 7)) * deviation
    found = interval_of_mean(values, scenes)
    assert (found.low, found.high) == pytest.approx((np.mean(values) - half, np.mean(values) + half), rel=1e-12)


def test_p_value_is_scipys_where_each_scene_has_one_image() -> None:
    """Exact: both go through all 2^9 choices of signs."""
    differences = np.random.default_rng(10).normal(0.3, 0.5, 9)
    theirs = scipy.stats.permutation_test(
        (differences,), np.sum, permutation_type="samples", n_resamples=1000, alternative="two-sided"
    )
    assert sign_flip_p_value(differences, range(9)) == pytest.approx(float(theirs.pvalue), abs=1e-12)


def test_p_value_written_plainly_with_unequal_scenes() -> None:
    differences, scenes = [1.0, 2.0, -0.5, 0.25, -3.0, 0.75, 1.5], ["a", "a", "b", "c", "d", "d", "e"]
    sums = [3.0, -0.5, 0.25, -2.25, 1.5]
    reached = [
        abs(sum(sign * value for sign, value in zip(signs, sums, strict=True))) >= abs(sum(sums)) - 1e-12
        for signs in itertools.product((1, -1), repeat=5)
    ]
    assert sign_flip_p_value(differences, scenes) == sum(reached) / 32


def test_many_scenes_draw_signs_and_agree_with_the_normal_law() -> None:
    """100 scenes: the sum over its deviation is normal. p = 0.05 to 0.3, standard error below sqrt(.25 / 9999)."""
    differences = np.random.default_rng(11).normal(0.1, 1.0, 100)
    z = abs(differences.sum()) / math.sqrt((differences**2).sum())
    expected = 2 * float(scipy.stats.norm.sf(z))
    assert sign_flip_p_value(differences, range(100)) == pytest.approx(expected, abs=4 * 0.005 + 0.01)


# --- what it does at the edges ------------------------------------------------------------------------------------


def test_few_scenes_or_none_have_no_interval() -> None:
    values, images = scores(np.random.default_rng(1), FEWEST_SCENES - 1)
    few = interval_of_mean(values, images)
    assert not few.is_known
    assert few.mean == pytest.approx(values.mean())
    assert interval_of_mean(*scores(np.random.default_rng(1), FEWEST_SCENES)).is_known
    nothing = interval_of_mean([], [])
    assert math.isnan(nothing.mean)
    assert (nothing.images, nothing.scenes) == (0, 0)
    assert math.isnan(sign_flip_p_value([], []))


@pytest.mark.parametrize("bad", [math.inf, math.nan])
def test_what_is_not_finite_gives_no_interval_and_no_p(bad: float) -> None:
    values, scenes = scores(np.random.default_rng(1), 8)
    equal = paired_difference(values, values, scenes)
    assert (equal.interval.mean, equal.interval.low, equal.interval.high, equal.p_value) == (0.0, 0.0, 0.0, 1.0)
    values[3] = bad
    found = interval_of_mean(values, scenes)
    assert not found.is_known
    assert found.mean == pytest.approx(bad, nan_ok=True)
    difference = paired_difference(np.full(48, 40.0), values, scenes)
    assert not difference.interval.is_known
    assert math.isnan(difference.p_value)
    assert math.isnan(paired_difference(values, values, scenes).interval.mean), "two perfect scores"


def test_wrong_arguments() -> None:
    with pytest.raises(ArgumentError, match="2 values and 1 scenes"):
        interval_of_mean([1.0, 2.0], ["a"])
    with pytest.raises(ArgumentError, match="same images; found 1 and 2"):
        paired_difference([1.0], [1.0, 2.0], ["a"])
