"""What the noise of pixels has in common, as figures of components C, W, T and F of the noise model.

Column noise and the rows' spectrum come from the line means that the calibration has anyway
(:mod:`eldata.calibration.core.row_noise`), telegraph pixels from the second pass over the bias frames
(:mod:`eldata.calibration.audit.telegraph`), PRNU, each pixel's own response to light, from what the two flats of a pair
have in common. A figure that is not told from nothing is given as 0, a spectrum that is not told from a white one as
white: the chance that one is given without a reason is that of the audit, 1 in 100,000
(:data:`~eldata.calibration.core.findings.CHANCE`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from eldata.base.numbers import NOT_KNOWN, Figure
from eldata.calibration.audit.bias_sums import BLOCK, Ripple, spread_bands
from eldata.calibration.audit.row_waves import row_spectrum
from eldata.calibration.core.findings import BANDING, CHANCE, DARK_SIGNAL, LIGHT, ROW_DRIFT, UNLIKE, withheld
from eldata.noise.structure import NoiseStructure, RowSpectrum, TelegraphPixels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from eldata.calibration.audit.telegraph import TelegraphGroups
    from eldata.calibration.core._frames import Mosaic, Values
    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import RowNoise


_BANDING = (BANDING.name, ROW_DRIFT.name)  # findings by which rows are not white
_NOT_JUMPING = (LIGHT.name, DARK_SIGNAL.name)  # findings of pixels that are noisier for another reason
_MOST_PIXELS = 1 << 20  # and of a flat for PRNU
_REACH = 8.0
_BY_SECOND = 1.5  # variance of a pixel less the mean of two others, over that of a pixel
_SATURATED = 1e-4  # share of pixels from which on a pair is left out
_FEWEST_BLOCKS = 24


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

    @property
    def rows(self) -> str:
        """What the rows' offsets are like, in a word or two; "-" where row noise is withheld."""
        spectrum = self.row_spectrum
        if spectrum is None:
            return NOT_KNOWN
        kind = "white" if len(spectrum.power_dn2) == 1 and not spectrum.waves else "banded"
        return kind + "".join(f", 1/{1 / wave.frequency_per_row:.3g}" for wave in spectrum.waves)

    def cells(self) -> tuple[str, ...]:
        """Return the figures with their errors, as tables show them."""
        first, *others = (figure.cell(self) for figure in STRUCTURE)
        return (first, self.rows, *others)


@dataclass(frozen=True, slots=True, kw_only=True)
class StructureFigure(Figure):
    """A figure of what the noise of pixels has in common.

    Attributes
    ----------
    of
        Value and standard error, in the figure's unit; ``None``: it was not looked for, or there is none.
    nothing
        How tables show that it is not told from nothing; empty: as a value with its error.
    """

    of: Callable[[MeasuredStructure], tuple[float, float] | None]
    nothing: str = "0"

    def cell(self, structure: MeasuredStructure) -> str:
        """Return the figure as tables show it."""
        found = self.of(structure)
        if found is None:
            return NOT_KNOWN
        return self.nothing if self.nothing and not found[0] else self.format(*found)


def _column(one: MeasuredStructure) -> tuple[float, float] | None:
    return None if one.sigma_column_dn is None else (one.sigma_column_dn, one.sigma_column_error_dn)


def _share(one: MeasuredStructure) -> tuple[float, float] | None:
    return None if one.telegraph is None else (1e6 * one.telegraph.share, 1e6 * one.share_error)


def _jump(one: MeasuredStructure) -> tuple[float, float] | None:
    return (one.telegraph.amplitude_dn, one.amplitude_error_dn) if one.telegraph and one.telegraph.share else None


def _duty(one: MeasuredStructure) -> tuple[float, float] | None:
    return (one.telegraph.duty, one.duty_error) if one.telegraph and one.telegraph.share else None


def _prnu(one: MeasuredStructure) -> tuple[float, float] | None:
    return None if one.prnu is None else (100 * one.prnu, 100 * one.prnu_error)


STRUCTURE: Final = (
    StructureFigure(
        name="sigma_column_dn", label="sigma_column", symbol="σ column", unit="DN", meaning="column noise", of=_column
    ),
    StructureFigure(name="telegraph_share", label="telegraph", unit="ppm", meaning="pixels that jump", of=_share),
    StructureFigure(name="amplitude_dn", label="jump", unit="DN", meaning="how far they jump", of=_jump),
    StructureFigure(name="duty", label="duty", meaning="share of frames at the upper level", of=_duty),
    StructureFigure(name="prnu", label="PRNU", unit="%", meaning="pixels' own response to light", of=_prnu, nothing=""),
)
"""Figures of components C, T and F; that of W is a spectrum (:attr:`MeasuredStructure.rows`)."""

COLUMN, SHARE, JUMP, DUTY, PRNU = STRUCTURE
HEADER: Final = (COLUMN.heading, "rows", *(figure.heading for figure in STRUCTURE[1:]))


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
        found, errors = groups.pixels(Ripple.of(read.tukey_lambda, read.sigma_tl_dn), is_seen=UNLIKE.name in seen)
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


def pooled_prnu(found: Sequence[MeasuredStructure]) -> float | None:
    """Return the PRNU of all ISOs together, weighed by their errors; ``None`` where no flats show it."""
    known = [(one.prnu, one.prnu_error) for one in found if one.prnu is not None]
    seen = [(value, error) for value, error in known if value > 0]
    if not seen:
        return 0.0 if known else None
    values, errors = np.array(seen).T
    return float(np.average(values, weights=errors**-2.0))


class ResponsePattern:
    """Accumulates pairs of flats for PRNU: what the two frames of a pair have in common, pixel by pixel.

    Of each pixel the mean of the next two of its site to the left and to the right is taken off, and with it light that
    changes straight over them, and what a row has in common. The products of two frames have the pattern's variance,
    ``3/2 (prnu^2 signal^2 + v / n)``: the mean of n bias frames, with noise of variance v, was taken off both.

    Parameters
    ----------
    fixed
        Of the bias frames.
    limit_dn
        From which value on a pixel counts as saturated.
    """

    def __init__(self, fixed: FixedPattern, limit_dn: float) -> None:
        self._fixed, self._limit = fixed, limit_dn
        self._places = spread_bands(fixed.total_dn.shape, _MOST_PIXELS)
        self._sums: Values = np.zeros((2, 0))

    def add(self, first: Mosaic, second: Mosaic) -> None:
        """Add a pair of equal flats; one that saturates is left out.

        Its weight is the inverse of the square of what its noise adds to prnu^2.
        """
        sums, noise = [], []
        for rows in self._places:
            flats = first[rows], second[rows]
            if max(float(np.mean(flat >= self._limit)) for flat in flats) > _SATURATED:
                return
            found, spread = self._of_band(rows, *flats)
            sums.append(found)
            noise.append(spread)
        pair = np.concatenate(sums, axis=1)
        signal2 = float(pair[1].sum()) / max(float(pair[2].sum()), 1.0)
        if signal2 > 0:
            weight = signal2 / float(np.mean(noise)) ** 2
            self._sums = weight * pair[:2] + (self._sums if self._sums.size else 0.0)

    def _of_band(self, rows: slice, first: Mosaic, second: Mosaic) -> tuple[Values, float]:
        """Return, by block of columns, the products over the noise's share, the signals' products, how many; noise."""
        fixed, pattern = self._fixed, self._fixed.pattern
        period, blocks = len(pattern), first.shape[1] // BLOCK
        sums, noise = np.zeros((3, blocks)), []
        mean = fixed.total_dn[rows].astype(np.float32) / np.float32(fixed.frames)
        for (y, x), channel in np.ndenumerate(pattern):
            site = slice(y, None, period), slice(x, blocks * BLOCK, period)
            a, b = (flat[site] - mean[site] for flat in (first, second))
            sound = ~fixed.defects[rows][site]
            sound = sound[:, 1:-1] & sound[:, :-2] & sound[:, 2:]
            high = [plane[:, 1:-1] - (plane[:, :-2] + plane[:, 2:]) / 2 for plane in (a, b)]
            for plane in high:
                low, top = np.quantile(plane, (0.159, 0.841))
                sound &= np.abs(plane) < _REACH * max(float(top - low) / 2, 0.5)
            dark = _BY_SECOND * fixed.temporal_variance_dn2[channel] / fixed.frames
            columns = np.arange(1, a.shape[1] - 1) * period // BLOCK
            for number, values in enumerate((high[0] * high[1] - dark, a[:, 1:-1] * b[:, 1:-1], np.ones_like(high[0]))):
                sums[number] += np.bincount(columns, (values * sound).sum(axis=0, dtype=np.float64), blocks)
            noise.append(float(np.mean((high[0] - high[1]) ** 2)) / 2)
        return sums, float(np.mean(noise))

    def prnu(self) -> tuple[float | None, float]:
        """Return the PRNU and its standard error, by the scatter of blocks; 0 where it is not told from nothing.

        The blocks' sums are those of all pairs: what a pattern of finitely many pixels adds to the error is in it.
        """
        from scipy.special import stdtrit

        products, signals = self._sums
        if products.size < _FEWEST_BLOCKS or not signals.sum() > 0:
            return None, math.nan
        blocks, total = products.size, _BY_SECOND * float(signals.sum())
        square = float(products.sum()) / total
        left = products - square * _BY_SECOND * signals
        error = math.sqrt(float(left @ left) * blocks / (blocks - 1)) / total
        if square <= float(stdtrit(blocks - 1, 1 - CHANCE)) * error:
            return 0.0, math.sqrt(error)
        return math.sqrt(square), error / (2 * math.sqrt(square))
