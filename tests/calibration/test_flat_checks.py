"""What faults of flats do to K, and what is said of them."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.calibration.checks import find_uneven_steps, flat_findings
from eldata.calibration.flats import FlatPairs, photon_transfer
from eldata.raw import bayer_cfa
from tests.calibration import flats as study
from tests.calibration.chain import given
from tests.calibration.in_memory import calibrated_arrays
from tests.calibration.simulation import BAYER, XTRANS, Body, Camera
from tests.cases import in_one_test

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SMALL = (256, 384)


def small(setting: study.Setting) -> study.Setting:
    return replace(setting, shape=SMALL)


@in_one_test(
    "white, setting",
    [(13583, study.Setting()), (11000, study.QUIET), (15000, study.LOUD), (9000, study.Setting())],
)
def test_saturation_below_white(white: int, setting: study.Setting) -> None:
    """Values pile up: K, which came out 7 to 40 % too low, is withheld."""
    found = study.outcome(setting, study.clipped(white)(small(setting), np.random.default_rng(3)))
    (said,) = (one for one in found.findings if one.check == "saturation")
    assert (said.effect, said.figures) == ("withheld", ("gain",))
    assert f"the flats saturate at {white} DN, below the recorded white level: values pile up there" in said.text
    assert found.refused or found.off < -0.03
    assert math.isnan(found.error)


@in_one_test(
    "pairs, setting",
    [
        *((study.unequal(step), study.QUIET) for step in (0.04, -0.2)),
        (study.unequal(0.2), study.LOUD),
        (study.unequal(0.25), study.Setting()),
    ],
)
def test_pairs_of_unequal_light(pairs: Callable[..., list[study.Pair]], setting: study.Setting) -> None:
    """4 % with 1 % of PRNU made K 3 % too large at K = 0.09, 20 % made it 78 %."""
    found = study.outcome(setting, pairs(small(setting), np.random.default_rng(6)))
    assert abs(found.off) < 5 * found.error < 0.02
    assert found.findings == ()


@in_one_test("moved, levels", [(0.25, (0.2, 0.5, 0.9)), (0.7, (0.1, 0.3, 0.6, 0.9)), (0.4, (0.8,) * 4)])
def test_a_chart_that_moves_within_a_pair(moved: float, levels: tuple[float, ...]) -> None:
    """Edges that move are noise to the mean: K comes out a multiple of the truth, and is withheld."""
    setting = study.Setting(shape=(512, 1536), levels=levels)
    found = study.outcome(setting, study.chart(moved)(setting, np.random.default_rng(8)))
    assert found.off > 0.5
    assert math.isnan(found.error)
    (said,) = (one for one in found.findings if one.check == "uneven flats")
    assert said.effect == "withheld"
    assert said.allowance > 0.1
    assert re.search(r"a K that is off by [+-][0-9.]+%", said.text)


@in_one_test(
    "cfa, light",
    [
        (BAYER, lambda x, y: 0.51 + 0.24 * x + 0.24 * y),
        (XTRANS, lambda x, y: 0.6 + 0.3 * y - 0.1 * x**2),
        (bayer_cfa(block=2), lambda x, y: 1 - 0.25 * (x**2 + y**2)),
        (bayer_cfa(block=3), lambda x, y: (1 + 0.2 * (x**2 + y**2)) ** -2.0),
    ],
)
def test_light_that_falls_off_steeply_is_on_the_line(
    cfa: tuple[tuple[int, ...], ...], light: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
) -> None:
    """130 x 192 pixels, K = 1: five standard errors, as they are stated."""
    generator = np.random.default_rng(14)
    y, x = np.meshgrid(np.linspace(-1, 1, 130), np.linspace(-1, 1, 192), indexing="ij")
    channels = max(map(max, cfa)) + 1
    flats = FlatPairs(cfa, (512.0,) * channels, 16383.0)
    for level in (300.0, 3000.0, 12000.0):
        one, two = (generator.poisson(level * light(x, y)) + generator.normal(512, 2, y.shape) for _ in range(2))
        flats.add(np.rint(one).astype(np.uint16), np.rint(two).astype(np.uint16))
    found = photon_transfer(flats)
    assert list(flat_findings(found)) == []
    assert abs(found.gain_dn_per_e - 1) < 5 * found.gain_error < 0.1


def test_the_published_method_is_not_given_where_there_is_no_line() -> None:
    """It takes the chart's patches for noise: K of 12,000 in place of 1."""
    setting = study.Setting(shape=(256, 1536), levels=(0.3, 0.6, 0.9))
    body = Body(Camera(shape=setting.shape), np.random.default_rng(1))
    bias = body.bias_frames(4)
    for light, is_given in ((study.clean, True), (study.chart(0.3), False)):
        found = calibrated_arrays(body.camera.sensor, bias, light(setting, np.random.default_rng(9)))
        assert (found.gain is not None) is is_given
        assert (found.spatial is not None) is is_given
        assert ("gain" in found.withheld) is not is_given
        assert found.tukey_lambda is not None, "the read noise is of the bias frames"


def test_smoothed_flats_are_told_by_their_neighbours() -> None:
    weak = study.outcome(study.Setting(), study.smoothed(0.05)(small(study.Setting()), np.random.default_rng(9)))
    assert [(one.check, one.effect) for one in weak.findings] == [("correlation in flats", "wider")]
    assert abs(weak.off) < 1.96 * weak.error < 0.25
    strong = study.outcome(study.Setting(), study.smoothed(0.2)(small(study.Setting()), np.random.default_rng(9)))
    assert [(one.check, one.effect) for one in strong.findings] == [("correlation in flats", "withheld")]
    assert strong.off < -0.3
    assert math.isnan(strong.error)


@in_one_test("share, effect", [(0.035, "wider"), (0.07, "withheld"), (0.12, "withheld")])
def test_a_line_that_is_bent(share: float, effect: str) -> None:
    """A sensor that is not linear, by so much at white: K is off by twice that; the error reaches it, or it goes."""
    setting = study.Setting(levels=(0.1, 0.3, 0.5, 0.7, 0.9))
    found = study.outcome(setting, study.bent(share)(small(setting), np.random.default_rng(10)))
    assert [(one.check, one.effect) for one in found.findings] == [("uneven flats", effect)]
    assert found.off < -1.5 * share
    assert math.isnan(found.error) == (effect == "withheld")
    assert effect == "withheld" or abs(found.off) < 1.96 * found.error


@pytest.mark.study
def test_standard_errors_of_the_gain_cover_the_truth() -> None:
    """200 cameras of 25 kilopixels: the share within 1.96 errors has a standard error of 1.5 %; allowed are 4.5."""
    setting, make = replace(study.QUIET, shape=(128, 192)), study.unequal(0.08)
    found = [study.outcome(setting, make(setting, np.random.default_rng((11, seed)))) for seed in range(200)]
    scores = np.array([one.off / one.error for one in found])
    assert abs(np.mean(np.abs(scores) < 1.96) - 0.95) < 4.5 * math.sqrt(0.95 * 0.05 / 200)
    assert abs(scores.mean()) < 4.5 / math.sqrt(200)


@pytest.mark.parametrize(
    ("share", "effect"), [(0.0, None), (0.05, None), (0.35, "wider"), (0.5, "wider"), (1.0, "withheld")]
)
def test_steps_that_grow_with_the_light(share: float, effect: str | None) -> None:
    """Compression by a curve whose steps are a share of the photons' noise: rounding adds share^2 / 12 to K.

    512 x 768 pixels, five pairs without vignetting, so that there are no values between the flats: K is known to 0.3 %.
    """
    camera = Camera(shape=(512, 768))
    flats = FlatPairs(camera.cfa, [camera.black] * 4, camera.white)
    kept = np.arange(16384)
    if share:
        roots = np.arange(1, 2 * math.sqrt(16384 - 512) / share)
        kept = np.unique(np.append(np.arange(600), 600 + (share * roots / 2) ** 2).astype(int))
    for first, second in Body(camera, np.random.default_rng(3)).flat_pairs(
        (600, 1500, 3000, 6000, 10000), shaded=False
    ):
        nearest = [
            kept[np.searchsorted((kept[1:] + kept[:-1]) / 2, flat)].astype(np.uint16) for flat in (first, second)
        ]
        flats.add(*nearest)
    transfer = photon_transfer(flats)
    found = list(find_uneven_steps(flats, transfer))
    assert [one.effect for one in found] == ([effect] if effect else [])
    gain = given(found, "gain", transfer.gain_dn_per_e, transfer.gain_error, transfer.gain_dn_per_e)
    assert (gain is None) == (effect == "withheld")
    assert gain is None or abs(gain.value - 1) < 3 * gain.error
    if effect == "withheld":
        assert abs(transfer.gain_dn_per_e - 1) == pytest.approx(1 / 12, rel=0.2)
        assert found[0].allowance == pytest.approx(1 / 12, rel=0.2)
