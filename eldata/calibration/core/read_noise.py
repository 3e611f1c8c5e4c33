"""Read noise: shape lambda and scale sigma_TL of the Tukey-lambda distribution, from all pixels of all bias frames.

Nothing is sorted: the second pass over the bias frames counts the residuals in cells of a twentieth of their standard
deviation, and both estimators work on those counts.

A residual is a pixel's value less its own mean over the n frames, the channel's drift in this frame and the row's
offset. Taking off the pixel's mean removes every fixed pattern, whatever its distribution, but mixes the noise of n
frames, which makes tails look lighter: the kurtosis shrinks by ((1 - 1/n)^4 + (n - 1)/n^4) / (1 - 1/n)^2, a fifth at
n = 10. The model is therefore of the residual, not of the noise: the pixel's own share of Tukey lambda plus rounding,
and the other frames' share with its own distribution (:class:`eldata.calibration.core._tukey_lambda.ResidualModel`).

Noise of a column that changes from frame to frame stays in the read noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.core.findings import FIT, READ, ROUNDING, SHAPE
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Values
    from eldata.calibration.core._residual_fit import ResidualFit, ResidualHistogram
    from eldata.calibration.core._tukey_lambda import ResidualModel
    from eldata.calibration.core.findings import Figure, Finding
    from eldata.calibration.core.row_noise import ColourBias, LineNoise

_TAIL = 1000  # residuals beyond the point from which on the variance is the fitted distribution's
_MOST_ERROR = 0.15  # of lambda, and of sigma_TL as a share: beyond, neither figure nor error means anything
_BY_CHANCE = 1e-6  # of the fit's chi^2
_QUIETEST = 0.4  # of sigma_G, in steps: below, rounding decides what is recorded
_NEARLY_NORMAL = 0.14  # a shape
_LEAST_BLUR = 0.05
_WAVE_BY_CHANCE = 6.0  # of 1 / N, the mean squared size of N levels that lie anywhere: more once in 400
_STEPS_SHOW = 5.0  # of the levels' wave in its own standard errors: of less, chi^2 per degree is not 0.2 larger
# Measured, from 0.3 to 0.8 DN, with the ripple of the variance, peak to peak, for 1: of bodies without fixed pattern,
# shifts of lambda and sigma_TL are up to 2 (relative ones) and of sigma_G up to 0.4; where levels lie anywhere, 0.2 and
# 0.04 with its square for 1, as the noise of pixels then differs.
_OF_RIPPLE, _OF_RIPPLE_IN_SIGMA = 2.0, 0.5
_OF_SQUARE, _OF_SQUARE_IN_SIGMA = 0.2, 0.05
_MOST_RIPPLE = 0.3  # of the variance: beyond, not even sigma_G is known
_MOST_IN_ROWS = 0.3  # of sigma_row

PLOT_POINTS = 121
"""Of a probability plot."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReadNoise:
    """Read noise of one ISO.

    Attributes
    ----------
    tukey_lambda, tukey_lambda_error
        Shape and its standard error, from the scatter between groups of rows.
    sigma_tl_dn, sigma_tl_error_dn
        Scale (not the standard deviation) without the rounding's share, and its standard error, DN.
    sigma_gauss_dn, sigma_gauss_error_dn
        Standard deviation of the read noise without the rounding's share, and its standard error: the Gaussian model.
        Of the residuals themselves, but for the outermost thousand: of heavy tails a few pixels would decide it. Their
        share is that of the fitted distribution.
    ppcc_lambda, ppcc_sigma_tl_dn
        Shape of the highest probability-plot correlation and the plot's slope, with the model's own answer to the same
        question compared with the truth it was made with, so that rounding and the mean over frames are allowed for.
    ppcc_lambda_plain, ppcc_sigma_plain_dn
        The same without that: what the published procedure gives on these residuals.
    curve
        (2, points): shapes and correlations, the PPCC plot.
    r_squared_tl, r_squared_gauss
        Of the probability plots of the residuals against Tukey lambda at its best shape and against the normal one.
    chi2_per_dof, chi2_freedom
        Of the fitted distribution over the cells with 25 residuals or more, and how many of these count. Not a number
        where the pixels' levels are so alike that the residuals show their steps of a DN.
    residuals
        How many there were.
    beyond
        How many lay outside of the histogram (more than 400 standard deviations).
    converged
        Whether the fit came to an end.
    alike
        How far the pixels' levels share a fraction of a DN: from 0, everywhere between whole DN, to 1, all alike.
    """

    tukey_lambda: float
    tukey_lambda_error: float
    sigma_tl_dn: float
    sigma_tl_error_dn: float
    sigma_gauss_dn: float
    sigma_gauss_error_dn: float
    ppcc_lambda: float
    ppcc_sigma_tl_dn: float
    ppcc_lambda_plain: float
    ppcc_sigma_plain_dn: float
    curve: Values = field(repr=False)
    r_squared_tl: float
    r_squared_gauss: float
    chi2_per_dof: float
    chi2_freedom: int
    residuals: int
    converged: bool
    beyond: int
    alike: float

    @property
    def largest_error(self) -> float:
        """Of lambda, and of sigma_TL as a share of it."""
        return max(self.tukey_lambda_error, self.sigma_tl_error_dn / self.sigma_tl_dn)

    @property
    def highest_correlation(self) -> float:
        """The curve at ``ppcc_lambda_plain``."""
        return float(np.interp(self.ppcc_lambda_plain, *self.curve))


@dataclass(frozen=True, slots=True, eq=False)
class ProbabilityPlot:
    """Quantiles of the residuals beside those of the two distributions (figure "TL-PPCC").

    Attributes
    ----------
    ordered_dn
        Quantiles of the residuals, evenly spaced in the normal quantile out to the outermost hundred residuals.
    normal, tukey_lambda
        Quantiles of the standard normal and of the Tukey-lambda distribution of ``shape`` at the same levels.
    shape
        Lambda of the highest probability-plot correlation on these residuals.
    slope_normal_dn, slope_tukey_lambda_dn
        Of the two least-squares lines through the origin that all residuals, not just these points, make.
    """

    ordered_dn: Values = field(repr=False)
    normal: Values = field(repr=False)
    tukey_lambda: Values = field(repr=False)
    shape: float
    slope_normal_dn: float
    slope_tukey_lambda_dn: float


def read_noise(histogram: ResidualHistogram) -> ReadNoise:
    """Estimate lambda and sigma_TL (equation of N_read ~ TL(lambda; mu_c, sigma_TL)).

    Start: the shape of the highest probability-plot correlation (PPCC) on the histogram. Then interval-censored maximum
    likelihood of the residual's distribution, ``sum over cells of c ln P(cell; lambda, sigma)``, by Fisher scoring.
    Its covariance is ``I^-1 J I^-1`` with the information I and the scatter J of the score between groups of rows.

    Raises
    ------
    ArgumentError
        If the histogram is malformed.
    DatasetError
        If it holds too few residuals, or all in a few cells.
    """
    from eldata.calibration.core._residual_fit import ResidualCells, residual_fit
    from eldata.calibration.core._tukey_lambda import (
        HIGHEST,
        LOWEST,
        ResidualModel,
        correlation,
        normal_correlation,
        wave_of_rounding,
    )

    counts = histogram.counts
    if counts.ndim != 2 or counts.shape[1] % 2 == 0 or not histogram.cell_dn > 0:
        raise ArgumentError(
            "a histogram is (groups, an odd number of cells) with cells of positive width; found shape "
            f"{counts.shape}, width {histogram.cell_dn}"
        )
    if histogram.frames < 1 or not histogram.row_pixels > 1:
        raise ArgumentError(
            f"residuals are of 1 frame or more and rows of 2 pixels or more; found {histogram.frames} and "
            f"{histogram.row_pixels}"
        )
    total = counts.sum(axis=0)
    inner = total[1:-1]
    beyond = int(total[0] + total[-1])
    number = int(total.sum())
    if number < 1000 or np.count_nonzero(inner) < 5:
        raise DatasetError(
            f"{number} residuals in {np.count_nonzero(inner)} cells do not show a distribution: give more pixels, and "
            "frames whose noise is not lost in rounding"
        )
    values = histogram.values_dn[1:-1]
    plain_lambda, plain_sigma, curve = ppcc(values, inner)

    model = ResidualModel(histogram.frames, histogram.row_pixels, histogram.rounding_dn)
    cells = ResidualCells.of(histogram)
    variance = float(inner @ values**2) / float(inner.sum())
    start = (min(max(plain_lambda, LOWEST + 0.1), HIGHEST - 0.1), max(plain_sigma, 0.05 * math.sqrt(variance)))
    deviation = math.sqrt(variance / model.own)
    fit = residual_fit(cells, model, start)
    shape, sigma = fit.shape, fit.scale
    # The groups' scatter, of which errors are made, scatters itself: never below what independent residuals give. Of a
    # pixel's n only n - 1 are: measured, their variances are between those of n and of n - 1.
    dependence = math.sqrt(1 - 1 / histogram.frames) if histogram.frames > 1 else 1.0
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), np.diag(fit.information) / dependence))

    # What the same probability plot says of the fitted model, whose truth is known.
    expected = _expected(histogram, model, fit)
    model_lambda, model_sigma, _ = ppcc(values, expected * number)
    best, _ = correlation(values[inner > 0], inner[inner > 0].astype(np.float64), plain_lambda)
    normal, _ = normal_correlation(values[inner > 0], inner[inner > 0].astype(np.float64))
    gauss, gauss_error = _standard_deviation(histogram, model, fit)
    chi2, freedom = fit.chi2_per_dof(cells)
    # The mean of n frames blurs the wave of the levels. Where it leaves nothing, how alike they are is not known.
    blur = math.exp(-2 * math.pi**2 * deviation**2 / histogram.frames)
    by_chance = _WAVE_BY_CHANCE * len(histogram.level_waves) * histogram.frames / number
    waves = histogram.level_waves, histogram.level_waves - wave_of_rounding(shape, sigma, histogram.frames)
    wave, of_levels = (math.sqrt(max(float((np.abs(each) ** 2).max()) - by_chance, 0.0)) for each in waves)
    alike = min(of_levels / blur, 1.0) if blur > _LEAST_BLUR else 1.0
    return ReadNoise(
        tukey_lambda=shape,
        tukey_lambda_error=float(errors[0]),
        sigma_tl_dn=sigma,
        sigma_tl_error_dn=float(errors[1]) * sigma,
        sigma_gauss_dn=gauss,
        sigma_gauss_error_dn=gauss_error,
        ppcc_lambda=plain_lambda + shape - model_lambda,
        ppcc_sigma_tl_dn=plain_sigma * sigma / model_sigma,
        ppcc_lambda_plain=plain_lambda,
        ppcc_sigma_plain_dn=plain_sigma,
        curve=curve,
        r_squared_tl=best**2,
        r_squared_gauss=normal**2,
        chi2_per_dof=math.nan if wave * math.sqrt(number) > _STEPS_SHOW else chi2,
        chi2_freedom=freedom,
        residuals=number,
        beyond=beyond,
        converged=fit.converged,
        alike=alike,
    )


def read_noise_findings(
    read: ReadNoise, bias: ColourBias, rows: LineNoise, step_dn: float = 1.0, rounding_dn: float = 1.0
) -> tuple[Finding, ...]:
    """Return what the fit shows of its own assumptions, and what rounding does to the figures.

    It is to steps of ``step_dn`` in the mean; the read noise is beside one to steps of ``rounding_dn``.

    The fit's chi^2 has as many degrees of freedom as cells, less the parameters. What it is above 1 per degree, the
    errors are to be larger: a misfit of that size along the direction that a parameter moves would shift it so far.
    """
    from scipy.special import chdtri

    limit = float(chdtri(read.chi2_freedom, _BY_CHANCE)) / read.chi2_freedom
    misfit = math.sqrt(read.chi2_per_dof - 1) if read.chi2_per_dof > limit else 0.0
    error = math.hypot(1.0, misfit) * read.largest_error
    found = list(_rounding(read, bias, rows, step_dn, math.sqrt(max(step_dn**2 - rounding_dn**2, 0.0) / 12)))
    if not read.converged:
        text = (
            f"the fit of a Tukey-lambda distribution to {read.residuals} residuals came to no end: lambda and its "
            "error are not known; look at its plots"
        )
        found.append(SHAPE.seen(math.inf, _MOST_ERROR, text).of("withheld", READ))
    elif not error < _MOST_ERROR:
        text = (
            f"{read.residuals} residuals do not tell the shape of the read noise: lambda is uncertain by "
            f"{read.tukey_lambda_error:.2g}, sigma_TL by {read.sigma_tl_error_dn / read.sigma_tl_dn:.1%}"
            + (f", {math.hypot(1, misfit):.1f} times as much by their misfit" if misfit else "")
            + "; look at its plots, and use more frames or a higher ISO"
        )
        found.append(SHAPE.seen(error, _MOST_ERROR, text).of("withheld", READ))
    elif misfit:
        text = (
            f"the residuals do not follow the fitted Tukey-lambda distribution (chi2 per degree of freedom "
            f"{read.chi2_per_dof:.1f}, by chance at most {limit:.1f}): look at its plots"
        )
        allowance = misfit * read.largest_error
        found.append(FIT.seen(read.chi2_per_dof, limit, text).of("wider", READ, allowance))
    return tuple(found)


def _rounding(read: ReadNoise, bias: ColourBias, rows: LineNoise, step_dn: float, added_dn: float) -> Iterator[Finding]:
    """Yield what rounding to steps of so many DN, which adds so much to the read noise, does to figures of quiet noise.

    It adds a twelfth to the variance, whatever the noise, only where the pixels' levels lie everywhere between two
    steps, or the noise is wide. Where they share a fraction of one, it makes noise smaller or larger, moves the mean,
    and hides offsets of rows or enlarges them, by what :class:`Ripple` says; the rows' own offsets spread the levels.
    """
    from eldata.calibration.core._tukey_lambda import Ripple

    sigma, quietest = math.sqrt(max(read.sigma_gauss_dn**2 - added_dn**2, 0.0)), _QUIETEST * step_dn
    steps = f"steps of {step_dn:.3g}" if step_dn > 1 else "whole"
    if not sigma >= quietest:
        text = (
            f"the read noise is {sigma:.2g} DN, below {quietest:.2g} DN, where rounding to {steps} DN decides what is "
            "recorded, and the shape of the noise is not seen: use a raw mode of more bits, or the figures of a higher "
            "ISO"
        )
        yield ROUNDING.seen(sigma, quietest, text).of("withheld", ("shape",))
    # How alike the levels' fractions of a DN are says nothing of wider steps.
    alike = (1.0 if step_dn > 1 else read.alike) * math.exp(-2 * (math.pi * rows.sigma_dn / step_dn) ** 2)
    # Rounding itself makes tails light: lighter ones than a normal distribution's are not taken for the noise's.
    shape = min(read.tukey_lambda, _NEARLY_NORMAL)
    scale = sigma / math.sqrt(tukey_lambda_variance(shape)) / step_dn
    ripple, lower = Ripple.of(shape, scale), 1.0
    recorded = 1 + (step_dn / max(sigma, 1e-12)) ** 2 / 12  # with rounding, of the variance without
    for _ in range(20):  # of the noise as quiet as it may be, if rounding has made it larger
        lower = math.sqrt(max(1 - ripple.variance * alike / 2 * recorded, 0.1))
        ripple = Ripple.of(shape, lower * scale)
    width, shift = ripple.variance * alike, ripple.mean_steps / 2 * step_dn * alike
    changed = (
        f"changes the variance of a pixel's noise by up to {ripple.variance / 2:.1%}, as its level lies between two "
        f"values, that of all by up to {width / 2:.1%}, and"
        if math.isfinite(width)
        else "decides whether a pixel changes at all, and changes"
    )
    text = (
        f"the read noise is quiet ({sigma:.2g} DN): rounding to {steps} DN {changed} the mean by up to {shift:.2g} "
        "DN; use a raw mode of more bits"
    )
    square, of_rows = ripple.variance**2, rows.sigma_error_dn / max(rows.sigma_dn, 1e-12)
    off: dict[Figure, tuple[float, float, float]] = {  # by so much; what is too much, and what is in the error
        "shape": (_OF_RIPPLE * width + _OF_SQUARE * square, _MOST_ERROR, read.largest_error),
        "read noise": (
            *(_OF_RIPPLE_IN_SIGMA * width + _OF_SQUARE_IN_SIGMA * square, math.inf),
            read.sigma_gauss_error_dn / max(sigma, 1e-12),
        ),
        "row noise": (2 * math.pi * shift / step_dn, _MOST_IN_ROWS if read.converged else of_rows, of_rows),
        "colour bias": (shift, math.inf, min(filter(math.isfinite, bias.standard_error_dn), default=math.inf)),
    }
    of_width = () if width <= _MOST_RIPPLE else READ if math.isfinite(width) else (*READ, "row noise")
    lost = tuple(figure for figure, (share, most, _) in off.items() if share > most or figure in of_width)
    if lost:
        yield ROUNDING.seen(width, _MOST_RIPPLE, text).of("withheld", lost)
    for figure, (share, _, least) in off.items():
        if figure not in lost and share > least:
            yield ROUNDING.seen(share, least, text).of("wider", (figure,), share)


def probability_plot(histogram: ResidualHistogram, read: ReadNoise) -> ProbabilityPlot:
    """Return the points of the two probability plots that :func:`read_noise` has taken its R^2 of ``read`` from."""
    from scipy.special import ndtr, ndtri

    from eldata.calibration.core._tukey_lambda import normal_correlation, tukey_lambda_quantile

    inner = histogram.counts[:, 1:-1].sum(axis=0)
    number = int(inner.sum())
    values, shape = histogram.values_dn[1:-1], read.ppcc_lambda_plain
    reach = float(-ndtri(100 / number)) if number > 1000 else 1.28
    normal = np.linspace(-reach, reach, PLOT_POINTS)
    levels = ndtr(normal)
    below = (np.cumsum(inner) - inner / 2) / number  # at the cells' centres
    filled = inner > 0
    return ProbabilityPlot(
        ordered_dn=np.interp(levels, below[filled], values[filled]),
        normal=normal,
        tukey_lambda=tukey_lambda_quantile(levels, shape),
        shape=shape,
        slope_normal_dn=normal_correlation(values[filled], inner[filled].astype(np.float64))[1],
        slope_tukey_lambda_dn=read.ppcc_sigma_plain_dn,
    )


def ppcc(values: Values, counts: NDArray[Any]) -> tuple[float, float, Values]:
    """Return the shape of the highest probability-plot correlation, the plot's slope there, and the curve.

    The curve is (2, 41): shapes from -0.45 to 0.55 and correlations.

    The grouped form of :func:`scipy.stats.ppcc_max` with the Tukey-lambda family.

    Parameters
    ----------
    values
        Ascending values.
    counts
        How often each occurred.
    """
    from scipy.optimize import minimize_scalar

    from eldata.calibration.core._tukey_lambda import correlation

    used = counts > 1e-12 * np.max(counts)
    values, weights = values[used], np.asarray(counts, dtype=np.float64)[used]
    shapes = np.linspace(-0.45, 0.55, 41)
    curve = np.array([correlation(values, weights, float(shape))[0] for shape in shapes])
    best = int(curve.argmax())
    around = (float(shapes[max(best - 1, 0)]), float(shapes[min(best + 1, 40)]) + (best == 40) * 1.4)
    found = minimize_scalar(
        lambda shape: -correlation(values, weights, float(shape))[0],
        bounds=around,
        method="bounded",
        options={"xatol": 1e-6},
    )
    shape = float(found.x)
    return shape, correlation(values, weights, shape)[1], np.stack([shapes, curve])


def _expected(histogram: ResidualHistogram, model: ResidualModel, fit: ResidualFit) -> Values:
    """Return the probability of each inner cell of the histogram."""
    both = histogram.folded.sum(axis=0)
    half = histogram.counts.shape[1] // 2
    cells = min(half, int(np.count_nonzero(both[:half].cumsum() < both[:half].sum())) + 1)
    starts = np.arange(cells + 1)
    edges = np.maximum(starts - 0.5, 0.0) * histogram.cell_dn
    probabilities = model.probabilities(edges, fit.shape, fit.scale)
    side = np.zeros(half)
    side[:cells] = probabilities[:cells]
    return np.concatenate([side[:0:-1] / 2, side[:1], side[1:] / 2])


def _standard_deviation(histogram: ResidualHistogram, model: ResidualModel, fit: ResidualFit) -> tuple[float, float]:
    """Return the standard deviation of the noise without the rounding's share, and its error between groups.

    The mean square of the residuals is the measured one up to where :data:`_TAIL` lie further out, and the fitted one
    beyond: the mean square of heavy tails hangs on a few pixels, and of shapes below -1/4 it has no error.
    """
    from eldata.calibration.core._residual_fit import centred

    both = histogram.folded
    numbers = both.sum(axis=1)
    number = float(numbers.sum())
    tail = np.cumsum(both.sum(axis=0)[::-1])[::-1]
    # Tails lighter than a normal distribution's decide nothing, and are often what rounding has left of the noise.
    far = int(np.count_nonzero(tail >= _TAIL)) if fit.shape < _NEARLY_NORMAL else both.shape[1]
    far = max(1, int(min(far, both.shape[1] - 1)))
    squares_of_cells = (np.arange(both.shape[1]) * histogram.cell_dn) ** 2
    if histogram.squares_dn2 is None:
        # A cell's width adds its own twelfth of a square.
        squares = both[:, :far] @ (squares_of_cells[:far] - histogram.cell_dn**2 / 12)
    else:
        squares = histogram.squares_dn2 - both[:, far:] @ squares_of_cells[far:]
    edge = (far - 0.5) * histogram.cell_dn

    def beyond(shape: float, sigma: float) -> float:
        """Return the mean of r^2 where abs(r) > edge, by parts: 2 (edge^2 P(edge) + integral of 2 r P(r))."""
        points = edge * np.exp(np.linspace(0.0, 8.0, 800))
        tails = model.tails(points, shape, sigma)
        return 2 * (edge**2 * float(tails[0]) + 2 * float(np.trapezoid(points**2 * tails, np.log(points))))

    step = 1e-3
    slope = np.array(
        [
            (beyond(fit.shape + step, fit.scale) - beyond(fit.shape - step, fit.scale)) / (2 * step),
            (beyond(fit.shape, fit.scale * (1 + step)) - beyond(fit.shape, fit.scale * (1 - step))) / (2 * step),
        ]
    )
    mean = float(squares.sum()) / number + beyond(fit.shape, fit.scale)
    by_rounding = histogram.rounding_dn**2 / 12
    sigma = math.sqrt(max(mean / model.own - by_rounding, 0.0))  # 1/own undoes what the means took
    by_group = centred(squares, numbers) / number + fit.influence @ slope
    groups = len(by_group)
    if groups < 2 or sigma == 0:
        return sigma, math.nan
    error = math.sqrt(float(by_group @ by_group) * groups / (groups - 1)) / model.own
    return sigma, error / (2 * sigma)
