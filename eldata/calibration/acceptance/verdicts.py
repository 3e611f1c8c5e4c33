"""What the diagnostics of a noise profile found: comparisons of simulation and theory, and what the plots show."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.noise.model import NoiseModel

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.calibration.core._frames import Values
    from eldata.noise.gain_modes import GainMode, LogLogFit
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import CameraProfile
    from eldata.noise.structure import Components

CHANNELS = ("R", "G1", "B", "G2")
SIGNALS_E = (0.0, 1.0, 3.0, 10.0, 30.0, 60.0, 100.0, 150.0, 200.0, 300.0, 400.0, 500.0)

LIMIT = 4.0
"""Deviations up to this many standard errors are "ok"."""

_FAR = 1e9  # larger deviations are not told apart: a number stays a number in JSON

Verdict = Literal["ok", "off", "-"]


@dataclass(frozen=True, slots=True)
class TheoryCheck:
    """One number of the simulation against the theory's.

    Attributes
    ----------
    check
        What is examined, such as ``"variance over signal"``.
    symbol, unit
        Which number of it; 1 is the unit of a plain number.
    expected, found
        By the closed form, and in the simulated frames.
    standard_error
        Of ``found``; ``None`` where it has none.
    """

    check: str
    symbol: str
    unit: str
    expected: float
    found: float
    standard_error: float | None

    @property
    def deviation(self) -> float | None:
        """How far ``found`` lies from ``expected``, in standard errors."""
        if self.standard_error is None:
            return None
        difference = self.found - self.expected
        return (
            max(-_FAR, min(_FAR, difference / self.standard_error)) if self.standard_error else _FAR * (difference != 0)
        )

    @property
    def verdict(self) -> Verdict:
        """``"ok"`` up to 4 standard errors, else ``"off"``; ``"-"`` if there is no standard error."""
        deviation = self.deviation
        if deviation is None:
            return "-"
        return "ok" if abs(deviation) <= LIMIT else "off"

    def cells(self) -> tuple[str, str, str, str, str]:
        """Return expected, found, standard error, deviation and verdict, with the digits that mean something."""
        error, deviation = self.standard_error, self.deviation
        if error is None or deviation is None:
            return f"{self.expected:.5g}", f"{self.found:.5g}", "-", "-", self.verdict
        size = abs(deviation)
        shown = f"{deviation:+.0f}" if size < 1e5 else f"{deviation:+.0e}"
        if size < 100:
            shown = f"{round(deviation, 1) + 0.0:+.1f}"
        if not 1e-9 < error < 1e9:
            return f"{self.expected:.6g}", f"{self.found:.6g}", f"{error:.1g}", shown, self.verdict
        places = max(0, math.ceil(-math.log10(error / 3)))  # the error has two digits up to 0.29, one from 0.3 on
        expected, found = (f"{round(value, places) + 0.0:.{places}f}" for value in (self.expected, self.found))
        return expected, found, f"{error:.{places}f}", shown, self.verdict

    def as_dict(self) -> dict[str, str | float | None]:
        """Return fields, deviation and verdict as plain types."""
        return asdict(self) | {"deviation": self.deviation, "verdict": self.verdict}


def table_rows(comparisons: Iterable[TheoryCheck]) -> list[tuple[str, ...]]:
    """Return check, symbol, unit and cells of each comparison; of a check the first one alone names it."""
    return [
        ("" if index else check, one.symbol, one.unit, *one.cells())
        for check, group in groupby(comparisons, lambda one: one.check)
        for index, one in enumerate(group)
    ]


def parameter_rows(parameters: NoiseParameters) -> list[tuple[str, str, str]]:
    """Return symbol, value and unit of each parameter."""
    bias = zip(CHANNELS, parameters.colour_bias_dn, strict=True)
    return [
        ("K", f"{parameters.gain_dn_per_e:.5g}", "DN/e-"),
        ("lambda", f"{parameters.tukey_lambda:.5g}", "1"),
        ("sigma_TL", f"{parameters.sigma_tl_dn:.5g}", "DN"),
        ("sigma_G", f"{parameters.sigma_gauss_dn:.5g}", "DN"),
        ("sigma_row", f"{parameters.sigma_row_dn:.5g}", "DN"),
        *((f"bias {name}", f"{value:.5g}", "DN") for name, value in bias),
        *([("q", f"{step:.5g}", "DN")] if (step := parameters.quantisation_step_dn) != 1 else []),
    ]


def read_fit(mode: GainMode, components: Components) -> LogLogFit:
    """Return the fit of the read noise that a model uses: sigma_TL, or the Gaussian sigma for ``G``."""
    return mode.gauss_fit if components.read == "gaussian" else mode.tukey_lambda_fit


def read_sigma_dn(parameters: NoiseParameters, components: Components) -> float:
    """Return the scale of the read noise that a model uses."""
    return parameters.sigma_gauss_dn if components.read == "gaussian" else parameters.sigma_tl_dn


@dataclass(frozen=True, eq=False, slots=True)
class Diagnostics:
    """All comparisons of one camera's noise, and what the plots show.

    Attributes
    ----------
    profile, parameters, spec, seed
        What was examined.
    comparisons
        Every one, in the order of the report: mean and variance by signal, in the order of :data:`SIGNALS_E`; a bias
        frame's means by channel, and its row means; quantiles of the read noise, the row noise and the quantisation
        alone; sampled parameters against the profile's fits.
    row_means_dn
        Sorted row means of the bias frame, each less its channels' mean.
    quantiles_dn
        (2, n) of the read noise alone, expected and found; ``None`` if the model has none.
    draws
        Parameters as sampled from the profile, which the last comparisons are about.
    """

    profile: CameraProfile
    parameters: NoiseParameters
    spec: str
    seed: int
    comparisons: tuple[TheoryCheck, ...]
    row_means_dn: Values
    quantiles_dn: Values | None
    draws: tuple[NoiseParameters, ...]

    @property
    def model(self) -> NoiseModel:
        """The model under test."""
        return NoiseModel(self.spec)

    @property
    def normal_quantiles(self) -> Values:
        """The standard normal quantile at each of ``row_means_dn``, for their probability plot."""
        from scipy.special import ndtri

        count = self.row_means_dn.size
        quantiles: Values = ndtri((np.arange(count) + 0.5) / count)
        return quantiles

    def expected_mean_dn(self, signal_e: float) -> float:
        """Return the closed-form mean of D over the four channels, DN above black."""
        return sum(self.model.expected_mean_dn(signal_e, self.parameters, channel) for channel in range(4)) / 4

    def expected_variance_dn2(self, signal_e: float) -> float:
        """Return the closed-form variance of D, DN^2."""
        return self.model.expected_variance_dn2(signal_e, self.parameters)

    def of(self, check: str) -> tuple[TheoryCheck, ...]:
        """Return the comparisons of one check."""
        return tuple(comparison for comparison in self.comparisons if comparison.check == check)

    @property
    def off(self) -> tuple[TheoryCheck, ...]:
        """The comparisons that are off."""
        return tuple(comparison for comparison in self.comparisons if comparison.verdict == "off")

    @property
    def summary(self) -> str:
        """The outcome in one sentence."""
        judged = [comparison for comparison in self.comparisons if comparison.verdict != "-"]
        off, unjudged = len(self.off), len(self.comparisons) - len(judged)
        if off:
            text = f"{off} of {len(judged)} comparisons off by more than {LIMIT:g} standard errors"
        else:
            text = f"all {len(judged)} comparisons within {LIMIT:g} standard errors"
        if unjudged:
            text += f"; {unjudged} more have no standard error, because lambda is not above -1/4"
        return text

    def as_dict(self) -> dict[str, Any]:
        """Return what the terminal shows as plain types."""
        profile = self.profile.as_dict()
        return {
            "camera": self.profile.camera,
            "profile": {key: profile[key] for key in ("source", "gain_range_dn_per_e", "iso_range", "notes")}
            | {"accepted": list(self.profile.accepted)},
            "model": self.spec,
            "seed": self.seed,
            "parameters": self.parameters.as_dict(),
            "limit_standard_errors": LIMIT,
            "ok": not self.off,
            "comparisons": [comparison.as_dict() for comparison in self.comparisons],
        }
