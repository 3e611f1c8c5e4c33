"""Intervals over scenes: how often they hold the truth, against scipy where each scene has one image, and at the edges.

Coverage is simulated: with N trials and a coverage c its standard error is sqrt(c (1 - c) / N); tolerances are four of
them, plus the shortfall that few scenes bring by theory (stated at each test).
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
import scipy.stats

from eldata.errors import ArgumentError
from eldata.evaluation.statistics import (
    FEWEST_SCENES,
    expanded_level,
    interval_of_mean,
    paired_difference,
    sign_flip_p_value,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

IMAGES = 6  # of a scene, as in ELD
SCENE_SIGMA, IMAGE_SIGMA = 3.0, 1.0  # dB; scenes differ by more than images of one do
TRIALS = 600


def scores(generator: np.random.Generator, scenes: int, mean: float = 40.0) -> tuple[NDArray[np.float64], list[int]]:
    """Scores of images that share their scene's level, and the scene of each."""
    levels = generator.normal(mean, SCENE_SIGMA, scenes)
    values = np.repeat(levels, IMAGES) + generator.normal(0, IMAGE_SIGMA, scenes * IMAGES)
    return values, list(np.repeat(np.arange(scenes), IMAGES))


def four_errors(share: float, trials: int) -> float:
    return 4 * math.sqrt(share * (1 - share) / trials)


# --- coverage -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scenes", [10, 40])
def test_intervals_hold_the_truth_as_often_as_they_say(scenes: int) -> None:
    """600 trials: 0.95 +- 4 x 0.0089. With 10 scenes 4000 trials gave 0.9405."""
    generator = np.random.default_rng(scenes)
    held = 0
    for _ in range(TRIALS):
        interval = interval_of_mean(*scores(generator, scenes), resamples=999)
        held += interval.low <= 40.0 <= interval.high
    assert held / TRIALS == pytest.approx(0.95, abs=four_errors(0.95, TRIALS) + 0.01)


def test_taking_images_for_independent_would_hold_the_truth_far_less_often() -> None:
    """Why scenes are drawn: the level of a scene adds 9 to a variance of 1 / 6 of 1, so that intervals over images are
    sqrt((9 + 1) / 6 / (9 + 1/6)) = 0.43 as wide as they should be, and hold the truth in about 60 % of cases."""
    generator = np.random.default_rng(5)
    held = 0
    for _ in range(TRIALS):
        values, _ = scores(generator, 40)
        interval = interval_of_mean(values, range(len(values)), resamples=499)
        held += interval.low <= 40.0 <= interval.high
    expected = 2 * float(scipy.stats.norm.cdf(1.96 * math.sqrt(10 / 6 / (9 + 1 / 6)))) - 1
    assert held / TRIALS == pytest.approx(expected, abs=four_errors(expected, TRIALS) + 0.02)


def test_paired_intervals_hold_the_difference_and_are_narrower() -> None:
    """Two methods on the same scenes, 0.3 dB apart: the scenes' levels cancel."""
    generator = np.random.default_rng(6)
    held = 0
    for _ in range(TRIALS):
        first, scenes = scores(generator, 12)
        second = first + 0.3 + np.repeat(generator.normal(0, 0.2, 12), IMAGES) + generator.normal(0, 0.1, len(first))
        difference = paired_difference(first, second, scenes, resamples=999)
        held += difference.interval.low <= 0.3 <= difference.interval.high
    assert held / TRIALS == pytest.approx(0.95, abs=four_errors(0.95, TRIALS) + 0.01)
    alone = interval_of_mean(first, scenes, resamples=999)
    found = difference.interval
    assert (found.high - found.low) < 0.2 * (alone.high - alone.low)


def test_p_values_of_equal_methods_are_spread_evenly() -> None:
    """Of 600 trials without a difference, a share a has p <= a: within four standard errors, for several a."""
    generator = np.random.default_rng(7)
    found = []
    for _ in range(TRIALS):
        differences = np.repeat(generator.normal(0, 0.5, 10), IMAGES) + generator.normal(0, 0.1, 60)
        found.append(sign_flip_p_value(differences, list(np.repeat(np.arange(10), IMAGES))))
    for share in (0.05, 0.2, 0.5, 0.8):
        assert np.mean(np.array(found) <= share) == pytest.approx(share, abs=four_errors(share, TRIALS) + 2**-9)


# --- against scipy ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0.8, 0.95])
def test_as_scipy_where_each_scene_has_one_image(level: float) -> None:
    """scipy's percentile interval at the expanded level. An end moves by chance: its standard error is
    sqrt(a (1 - a) / R) / density(a), about 0.03 s of the means' deviation s at a = 0.01 and R = 20000; four are 0.15 s
    for the difference of two."""
    values = np.random.default_rng(8).gamma(4, 2, 15)
    mine = interval_of_mean(values, range(15), level=level, resamples=20000, seed=3)
    theirs = scipy.stats.bootstrap(
        (values,),
        np.mean,
        confidence_level=expanded_level(level, 15),
        n_resamples=20000,
        method="percentile",
        rng=np.random.default_rng(9),
    )
    assert mine.mean == pytest.approx(values.mean(), rel=1e-14)
    tolerance = 0.15 * float(theirs.standard_error)
    assert mine.low == pytest.approx(theirs.confidence_interval.low, abs=tolerance)
    assert mine.high == pytest.approx(theirs.confidence_interval.high, abs=tolerance)


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


def test_expanded_level_makes_percentiles_of_normal_means_reach_students() -> None:
    """Of n normal values the bootstrap's deviation is s sqrt((n - 1) / n) / sqrt(n)."""
    for scenes in (6, 10, 40):
        quantile = float(scipy.stats.norm.ppf((1 + expanded_level(0.95, scenes)) / 2))
        assert quantile * math.sqrt((scenes - 1) / scenes) == pytest.approx(
            float(scipy.stats.t.ppf(0.975, scenes - 1)), rel=1e-9
        )


# --- what it does at the edges ------------------------------------------------------------------------------------


def test_same_seed_same_interval_and_another_another() -> None:
    values, scenes = scores(np.random.default_rng(1), 10)
    assert interval_of_mean(values, scenes) == interval_of_mean(values, scenes)
    assert interval_of_mean(values, scenes).low != interval_of_mean(values, scenes, seed=1).low


def test_pieces_of_memory_do_not_change_the_kind_of_result(monkeypatch: pytest.MonkeyPatch) -> None:
    from eldata.evaluation import statistics

    values, scenes = scores(np.random.default_rng(1), 20)
    whole = interval_of_mean(values, scenes), sign_flip_p_value(values - 40.2, scenes)
    monkeypatch.setattr(statistics, "_ENTRIES_AT_ONCE", 64)
    pieces = interval_of_mean(values, scenes), sign_flip_p_value(values - 40.2, scenes)
    assert pieces == whole  # the same draws in the same order


def test_order_of_images_within_a_scene_does_not_matter() -> None:
    values, scenes = scores(np.random.default_rng(1), 8)
    turned = interval_of_mean(values.reshape(8, IMAGES)[:, ::-1].ravel(), scenes)
    straight = interval_of_mean(values, scenes)
    assert turned.low == pytest.approx(straight.low, rel=1e-13)
    assert turned.high == pytest.approx(straight.high, rel=1e-13)


def test_mean_is_over_images_not_over_scenes() -> None:
    values = [1.0] * 10 + [2.0, 3.0, 4.0, 5.0, 6.0]
    scenes = ["a"] * 10 + list("bcdef")
    found = interval_of_mean(values, scenes)
    assert found.mean == pytest.approx(2.0)
    assert (found.images, found.scenes) == (15, 6)
    assert found.low < 2.0 < found.high


def test_few_scenes_have_no_interval() -> None:
    values, scenes = scores(np.random.default_rng(1), FEWEST_SCENES - 1)
    found = interval_of_mean(values, scenes)
    assert not found.is_known
    assert found.mean == pytest.approx(values.mean())
    assert interval_of_mean(*scores(np.random.default_rng(1), FEWEST_SCENES)).is_known


@pytest.mark.parametrize("bad", [math.inf, math.nan])
def test_what_is_not_finite_gives_no_interval_and_no_p(bad: float) -> None:
    values, scenes = scores(np.random.default_rng(1), 8)
    values[3] = bad
    found = interval_of_mean(values, scenes)
    assert not found.is_known
    assert found.mean == pytest.approx(bad, nan_ok=True)
    difference = paired_difference(np.full(48, 40.0), values, scenes)
    assert not difference.interval.is_known
    assert math.isnan(difference.p_value)


def test_two_perfect_scores_have_no_difference() -> None:
    values, scenes = scores(np.random.default_rng(1), 8)
    values[3] = math.inf
    assert math.isnan(paired_difference(values, values, scenes).interval.mean)


def test_nothing() -> None:
    found = interval_of_mean([], [])
    assert math.isnan(found.mean)
    assert (found.images, found.scenes) == (0, 0)
    assert math.isnan(sign_flip_p_value([], []))


def test_equal_methods_have_no_width_and_p_1() -> None:
    values, scenes = scores(np.random.default_rng(1), 8)
    found = paired_difference(values, values, scenes)
    assert (found.interval.mean, found.interval.low, found.interval.high, found.p_value) == (0.0, 0.0, 0.0, 1.0)


def test_wrong_arguments() -> None:
    with pytest.raises(ArgumentError, match="2 values and 1 scenes"):
        interval_of_mean([1.0, 2.0], ["a"])
    with pytest.raises(ArgumentError, match="same images; found 1 and 2"):
        paired_difference([1.0], [1.0, 2.0], ["a"])
    with pytest.raises(ArgumentError, match="between 0 and 1; found 95"):
        interval_of_mean([1.0], ["a"], level=95)
    with pytest.raises(ArgumentError, match="resamples must be 1 or more; found 0"):
        interval_of_mean([1.0], ["a"], resamples=0)
    with pytest.raises(ArgumentError, match="seed must be 0 or more; found -1"):
        sign_flip_p_value([1.0], ["a"], seed=-1)
