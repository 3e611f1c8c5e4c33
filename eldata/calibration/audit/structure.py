"""What the noise of pixels has in common, as figures of components C, W, T and F of the noise model.

Column noise and the rows' spectrum come from the line means that the calibration has anyway
(:mod:`eldata.calibration.core.row_noise`), telegraph pixels from the second pass over the bias frames
(:class:`TelegraphGroups`), PRNU, each pixel's own response to light, from what the two flats of a pair
have in common. A figure that is not told from nothing is given as 0, a spectrum that is not told from a white one as
white: the chance that one is given without a reason is that of the audit, 1 in 100,000
(:data:`~eldata.calibration.core.findings.CHANCE`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from eldata.base.figures import NOT_KNOWN, Figure
from eldata.calibration.audit.bias_checks import row_spectrum
from eldata.calibration.audit.bias_sums import BLOCK, Ripple, spread_bands
from eldata.calibration.core.findings import BANDING, CHANCE, DARK_SIGNAL, LIGHT, ROW_DRIFT, UNLIKE, withheld
from eldata.noise.structure import NoiseStructure, RowSpectrum, TelegraphPixels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import RowNoise

    Plane = NDArray[np.float32]

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
        self._sums = np.zeros((2, 0))

    def add(self, first: NDArray[np.uint16], second: NDArray[np.uint16]) -> None:
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

    def _of_band(
        self, rows: slice, first: NDArray[np.uint16], second: NDArray[np.uint16]
    ) -> tuple[NDArray[np.float64], float]:
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


# --- telegraph pixels -------------------------------------------------------------------------------------------------

_GROUPS = 3  # of bias frames, whose variances know nothing of each other
_JUMP_PIXELS = 1 << 19  # of a frame are looked at for telegraph pixels
_JUMP_REACH = 12.0  # standard deviations, at which single values end
_MOST_JUMP = 0.1  # of the pixels: beyond, moments tell no few noisy pixels from a spread of all of them
_LEAST_ERRORS = 2  # that a share is above 0
_JACKKNIFE = 24  # parts of a frame
_ROUNDS = 6  # each leaves a share of what is wrong, below a tenth


def two_values(second: float, third: float) -> tuple[float, float]:
    """Return share and step of a variable that is one step higher with a chance, from its second and third cumulant.

    They are ``s (1 - s) a^2`` and ``s (1 - s) (1 - 2 s) a^3``, so that ``third^2 / second^3 = 1 / (s (1 - s)) - 4``.
    """
    product = 1 / (4 + third**2 / second**3)
    share = (1 - math.copysign(math.sqrt(max(1 - 4 * product, 0.0)), third)) / 2
    return share, math.sqrt(second / product)


class TelegraphGroups:
    """Accumulates bias frames, by groups one after another, for the share, amplitude and duty of telegraph pixels.

    If all pixels have one noise, of whatever distribution, the variances of a pixel in two groups of frames have no
    covariance; where a share s of them has more variance by d, their second cumulant over the pixels is s (1 - s) d^2,
    and the third one, from the product of three groups, s (1 - s) (1 - 2 s) d^3: :func:`two_values`. A pixel that is an
    amplitude a higher in a share of the frames has d as its second cumulant, and its third, which the covariance of
    third moments with the variances of other groups tells, in the same way says both.

    The memory is 36 bytes a pixel, of half a megapixel at most.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self._fixed = fixed
        self._places = spread_bands(fixed.total_dn.shape, _JUMP_PIXELS)
        sigma = np.sqrt(np.maximum(fixed.temporal_variance_dn2, 1e-6))
        self._sigma_dn = math.sqrt(float(np.mean(sigma**2)))
        self._sound = ~self._cut(fixed.defects)
        self._mean = self._cut(fixed.total_dn).astype(np.float32) / np.float32(fixed.frames)
        channel = np.tile(fixed.pattern, (BLOCK // len(fixed.pattern), self._mean.shape[1] // len(fixed.pattern) + 1))
        self._scale = (1 / sigma[np.tile(channel, (len(self._places), 1))[:, : self._mean.shape[1]]]).astype(np.float32)
        self._size = fixed.frames // _GROUPS
        self._sums = np.zeros((3, *self._mean.shape), np.float32)
        self._seconds: list[Plane] = []
        self._thirds: list[Plane] = []
        self._added = 0

    def _cut(self, plane: NDArray[Any]) -> NDArray[Any]:
        cut: NDArray[Any] = np.concatenate([plane[rows, : plane.shape[1] // BLOCK * BLOCK] for rows in self._places])
        return cut

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a bias frame."""
        if self._size < 2 or len(self._seconds) == _GROUPS:
            return
        values = self._cut(mosaic).astype(np.float32)
        values -= self._mean
        values *= self._scale
        values *= self._sound
        np.clip(values, -_JUMP_REACH, _JUMP_REACH, out=values)
        values -= values.mean(axis=1, keepdims=True)
        for power in range(3):
            self._sums[power] += values ** (power + 1)
        self._added += 1
        if self._added == self._size:
            self._end_group()

    def _end_group(self) -> None:
        n = self._size
        first, second, third = self._sums
        self._seconds.append((second - first**2 / n) / (n - 1))
        if n > 2:
            cubes = third - 3 * first * second / n + 2 * first**3 / n**2
            self._thirds.append(cubes * np.float32(n / ((n - 1) * (n - 2))))
        self._sums[:] = 0
        self._added = 0

    def pixels(
        self, ripple: Ripple, *, is_seen: bool = False
    ) -> tuple[TelegraphPixels | None, tuple[float, float, float]]:
        """Return the telegraph pixels and the errors of share, amplitude [DN] and duty; ``None`` from too few frames.

        The cumulants are means over blocks of 48 x 48 pixels, and the scatter of the second one over them, by Student's
        t, says whether pixels differ at all, where the audit has not (``is_seen``) said so. Errors are the jackknife's,
        over parts of the frame. Without three frames in a group the duty counts as a half. A share above a tenth, or
        not above twice its error, is none: then the third cumulant tells no few noisy pixels.
        """
        from scipy.special import stdtrit

        if len(self._seconds) < _GROUPS:
            return None, (math.nan,) * 3
        cumulants = self._cumulants()
        blocks = cumulants.shape[1]
        # A variance that ripples by r peak to peak over the pixels' levels has a variance of r^2 / 8, or less.
        by_rounding = ripple.variance**2 / 8
        error = float(cumulants[0].std(ddof=1)) / math.sqrt(blocks)
        nothing = TelegraphPixels(0.0, 0.0), (math.nan,) * 3
        if not is_seen and cumulants[0].mean() - by_rounding <= float(stdtrit(blocks - 1, 1 - CHANCE)) * error:
            return nothing
        whole = self._of(cumulants.mean(axis=1))
        if whole[0] > _MOST_JUMP:
            return nothing
        parts = np.array_split(np.arange(blocks), min(_JACKKNIFE, blocks))
        without = np.array([self._of(np.delete(cumulants, part, axis=1).mean(axis=1)) for part in parts])
        of_parts = np.sqrt((len(parts) - 1) * without.var(axis=0))
        share, amplitude, duty = whole
        if share <= _LEAST_ERRORS * of_parts[0]:
            return nothing
        kept = 1 - self._taken_for_defects(amplitude, duty)
        if share > _MOST_JUMP * kept:
            return nothing
        share, of_parts[0] = share / kept, of_parts[0] / kept
        errors = (float(of_parts[0]), float(of_parts[1]), float(of_parts[2]) if self._thirds else math.nan)
        return TelegraphPixels(share, amplitude, duty), errors

    def with_others(self, jumping: TelegraphPixels, whole: ReadNoise, histogram: ResidualHistogram) -> TelegraphPixels:
        """Return telegraph pixels with the read noise of the others, against that of all sound pixels."""
        from eldata.calibration.core.read_noise import read_noise

        if not jumping.share:
            return jumping
        kept = 1 - self._taken_for_defects(jumping.amplitude_dn, jumping.duty)
        others = read_noise(other_pixels(histogram, replace(jumping, share=kept * jumping.share)))
        return replace(
            jumping,
            tukey_lambda_shift=others.tukey_lambda - whole.tukey_lambda,
            sigma_tl_ratio=others.sigma_tl_dn / whole.sigma_tl_dn,
            sigma_gauss_ratio=others.sigma_gauss_dn / whole.sigma_gauss_dn,
        )

    def _taken_for_defects(self, amplitude_dn: float, duty: float) -> float:
        """Return the chance that a telegraph pixel is left out as a defect: its mean may lie off its neighbourhood's.

        The mean is that of the frames without the lowest and the highest value. Of n frames B are at the upper level,
        so that it has B - 1 of them of n - 2, or all or none; beside it there are noise and the pixels' own levels.
        """
        from scipy.special import binom, ndtr

        n = self._fixed.frames
        upper = np.arange(n + 1)
        chances = binom(n, upper) * duty**upper * (1 - duty) ** (n - upper)
        jump = amplitude_dn * (np.clip(upper - 1, 0, n - 2) / (n - 2) - duty)
        limit = float(np.mean(self._fixed.threshold_dn))
        spread = math.hypot(self._sigma_dn / math.sqrt(n - 2), float(np.mean(self._fixed.summary.dsnu_dn)))
        return float(chances @ (ndtr((jump - limit) / spread) + ndtr((-jump - limit) / spread)))

    def _of(self, cumulants: NDArray[np.float64]) -> tuple[float, float, float]:
        """Return share, amplitude in DN and duty."""
        second, third, skewed = (float(value) for value in cumulants)
        if not second > 0:
            return 1.0, 0.0, 0.5
        share, more = two_values(second, third)
        duty, amplitude = two_values(more, skewed / (share * (1 - share) * more))
        return share, amplitude * self._sigma_dn, duty

    def _cumulants(self) -> NDArray[np.float64]:
        """Return (3, blocks): covariance and third cumulant of the variances, covariance of thirds with variances."""
        sound = _by_block(self._sound.astype(np.float64))
        count = np.maximum(sound.sum(axis=1), 3)

        def centred(plane: Plane) -> NDArray[np.float64]:
            values = _by_block(plane.astype(np.float64)) * sound
            centre: NDArray[np.float64] = (values.sum(axis=1) / count)[:, None]
            return (values - centre) * sound

        a, b, c = map(centred, self._seconds)
        second = (a * b + a * c + b * c).sum(axis=1) / 3 / (count - 1)
        third = (a * b * c).sum(axis=1) * count / ((count - 1) * (count - 2))
        skewed = np.zeros_like(second)
        for number, plane in enumerate(self._thirds):
            others = (a, b, c)[number - 1] + (a, b, c)[number - 2]
            skewed += (centred(plane) * others).sum(axis=1) / 6 / (count - 1)
        return np.stack([second, third, skewed])


def other_pixels(histogram: ResidualHistogram, jumping: TelegraphPixels) -> ResidualHistogram:
    """Return the histogram of residuals that the pixels without jumps have, from that of all.

    With the share s, and g the distribution of a jumping pixel's levels less their mean over the n frames, all pixels
    have ``h = (1 - s) h0 + s h0 * g``; ``h0 = (h - s h0 * g) / (1 - s)``, again and again, converges as s is small.
    """
    from scipy.special import binom

    n, duty = histogram.frames, jumping.duty
    others = np.arange(n)
    chances = binom(n - 1, others) * duty**others * (1 - duty) ** (n - 1 - others)
    steps = jumping.amplitude_dn / histogram.cell_dn
    # A residual is what its own frame has, less a share 1/n of all.
    shifts = np.concatenate([(own * (n - 1) - others) / n * steps for own in (0, 1)])
    weights = np.concatenate([(1 - duty) * chances, duty * chances])
    reach = math.ceil(float(np.abs(shifts).max())) + 1
    spread = np.zeros(2 * reach + 1)
    below = np.floor(shifts).astype(np.int64)
    np.add.at(spread, below + reach, weights * (1 - (shifts - below)))
    np.add.at(spread, below + 1 + reach, weights * (shifts - below))
    # Of all groups of rows together: in the tails, where the jumps show, a group's cells hold a residual or none.
    seen = histogram.counts[:, 1:-1].sum(axis=0).astype(np.float64)
    found, jumped = seen, seen
    for _ in range(_ROUNDS):
        jumped = jumping.share * np.convolve(found, spread)[reach:-reach]
        found = (seen - jumped) / (1 - jumping.share)
    counts = histogram.counts.astype(np.float64)
    shares = counts.sum(axis=1) / counts.sum()
    counts[:, 1:-1] = (counts[:, 1:-1] - shares[:, None] * jumped) / (1 - jumping.share)
    return replace(histogram, counts=counts, squares_dn2=None)


def _by_block(plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (blocks, pixels) of a plane of whole blocks."""
    down, across = plane.shape[0] // BLOCK, plane.shape[1] // BLOCK
    blocks = plane.reshape(down, BLOCK, across, BLOCK).swapaxes(1, 2)
    return np.ascontiguousarray(blocks).reshape(down * across, BLOCK * BLOCK)
