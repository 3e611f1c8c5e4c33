"""What rounding to whole DN does to residuals and row means where the pixels' levels share their fractions of a DN.

Rounding adds an independent uniform error only where a pixel's level may lie anywhere between two whole numbers, or the
noise is wide enough: where its characteristic function is 0 at 2 pi. In a quiet body without fixed pattern all levels
have one fraction. Near 0 it hides noise, and row offsets with it; near 1/2 it enlarges them.

A pixel of level m and row offset r, s = m + r, is recorded as round(s + e), with noise e of characteristic function
phi. The recorded value less s has the characteristic function ::

    sum over l of exp(2 pi i l s) Q(w + 2 pi l),   Q(w) = phi(w) sin(w / 2) / (w / 2)

of which independent uniform rounding is the term l = 0. A residual is one such value less the mean of n and lies on the
lattice of 1/n DN; its probabilities are the inverse transform of a product of n such sums, averaged over the pixels'
levels. Of these only the means of exp(2 pi i l m) matter, which the sum of n frames tells: its remainder modulo n is
the fraction of a pixel's mean, which the noise blurs by a factor that the model knows.

The mean that is taken off a row is itself of recorded values, and taken to 1/n DN: a row's offset sets both that and
the rounding of its pixels. What rounding leaves of the mean is a wave of it, whose terms are products over the n frames
too.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import kernel
from eldata.calibration.core._tukey_lambda import smoothed_tails
from eldata.calibration.core.row_noise import OffsetResponse, normal_nodes
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Values

    Complex: TypeAlias = NDArray[np.complexfloating[Any, Any]]

HARMONICS = 12
"""Means of exp(2 pi i l m) that are known of the levels."""

_MOST_TERMS = 8  # of the sum over l, on each side of the largest
_NEGLIGIBLE = 1e-7  # amplitude of what rounding adds; a hundred million residuals do not show it
_PER_DN = 16  # values of the density of noise and rounding per DN
_REACH = 25.0  # standard deviations at which that density ends; further out the independent model does
_FRACTION_ERROR = 0.02, 0.5  # of expected waves, and of what takes the non-uniformity for normal
_WIDE_DN = 1.0  # of row offsets: beyond, residuals depend on them by their fraction of a DN alone, and that is even
_PHASES = 128  # of these
_LEAST_BLUR_DN2 = 1e-5  # of row means, whose sum over waves would not end: 1/300 DN, where they are taken to 1/n DN


@dataclass(frozen=True, slots=True, eq=False)
class LevelFractions:
    """Where between whole DN the pixels' levels lie, and how far the offsets of rows and frames move them.

    Attributes
    ----------
    remainders
        (groups of rows, channels, n) sound pixels by the sum of their n frames modulo n.
    local_levels
        (channels, bins) share of the pixels by the fraction of their neighbourhood's mean, in even bins from 0 on.
    dsnu_dn
        (channels,) standard deviation of the pixels' levels around it.
    rows
        (kinds of rows, channels) share of all pixels: the channels of one row have one offset.
    offset_variance_dn2
        Of the offsets that were taken off (of the row, and of the channel in the frame), without the pixels' noise in
        them.
    pixel_variance_dn2
        Over time, around these offsets.
    """

    remainders: Counts = field(repr=False)
    local_levels: Values = field(repr=False)
    dsnu_dn: Values
    rows: Values = field(repr=False)
    offset_variance_dn2: float
    pixel_variance_dn2: float

    @property
    def pixels(self) -> Counts:
        """By group and channel."""
        return np.asarray(self.remainders.sum(axis=2))

    def waves(self) -> Values:
        """Return the mean of exp(2 pi i l sum / n): (groups, channels, 2 k), k real parts, then k imaginary ones."""
        frames = self.remainders.shape[2]
        harmonics = np.arange(1, min(HARMONICS, frames // 2) + 1)
        turns = np.exp(2j * math.pi * np.outer(np.arange(frames), harmonics) / frames)
        waves = self.remainders @ turns / np.maximum(self.pixels, 1)[..., None]
        return np.concatenate([waves.real, waves.imag], axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class Rounded:
    """What rounding makes of one distribution of the noise.

    Attributes
    ----------
    by_fraction
        (kinds of rows, fractions, points): by how much the probability that abs(residual) is 0, 1, ... 1/n DN is above
        that with independent uniform rounding (0 +- 1/2, ...), for pixels of one fraction each.
    weights
        (channels, fractions) share of the channel's pixels. A Fourier series: some may be below 0.
    weights_by_wave
        (channels, fractions, 2 k): its derivative by the observed waves.
    rows
        (kinds of rows, channels) share of all pixels.
    response
        Of row means to row offsets.
    variance_dn2
        By how much the variance of residuals is above that with independent uniform rounding.
    shift_dn
        By how much the mean recorded value is off the level, at most, where all pixels have one fraction.
    """

    by_fraction: Values
    weights: Values
    weights_by_wave: Values
    rows: Values
    response: OffsetResponse
    variance_dn2: float
    shift_dn: float

    @property
    def change(self) -> Values:
        """(points,) averaged over the pixels."""
        return np.asarray(np.einsum("kc,cf,kfp->p", self.rows, self.weights, self.by_fraction, optimize=True))

    def by_wave(self, weights: Values) -> Values:
        """Return the derivative of ``change @ weights``, weights (points, 2), by the waves: (channels, 2 k, 2)."""
        sums = np.einsum("kfp,pj->kfj", self.by_fraction, weights, optimize=True)
        return np.asarray(np.einsum("kc,cfw,kfj->cwj", self.rows, self.weights_by_wave, sums, optimize=True))


@dataclass(frozen=True, slots=True, eq=False)
class RoundedResiduals:
    """Residuals of n frames with rounding as it is.

    Parameters
    ----------
    frames, row_pixels
        Over which each pixel's and each row's mean was taken off.
    fractions
        Of the pixels' levels.
    """

    frames: int
    row_pixels: float
    fractions: LevelFractions

    def at(self, shape: float, sigma: float) -> Rounded:
        """Return what rounding makes of Tukey-lambda noise of a shape and scale."""
        noise = _Noise(shape, sigma, self.frames)
        rows = self.fractions.rows
        offsets = math.sqrt(max(self.fractions.offset_variance_dn2, 0.0))
        for _ in range(4):
            levels, by_wave = self._levels(noise, offsets)
            response = _response(noise, levels, rows)
            offsets = response.sigma_dn(self.fractions.offset_variance_dn2 / (1 - 1 / self.frames))
        turns = np.exp(-2j * math.pi * np.outer(noise.fractions, np.arange(1, noise.harmonics + 1)))
        weights = (1 + 2 * (levels[:, : noise.harmonics] @ turns.T).real) / noise.fractions.size
        weights_by_wave = 2 * (turns @ by_wave[:, : noise.harmonics]).real / noise.fractions.size
        changes = [self._changes(noise, offsets, response, kind) for kind in range(len(rows))]
        by_fraction = np.stack([change for change, _ in changes])
        rounding = float(response.shares @ [lost for _, lost in changes])
        rounded = Rounded(
            by_fraction,
            weights,
            weights_by_wave,
            rows,
            response,
            # Lattice points stand for residuals whose offset is rounded to 1/n DN; those of the other model for cells.
            variance_dn2=1 / (12 * self.frames**2) - rounding,
            shift_dn=2 * float(np.abs(noise.slopes(np.arange(1, 2))).sum()),
        )
        points = np.arange(by_fraction.shape[2]) / self.frames
        return replace(rounded, variance_dn2=rounded.variance_dn2 + float(rounded.change @ points**2))

    def _levels(self, noise: _Noise, offsets: float) -> tuple[Complex, Complex]:
        """Return the mean of exp(2 pi i l m) by channel, and its derivative by the observed waves.

        These are linear in these means; where the noise blurs them, what is expected stays.
        """
        counts = self.fractions.pixels
        of_channel = counts.sum(axis=0)
        observed = np.einsum("gc,gcw->cw", counts, self.fractions.waves()) / np.maximum(of_channel, 1)[:, None]
        number = observed.shape[1] // 2
        frequency = 2 * math.pi * np.arange(1, number + 1) / self.frames
        order = frequency + 2 * math.pi * noise.terms[:, None]
        one = noise.turns @ (noise(order) * np.exp(-0.5 * (order * offsets) ** 2))
        whole = (one * np.exp(1j * np.outer(noise.fractions, frequency))) ** self.frames
        series = np.fft.fft(whole, axis=0) / len(whole)  # coefficients of exp(2 pi i l m)
        known = np.arange(1, noise.harmonics + 1)
        plus, minus, constant = series[known].T, series[-known].T, series[0]
        real, imaginary = plus + minus, 1j * (plus - minus)
        matrix = np.block([[real.real, imaginary.real], [real.imag, imaginary.imag]])
        levels = np.zeros((len(of_channel), HARMONICS), dtype=np.complex128)
        by_wave = np.zeros((len(of_channel), HARMONICS, 2 * number), dtype=np.complex128)
        rest = observed - np.concatenate([constant.real, constant.imag])
        all_expected, all_errors = self._expected(noise, offsets)
        for channel, pixels in enumerate(of_channel):
            expected, errors = all_expected[channel, : known.size], all_errors[channel, : known.size]
            prior = np.concatenate([expected.real, expected.imag])
            weight = 2.0 * pixels  # the mean wave of N pixels scatters by 1 / (2 N) in each part
            left = matrix.T @ matrix * weight + np.diag(np.tile(1 / errors**2, 2))
            gain = np.linalg.solve(left, matrix.T * weight)
            found = prior + gain @ (rest[channel] - matrix @ prior)
            levels[channel, : known.size] = found[: known.size] + 1j * found[known.size :]
            by_wave[channel, : known.size] = gain[: known.size] + 1j * gain[known.size :]
        return levels / np.maximum(np.abs(levels), 1.0), by_wave

    def _expected(self, noise: _Noise, offsets: float) -> tuple[Complex, Values]:
        """Return the mean of exp(2 pi i l m), (channels, HARMONICS), if non-uniformity is normal, and its error.

        Rounding moves the neighbourhoods' means off their levels, too.
        """
        orders = np.arange(1, HARMONICS + 1)
        share = self.fractions.local_levels
        bins = share.shape[1]
        true = (np.arange(2 * bins + 1) - bins // 2) / bins
        turns = np.exp(2j * math.pi * np.outer(true, orders[:_MOST_TERMS]))
        expected, errors = np.zeros((len(share), HARMONICS), dtype=np.complex128), np.zeros((len(share), HARMONICS))
        for channel, dsnu in enumerate(self.fractions.dsnu_dn):
            blurred = np.exp(-2 * (math.pi * orders) ** 2 * (dsnu**2 + offsets**2))
            waves = blurred[:_MOST_TERMS] * noise.slopes(orders[:_MOST_TERMS])
            recorded = true + 2 * (turns * waves).imag.sum(axis=1)
            levels = np.interp(np.arange(bins) / bins, np.maximum.accumulate(recorded), true)
            normal = np.exp(-2 * (math.pi * orders * dsnu) ** 2)
            expected[channel] = normal * (np.exp(2j * math.pi * np.outer(orders, levels)) * share[channel]).sum(axis=1)
            errors[channel] = _FRACTION_ERROR[0] + _FRACTION_ERROR[1] * (1 - normal)
        return expected, errors

    def _changes(self, noise: _Noise, offsets: float, response: OffsetResponse, kind: int) -> tuple[Values, float]:
        """Return ``by_fraction`` of one kind of rows, and the variance that rounding to 1/n DN takes from offsets."""
        n = self.frames
        points = 2 * n * noise.reach
        frequency = 2 * math.pi * np.arange(points // 2 + 1) * n / points
        nodes, shares = normal_nodes(offsets) if offsets < _WIDE_DN else _even_nodes()
        seen = response.seen(nodes)[kind]

        # Taken off is D, the row's recorded mean less that of n frames, to the nearest 1/n DN; its pixels' noise is in
        # it. All y = recorded value less level, and less what is seen of its offset, are alike and independent, and
        # residual = own y - mean of n y + D - rounded D. The last two are a wave of D with a period of 1/n DN:
        # exp(i w (D - rounded D)) = sum over k of sinc(w / (2 pi n) - k) exp(2 pi i k n D), and D is a sum over frames.
        blur2 = self.fractions.pixel_variance_dn2 * (1 - 1 / n) / self.row_pixels
        blur2 = max(blur2, _LEAST_BLUR_DN2)
        whole = np.zeros((noise.fractions.size, frequency.size))
        rounding = 1 / (12 * n**2)
        small = 0
        for k in itertools.count():
            terms = [self._term(wave, noise, frequency, nodes, shares, seen, blur2) for wave in sorted({k, -k})]
            for term in terms:
                whole += term
            if k:
                turns = np.exp(2j * math.pi * k * seen)
                of_mean = (shares @ turns ** (n - 1)) * (shares @ turns.conj()) ** (n - 1)
                of_mean *= math.exp(-2 * (math.pi * k * n) ** 2 * blur2)
                rounding += (-1) ** k * float(of_mean.real) / (math.pi * k * n) ** 2
            is_small = max(float(np.abs(term).max()) for term in terms) < _NEGLIGIBLE
            small = small + 1 if is_small else 0
            if small == 2:  # one alone may be 0 by symmetry, as where means come in halves of a DN
                break

        # The same with independent uniform rounding, as eldata.calibration.core._tukey_lambda.ResidualModel has it.
        row = 1 / self.row_pixels
        own, share = (1 - 1 / n) * (1 - row), (1 - row) / n
        of_row = max(own * (1 - own) - (n - 1) * share**2, 0.0) * noise.variance
        independent = np.zeros(frequency.size)
        for alias in (-1, 0, 1):
            w = frequency + 2 * math.pi * n * alias
            independent += (
                noise(own * w)
                * noise(share * w) ** (n - 1)
                * np.exp(-0.5 * of_row * w**2)
                * np.sinc(w / (2 * math.pi * n))
            )
        change = np.fft.irfft(whole - independent, points, axis=1)
        folded: Values = change[:, : points // 2].copy()
        folded[:, 1:] += change[:, : points // 2 : -1]
        return folded, rounding

    def _term(
        self, k: int, noise: _Noise, frequency: Values, nodes: Values, shares: Values, seen: Values, blur2: float
    ) -> Values:
        """Return a term of the sum over k, (fractions, frequencies), for row offsets at nodes, seen as these."""
        n = self.frames
        left = nodes - seen
        beyond = frequency - 2 * math.pi * n * k
        w = frequency - beyond / self.row_pixels  # the pixel is in its row's mean
        own, share = (1 - 1 / n) * w, w / n
        nearest = -np.rint(own / (2 * math.pi))
        turned = np.outer(left, own) + 2 * math.pi * np.outer(nodes, nearest)
        mean: Values = 2 * math.pi * k * seen[:, None]
        mine_by_node: Complex = shares[:, None] * np.exp(1j * (turned + (n - 1) * mean))
        theirs_by_node: Complex = np.exp(-1j * (np.outer(left, share) + mean))
        of_nodes = np.exp(2j * math.pi * np.outer(noise.terms, nodes))
        mine = _product(of_nodes, mine_by_node) * noise(own + 2 * math.pi * (nearest + noise.terms[:, None]))
        theirs = _product(of_nodes * shares, theirs_by_node) * noise(-share + 2 * math.pi * noise.terms[:, None])
        whole = _product(noise.turns, mine) * _product(noise.turns, theirs) ** (n - 1)
        whole *= np.exp(2j * math.pi * np.outer(noise.fractions, nearest) - 0.5 * blur2 * beyond**2)
        return np.asarray(whole.real * np.sinc(frequency / (2 * math.pi * n) - k))


class _Noise:
    """Q of the module's text for one shape and scale, and how many terms of which sums matter."""

    def __init__(self, shape: float, sigma: float, frames: int) -> None:
        from scipy.interpolate import CubicSpline

        deviation = sigma * math.sqrt(tukey_lambda_variance(shape))
        self.variance = deviation**2 + 1 / 12
        self.reach = math.ceil(_REACH * deviation + 3)
        x = np.arange(self.reach * _PER_DN + 1) / _PER_DN
        tails = smoothed_tails(np.concatenate([x - 0.5, x + 0.5]), shape, sigma, np.zeros(1), np.ones(1))
        density = (tails[: x.size] - tails[x.size :]) / _PER_DN
        whole = np.zeros(1 << max(12, math.ceil(math.log2(16 * self.reach * _PER_DN))))
        whole[: x.size] = density
        whole[1 - x.size :] = density[:0:-1]
        transform = np.fft.rfft(whole).real
        step = 2 * math.pi * _PER_DN / whole.size
        self._table = CubicSpline(np.arange(transform.size) * step, transform)
        self._last = (transform.size - 1) * step
        orders = np.arange(1, _MOST_TERMS + 1)
        terms = int(np.count_nonzero(np.abs(self.slopes(orders)) * 2 * math.pi * orders > _NEGLIGIBLE))
        blurred = np.exp(-2 * (math.pi * np.arange(1, HARMONICS + 1)) ** 2 * self.variance / frames)
        self.harmonics = min(HARMONICS, max(terms, int(np.count_nonzero(blurred > _NEGLIGIBLE)), 1))
        self.terms = np.arange(-max(terms, 1), max(terms, 1) + 1)
        count = 2 << math.ceil(math.log2(self.harmonics + self.terms[-1] + 1))
        self.fractions = np.arange(count) / count
        self.turns = np.exp(2j * math.pi * np.outer(self.fractions, self.terms))

    def __call__(self, frequency: Values) -> Values:
        size = np.abs(frequency)
        value: Values = np.where(size < self._last, self._table(np.minimum(size, self._last)), 0.0)
        return value

    def slopes(self, orders: Counts) -> Values:
        """Return the derivative of Q at 2 pi times each positive order."""
        slopes: Values = self._table(2 * math.pi * orders, 1)
        return slopes


def rounding_matters(sigma: float) -> bool:
    """Whether the characteristic function of noise of this scale is above 1e-9 at 2 pi (of a logistic one, it is)."""
    return sigma < 1.5


def ripples(deviation_dn: float, frames: int, residuals: int) -> bool:
    """Whether so many residuals show where the lattice of whole DN lies, which the mean of n frames blurs."""
    return math.exp(-2 * math.pi**2 * (deviation_dn**2 + 1 / 12) / frames) * math.sqrt(residuals) > 0.03


def _response(noise: _Noise, levels: Complex, rows: Values) -> OffsetResponse:
    """Return the mean recorded values of rows under an offset, for channels of the given mean waves."""
    orders = np.arange(1, _MOST_TERMS + 1)
    one = np.arange(64) / 64
    turns = -1j * np.exp(2j * math.pi * np.outer(orders, one))
    by_channel = 2 * ((levels[:, : orders.size] * noise.slopes(orders)) @ turns).real
    shares = rows.sum(axis=1)
    wave = (rows / shares[:, None]) @ by_channel
    periods = 8
    offsets = np.arange(-64 * periods, 64 * periods + 1) / 64
    whole = np.concatenate([np.tile(wave, 2 * periods), wave[:, :1]], axis=1)
    return OffsetResponse(offsets, offsets + whole - wave[:, :1], shares)


def _even_nodes() -> tuple[Values, Values]:
    """Return nodes and weights of all fractions of a DN alike."""
    return np.arange(_PHASES) / _PHASES, np.full(_PHASES, 1 / _PHASES)


@kernel
def _product(left: NDArray[np.inexact[Any]], right: Complex) -> Complex:
    """Return the matrix product of two small matrices, in this thread alone; entries of ``left`` near 0 cost nothing.

    The threads of BLAS would wait for one another at such sizes.
    """
    result = np.zeros((left.shape[0], right.shape[1]), dtype=np.complex128)
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            factor = left[i, j]
            if abs(factor) > 1e-15:
                for k in range(right.shape[1]):
                    result[i, k] += factor * right[j, k]
    return result
