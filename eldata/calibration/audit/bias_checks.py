"""Which assumptions about the bias frames do not hold: each check is a function of what the audit has summed up.

The chance that a check speaks of frames without its fault is below one in 100,000, so that a camera of a dozen ISOs
does not meet one; thresholds follow from that and from the number of blocks, pixels and frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.audit.bias_sums import GAPS, BiasSeen, Ripple
from eldata.calibration.audit.neighbours import OUTLIERS
from eldata.calibration.core.findings import (
    CHANCE,
    COARSE,
    CORRELATED,
    DARK_SIGNAL,
    FILTERED,
    LIGHT,
    LOPSIDED,
    UNLIKE,
)
from eldata.calibration.core.read_noise import read_noise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.calibration.audit.bias_sums import BiasStatistics
    from eldata.calibration.audit.neighbours import NeighbourStatistics
    from eldata.calibration.core._frames import Mask, Values
    from eldata.calibration.core._residual_fit import ResidualHistogram
    from eldata.calibration.core.findings import Figure, Finding
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import ColourBias

_LOW_SHARE = 0.05  # of the blocks, the darkest: taken for those without light
_MOST_OF_BIAS_DN = 0.5  # that light may add to the colour bias; in loud noise this share of its standard deviation
_MOST_OF_BIAS = 0.2
_LEAST_EATEN = 0.52  # wins of outliers' own neighbours; one half without a filter, a little more with correlation
_OF_EATEN = 0.35  # measured: shifts of sigma_G are up to a third where every pixel above its neighbours is removed
_OF_SKEWNESS = 0.5  # measured: shifts of lambda and both sigmas are up to the skewness
_MOSTLY = 0.5
_OF_UNLIKENESS = 2.0  # measured: shifts of lambda and both sigmas are 0.3 to 4 times the unlikeness
_LEAST_STAYING = 0.02  # of the levels' variance: what stays from frame to frame is not known better
_EXPONENTIAL = 2.0  # skewness of a dark signal over the pixels
# What is added to the noise makes its tails lighter: sigma_TL goes up by so many times sigma_G's share.
_OF_LIGHTER_TAILS = 2.0
_SURELY = 2.0  # standard errors
_MOST_RIPPLE = 0.02  # of the variance
_FAINT_RIPPLE = 1e-3  # of sizes: the sum of sizes of a pixel then tells nothing of rounding


def bias_findings(seen: BiasSeen) -> tuple[Finding, ...]:
    """Return what the bias frames' noise says against what the estimates take for granted."""
    checks = (noisy_levels, correlated, filtered_outliers, coarse_values)
    return tuple(finding for check in checks for finding in check(seen))


def noisy_levels(seen: BiasSeen) -> Iterator[Finding]:
    """Yield what goes with the level: light, dark current, pixels that jump. A clip hides all of them."""
    if not seen.is_clipped:
        lit = tuple(light(seen))
        yield from lit
        yield from unlike_pixels(seen, is_lit=bool(lit))


def over_black(seen: Finding, level_dn: float, bias: ColourBias, sigma_dn: float) -> Iterator[Finding]:
    """Yield what light of a mean level means for the colour bias, which it adds to, where the noise has this sigma."""
    if level_dn > max(_MOST_OF_BIAS_DN, _MOST_OF_BIAS * sigma_dn):
        yield seen.of("withheld", ("colour bias",), level_dn)
    elif level_dn > min(bias.standard_error_dn):
        yield seen.of("wider", ("colour bias",), level_dn)


# --- light --------------------------------------------------------------------------------------------------------


def light(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if the variance of blocks grows with their level, as that of light and dark current does.

    Shading without light has no such slope. Least squares over the blocks; their variances are means of thousands of
    squares clipped at four standard deviations, so that the slope over its standard error follows Student's t. A smooth
    shading (of second order) would hide a faint light, so the slope is also taken with one allowed for: two tests.
    """
    from scipy.special import stdtrit

    statistics = seen.statistics
    level, variance = statistics.level_dn, statistics.variance.ravel()
    y, x = np.meshgrid(np.linspace(-1, 1, level.shape[0]), np.linspace(-1, 1, level.shape[1]), indexing="ij")
    # Pixels that are both brighter and noisier than others of their block, and noise that goes further up than down,
    # raise mean level and mean variance of the block together, too.
    spread, noise = statistics.spread_dn, statistics.neighbours.skewness * statistics.sigma_dn / (2 * statistics.pairs)
    of_pixels = (statistics.level_score / statistics.pixels * spread / statistics.pairs + noise) / statistics.pixels
    flat = np.ones((level.size, 1))
    smooth = np.stack([part.ravel() for part in (np.ones_like(x), x, y, x * y, x**2, y**2)], axis=1)
    found = max(
        (
            _slope(level.ravel(), variance, max(float(of_pixels.sum()), 0.0), beside, seen.ripple)
            for beside in (flat, smooth)
        ),
        key=lambda one: one[0],
    )
    statistic, slope, over_dark = found
    threshold = float(stdtrit(level.size - 7, 1 - CHANCE / 2))
    if statistic <= threshold:
        return
    share = 0.5 * slope * over_dark
    text = (
        f"light or dark current in the bias frames: where they are brighter, their noise is larger "
        f"({slope * statistics.sigma_dn**2:.2g} DN^2 for each DN), which adds {share:.1%} or more to the read noise; "
        "cap the lens, cover the viewfinder, and take them in the dark at the shortest exposure"
    )
    yield from LIGHT.judged(statistic, threshold, text, {"read noise": (share, seen.read_error)})
    yield from over_black(LIGHT.seen(statistic, threshold, text), over_dark, seen.bias, statistics.sigma_dn)


def _slope(
    level: Values, variance: Values, of_pixels: float, beside: Values, ripple: Ripple
) -> tuple[float, float, float]:
    """Return t of the slope of variance over level, the slope, and the mean level over the darkest blocks'.

    Of the sum of the blocks' products ``of_pixels`` is what single pixels make of it.

    A variance that ripples with the level by r, from rounding, has a slope over the level in standard deviations of r /
    2 at most.
    """
    own, noise = (values - beside @ np.linalg.lstsq(beside, values, rcond=None)[0] for values in (level, variance))
    spread = float(own @ own)
    slope = (float(own @ noise) - of_pixels) / spread
    left = noise - slope * own
    error = math.sqrt(float(left @ left) / (level.size - beside.shape[1] - 1) / spread)
    by_rounding = ripple.variance / 2 / math.sqrt(spread / level.size)
    return (slope - by_rounding) / error, slope, float(own.mean() - np.quantile(own, _LOW_SHARE))


# --- pixels of their own kind -------------------------------------------------------------------------------------


def unlike_pixels(seen: BiasSeen, *, is_lit: bool) -> Iterator[Finding]:
    """Yield a finding if some pixels are noisier than others: by dark current of their own, or by telegraph noise.

    Two tests, both of sums over blocks whose mean is 0 if all pixels of a block have the same noise, and so with a
    Student's t over the blocks' own scatter: does the size of a pixel's noise in one pair of frames say something about
    that in another, and does the pixel's level in the other frames? A third sees few, but very noisy pixels: the sums
    of sizes over all pairs against what independent sizes give, the convolution of their histogram, by a Poisson count
    at each value.

    Where level and noise go together, :class:`DarkSignal` tells dark current from pixels that jump. Beside such pixels
    dark current shows among those below the mean level, where few of them lie.
    """
    from scipy.special import ndtri, pdtrc, stdtrit

    statistics, ripple, gain_dn_per_e = seen.statistics, seen.ripple, seen.gain_dn_per_e
    threshold = float(stdtrit(statistics.unlikeness.size - 1, 1 - CHANCE / 4))
    by_size = _student(statistics.unlikeness, ripple.size**2 / 4)
    unlikeness = max(float(statistics.unlikeness.mean()), 0.0)
    expected = np.ones(1)
    for _ in range(statistics.pairs):
        expected = np.convolve(expected, statistics.sizes / statistics.sizes.sum())
    pixels = int(statistics.totals.sum())
    expected = np.pad(expected, (0, max(0, 256 - expected.size)))[:256]
    above, by_chance = (np.cumsum(values[::-1])[::-1] for values in (statistics.totals, expected * pixels))
    chances = pdtrc(np.maximum(above - 1, 0), np.maximum(by_chance, 1e-12))
    # As standard deviations of a normal variable that is as rare, in the terms of the others.
    rarest = -float(ndtri(max(float(chances[above > 0].min()), 1e-300)))
    least_rare = -float(ndtri(CHANCE / 4 / 256))
    few = not is_lit and ripple.size < _FAINT_RIPPLE and rarest > least_rare
    # Less what rounding can do: a variance that ripples by r over the levels has a slope of r / 2 at most, or less.
    by_rounding, of_lower = (
        float(freedom.mean()) * ripple.variance / 2 for freedom in (statistics.level_freedom, statistics.lower_freedom)
    )
    by_level = max(_student(sign * statistics.level_score, by_rounding) for sign in (1, -1))
    whole = DarkSignal.of(statistics, gain_dn_per_e) if by_level > threshold else None
    signal = whole
    if whole is not None and whole.is_of_few:
        is_beside = whole.is_rising and _student(statistics.lower_score, of_lower) > threshold
        signal = DarkSignal.of(statistics, gain_dn_per_e, is_lower=True) if is_beside else None
    if signal is not None:
        text = (
            "dark current or light in the bias frames: pixels with a higher level also have more noise, which adds "
            f"{signal.mean / 2:.1%} or more to the read noise; take them in the dark, at the shortest exposure and "
            "with a camera that is not warm"
        )
        if gain_dn_per_e is None:
            text += "; where K is known, from flats or --gain, it is told from pixels that jump between levels"
        shares: dict[Figure, tuple[float, float]] = {"read noise": (_OF_LIGHTER_TAILS * signal.mean, seen.read_error)}
        yield from DARK_SIGNAL.judged(by_level, threshold, text, shares)
        of_level = DARK_SIGNAL.seen(by_level, threshold, text)
        yield from over_black(of_level, signal.level_dn, seen.bias, statistics.sigma_dn)
        return
    if by_size <= threshold and not few and whole is None:
        return
    least = float((above - by_chance).max() / pixels)
    text = (
        f"{least:.2%} of the pixels or more are noisier than the others (random telegraph noise, which jumps between "
        "levels, is the usual reason): lambda and sigma are those of all pixels together"
    )
    statistic, limit = max(
        ((by_size, threshold), (by_level, threshold), (rarest if few else 0.0, least_rare)),
        key=lambda one: one[0] / one[1],
    )
    share = max(_OF_UNLIKENESS * unlikeness, 0.0 if whole is None else whole.mean)
    yield from UNLIKE.judged(statistic, limit, text, {"read noise": (share, seen.read_error)})


@dataclass(frozen=True, slots=True)
class DarkSignal:
    """What of the pixels' noise goes with their level, as a share of the noise's variance.

    k photoelectrons of dark current add k K to a pixel's level and k K^2 to its variance. Over the pixels, level and
    variance then have a covariance of K times the signal's variance, and level, level and variance a joint cumulant of
    K times its third one, whatever fixed pattern there is beside it. Both together tell how skewed the signal is over
    the pixels: an exponential one by 2. A few pixels that jump between levels are skewed by one over the root of their
    share, and what they add to the variance for each DN of level is not K.

    Attributes
    ----------
    mean
        Of what goes with the level: of an exponential signal its standard deviation over the pixels, of a more skewed
        one (of a gamma distribution) less.
    level_dn
        Mean level that it has, DN.
    is_rising
        Whether noise grows with the level.
    is_of_few
        Whether it surely is not dark current of all pixels: it falls with the level, is too skewed, is steeper than K,
        or noise differs between pixels by much more than K and their levels explain.
    """

    mean: float
    level_dn: float
    is_rising: bool
    is_of_few: bool

    @classmethod
    def of(cls, statistics: BiasStatistics, gain_dn_per_e: float | None, *, is_lower: bool = False) -> DarkSignal:
        """Work it out, by K if it is known; ``is_lower``: by the slope among the pixels below the mean level."""
        number = statistics.pairs * statistics.pixels
        covariances, bends = statistics.level_score / number, statistics.bend_score / number
        covariance, error = _mean_and_error(covariances)
        bend, bend_error = _mean_and_error(bends)
        # In units of the levels' spread. The signal's variance is no more than that of all that stays.
        variance, per_level = max((statistics.dsnu_dn / statistics.spread_dn) ** 2, _LEAST_STAYING), math.inf
        if gain_dn_per_e is not None:
            per_level = gain_dn_per_e * statistics.spread_dn / statistics.sigma_dn**2
        is_steep = covariance - _SURELY * error > per_level * variance
        if is_lower:
            slope = float(statistics.lower_score.sum() / statistics.lower_freedom.sum())
            covariance, bend = slope * float((statistics.level_freedom / number).mean()), 0.0
        variance = min(variance, abs(covariance) / per_level) if math.isfinite(per_level) else variance
        deviation = math.sqrt(variance)
        skewness = bend / covariance / deviation
        skewness_error = math.hypot(bend_error / covariance / deviation, 1.5 * skewness * error / covariance)
        # The variance varies by four times as much as the size squared, where it varies little.
        beyond, beyond_error = _mean_and_error(
            _MOSTLY * 4 * statistics.unlikeness - covariance / variance * covariances
        )
        mean = abs(covariance) / deviation * _EXPONENTIAL / max(abs(skewness), _EXPONENTIAL)
        level_dn = statistics.dsnu_dn
        if gain_dn_per_e is not None:
            level_dn = min(level_dn, mean * statistics.sigma_dn**2 / gain_dn_per_e)
        is_skewed = skewness - _SURELY * skewness_error > _EXPONENTIAL
        is_of_few = covariance < 0 or is_steep or is_skewed or beyond > _SURELY * beyond_error
        return cls(mean, level_dn, covariance > 0, is_of_few)


def _mean_and_error(scores: Values) -> tuple[float, float]:
    return float(scores.mean()), float(scores.std(ddof=1)) / math.sqrt(scores.size)


def _student(scores: Values, by_rounding: float) -> float:
    """Return by how many standard errors the mean of the blocks' scores exceeds what rounding may give."""
    mean, error = _mean_and_error(scores)
    return (mean - by_rounding) / error


# --- filters ------------------------------------------------------------------------------------------------------


def correlated(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if neighbouring pixels share noise in the bias frames.

    Beside what a filter takes from the pixels, the mean of a row's pixels scatters by more, or less, than that of as
    many independent ones, which the row noise is measured against.
    """
    near, rows = seen.statistics.neighbours, seen.rows
    statistic, threshold = _largest(near, seen.ripple)
    if statistic <= threshold:
        return
    share = abs(math.sqrt(1 + 2 * _sum_of(near)) - 1)
    line = rows.rows
    of_pixels = 2 * _sum_of(near, near.lags[:, 0] == 0) * rows.pixel_variance_dn2 / len(rows.columns.fixed_dn)
    of_rows = math.hypot(share, of_pixels / (2 * max(line.variance_dn2, 1e-12)))
    error = line.sigma_error_dn / max(line.sigma_dn, 1e-12)
    shares: dict[Figure, tuple[float, float]] = {
        "read noise": (share, seen.read_error),
        "row noise": (of_rows, error),
    }
    text = _SHARED.format(largest=near.correlation[np.abs(near.correlation).argmax()])
    yield from CORRELATED.judged(statistic, threshold, text, shares)


_SHARED = (
    "neighbouring pixels share noise in the bias frames (correlation {largest:.3f}): the camera or a converter has "
    "filtered these files, or the sensor mixes neighbours; use files without noise reduction and resampling"
)


def _largest(near: NeighbourStatistics, ripple: Ripple) -> tuple[float, float]:
    """Return the largest of the correlations, and of their two sums along the axes, over its error; and the limit.

    The error needs no assumption on the distribution, and sums of so many products are normal. Where row noise moves
    neighbours of one level over the steps of the values together, they share a mean that ripples by r, and so a
    correlation of r^2 / 4 at most.
    """
    from scipy.special import ndtri

    axes = (near.correlation[_at(near, (0, size)) | _at(near, (size, 0))].sum() / math.sqrt(2) for size in (1, 2))
    tests = (np.abs(np.array([*near.correlation, *axes])) - ripple.mean**2 / 4) / near.error
    return float(tests.max()), -float(ndtri(CHANCE / 2 / tests.size))


def _at(near: NeighbourStatistics, lag: tuple[int, int]) -> Mask:
    found: Mask = (near.lags == lag).all(axis=1)
    return found


def _sum_of(near: NeighbourStatistics, chosen: Mask | bool = True) -> float:
    """Return the sum of the correlations that are seen, one of each two opposite directions, above -1/2.

    A filter whose weights add up to 1 leaves ``1 / (1 + 2 sum)`` of the variance of independent noise.
    """
    seen = (np.abs(near.correlation) > 3 * near.error) & chosen
    return max(float(near.correlation[seen].sum()), -0.49)


def filtered_outliers(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if outliers do not stand alone, or the noise goes further to one side of the pixels' means.

    Independent neighbours of an outlier are like those of any other pixel: which of the two goes further is a fair
    coin. Where the noise is symmetric, its third powers add up to nothing but chance, and what rounding makes of them.
    """
    from scipy.special import bdtrc, ndtri

    near = seen.statistics.neighbours
    sides = np.concatenate([near.outlier_wins, near.outlier_wins.sum(axis=0, keepdims=True)])
    tests = sides[..., 0].size + 2
    threshold = -float(ndtri(CHANCE / tests))
    least = _LEAST_EATEN + float(np.abs(near.correlation).max())
    statistics_of = [
        (-float(ndtri(max(float(bdtrc(own - 1, own + other, 0.5)), 1e-300))), own / (own + other), size)
        for side in sides.tolist()
        for (own, other), size in zip(side, OUTLIERS, strict=True)
        if own + other and own > least * (own + other)
    ]
    statistic, wins, size = max(statistics_of, default=(0.0, 0.0, 0))
    if statistic > threshold:
        text = (
            f"values more than {size} standard deviations from their pixel's mean stand alone too rarely (a neighbour "
            f"goes along in {wins:.0%} of cases, 50% by chance): the camera removes single bright pixels (a "
            "star-eater), and with them the tails of the noise; switch such filters off or use another raw mode"
        )
        yield from FILTERED.judged(statistic, threshold, text, {"read noise": (_OF_EATEN, 0.0)})
        return
    if seen.is_clipped:
        return
    excess = (abs(near.skewness) - seen.ripple.skewness / 2) / near.skewness_error
    if excess > threshold:
        side = "above" if near.skewness > 0 else "below"
        text = (
            f"the noise is lopsided (skewness {near.skewness:.2f}): it goes further {side} a pixel's mean than to the "
            "other side, where the model has as much on both; random telegraph noise and filters against single bright "
            "pixels do this"
        )
        share = _OF_SKEWNESS * abs(near.skewness)
        yield from LOPSIDED.judged(excess, threshold, text, {"read noise": (share, seen.read_error)})


# --- steps of the values ------------------------------------------------------------------------------------------


def coarse_values(seen: BiasSeen) -> Iterator[Finding]:
    """Yield a finding if the values step by more than a DN: by some DN everywhere, or leave a share of gaps.

    Rounding to steps of s adds ``(s^2 - 1) / 12`` more to the variance than the model's rounding to whole DN.
    """
    step, gaps, size = seen.step, seen.gaps, seen.step_dn
    if step == 1 and gaps <= GAPS:
        return
    added = (size**2 - 1) / 12
    text = (
        f"the values step by {step} DN: fewer bits than the file has room for, or multiplied after conversion"
        if step > 1
        else f"{gaps:.0%} of the DN values between others never occur in a bias frame: the camera multiplies after "
        "conversion at this ISO, or compresses with loss"
    )
    text += (
        f"; rounding adds {added:.2g} DN^2 more than the model's; use a raw mode with all bits, or leave this ISO out"
    )
    share = _OF_LIGHTER_TAILS * (1 - math.sqrt(max(1 - added / max(seen.read.sigma_gauss_dn, 1e-12) ** 2, 0.0)))
    yield from COARSE.judged(size, 1 / (1 - GAPS), text, {"read noise": (share, seen.read_error)})


def read_noise_in_steps(residuals: ResidualHistogram, step: int) -> ReadNoise | None:
    """Estimate the read noise beside rounding to a step of several DN, uniform over it, in place of that to whole DN.

    ``None`` for a step of 1 DN, or where rounding depends on the noise: where the noise that is found would ripple by a
    fiftieth of its variance from one step to the next.
    """
    if step == 1:
        return None
    found = read_noise(replace(residuals, rounding_dn=float(step), fractions=None))
    ripple = Ripple.of(found.tukey_lambda, found.sigma_tl_dn / step)
    return found if found.converged and ripple.variance < _MOST_RIPPLE else None
