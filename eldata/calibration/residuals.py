"""Read noise: shape lambda and scale sigma_TL of the Tukey-lambda distribution, from all pixels of all bias frames.

Source: Wei et al., TPAMI 2021, section 3.2.1, figure 7, whose probability-plot correlation (PPCC) starts a maximum
likelihood fit. Nothing is sorted: :class:`~eldata.calibration.bias_sums.BiasSums` counts the residuals in cells of a
twentieth of their standard deviation, and both estimators work on those counts.

A residual is a pixel's value less its own mean over the n frames, the channel's drift in this frame and the row's
offset. Taking off the pixel's mean removes every fixed pattern, whatever its distribution, but mixes the noise of n
frames, which makes tails look lighter: the kurtosis shrinks by ((1 - 1/n)^4 + (n - 1)/n^4) / (1 - 1/n)^2, a fifth at
n = 10. The model is therefore of the residual, not of the noise: the pixel's own share of Tukey lambda plus rounding,
and the other frames' share with its own distribution (:class:`eldata.calibration.tukey_lambda.ResidualModel`).

Rounding counts as an independent and uniform error; in quiet bodies whose pixels' levels share a fraction of a DN it is
not, and :func:`~eldata.calibration.checks.read_noise_findings` allows for it. Noise of a column that changes from frame
to frame stays in the read noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import optimize, special

from eldata.calibration.bias_sums import CELLS_PER_SIGMA, ResidualHistogram
from eldata.calibration.tukey_lambda import (
    HIGHEST,
    LOWEST,
    NEARLY_NORMAL,
    ResidualModel,
    correlation,
    normal_correlation,
    tukey_lambda_quantile,
    wave_of_rounding,
)
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from eldata.calibration.sums import Counts, Values

_TAIL = 1000  # residuals beyond the point from which on the variance is the fitted distribution's
_LEAST_BLUR = 0.05
_WAVE_BY_CHANCE = 6.0  # of 1 / N, the mean squared size of N levels that lie anywhere: more once in 400
_STEPS_SHOW = 5.0  # of the levels' wave in its own standard errors: of less, chi^2 per degree is not 0.2 larger

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
    """Quantiles of the residuals and of the two distributions (figure "TL-PPCC").

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
    DatasetError
        If the histogram holds too few residuals, or all in a few cells.
    """
    total = histogram.counts.sum(axis=0)
    inner = total[1:-1]
    number = int(total.sum())
    if number < 1000 or np.count_nonzero(inner) < 5:
        raise DatasetError(
            f"{number} residuals in {np.count_nonzero(inner)} cells do not show a distribution: give more pixels, and "
            "frames whose noise is not lost in rounding"
        )
    values = histogram.values_dn[1:-1]
    plain_lambda, plain_sigma, curve = ppcc(values, inner)

    model = ResidualModel(histogram.frames, histogram.row_pixels, histogram.rounding_dn)
    variance = float(inner @ values**2) / float(inner.sum())
    start = (min(max(plain_lambda, LOWEST + 0.1), HIGHEST - 0.1), max(plain_sigma, 0.05 * math.sqrt(variance)))
    deviation = math.sqrt(variance / model.own)
    fit = fit_residuals(histogram, model, start)
    shape, sigma = fit.shape, fit.scale
    # The groups' scatter, of which errors are made, scatters itself: never below what independent residuals give. Of a
    # pixel's n only n - 1 are: measured, their variances are between those of n and of n - 1.
    dependence = math.sqrt(1 - 1 / histogram.frames) if histogram.frames > 1 else 1.0
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), np.diag(fit.information) / dependence))

    # What the same probability plot says of the fitted model, whose truth is known.
    model_lambda, model_sigma, _ = ppcc(values, _expect_cells(histogram, model, fit) * number)
    filled = values[inner > 0], inner[inner > 0].astype(np.float64)
    best, normal = correlation(*filled, plain_lambda)[0], normal_correlation(*filled)[0]
    gauss, gauss_error = _standard_deviation(histogram, model, fit)
    chi2, freedom = fit.chi2_per_dof()
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
        converged=fit.converged,
        alike=alike,
    )


def probability_plot(histogram: ResidualHistogram, read: ReadNoise) -> ProbabilityPlot:
    """Return the points of the two probability plots that :func:`read_noise` has taken its R^2 of ``read`` from."""
    inner = histogram.counts[:, 1:-1].sum(axis=0)
    number = int(inner.sum())
    values, shape = histogram.values_dn[1:-1], read.ppcc_lambda_plain
    reach = float(-special.ndtri(100 / number)) if number > 1000 else 1.28
    normal = np.linspace(-reach, reach, PLOT_POINTS)
    levels = special.ndtr(normal)
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
    used = counts > 1e-12 * np.max(counts)
    values, weights = values[used], np.asarray(counts, dtype=np.float64)[used]
    shapes = np.linspace(-0.45, 0.55, 41)
    curve = np.array([correlation(values, weights, float(shape))[0] for shape in shapes])
    best = int(curve.argmax())
    around = (float(shapes[max(best - 1, 0)]), float(shapes[min(best + 1, 40)]) + (best == 40) * 1.4)

    highest = optimize.minimize_scalar(
        lambda shape: -correlation(values, weights, shape)[0], bounds=around, method="bounded", options={"xatol": 1e-6}
    )
    shape = float(highest.x)
    return shape, correlation(values, weights, shape)[1], np.stack([shapes, curve])


def _expect_cells(histogram: ResidualHistogram, model: ResidualModel, fit: ResidualFit) -> Values:
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
    both = histogram.folded
    numbers = both.sum(axis=1)
    number = float(numbers.sum())
    tail = np.cumsum(both.sum(axis=0)[::-1])[::-1]
    # Tails lighter than a normal distribution's decide nothing, and are often what rounding has left of the noise.
    far = int(np.count_nonzero(tail >= _TAIL)) if fit.shape < NEARLY_NORMAL else both.shape[1]
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
    of_shape = beyond(fit.shape + step, fit.scale) - beyond(fit.shape - step, fit.scale)
    of_scale = beyond(fit.shape, fit.scale * (1 + step)) - beyond(fit.shape, fit.scale * (1 - step))
    slope = np.array([of_shape, of_scale]) / (2 * step)
    mean = float(squares.sum()) / number + beyond(fit.shape, fit.scale)
    by_rounding = histogram.rounding_dn**2 / 12
    sigma = math.sqrt(max(mean / model.own - by_rounding, 0.0))  # 1/own undoes what the means took
    by_group = _subtract_share(squares, numbers) / number + fit.influence @ slope
    if (groups := len(by_group)) < 2 or sigma == 0:
        return sigma, math.nan
    error = math.sqrt(float(by_group @ by_group) * groups / (groups - 1)) / model.own
    return sigma, error / (2 * sigma)


# --- maximum likelihood -----------------------------------------------------------------------------------------------

_CORE = 6 * CELLS_PER_SIGMA  # cells that stay as they are; beyond, they merge to ever wider ones
_GROWTH = 1.05
_LEAST_IN_TAIL = 20  # residuals in the outermost cell of the likelihood
_NEAR = 0.1  # to the end, in errors that the parameters would have if all residuals were independent


@dataclass(frozen=True, slots=True, eq=False)
class ResidualFit:
    """Shape and scale of highest likelihood, and what errors and other figures are worked out from.

    Attributes
    ----------
    shape, scale
        Of the Tukey-lambda distribution, the scale in DN.
    counts, probabilities
        Residuals in each cell of the likelihood, and the share that the fit expects there.
    influence
        (groups, 2): what each group of rows adds to the errors of shape and ln scale.
    information
        (2, 2) covariance of the two if all residuals were independent.
    converged
        Whether the iteration came to an end.
    """

    shape: float
    scale: float
    counts: Values = field(repr=False)
    probabilities: Values = field(repr=False)
    influence: Values = field(repr=False)
    information: Values = field(repr=False)
    converged: bool

    @property
    def covariance(self) -> Values:
        """(2, 2) of shape and ln scale, from the scatter between groups of rows."""
        groups = len(self.influence)
        return np.asarray(self.influence.T @ self.influence * groups / (groups - 1))

    def chi2_per_dof(self) -> tuple[float, int]:
        """Return chi^2 per degree of freedom over the cells where 25 residuals or more are expected, and these."""
        expected = self.probabilities * float(self.counts.sum())
        filled = expected >= 25
        misfit = ((self.counts - expected) ** 2)[filled] / expected[filled]
        freedom = max(1, misfit.size - 3)
        return float(misfit.sum()) / freedom, freedom


def fit_residuals(histogram: ResidualHistogram, model: ResidualModel, start: tuple[float, float]) -> ResidualFit:
    """Fit shape and scale to the counts of abs(residual), from a shape and a scale to begin with."""
    both = histogram.folded
    starts = _cell_starts(both.sum(axis=0))
    observed = np.add.reduceat(both, starts, axis=1).astype(np.float64)
    edges = np.asarray(np.maximum(starts - 0.5, 0.0) * histogram.cell_dn)
    counts = observed.sum(axis=0)

    def expect(at: Values) -> Values:
        """Return the probabilities of the cells at shape and ln scale."""
        return model.probabilities(edges.copy(), float(at[0]), math.exp(float(at[1])))

    at, probabilities, scores, converged = _maximise(counts, expect, np.array([start[0], math.log(start[1])]))
    inverse = np.linalg.inv((scores * probabilities) @ scores.T * float(counts.sum()))
    by_group = (observed - observed.sum(axis=1, keepdims=True) * probabilities) @ scores.T
    influence = _subtract_share(by_group, observed.sum(axis=1)) @ inverse
    return ResidualFit(float(at[0]), math.exp(at[1]), counts, probabilities, influence, inverse, converged)


def _maximise(counts: Values, expect: Callable[[Values], Values], at: Values) -> tuple[Values, Values, Values, bool]:
    """Maximise the likelihood by Fisher scoring; return the place, probabilities and scores there, and convergence."""
    number = float(counts.sum())

    def scores_at(place: Values) -> Values:
        """Return d ln P / d (shape, ln scale), (2, cells)."""
        step = 1e-4
        ends = ((expect(place + step * unit), expect(place - step * unit)) for unit in np.eye(2))
        return np.stack([(np.log(above) - np.log(below)) / (2 * step) for above, below in ends])

    probabilities = expect(at)
    value, scores = float(counts @ np.log(probabilities)), scores_at(at)
    for _ in range(60):
        information = (scores * probabilities) @ scores.T * number
        ascent = scores @ counts
        move = np.linalg.solve(information, ascent)
        is_near = float(ascent @ move) < _NEAR**2
        length = min(1.0, 0.1 / float(np.abs(move).max()))
        while length > 1e-4:
            shape, log_scale = at + length * move
            proposed = np.array([min(max(float(shape), LOWEST + 1e-3), HIGHEST), float(log_scale)])
            tried = expect(proposed)
            reached = float(counts @ np.log(tried))
            if reached >= value - 1e-12 * abs(value):
                break
            length /= 2
        else:
            break
        moved = float(np.abs(proposed - at).max())
        at, value, probabilities, scores = proposed, reached, tried, scores_at(proposed)
        if moved < 1e-6:
            return at, probabilities, scores, True
    return at, probabilities, scores, is_near


def _subtract_share(by_group: Values, sizes: Values | Counts) -> Values:
    """Return sums by group less their share of the whole, by the groups' sizes."""
    return np.asarray(by_group - np.multiply.outer(sizes / sizes.sum(), by_group.sum(axis=0)))


def _cell_starts(both: Counts) -> Counts:
    """Return the starts of the likelihood's cells: one by one in the core, then ever wider; the last is open."""
    starts = list(range(min(_CORE, len(both) - 1)))
    width = 1.0
    while starts[-1] + math.ceil(width) < len(both):
        starts.append(starts[-1] + math.ceil(width))
        width *= _GROWTH
    tail = np.cumsum(both[::-1])[::-1]
    kept = [start for start in starts if start == 0 or tail[start] >= _LEAST_IN_TAIL]
    return np.array(kept, dtype=np.int64)
