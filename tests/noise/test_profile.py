"""Camera profiles: the shipped figures, the file, the joint distribution of what is drawn, and gain modes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from eldata.errors import ArgumentError, ProfileError
from eldata.noise import CameraProfile, NoiseParameters, shipped_profiles
from eldata.noise.parameters import Generator
from eldata.noise.profile import GainMode, LogLogFit, ProfileRow, RowChoice
from tests.cases import in_one_test

CAMERAS = ("CanonEOS5D4", "CanonEOS700D", "CanonEOS70D", "NikonD850", "NikonD850-2", "SonyA7S2")
FITS = ("tukey_lambda_fit", "gauss_fit", "row_fit")
SIGMA_OF = {"tukey_lambda_fit": "sigma_tl_dn", "gauss_fit": "sigma_gauss_dn", "row_fit": "sigma_row_dn"}

# 6 cameras and a dozen statistics: false alarms at about 1e-4 in all, if the seeds were not fixed.
LEAST_P_VALUE = 1e-6

FULL = CameraProfile(
    camera="Acme Nocturne 1",
    source="a test",
    gain_range_dn_per_e=(0.1, 12.8),
    tukey_lambda_fit=LogLogFit(0.5, 0.25, 0.125),
    gauss_fit=LogLogFit(-0.5, 1.25, 0.0),
    row_fit=LogLogFit(1e-17, -1.0, 1 / 3),
    rows=(
        ProfileRow(0.1, (1.0, 2.0, 3.0, 4.0), 100.0, 0.1, 1.5, 2.5, 0.5, 0.99, 0.97),
        ProfileRow(-0.1, (-1.0, 0.1, 0.2, 0.3)),
    ),
    iso_range=(100.0, 12800.0),
    black_level_dn=512.0,
    white_level_dn=16383.0,
    notes=("first note", "zweite Notiz: größer"),
)

WITH_FRAMES = dataclasses.replace(
    FULL,
    rows=(
        dataclasses.replace(FULL.rows[0], frame_bias_dn=((0.0, 1.5, 3.25, 4.0), (2.0, 2.5, 2.75, 4.0))),
        dataclasses.replace(FULL.rows[1], frame_bias_dn=tuple((float(n), 0.1, 0.2, 0.3) for n in (-4, -1, 2))),
    ),
)


# --- shipped --------------------------------------------------------------------------------------------------------


def test_draws_of_shipped_profiles_are_frozen() -> None:
    """To nine digits, as they were before rows could hold the bias of each frame."""
    digest = hashlib.sha256()
    for name in shipped_profiles():
        for row in ("any", "nearest-gain"):
            for generator in (np.random.default_rng(3), torch.Generator().manual_seed(3)):
                drawn = CameraProfile.load(name).sample(generator, row=row).as_dict()
                digest.update(" ".join(f"{value:.9g}" for value in np.hstack(list(drawn.values()))).encode())
    assert digest.hexdigest()[:16] == "6623d5b2d4f3edb0"


# --- files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "profile",
    [
        FULL,
        dataclasses.replace(FULL, iso_range=None, black_level_dn=None, white_level_dn=None, notes=()),
        dataclasses.replace(FULL, rows=FULL.rows[1:], gain_range_dn_per_e=(0.1 + 0.2, 1e300)),
        dataclasses.replace(WITH_FRAMES, quantisation_step_dn=4.0),
    ],
    ids=["full", "least", "odd numbers", "frames"],
)
def test_every_field_survives_a_file(profile: CameraProfile, tmp_path: Path) -> None:
    path = tmp_path / "deep.json"
    profile.save(path)
    assert CameraProfile.load(path) == profile
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data["schema"] == 1
    assert set(data) == {"schema", *(field.name for field in dataclasses.fields(CameraProfile))} - {
        "modes",
        "accepted",
        *(() if profile.quantisation_step_dn != 1 else ("quantisation_step_dn",)),
    }


def as_json(profile: CameraProfile) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(json.dumps({"schema": 1} | profile.as_dict()))
    return data


def load(data: object, folder: Path) -> CameraProfile:
    path = folder / "camera.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return CameraProfile.load(path)


# What is no number, text or list at all is refused by base/fields.py, which has tests of its own.
WRONG: list[tuple[tuple[str | int, ...], object]] = [
    *(((name,), value) for name in ("source", "gain_range_dn_per_e", "rows", *FITS) for value in (..., 5)),
    *(((name,), value) for name in ("gain_range_dn_per_e", "iso_range") for value in ([1.0], [2.0, 1.0], [0.0, 1.0])),
    *(((name, "sigma"), -1e-9) for name in FITS),
    (("rows",), []),
    (("rows", 0, "r_squared_tl"), "1"),
    *((("rows", 0, name), 0) for name in ("iso", "gain_dn_per_e")),
    *((("rows", 0, name), -1.0) for name in ("sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")),
    *((("rows", 0, "tukey_lambda"), value) for value in (..., -0.5, 2.5)),
    (("rows", 1, "colour_bias_dn"), [1, 2, 3]),
    (("rows", 0, "frame_bias_dn"), [[1.0, 2.0, 3.0, 4.002]]),
    (("rows", 0, "frame_bias_dn", 1), [1, 2, 3, 4, 5]),
    (("quantisation_step_dn",), 0),
    (("schema",), 4),
    (("rows", 1, "extra"), 1),
]


@in_one_test("keys, value", WRONG)
def test_a_wrong_field_is_named(keys: tuple[str | int, ...], value: object, tmp_path: Path) -> None:
    """With what is expected and found; ``...`` stands for a field that is missing."""
    data: Any = as_json(WITH_FRAMES if "frame_bias_dn" in keys else FULL)
    inner = data
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    if value is ...:
        del inner[keys[-1]]
    named = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".")
    with pytest.raises(ProfileError, match=rf"camera\.json, field {re.escape(named)}.*: (expected .*found|is unknown)"):
        load(data, tmp_path)


# --- drawing --------------------------------------------------------------------------------------------------------

COUNT = 4000
MEAN_ERROR = 1 / math.sqrt(COUNT)
VARIANCE_ERROR = math.sqrt(2 / COUNT)


def torch_generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


BOTH = pytest.mark.parametrize("make", [np.random.default_rng, torch_generator])


@pytest.fixture(scope="module", params=[("NikonD850-2", np.random.default_rng), ("SonyA7S2", torch_generator)])
def drawn(request: pytest.FixtureRequest) -> tuple[CameraProfile, list[NoiseParameters]]:
    name, make = request.param
    profile, generator = CameraProfile.load(name), make(20)
    return profile, [profile.sample(generator) for _ in range(COUNT)]


def log_gains(draws: list[NoiseParameters]) -> Any:
    return np.log([draw.gain_dn_per_e for draw in draws])


def residuals(profile: CameraProfile | GainMode, draws: list[NoiseParameters], fit: str) -> Any:
    """How many deviations of the fit ln sigma lies off its line."""
    line = getattr(profile, fit)
    sigmas = np.log([getattr(draw, SIGMA_OF[fit]) for draw in draws])
    return (sigmas - (line.slope * log_gains(draws) + line.intercept)) / line.sigma


def test_the_log_gain_is_uniform_between_the_cameras_own_limits(
    drawn: tuple[CameraProfile, list[NoiseParameters]],
) -> None:
    """4000 draws, Kolmogorov-Smirnov."""
    profile, draws = drawn
    low, high = np.log(profile.gain_range_dn_per_e)
    gains = log_gains(draws)
    assert low <= gains.min() < gains.max() <= high
    assert stats.kstest((gains - low) / (high - low), "uniform").pvalue > LEAST_P_VALUE


def test_the_log_sigmas_are_normal_around_their_lines(drawn: tuple[CameraProfile, list[NoiseParameters]]) -> None:
    """4000 draws: Kolmogorov-Smirnov; mean, variance and correlations within 5 standard errors, none left over ln K."""
    profile, draws = drawn
    gains, off = log_gains(draws), [residuals(profile, draws, fit) for fit in FITS]
    for one in off:
        assert stats.kstest(one, "norm").pvalue > LEAST_P_VALUE
        assert abs(one.mean()) < 5 * MEAN_ERROR
        assert abs(one.var() - 1) < 5 * VARIANCE_ERROR
        assert abs(np.corrcoef(one**2, gains)[0, 1]) < 5 * MEAN_ERROR
    correlation = np.corrcoef([*off, gains])
    assert np.abs(correlation[np.triu_indices(4, 1)]).max() < 5 * MEAN_ERROR


def test_lambda_and_colour_bias_come_from_one_row_and_every_row_alike(
    drawn: tuple[CameraProfile, list[NoiseParameters]],
) -> None:
    """4000 draws over 14 to 20 rows, chi-square; and the row is independent of the gain."""
    profile, draws = drawn
    index: dict[tuple[float, tuple[float, ...]], list[int]] = {}
    for number, row in enumerate(profile.rows):
        index.setdefault((row.tukey_lambda, row.colour_bias_dn), []).append(number)
    # A pair that stands in no row would be a KeyError.
    rows = np.array([index[draw.tukey_lambda, draw.colour_bias_dn][0] for draw in draws])
    expected = np.array([len(numbers) for numbers in index.values()]) / len(profile.rows) * COUNT
    observed = np.array([(rows == numbers[0]).sum() for numbers in index.values()])
    assert stats.chisquare(observed, expected).pvalue > LEAST_P_VALUE
    assert abs(np.corrcoef(rows, log_gains(draws))[0, 1]) < 5 * MEAN_ERROR


@pytest.mark.parametrize("row", ["any", "nearest-gain"])
@BOTH
def test_a_frame_of_the_drawn_row_gives_the_colour_bias(make: Callable[[int], Generator], row: RowChoice) -> None:
    """3000 draws, chi-square over all frames of both rows; all else is drawn as without frames."""
    generator, same = make(23), make(23)
    counts: dict[tuple[float, ...], int] = {}
    for _ in range(3000):
        draw, without = WITH_FRAMES.sample(generator, row=row), FULL.sample(same, row=row)
        (drawn_row,) = (one for one in WITH_FRAMES.rows if one.colour_bias_dn == without.colour_bias_dn)
        assert draw.colour_bias_dn in drawn_row.frame_bias_dn
        assert dataclasses.replace(draw, colour_bias_dn=without.colour_bias_dn) == without
        counts[draw.colour_bias_dn] = counts.get(draw.colour_bias_dn, 0) + 1
    chances = [1 / len(one.frame_bias_dn) for one in WITH_FRAMES.rows for _ in one.frame_bias_dn]
    frames = [frame for one in WITH_FRAMES.rows for frame in one.frame_bias_dn]
    shares = np.array(chances) / 2 if row == "any" else np.array([0.5, 0.5])  # the second row has no gain
    observed = [counts[frame] for frame in frames if frame in counts]
    assert stats.chisquare(observed, 3000 * shares).pvalue > LEAST_P_VALUE
    assert WITH_FRAMES.measured(100) == FULL.measured(100)


@BOTH
@in_one_test("iso, gain", [(1600.0, None), (None, 1.25), (123.0, None)])
def test_fixing_the_gain_leaves_the_other_draws_as_they_were(
    make: Callable[[int], Generator], iso: float | None, gain: float | None
) -> None:
    sony = CameraProfile.load("SonyA7S2")
    free, tied = sony.sample(make(7)), sony.sample(make(7), iso=iso, gain_dn_per_e=gain)
    gain = gain or sony.gain_at_iso(iso or 0)
    assert tied.gain_dn_per_e == gain != free.gain_dn_per_e
    assert (tied.tukey_lambda, tied.colour_bias_dn) == (free.tukey_lambda, free.colour_bias_dn)
    for fit in FITS:
        assert residuals(sony, [tied], fit)[0] == pytest.approx(residuals(sony, [free], fit)[0], abs=1e-9)


# --- ISO ------------------------------------------------------------------------------------------------------------


# Truth by construction: ISO 50 is an extended one, which has the gain of ISO 100; so has 1600 that of 800.
TRUE_GAINS = {50.0: 0.4, 100.0: 0.4, 200.0: 0.8, 400.0: 1.6, 800.0: 3.2, 1600.0: 3.2}
EXTENDED = dataclasses.replace(
    FULL,
    gain_range_dn_per_e=(0.4, 3.2),
    rows=tuple(ProfileRow(0.1, (0.0,) * 4, iso, gain, 1.5, 2.5, 0.5) for iso, gain in TRUE_GAINS.items()),
    iso_range=(50.0, 1600.0),
)


# Regression: 0.796 at ISO 125 and 1.61 at ISO 320, on the line from one end of the range to the other.
def test_the_gain_between_measured_isos_some_of_which_share_it(tmp_path: Path) -> None:
    EXTENDED.save(tmp_path / "extended.json")
    profile = CameraProfile.load(tmp_path / "extended.json")
    assert profile == EXTENDED
    assert {iso: profile.gain_at_iso(iso) for iso in TRUE_GAINS} == TRUE_GAINS
    for iso, gain in ((64, 0.4), (99, 0.4), (125, 0.5), (320, 1.28), (640, 2.56), (1000, 3.2)):
        assert profile.gain_at_iso(iso) == pytest.approx(gain, rel=1e-12)
        drawn = profile.sample(np.random.default_rng(0), iso=iso)
        assert (drawn.gain_dn_per_e, drawn.iso) == (profile.gain_at_iso(iso), iso)
    for iso, gain in ((25, 0.2), (1700, 3.4)):  # beyond them in proportion
        with pytest.raises(ArgumentError, match="outside of the calibrated range 50 to 1600"):
            EXTENDED.gain_at_iso(iso)
        assert EXTENDED.gain_at_iso(iso, extrapolate=True) == pytest.approx(gain, rel=1e-12)


def test_the_iso_of_a_gain() -> None:
    for gain in np.geomspace(0.4, 3.2, 50)[1:-1]:
        iso = EXTENDED.iso_at_gain(gain)
        assert iso is not None
        assert EXTENDED.gain_at_iso(iso) == pytest.approx(gain, rel=1e-12)
    for gain, iso in ((0.4, 50), (0.5, 125), (1.6, 400), (3.2, 800), (0.2, 25), (6.4, 1600)):
        assert EXTENDED.iso_at_gain(gain) == pytest.approx(iso, rel=1e-12)
    assert dataclasses.replace(FULL, rows=FULL.rows[1:], iso_range=None).iso_at_gain(1.0) is None


# --- as it was measured ---------------------------------------------------------------------------------------------


def test_the_measured_parameters_of_an_iso() -> None:
    found = FULL.measured(100)
    assert found == NoiseParameters(0.1, 0.1, 1.5, 2.5, 0.5, (1.0, 2.0, 3.0, 4.0))
    assert found.range_dn == 16383.0 - 512.0
    # A sample's scales are off their lines, whatever the row.
    assert FULL.sample(np.random.default_rng(0), iso=100, row="nearest-gain").sigma_tl_dn != 1.5


def test_an_iso_that_was_not_measured() -> None:
    row = FULL.rows[0]
    partly = (row, dataclasses.replace(row, iso=200.0, sigma_row_dn=None), dataclasses.replace(row, iso=400.0))
    profile = dataclasses.replace(FULL, rows=partly)
    for iso in (200, 300):
        with pytest.raises(ArgumentError, match=rf"ISO {iso} of .* was not measured, or not completely; ISO 100, 400"):
            profile.measured(iso)
    with pytest.raises(ArgumentError, match="no row of SonyA7S2's profile has K and all scales"):
        CameraProfile.load("SonyA7S2").measured(100)


# --- refusals -------------------------------------------------------------------------------------------------------


@in_one_test(
    "given, words",
    [
        ({"iso": 100, "gain_dn_per_e": 1.0}, "give iso or gain_dn_per_e, not both"),
        ({"row": "measured", "gain_dn_per_e": 0.1}, "row='measured' gives the figures of one ISO; give iso"),
        ({"row": "measured", "iso": 300}, "ISO 300 of .* was not measured"),
        ({"row": "all"}, "row must be 'any', .* or 'measured'; found"),
        ({"iso": math.nan}, "an ISO is finite and above 0"),
        ({"gain_dn_per_e": 0.0}, "gain_dn_per_e must be"),
        ({"generator": np.random.RandomState(0)}, r"generator must be a numpy\.random\.Generator or a torch"),
    ],
)
def test_what_a_draw_refuses(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        FULL.sample(**{"generator": np.random.default_rng(0)} | given)
    with pytest.raises(ArgumentError, match=r"no row of Acme Nocturne 1's profile has a gain"):
        dataclasses.replace(FULL, rows=FULL.rows[1:]).sample(np.random.default_rng(0), row="nearest-gain")


def test_profiles_that_are_refused() -> None:
    assert shipped_profiles() == (*CAMERAS, "SonyA7S2-PMN")
    with pytest.raises(ProfileError, match=r"'Leica'; known are CanonEOS5D4, .*, SonyA7S2-PMN"):
        CameraProfile.load("Leica")
    with pytest.raises(ProfileError, match="the white level, 512 DN, must lie above the black level, 512 DN"):
        dataclasses.replace(FULL, white_level_dn=512.0)


# --- gain modes: cameras that switch their conversion gain -----------------------------------------------------------

OF_MODES = 5_000  # draws

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
    draws = [TWO.sample(generator) for _ in range(OF_MODES)]
    shares = {}
    for mode in (LOW, HIGH):
        inside = [one for one in draws if mode.distance(one.gain_dn_per_e) == 0]
        shares[mode] = len(inside)
        low, high = (math.log(limit) for limit in mode.gain_range_dn_per_e)
        x = log_gains(inside)
        assert stats.kstest(x, stats.uniform(low, high - low).cdf).pvalue > LEAST_P_VALUE
        for fit in FITS:
            assert stats.kstest(residuals(mode, inside, fit), "norm").pvalue > LEAST_P_VALUE, fit
        of_mode = {
            (row.tukey_lambda, row.colour_bias_dn) for row in TWO.rows if mode.distance(row.gain_dn_per_e or 1) == 0
        }
        assert {(one.tukey_lambda, one.colour_bias_dn) for one in inside} == of_mode
    assert sum(shares.values()) == OF_MODES, "nothing is drawn between the modes"
    assert stats.binomtest(shares[LOW], OF_MODES, 3 / 5).pvalue > LEAST_P_VALUE, "three stops and two"


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

    def lower(gain: float) -> float:
        return math.exp(0.75 * math.log(gain) + 0.8)

    def upper(gain: float) -> float:
        return math.exp(0.75 * math.log(gain) - 0.1)

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
CONTRADICTIONS: list[tuple[dict[str, Any], str]] = [
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


@in_one_test("changes, text", CONTRADICTIONS)
def test_modes_that_do_not_go_together(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ProfileError, match=text):
        dataclasses.replace(TWO, **changes)
