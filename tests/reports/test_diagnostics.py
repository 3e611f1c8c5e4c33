"""The comparisons against numpy and scipy alone, and their standard errors against repeated simulation."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from eldata.calibration.acceptance import theory as module
from eldata.calibration.acceptance.theory import diagnose, sample_parameters, tukey_lambda_kurtosis
from eldata.calibration.acceptance.verdicts import SIGNALS_E, Diagnostics, TheoryCheck, parameter_rows
from eldata.calibration.core._tukey_lambda import tukey_lambda_quantile
from eldata.errors import ArgumentError
from eldata.noise.gain_modes import shipped_profiles
from eldata.noise.parameters import NoiseParameters
from eldata.noise.profile import CameraProfile
from eldata.noise.structure import PAPER_MODELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.model import NoiseModel

PARAMETERS = NoiseParameters(1.7, -0.06, 1.3, 2.4, 0.6, (0.4, -0.2, 0.9, -0.3))


def frame_by_numpy(
    model: NoiseModel, p: NoiseParameters, signal_e: float, size: tuple[int, int], rng: np.random.Generator
) -> NDArray[np.float64]:
    """The noise model once more, in numpy and scipy alone."""
    parts = model.components
    shape = (4, *size)
    dn = np.full(shape, p.gain_dn_per_e * signal_e)
    if parts.shot == "poisson":
        dn = p.gain_dn_per_e * rng.poisson(signal_e, shape)
    if parts.read == "tukey-lambda":
        dn = dn + p.sigma_tl_dn * scipy.stats.tukeylambda.rvs(p.tukey_lambda, size=shape, random_state=rng)
    if parts.read == "gaussian":
        dn = dn + rng.normal(0, p.sigma_gauss_dn, shape)
    if parts.colour_bias:
        dn = dn + np.reshape(p.colour_bias_dn, (4, 1, 1))
    if parts.row:
        rows = rng.normal(0, p.sigma_row_dn, (2, size[0], 1))
        dn = dn + rows[[0, 0, 1, 1]]
    if parts.quantisation:
        dn = dn + rng.uniform(-0.5, 0.5, shape)
    return np.asarray(dn, dtype=np.float64)


# --- expected -----------------------------------------------------------------------------------------------------


def test_expected_values_are_those_of_scipy(sony: CameraProfile) -> None:
    result = diagnose(sony, PARAMETERS)
    gain, read = 1.7, 1.3**2 * float(scipy.stats.tukeylambda.var(-0.06))
    for signal, mean, variance in zip(
        SIGNALS_E, result.of("mean over signal"), result.of("variance over signal"), strict=True
    ):
        assert mean.expected == pytest.approx(gain * signal + 0.2)
        assert variance.expected == pytest.approx(gain**2 * signal + read + 0.36 + 1 / 12)
    assert [item.expected for item in result.of("bias frame, mean by channel")] == [0.4, -0.2, 0.9, -0.3]
    deviation, shared, apart = result.of("bias frame, row means")
    assert deviation.expected == pytest.approx(math.sqrt(0.36 + (read + 1 / 12) / 1024))
    assert shared.expected == pytest.approx(0.36)
    assert apart.expected == 0
    levels = [float(item.symbol.removeprefix("quantile ")) for item in result.of("read noise alone")]
    assert (levels[0], levels[-1]) == (0.0001, 0.9999)
    np.testing.assert_allclose(
        [item.expected for item in result.of("read noise alone")],
        1.3 * scipy.stats.tukeylambda.ppf(levels, -0.06),
        atol=1e-12,
    )
    rows = result.of("row noise alone")
    levels = [float(item.symbol.removeprefix("quantile ")) for item in rows]
    np.testing.assert_allclose([item.expected for item in rows], 0.6 * scipy.stats.norm.ppf(levels), atol=1e-12)


def test_gaussian_read_noise_has_gaussian_quantiles(sony: CameraProfile) -> None:
    result = diagnose(sony, PARAMETERS, spec="G+P")
    levels = [float(item.symbol.removeprefix("quantile ")) for item in result.of("read noise alone")]
    np.testing.assert_allclose(
        [item.expected for item in result.of("read noise alone")], 2.4 * scipy.stats.norm.ppf(levels), atol=1e-12
    )
    # s.e. by the textbook: sqrt(u (1 - u) / N) / density
    density = scipy.stats.norm.pdf(scipy.stats.norm.ppf(levels)) / 2.4
    errors = np.sqrt(np.multiply(levels, 1 - np.array(levels)) / (4 * 512 * 512)) / density
    np.testing.assert_allclose(
        [item.standard_error or 0.0 for item in result.of("read noise alone")], errors, rtol=1e-6
    )
    assert not result.of("row noise alone") + result.of("quantisation alone")


@pytest.mark.parametrize("shape", [-0.2, -0.01, 0.0, 0.14, 1.0, 2.0])
def test_tukey_lambda_functions(shape: float) -> None:
    levels = np.array([1e-4, 0.1, 0.5, 0.77, 0.9999])
    np.testing.assert_allclose(
        tukey_lambda_quantile(levels, shape), scipy.stats.tukeylambda.ppf(levels, shape), rtol=1e-9, atol=1e-12
    )

    def moment(power: int) -> float:
        # With u = 1 / (1 + exp(-t)), whose derivative is u (1 - u); the distribution is symmetric.
        t = np.linspace(-150.0, 0.0, 200_001)
        u = 1 / (1 + np.exp(-t))
        values = scipy.stats.tukeylambda.ppf(u, shape) ** power * u * (1 - u)
        return 2 * float(scipy.integrate.simpson(values, x=t))

    assert tukey_lambda_kurtosis(shape) == pytest.approx(moment(4) / moment(2) ** 2 - 3, rel=1e-5, abs=1e-5)


def test_long_tails_have_no_fourth_moment() -> None:
    assert tukey_lambda_kurtosis(-0.25) == math.inf


# --- found --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", ["P*+G*+B+R+U", "G+P*"])
def test_an_independent_simulation_agrees(sony: CameraProfile, monkeypatch: pytest.MonkeyPatch, spec: str) -> None:
    """Closed forms and estimators are right, whatever the package's own engine does."""
    frames: list[tuple[float, NDArray[np.float64]]] = []

    def recorded(
        model: NoiseModel, p: NoiseParameters, signal_e: float, size: tuple[int, int], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        frame = frame_by_numpy(model, p, signal_e, size, rng)
        frames.append((signal_e, frame))
        return frame

    monkeypatch.setattr(module, "_frame", recorded)
    result = diagnose(sony, PARAMETERS, spec=spec, seed=2)
    assert result.off == ()
    # The statistics, from the frames that were simulated: the flats come first, then the bias frame.
    for (signal, frame), mean, variance in zip(
        frames, result.of("mean over signal"), result.of("variance over signal"), strict=False
    ):
        assert mean.symbol == f"at {signal:g} e-"
        assert mean.found == pytest.approx(np.mean(frame), rel=1e-12)
        by_channel = np.mean([np.var(channel) for channel in frame])
        assert variance.found == pytest.approx(by_channel, rel=2e-3)  # less what the sample's own mean takes
    _, bias = frames[len(SIGNALS_E)]
    np.testing.assert_allclose(
        [item.found for item in result.of("bias frame, mean by channel")], [channel.mean() for channel in bias]
    )
    red, green, blue, second_green = bias
    mosaic = np.concatenate([np.hstack([red, green]), np.hstack([blue, second_green])])
    mosaic -= np.repeat(
        [[red.mean() / 2 + green.mean() / 2], [blue.mean() / 2 + second_green.mean() / 2]], 1024, axis=0
    )
    assert result.of("bias frame, row means")[0].found == pytest.approx(np.std(mosaic.mean(axis=1)), rel=1e-3)
    assert result.of("bias frame, row means")[1].found == pytest.approx(
        np.mean([np.cov(red.mean(axis=1), green.mean(axis=1))[0, 1], np.cov(blue.mean(1), second_green.mean(1))[0, 1]])
    )
    np.testing.assert_allclose(result.row_means_dn, np.sort(mosaic.mean(axis=1)), atol=1e-9)
    _, read = frames[len(SIGNALS_E) + 1]
    levels = [float(item.symbol.removeprefix("quantile ")) for item in result.of("read noise alone")]
    np.testing.assert_allclose([item.found for item in result.of("read noise alone")], np.quantile(read, levels))


@pytest.mark.study
def test_standard_errors_are_those_of_repeated_simulation(sony: CameraProfile, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over 100 seeds, every deviation has mean 0 and standard deviation 1, within 4.5 of their own standard errors."""
    for name, size in (
        ("_FLAT", (96, 8)),
        ("_BIAS", (96, 24)),
        ("_READ", (192, 256)),
        ("_ROW", (16384, 1)),
        ("_QUANTISATION", (96, 96)),
    ):
        monkeypatch.setattr(module, name, size)
    repeats = 100
    deviations = defaultdict(list)
    for seed in range(repeats):
        for item in diagnose(sony, PARAMETERS, seed=seed).comparisons:
            assert item.deviation is not None
            deviations[item.check, item.symbol].append(item.deviation)
    assert len(deviations) == 61
    for which, values in deviations.items():
        assert abs(np.mean(values)) < 4.5 / math.sqrt(repeats), which
        assert abs(np.std(values) - 1) < 4.5 / math.sqrt(2 * repeats), which


@pytest.mark.parametrize("camera", shipped_profiles())
def test_every_shipped_profile_is_ok(camera: str) -> None:
    profile = CameraProfile.load(camera)
    result = diagnose(profile, sample_parameters(profile, 1), seed=1)
    assert result.off == ()
    assert len(result.comparisons) == 61


@pytest.mark.parametrize("spec", [*PAPER_MODELS, "P", "P*", "B", "R", "U"])
def test_every_model_is_ok(sony: CameraProfile, spec: str) -> None:
    result = diagnose(sony, PARAMETERS, spec=spec)
    assert result.off == ()
    assert result.summary == f"all {len(result.comparisons)} comparisons within 4 standard errors"
    assert bool(result.of("read noise alone")) == ("G" in spec)


# --- it notices ---------------------------------------------------------------------------------------------------


def test_another_cameras_noise_is_off(sony: CameraProfile) -> None:
    other = CameraProfile.load("NikonD850")
    result = diagnose(sony, sample_parameters(sony, 0), simulated=sample_parameters(other, 0))
    assert {item.check for item in result.off} >= {
        "mean over signal",
        "variance over signal",
        "bias frame, mean by channel",
        "read noise alone",
        "row noise alone",
    }
    assert "comparisons off by more than 4 standard errors" in result.summary


@pytest.mark.parametrize(
    ("changed", "checks"),
    [
        ({"gain_dn_per_e": 1.72}, {"mean over signal", "variance over signal"}),
        ({"tukey_lambda": -0.09}, {"variance over signal", "read noise alone"}),
        ({"sigma_tl_dn": 1.33}, {"variance over signal", "read noise alone"}),
        ({"sigma_row_dn": 0.75}, {"variance over signal", "bias frame, row means", "row noise alone"}),
        (
            {"colour_bias_dn": (0.4, -0.2, 0.9, -0.1)},
            {"mean over signal", "bias frame, mean by channel"},
        ),
    ],
)
def test_a_small_change_of_one_parameter_is_seen_where_it_matters(
    sony: CameraProfile, changed: dict[str, float], checks: set[str]
) -> None:
    result = diagnose(sony, PARAMETERS, simulated=replace(PARAMETERS, **changed))  # type: ignore[arg-type] # of fields
    assert {item.check for item in result.off} >= checks - {"mean over signal"}
    assert {item.check for item in result.off} <= checks


def test_a_profile_that_samples_elsewhere_is_off(sony: CameraProfile, monkeypatch: pytest.MonkeyPatch) -> None:
    (mode,) = sony.gain_modes
    wide = replace(sony, row_fit=replace(mode.row_fit, sigma=2 * mode.row_fit.sigma))
    monkeypatch.setattr(CameraProfile, "sample", lambda _, rng: _sample(wide, rng))
    result = diagnose(sony, PARAMETERS)
    assert {item.symbol.partition(",")[0] for item in result.off} == {"sigma_row"}


_sample = CameraProfile.sample


def test_a_variance_without_standard_error_is_not_judged(sony: CameraProfile) -> None:
    result = diagnose(sony, replace(PARAMETERS, tukey_lambda=-0.3))
    unjudged = [item for item in result.comparisons if item.verdict == "-"]
    assert {item.check for item in unjudged} == {"variance over signal", "bias frame, row means"}
    assert len(unjudged) == len(SIGNALS_E) + 1
    assert unjudged[0].cells()[2:] == ("-", "-", "-")
    assert "13 more have no standard error" in result.summary
    assert result.off == ()


# --- comparisons --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("found", "deviation", "verdict"),
    [(1.0, 0.0, "ok"), (1.4, 4.0, "ok"), (0.6, -4.0, "ok"), (1.41, 4.1, "off"), (0.59, -4.1, "off")],
)
def test_verdict(found: float, deviation: float, verdict: str) -> None:
    item = TheoryCheck("check", "symbol", "DN", 1.0, found, 0.1 + 1e-12)
    assert item.deviation == pytest.approx(deviation)
    assert item.verdict == verdict


@pytest.mark.parametrize(
    ("item", "cells"),
    [
        (TheoryCheck("", "", "", 1.23456, 1.2, 0.0123), ("1.235", "1.200", "0.012", "-2.8", "ok")),
        (TheoryCheck("", "", "", 1.23456, 1.2, 0.0456), ("1.23", "1.20", "0.05", "-0.8", "ok")),
        (TheoryCheck("", "", "", 0.0, -1e-9, 0.1), ("0.00", "0.00", "0.10", "+0.0", "ok")),
        (TheoryCheck("", "", "", 12345.6, 12345.6, 17.0), ("12346", "12346", "17", "+0.0", "ok")),
        (TheoryCheck("", "", "", 0.0, 0.0, 0.0), ("0", "0", "0", "+0.0", "ok")),
        (TheoryCheck("", "", "", 0.0, 1.0, 0.0), ("0", "1", "0", "+1e+09", "off")),
    ],
)
def test_cells(item: TheoryCheck, cells: tuple[str, ...]) -> None:
    assert item.cells() == cells


def test_the_same_seed_gives_the_same_numbers(sony: CameraProfile, diagnostics: Diagnostics) -> None:
    again = diagnose(sony, sample_parameters(sony, 0))
    assert again.comparisons == diagnostics.comparisons
    assert diagnose(sony, diagnostics.parameters, seed=1).of("mean over signal") != diagnostics.of("mean over signal")


def test_as_dict_is_plain(diagnostics: Diagnostics) -> None:
    data = json.loads(json.dumps(diagnostics.as_dict(), allow_nan=False))
    assert data["ok"] is True
    assert data["comparisons"][0]["verdict"] == "ok"
    assert data["parameters"]["gain_dn_per_e"] == diagnostics.parameters.gain_dn_per_e


# --- parameters ---------------------------------------------------------------------------------------------------


def test_iso_and_gain_are_kept(sony: CameraProfile) -> None:
    assert sample_parameters(sony, 0, iso=800).gain_dn_per_e == pytest.approx(sony.gain_at_iso(800))
    at_gain = sample_parameters(sony, 0, gain_dn_per_e=1.5)
    assert at_gain.gain_dn_per_e == 1.5
    nearest = {row.colour_bias_dn for row in sony.rows if row.iso == 1600}
    assert at_gain.colour_bias_dn in nearest


def test_a_profile_without_gains_in_its_rows_takes_any(sony: CameraProfile) -> None:
    bare = replace(sony, rows=tuple(replace(row, gain_dn_per_e=None) for row in sony.rows))
    assert sample_parameters(bare, 0, gain_dn_per_e=1.5).gain_dn_per_e == 1.5


@pytest.mark.parametrize("gain", [0.0, -1.0, 0.05, 7.0, math.nan, math.inf])
def test_a_gain_outside_of_the_range_is_refused(sony: CameraProfile, gain: float) -> None:
    with pytest.raises(ArgumentError, match="calibrated range"):
        sample_parameters(sony, 0, gain_dn_per_e=gain)


def test_a_negative_seed_is_refused(sony: CameraProfile) -> None:
    with pytest.raises(ArgumentError, match="seed"):
        sample_parameters(sony, -1)


def test_parameter_rows_name_every_parameter() -> None:
    rows = parameter_rows(PARAMETERS)
    assert rows[0] == ("K", "1.7", "DN/e-")
    assert [symbol for symbol, _, _ in rows][-4:] == ["bias R", "bias G1", "bias B", "bias G2"]
