"""Telegraph pixels, which jump between two levels: their share, how far they jump, and for how much of the time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.audit.bias_sums import BLOCK, Ripple, spread_bands
from eldata.calibration.core.findings import CHANCE
from eldata.noise.structure import TelegraphPixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Mosaic, Plane, Values
    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.defects import FixedPattern
    from eldata.calibration.core.read_noise import ReadNoise


_GROUPS = 3  # of bias frames, whose variances know nothing of each other
_MOST_PIXELS = 1 << 19  # of a frame are looked at for telegraph pixels
_REACH = 12.0  # standard deviations, at which single values end
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
        self._places = spread_bands(fixed.total_dn.shape, _MOST_PIXELS)
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

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        if self._size < 2 or len(self._seconds) == _GROUPS:
            return
        values = self._cut(mosaic).astype(np.float32)
        values -= self._mean
        values *= self._scale
        values *= self._sound
        np.clip(values, -_REACH, _REACH, out=values)
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

    def _of(self, cumulants: Values) -> tuple[float, float, float]:
        """Return share, amplitude in DN and duty."""
        second, third, skewed = (float(value) for value in cumulants)
        if not second > 0:
            return 1.0, 0.0, 0.5
        share, more = two_values(second, third)
        duty, amplitude = two_values(more, skewed / (share * (1 - share) * more))
        return share, amplitude * self._sigma_dn, duty

    def _cumulants(self) -> Values:
        """Return (3, blocks): covariance and third cumulant of the variances, covariance of thirds with variances."""
        sound = _by_block(self._sound.astype(np.float64))
        count = np.maximum(sound.sum(axis=1), 3)

        def centred(plane: Plane) -> Values:
            values = _by_block(plane.astype(np.float64)) * sound
            centre: Values = (values.sum(axis=1) / count)[:, None]
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


def _by_block(plane: Values) -> Values:
    """Return (blocks, pixels) of a plane of whole blocks."""
    down, across = plane.shape[0] // BLOCK, plane.shape[1] // BLOCK
    blocks = plane.reshape(down, BLOCK, across, BLOCK).swapaxes(1, 2)
    return np.ascontiguousarray(blocks).reshape(down * across, BLOCK * BLOCK)
