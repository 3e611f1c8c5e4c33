"""Does the noise model do what its closed forms say? Frames are simulated for one camera and compared.

Every comparison is one number of the simulation against the same number of the theory. Standard errors are those of
the theory for the number of pixels, rows or draws at hand, so a deviation above 4 of them is no accident: for a normal
statistic it happens once in 16,000 times.

With the pixel noise of variance ``v`` and fourth cumulant ``k`` in rows of ``n`` pixels, R rows, and row noise of
variance ``r``, the squared standard errors are

- of the mean ``(v / n + r) / R``,
- of the variance ``((k + 2 v^2 + 4 r v) / n + 2 r^2) / R``,
- of the standard deviation s of row means, whose variance is ``V = r + v / n``, ``(2 V^2 + k / n^3) / (4 V R)``,
- of the covariance of two channels' row means, with ``q`` their pixel noise, ``(2 r^2 + 2 r q + q^2) / R``,
- of the quantile at u of N draws ``u (1 - u) / N Q'(u)^2``, with the quantile function Q.

The Tukey-lambda distribution has a fourth cumulant for lambda > -1/4 only. At or below that a sample variance has no
standard error: it is shown and not judged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.acceptance.verdicts import (
    CHANNELS,
    SIGNALS_E,
    Diagnostics,
    TheoryCheck,
    read_fit,
    read_sigma_dn,
)
from eldata.calibration.core._tukey_lambda import tukey_lambda_quantile
from eldata.errors import ArgumentError
from eldata.noise.model import NoiseModel
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.calibration.core._frames import Values
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import CameraProfile
    from eldata.noise.structure import Components

DRAWS = 300

_READ_LEVELS = np.array([0.0001, 0.001, 0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 0.999, 0.9999])
_PART_LEVELS = np.array([0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999])

# Packed height and width. Flats have short rows: more rows average the row noise better.
_FLAT = (1024, 64)
_BIAS = (1024, 512)
_READ = (512, 512)
_ROW = (65536, 1)
_QUANTISATION = (256, 256)

# An exposure ratio and a range as in practice, so that the scaling back and forth is under test too.
_RATIO, _RANGE_DN = 100.0, 16383.0
# The frames are float32: a few roundings, systematic where there is no noise to average them.
_ROUNDING = 2.0**-21


def sample_parameters(
    profile: CameraProfile,
    seed: int,
    *,
    iso: float | None = None,
    gain_dn_per_e: float | None = None,
    extrapolate: bool = False,
) -> NoiseParameters:
    """Draw the parameters to examine.

    With an ISO or a gain, lambda and colour bias are of the calibration row nearest in gain, if rows have gains;
    otherwise of any row.

    Raises
    ------
    ArgumentError
        If the ISO is not known, or it or the gain lies outside of the profile's range (by more than 1 %, for rounding)
        and ``extrapolate`` does not allow that.
    """
    low, high = profile.gain_range_dn_per_e
    if gain_dn_per_e is not None and not extrapolate and not low / 1.01 <= gain_dn_per_e <= high * 1.01:
        raise ArgumentError(
            f"gain {gain_dn_per_e:g} DN/e- is outside of the calibrated range {low:.4g} to {high:.4g} of "
            f"{profile.camera}"
        )
    fixed = iso is not None or gain_dn_per_e is not None
    known = any(row.gain_dn_per_e is not None for row in profile.rows)
    return profile.sample(
        _generator(seed, 0),
        iso=iso,
        gain_dn_per_e=gain_dn_per_e,
        row="nearest-gain" if fixed and known else "any",
        extrapolate=extrapolate,
    )


def diagnose(
    profile: CameraProfile,
    parameters: NoiseParameters,
    *,
    spec: str = "P*+G*+B+R+U",
    seed: int = 0,
    simulated: NoiseParameters | None = None,
) -> Diagnostics:
    """Simulate frames and compare them with the closed forms.

    Parameters
    ----------
    profile
        Whose fits are examined too.
    parameters
        What the closed forms are evaluated at.
    spec
        Components of the model (:mod:`eldata.noise.structure`).
    seed
        Of every frame; the same seed gives the same numbers.
    simulated
        What the frames are made with, if not ``parameters``: to see that a difference is found.

    Raises
    ------
    ArgumentError
        If the spec or the seed is unusable.
    """
    one = _Examined(NoiseModel(spec), parameters, parameters if simulated is None else simulated, seed)
    over_signal = _over_signal(one)
    bias, row_means = _bias_frame(one)
    read, quantiles = _read_noise(one)
    rng = _generator(seed, 5)
    draws = tuple(profile.sample(rng) for _ in range(DRAWS))
    return Diagnostics(
        profile=profile,
        parameters=parameters,
        spec=one.parts.spec,
        seed=seed,
        comparisons=(*over_signal, *bias, *read, *_other_parts(one), *_against_fits(profile, one.parts, draws)),
        row_means_dn=row_means,
        quantiles_dn=quantiles,
        draws=draws,
    )


# --- theory -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Examined:
    """The closed forms at fixed parameters, with the moments that their standard errors need; and frames made."""

    model: NoiseModel
    parameters: NoiseParameters
    actual: NoiseParameters
    seed: int

    @property
    def parts(self) -> Components:
        return self.model.components

    @property
    def row_variance(self) -> float:
        return self.parameters.sigma_row_dn**2 if self.parts.row else 0.0

    def mean(self, signal_e: float, channel: int) -> float:
        return self.model.expected_mean_dn(signal_e, self.parameters, channel)

    def variance(self, signal_e: float) -> float:
        return self.model.expected_variance_dn2(signal_e, self.parameters)

    def pixel_variance(self, signal_e: float) -> float:
        return max(self.variance(signal_e) - self.row_variance, 0.0)

    def fourth_cumulant(self, signal_e: float) -> float:
        """Of the pixel noise: Poisson K^4 I, uniform -q^4/120, Gaussian 0."""
        p = self.parameters
        shot = p.gain_dn_per_e**4 * signal_e if self.parts.shot == "poisson" else 0.0
        read = 0.0
        if self.parts.read == "tukey-lambda" and p.sigma_tl_dn > 0:
            variance = p.sigma_tl_dn**2 * tukey_lambda_variance(p.tukey_lambda)
            read = tukey_lambda_kurtosis(p.tukey_lambda) * variance**2
        return shot + read + (-(p.quantisation_step_dn**4) / 120 if self.parts.quantisation else 0.0)

    def rounding(self, signal_e: float) -> float:
        """How far rounding alone may move a mean."""
        largest = max(abs(self.mean(signal_e, channel)) for channel in range(4))
        return _ROUNDING * (largest + math.sqrt(self.variance(signal_e)))

    def frame(self, signal_e: float, size: tuple[int, int], stream: int, spec: str = "") -> Values:
        """Return a packed Bayer flat in DN above black, of these components if they are others than the model's."""
        model = NoiseModel(spec) if spec else self.model
        return _frame(model, self.actual, signal_e, size, _generator(self.seed, stream))


def tukey_lambda_kurtosis(tukey_lambda: float) -> float:
    """Return the excess kurtosis of the Tukey-lambda distribution; infinite for a shape of -1/4 or less."""
    if tukey_lambda <= -0.25:
        return math.inf
    from scipy.stats import tukeylambda

    return float(tukeylambda.stats(tukey_lambda, moments="k"))  # type: ignore[call-overload] # the stubs misspell it


def _finite(variance: float) -> float | None:
    return math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else None


# --- simulation ---------------------------------------------------------------------------------------------------


def _generator(seed: int, stream: int) -> np.random.Generator:
    """Return the generator of one purpose: none of them shares numbers with another."""
    if seed < 0:
        raise ArgumentError(f"the seed must be 0 or more; found {seed}")
    return np.random.default_rng([seed, stream])


def _frame(
    model: NoiseModel, parameters: NoiseParameters, signal_e: float, size: tuple[int, int], rng: np.random.Generator
) -> Values:
    """Return a packed Bayer flat (4, h, w) in DN above black."""
    level = signal_e * parameters.gain_dn_per_e * _RATIO / _RANGE_DN
    clean = np.full((4, *size), level, dtype=np.float32)
    noisy = model(clean, parameters=parameters, ratio=_RATIO, range_dn=_RANGE_DN, generator=rng)
    return noisy.astype(np.float64) * (_RANGE_DN / _RATIO)


def _over_signal(one: _Examined) -> list[TheoryCheck]:
    """Mean and variance of flats. Rows are the independent units: 2 h of them, of 2 w pixels each."""
    height, width = _FLAT
    count, n, r = 2 * height, 2 * width, one.row_variance
    means, variances = [], []
    for index, signal in enumerate(SIGNALS_E):
        frame = one.frame(signal, _FLAT, 100 + index)
        v, rounding = one.pixel_variance(signal), one.rounding(signal)
        centred = frame - frame.mean(axis=(1, 2), keepdims=True)
        # Subtracting the sample's own mean loses that mean's variance, known from the spread of the rows.
        lost = float(centred.mean(axis=2).var(axis=1, ddof=1).mean()) / height
        label, found = f"at {signal:g} e-", float(frame.mean())
        expected = sum(one.mean(signal, channel) for channel in range(4)) / 4
        error = math.hypot(math.sqrt((v / n + r) / count), rounding)
        means.append(TheoryCheck("mean over signal", label, "DN", expected, found, error))
        found = float((centred**2).mean()) + lost
        fourth = one.fourth_cumulant(signal)
        spread = _finite(((fourth + 2 * v * v + 4 * r * v) / n + 2 * r * r) / count + rounding**4)
        variances.append(TheoryCheck("variance over signal", label, "DN^2", one.variance(signal), found, spread))
    return [*means, *variances]


def _bias_frame(one: _Examined) -> tuple[list[TheoryCheck], Values]:
    """Channel means and row means of a bias frame."""
    height, width = _BIAS
    frame = one.frame(0.0, _BIAS, 1)
    v, r, rounding = one.pixel_variance(0.0), one.row_variance, one.rounding(0.0)
    by_channel = frame.mean(axis=2)  # (4, h)
    error = math.hypot(math.sqrt((v / width + r) / height), rounding)
    check = "bias frame, mean by channel"
    comparisons = [
        TheoryCheck(check, name, "DN", one.mean(0.0, channel), float(by_channel[channel].mean()), error)
        for channel, name in enumerate(CHANNELS)
    ]
    centred = by_channel - by_channel.mean(axis=1, keepdims=True)
    red, green, blue, second_green = centred
    # R and G1 share a mosaic row, B and G2 the other.
    row_means = np.sort(np.concatenate([(red + green) / 2, (blue + second_green) / 2]))
    n, count = 2 * width, row_means.size
    expected = r + v / n
    spread = 0.0 if expected == 0 else (2 * expected**2 + one.fourth_cumulant(0.0) / n**3) / (4 * expected * count)
    q = v / width
    shared = float(red @ green + blue @ second_green) / (count - 2)
    apart = float(red @ blue + green @ second_green) / (count - 2)
    found = math.sqrt(float(row_means @ row_means) / (count - 2))
    # Of both covariances: R with B and G1 with G2 are two products of the same two draws.
    error = math.hypot(math.sqrt((2 * r * r + 2 * r * q + q * q) / count), rounding**2)
    check = "bias frame, row means"
    comparisons += (
        TheoryCheck(check, "standard deviation", "DN", math.sqrt(expected), found, _finite(spread + rounding**2)),
        TheoryCheck(check, "covariance, same row", "DN^2", r, shared, error),
        TheoryCheck(check, "covariance, other row", "DN^2", 0.0, apart, error),
    )
    return comparisons, row_means


def _read_noise(one: _Examined) -> tuple[tuple[TheoryCheck, ...], Values | None]:
    """Quantiles of the read noise alone, and expected and found ones on a grid."""
    read, parameters = one.parts.read, one.parameters
    if read == "none":
        return (), None
    values = np.sort(one.frame(0.0, _READ, 2, "G*" if read == "tukey-lambda" else "G"), axis=None)

    def expected_and_slope(levels: Values) -> tuple[Values, Values]:
        if read == "tukey-lambda":
            shape, scale = parameters.tukey_lambda, parameters.sigma_tl_dn
            slope = levels ** (shape - 1) + (1 - levels) ** (shape - 1)
            return scale * tukey_lambda_quantile(levels, shape), scale * slope
        return _gaussian_quantiles(levels, parameters.sigma_gauss_dn)

    comparisons = _quantile_comparisons("read noise alone", values, _READ_LEVELS, *expected_and_slope(_READ_LEVELS))
    logits = np.linspace(math.log(1e-4 / (1 - 1e-4)), -math.log(1e-4 / (1 - 1e-4)), 241)
    grid = 1 / (1 + np.exp(-logits))
    return comparisons, np.stack([expected_and_slope(grid)[0], np.quantile(values, grid)])


def _other_parts(one: _Examined) -> Iterator[TheoryCheck]:
    """Quantiles of the row noise alone, of one pixel per row, and of quantisation alone, uniform over one step."""
    if one.parts.row:
        values = np.sort(one.frame(0.0, _ROW, 3, "R")[[0, 2]], axis=None)  # R and B: every mosaic row once
        expected = _gaussian_quantiles(_PART_LEVELS, one.parameters.sigma_row_dn)
        yield from _quantile_comparisons("row noise alone", values, _PART_LEVELS, *expected)
    if one.parts.quantisation:
        values = np.sort(one.frame(0.0, _QUANTISATION, 4, "U"), axis=None)
        step = one.parameters.quantisation_step_dn
        uniform = step * (_PART_LEVELS - 0.5), np.full_like(_PART_LEVELS, step)
        yield from _quantile_comparisons("quantisation alone", values, _PART_LEVELS, *uniform)


def _gaussian_quantiles(levels: Values, sigma: float) -> tuple[Values, Values]:
    """Return quantiles and their derivative by the level."""
    from scipy.special import ndtri

    z = ndtri(levels)
    return sigma * z, sigma * math.sqrt(2 * math.pi) * np.exp(z * z / 2)


def _quantile_comparisons(
    check: str, values: Values, levels: Values, expected: Values, slope: Values
) -> tuple[TheoryCheck, ...]:
    found = np.quantile(values, levels)
    return tuple(
        TheoryCheck(
            check,
            f"quantile {level:g}",
            "DN",
            float(e) + 0.0,
            float(f) + 0.0,
            math.hypot(math.sqrt(level * (1 - level) / values.size) * float(s), _ROUNDING * abs(float(e))),
        )
        for level, e, f, s in zip(levels, expected, found, slope, strict=True)
    )


# --- the profile's fits -------------------------------------------------------------------------------------------


def _against_fits(
    profile: CameraProfile, components: Components, draws: Sequence[NoiseParameters]
) -> Iterator[TheoryCheck]:
    """Which shares of the draws lie within 1 and 2 sigma of the lines, and where their gains lie."""
    gains = [draw.gain_dn_per_e for draw in draws]
    modes = [profile.mode_at(gain) for gain in gains]
    width = sum(mode.log_width for mode in profile.gain_modes)
    if width > 0:
        # How far along the ranges of all modes, one after the other: the gaps between them have no draws.
        ends = accumulate((mode.log_width for mode in profile.gain_modes), initial=0.0)
        before = dict(zip(profile.gain_modes, ends, strict=False))
        along = [
            before[mode] + math.log(gain / mode.gain_range_dn_per_e[0]) for mode, gain in zip(modes, gains, strict=True)
        ]
        place, error = float(np.mean(along)) / width, math.sqrt(1 / 12 / DRAWS)
        yield TheoryCheck("sampled parameters", "ln K, mean place in its range", "1", 0.5, place, error)
    for name, fits, scales in (
        (
            "sigma_G" if components.read == "gaussian" else "sigma_TL",
            [read_fit(mode, components) for mode in modes],
            [read_sigma_dn(draw, components) for draw in draws],
        ),
        ("sigma_row", [mode.row_fit for mode in modes], [draw.sigma_row_dn for draw in draws]),
    ):
        residuals = np.array(
            [
                abs(math.log(scale) - fit.slope * math.log(gain) - fit.intercept) / fit.sigma
                for fit, gain, scale in zip(fits, gains, scales, strict=True)
                if fit.sigma > 0  # else every draw lies on the line
            ]
        )
        for sigmas in (1, 2) if residuals.size else ():
            share, found = math.erf(sigmas / math.sqrt(2)), float((residuals <= sigmas).mean())
            symbol, error = f"{name}, share within {sigmas} sigma", math.sqrt(share * (1 - share) / residuals.size)
            yield TheoryCheck("sampled parameters", symbol, "1", share, found, error)
