"""Cameras that switch their conversion gain: profiles of several modes, and what is drawn from them."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats

from eldata.errors import ArgumentError, ProfileError
from eldata.noise import CameraProfile
from eldata.noise.profile import GainMode, LogLogFit, ProfileRow
from tests.cases import in_one_test

if TYPE_CHECKING:
    from pathlib import Path

COUNT = 5_000
LEAST_P_VALUE = 1e-6

LOW = GainMode(
    (0.2, 1.6), LogLogFit(0.75, 0.8, 0.05), LogLogFit(0.8, 1.4, 0.02), LogLogFit(0.8, -0.4, 0.1), (200, 1600)
)
HIGH = GainMode(
    (3.2, 12.8), LogLogFit(0.75, -0.1, 0.03), LogLogFit(0.8, 0.4, 0.01), LogLogFit(0.6, -1.5, 0.05), (3200, 12800)
)
TWO = CameraProfile(
    camera="Acme Nocturne 2",
    source="a test",
    gain_range_dn_per_e=(0.2, 12.8),
    tukey_lambda_fit=None,
    gauss_fit=None,
    row_fit=None,
    rows=tuple(
        ProfileRow(iso / 1e5, (float(iso), 0.0, 0.0, 0.0), iso, iso / 1000, 1.0, 2.0, 0.5)
        for iso in (50, 200, 400, 800, 1600, 3200, 6400, 12800)
    ),
    iso_range=(200, 12800),
    modes=(LOW, HIGH),
)


def test_a_file_holds_the_modes_and_older_versions_refuse_it(tmp_path: Path) -> None:
    path = tmp_path / "two.json"
    TWO.save(path)
    assert CameraProfile.load(path) == TWO
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data["schema"] == 2, "version 0.1 reads 1 alone"
    assert "modes" in data, "and names this field"
    assert not {"tukey_lambda_fit", "gauss_fit", "row_fit"} & set(data)
    (mode,) = CameraProfile.load("SonyA7S2").gain_modes
    assert (mode.gain_range_dn_per_e, mode.iso_range) == ((0.0939161, 6.0106285), (100, 6400))


def test_joint_draws_are_those_of_the_mode_in_which_k_lies() -> None:
    """ln K uniform over both ranges (p > 1e-6 each, by Kolmogorov and Smirnov and the binomial distribution)."""
    generator = np.random.default_rng(0)
    draws = [TWO.sample(generator) for _ in range(COUNT)]
    shares = {}
    for mode in (LOW, HIGH):
        inside = [one for one in draws if mode.distance(one.gain_dn_per_e) == 0]
        shares[mode] = len(inside)
        low, high = (math.log(limit) for limit in mode.gain_range_dn_per_e)
        x = np.log([one.gain_dn_per_e for one in inside])
        assert stats.kstest(x, stats.uniform(low, high - low).cdf).pvalue > LEAST_P_VALUE
        for fit, name in (
            (mode.tukey_lambda_fit, "sigma_tl_dn"), (mode.gauss_fit, "sigma_gauss_dn"), (mode.row_fit, "sigma_row_dn")
        ):  # fmt: skip
            assert fit is not None
            z = (np.log([getattr(one, name) for one in inside]) - fit.slope * x - fit.intercept) / fit.sigma
            assert stats.kstest(z, "norm").pvalue > LEAST_P_VALUE, name
        of_mode = {
            (row.tukey_lambda, row.colour_bias_dn) for row in TWO.rows if mode.distance(row.gain_dn_per_e or 1) == 0
        }
        assert {(one.tukey_lambda, one.colour_bias_dn) for one in inside} == of_mode
    assert sum(shares.values()) == COUNT, "nothing is drawn between the modes"
    assert stats.binomtest(shares[LOW], COUNT, 3 / 5).pvalue > LEAST_P_VALUE, "three stops and two"


def exact(profile: CameraProfile, **options: Any) -> float:
    """sigma_TL without the spread around the line."""
    modes = tuple(
        dataclasses.replace(mode, tukey_lambda_fit=dataclasses.replace(fit, sigma=0.0))
        for mode in profile.modes
        if (fit := mode.tukey_lambda_fit) is not None
    )
    return dataclasses.replace(profile, modes=modes).sample(np.random.default_rng(1), **options).sigma_tl_dn


def test_an_iso_belongs_to_one_mode_and_nothing_is_known_between_them() -> None:
    """Half a stop above 1600 the lower mode's line is the nearer one, half a stop below 3200 the upper one's."""

    lower, upper = (lambda gain, level=level: math.exp(0.75 * math.log(gain) + level) for level in (0.8, -0.1))
    assert exact(TWO, iso=1600) == pytest.approx(lower(1.6))
    assert exact(TWO, iso=1000) == pytest.approx(lower(1.0)), "in proportion within the mode"
    assert exact(TWO, iso=3200) == pytest.approx(upper(3.2))
    assert exact(TWO, gain_dn_per_e=12.8 * 1.005) == pytest.approx(upper(12.8 * 1.005)), "rounded by less than 1 %"
    for options, text in (
        ({"iso": 2000}, "ISO 3200 to 12800: which of them the camera has between ISO 1600 and 3200 was not measured"),
        ({"gain_dn_per_e": 2.0}, "K 2 DN/e- lies outside of the gain modes of Acme Nocturne 2, 0.2 to 1.6 and 3.2 to"),
        ({"gain_dn_per_e": 0.1}, "K 0.1 DN/e- lies outside of the gain modes"),
        ({"gain_dn_per_e": 12.8 * 1.015}, "K 12.99 DN/e- lies outside of the gain modes"),
        ({"iso": 25600}, "outside of the calibrated range 200 to 12800"),
        ({"iso": 50}, "outside of the calibrated range 200 to 12800"),
    ):
        with pytest.raises(ArgumentError, match=text):
            TWO.sample(np.random.default_rng(0), **options)
    assert exact(TWO, iso=2000, extrapolate=True) == pytest.approx(lower(2.0))
    assert exact(TWO, iso=2500, extrapolate=True) == pytest.approx(upper(2.5))
    assert exact(TWO, gain_dn_per_e=2.5, extrapolate=True) == pytest.approx(upper(2.5))
    assert exact(TWO, iso=50, extrapolate=True) == pytest.approx(lower(0.05))
    assert TWO.measured(50).gain_dn_per_e == 0.05, "a measured row needs no mode"
    for gain, nearest in ((1.6, 1600), (3.2, 3200)):
        drawn = TWO.sample(np.random.default_rng(0), gain_dn_per_e=gain, row="nearest-gain")
        assert drawn.tukey_lambda == nearest / 1e5


def test_the_gain_follows_the_rows_of_its_own_mode() -> None:
    """A camera whose gain doubles where it switches, is stated to from ISO 2000 on, and has an extended ISO 12800."""
    gains = {200: 0.2, 400: 0.4, 800: 0.8, 1600: 1.6, 3200: 6.4, 6400: 12.8, 12800: 12.8}
    profile = dataclasses.replace(
        TWO,
        rows=tuple(ProfileRow(0.1, (0.0,) * 4, iso, gain) for iso, gain in gains.items()),
        modes=(LOW, dataclasses.replace(HIGH, gain_range_dn_per_e=(4.0, 12.8), iso_range=(2000, 12800))),
    )
    assert {iso: profile.gain_at_iso(iso) for iso in gains} == gains
    for iso, gain in ((250, 0.25), (1250, 1.25), (2000, 4.0), (2500, 5.0), (4000, 8.0), (10000, 12.8)):
        assert profile.gain_at_iso(iso) == pytest.approx(gain, rel=1e-12)
        assert profile.iso_at_gain(gain) == pytest.approx(min(iso, 6400), rel=1e-12)
    for iso in (1601, 1999):
        with pytest.raises(ArgumentError, match="ISO 200 to 1600 and ISO 2000 to 12800: which of them the camera has"):
            profile.gain_at_iso(iso)
    for iso, gain in ((1700, 1.7), (1900, 3.8)):
        assert profile.gain_at_iso(iso, extrapolate=True) == pytest.approx(gain, rel=1e-12), "the nearer mode goes on"


LINE = LogLogFit(1.0, 0.0, 0.1)
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"row_fit": LINE}, "are those of the modes"),
    ({"modes": (LOW,)}, "one mode alone"),
    ({"modes": (HIGH, LOW)}, "must be wider than nothing and end below"),
    ({"modes": (dataclasses.replace(LOW, gain_range_dn_per_e=(0.2, 3.2)), HIGH)}, "found 0.2 to 3.2, 3.2 to 12.8"),
    ({"modes": (dataclasses.replace(LOW, iso_range=(200, 6400)), HIGH)}, "each mode's iso_range"),
    ({"modes": (dataclasses.replace(LOW, iso_range=None), HIGH)}, "all modes and the profile state an iso_range"),
    ({"iso_range": None}, "all modes and the profile state an iso_range"),
    ({"iso_range": (100, 12800)}, "iso_range must go from the first mode's to the last one's, 200 to 12800"),
    ({"gain_range_dn_per_e": (0.1, 12.8)}, "gain_range_dn_per_e must go from"),
    ({"rows": TWO.rows[:5]}, "no row has a K in the mode of ISO 3200 to 12800"),
]


@in_one_test("changes, text", REFUSED)
def test_modes_that_do_not_go_together(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ProfileError, match=text):
        dataclasses.replace(TWO, **changes)
