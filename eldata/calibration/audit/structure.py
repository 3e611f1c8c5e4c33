"""What the noise of pixels has in common, as figures of components C, W, T and F of the noise model.

Column noise and the rows' spectrum come from the line means that the calibration has anyway
(:mod:`eldata.calibration.core.row_noise`), telegraph pixels from the second pass over the bias frames
(:mod:`eldata.calibration.audit.telegraph`), PRNU from pairs of flats
(:mod:`eldata.calibration.audit.response_pattern`). A figure that is not told from nothing is given as 0, a spectrum
that is not told from a white one as white: the chance that one is given without a reason is that of the audit, 1 in
100,000 (:data:`~eldata.calibration.audit.bias_checks.CHANCE`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.tables import with_error
from eldata.calibration.audit.bias_checks import CHANCE, LEAKED, LEAST_WAVES, Ripple, periodogram, standing_out
from eldata.calibration.core.findings import withheld
from eldata.noise.structure import NoiseStructure, RowSpectrum, RowWave, TelegraphPixels

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.calibration.audit.telegraph import TelegraphGroups
    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import LineNoise, RowNoise

_BANDING = ("banding", "slow row drift")  # findings by which rows are not white
_UNLIKE = "unlike pixels"
_NOT_JUMPING = ("light", "dark signal")  # findings of pixels that are noisier for another reason
_HANN_NOISE = 1.5  # equivalent noise bandwidth of the window, in frequencies
_HANN_LOBE = 2  # frequencies on each side of a wave's own


@dataclass(frozen=True, slots=True)
class MeasuredStructure:
    """The figures of one ISO with their standard errors.

    Attributes
    ----------
    sigma_column_dn, sigma_column_error_dn
        Of the offset that a column has in a frame; 0 where it is not told from nothing.
    row_spectrum
        Of the rows' offsets; one band where they are not told from white ones. This and ``sigma_column_dn`` are
        ``None`` where row noise is withheld for another reason than bands.
    band_errors_dn2, wave_errors_dn
        Of the spectrum's powers, and of its waves' amplitudes.
    telegraph
        Share 0 where none are told; ``None`` where they were not looked for.
    share_error, amplitude_error_dn, duty_error
        Of its figures.
    prnu, prnu_error
        ``None`` without flats that show it.
    """

    sigma_column_dn: float | None
    sigma_column_error_dn: float
    row_spectrum: RowSpectrum | None
    band_errors_dn2: tuple[float, ...]
    wave_errors_dn: tuple[float, ...]
    telegraph: TelegraphPixels | None
    share_error: float = math.nan
    amplitude_error_dn: float = math.nan
    duty_error: float = math.nan
    prnu: float | None = None
    prnu_error: float = math.nan

    def at(self, gain_dn_per_e: float, iso: float, prnu: float | None) -> NoiseStructure:
        """Return the figures as a profile holds them, with the PRNU of all ISOs together."""
        return NoiseStructure(gain_dn_per_e, iso, self.sigma_column_dn, self.row_spectrum, self.telegraph, prnu)

    def cells(self) -> tuple[str, ...]:
        """Return the figures with their errors, as tables show them."""
        spectrum, jumping = self.row_spectrum, self.telegraph
        columns = rows = share = amplitude = duty = "-"
        if self.sigma_column_dn is not None:
            columns = with_error(self.sigma_column_dn, self.sigma_column_error_dn) if self.sigma_column_dn else "0"
        if spectrum is not None:
            rows = "white" if len(spectrum.power_dn2) == 1 and not spectrum.waves else "banded"
            rows += "".join(f", 1/{1 / wave.frequency_per_row:.3g}" for wave in spectrum.waves)
        if jumping is not None:
            share = with_error(1e6 * jumping.share, 1e6 * self.share_error) if jumping.share else "0"
        if jumping is not None and jumping.share:
            amplitude = with_error(jumping.amplitude_dn, self.amplitude_error_dn)
            duty = with_error(jumping.duty, self.duty_error)
        return (
            columns,
            rows,
            share,
            amplitude,
            duty,
            "-" if self.prnu is None else with_error(100 * self.prnu, 100 * self.prnu_error),
        )


HEADER = ("sigma_column [DN]", "rows", "telegraph [ppm]", "jump [DN]", "duty", "PRNU [%]")


def measured_structure(
    rows: RowNoise,
    findings: Iterable[Finding],
    read: ReadNoise,
    jumping: tuple[TelegraphGroups, ResidualHistogram] | None,
) -> MeasuredStructure:
    """Return what bias frames show.

    Parameters
    ----------
    rows
        Line means over time.
    findings
        What the audit says of the frames: by them rows are banded or withheld, and pixels noisier for another reason
        than jumps.
    read
        Of all pixels.
    jumping
        The sums of the frames and their residuals; ``None``: telegraph pixels are not looked for.
    """
    from scipy.special import ndtri

    columns, findings = rows.columns, tuple(findings)
    seen = {finding.check for finding in findings}
    is_withheld = "row noise" in withheld(finding for finding in findings if finding.check not in _BANDING)
    is_seen = columns.variance_dn2 > -float(ndtri(CHANCE)) * columns.variance_error_dn2
    spectrum, band_errors, wave_errors = row_spectrum(rows.rows, rows.frames, is_banded=not seen.isdisjoint(_BANDING))
    telegraph: tuple[TelegraphPixels | None, tuple[float, float, float]] = None, (math.nan,) * 3
    if jumping is not None and seen.isdisjoint(_NOT_JUMPING):
        groups, residuals = jumping
        found, errors = groups.pixels(Ripple.of(read.tukey_lambda, read.sigma_tl_dn), is_seen=_UNLIKE in seen)
        telegraph = None if found is None else groups.with_others(found, read, residuals), errors
    return MeasuredStructure(
        None if is_withheld else columns.sigma_dn if is_seen else 0.0,
        columns.sigma_error_dn,
        None if is_withheld else spectrum,
        band_errors,
        wave_errors,
        telegraph[0],
        *telegraph[1],
    )


# --- rows ---------------------------------------------------------------------------------------------------------


def row_spectrum(
    line: LineNoise, frames: int, *, is_banded: bool
) -> tuple[RowSpectrum, tuple[float, ...], tuple[float, ...]]:
    """Return the spectrum of the rows' offsets, in octaves, and the errors of its powers and of its waves' amplitudes.

    The pixels' own noise has the same power at every frequency, and is taken off. An ordinate averaged over n frames,
    whose mean is taken off, follows a Gamma distribution of shape n - 1: a band of m has a relative error of
    1 / sqrt(m (n - 1)). Rounding hides or enlarges offsets: all powers are scaled as sigma_row is.
    """
    lines, shape = line.deviations_dn.shape[1], frames - 1
    scale = line.sigma_dn**2 / line.variance_dn2 if line.variance_dn2 > 0 else 1.0
    lowest = 0.5 / lines
    if not is_banded:
        error = 2 * line.sigma_dn * line.sigma_error_dn
        return RowSpectrum((lowest, 0.5), (line.sigma_dn**2,)), (error,), ()
    waves, wave_errors = _waves(line, shape, scale)
    frequency, power = periodogram(line, np.ones(lines), blurred_over=0.5)
    of_pixels = float((line.deviations_dn**2).sum()) / line.deviations_dn.size * frames / shape - line.variance_dn2
    kept = np.ones(frequency.size, dtype=np.bool_)
    for wave in waves:
        # The power that a wave leaks to, without a window, falls with the square of the distance.
        height = lines * wave.amplitude_dn**2 / 4 / scale
        distance = np.maximum(np.abs(frequency - wave.frequency_per_row) * lines, 0.5)
        kept &= height / (math.pi * distance) ** 2 < LEAKED * np.median(power)
    edges, powers, errors = [lowest], list[float](), list[float]()
    upper = 1.5 / lines
    while edges[-1] < 0.5:
        upper = 0.5 if 2 * upper > 0.5 else upper
        chosen = kept & (frequency > edges[-1]) & (frequency <= upper)
        if chosen.any():
            mean = float(power[chosen].mean())
            powers.append(scale * max(mean - of_pixels, 0.0))
            errors.append(scale * mean / math.sqrt(shape * int(chosen.sum())))
            edges.append(upper)
        elif upper == 0.5:
            edges[-1] = 0.5
        upper = 2 * upper
    if not powers:  # a wave at every frequency that is left
        return RowSpectrum((lowest, 0.5), (0.0,), waves), (0.0,), wave_errors
    return RowSpectrum(tuple(edges), tuple(powers), waves), tuple(errors), wave_errors


def _waves(line: LineNoise, shape: int, scale: float) -> tuple[tuple[RowWave, ...], tuple[float, ...]]:
    """Return the waves that stand out under a Hann window, and the errors of their amplitudes.

    A wave's power is that of the frequencies around its own, over the ground; its amplitude in one frame of N rows over
    white noise of power g scatters by sqrt(2 g / N), under the window by sqrt(1.5) of it. With the pixels' own means
    goes what the mean of the n frames holds of a wave of free phase: of its square an exponential share, of mean and
    scatter 1 / n.
    """
    lines = line.deviations_dn.shape[1]
    frequency, power, ground, threshold = standing_out(line, shape)
    places = np.flatnonzero((power > threshold * ground) & (frequency > LEAST_WAVES / lines))
    waves, errors = [], []
    for group in np.split(places, np.flatnonzero(np.diff(places) > _HANN_LOBE) + 1) if places.size else []:
        around = slice(max(int(group[0]) - _HANN_LOBE, 0), int(group[-1]) + _HANN_LOBE + 1)
        excess = (power - ground)[around]
        variance = float(excess.sum()) * 2 / lines
        middle = float(np.maximum(excess, 0) @ frequency[around] / np.maximum(excess, 0).sum())
        waves.append(RowWave(middle, math.sqrt(scale * 2 * max(variance, 0.0))))
        by_ground = scale * 2 * _HANN_NOISE * float(ground[around].mean()) / (lines * (shape + 1))
        errors.append(math.hypot(math.sqrt(by_ground), waves[-1].amplitude_dn / (2 * shape)))
    return tuple(waves), tuple(errors)


def pooled_prnu(found: Sequence[MeasuredStructure]) -> float | None:
    """Return the PRNU of all ISOs together, weighed by their errors; ``None`` where no flats show it."""
    known = [(one.prnu, one.prnu_error) for one in found if one.prnu is not None]
    seen = [(value, error) for value, error in known if value > 0]
    if not seen:
        return 0.0 if known else None
    values, errors = np.array(seen).T
    return float(np.average(values, weights=errors**-2.0))
