"""Read noise: shape lambda and scale sigma_TL of the Tukey-lambda distribution, from all pixels of all bias frames.

Nothing is sorted: the second pass over the bias frames counts the residuals in cells of a twentieth of their standard
deviation, and both estimators work on those counts.

A residual is a pixel's value less its own mean over the n frames, the channel's drift in this frame and the row's
offset. Taking off the pixel's mean removes every fixed pattern, whatever its distribution, but mixes the noise of n
frames, which makes tails look lighter: the kurtosis shrinks by ((1 - 1/n)^4 + (n - 1)/n^4) / (1 - 1/n)^2, a fifth at
n = 10. The model is therefore of the residual, not of the noise: the pixel's own share of Tukey lambda plus rounding,
and the other frames' share with its own distribution (:class:`eldata.calibration._tukey_lambda.ResidualModel`).

Noise of a column that changes from frame to frame stays in the read noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration._frames import sums_by_row
from eldata.calibration.row_noise import check_same_frames, line_sums
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration._tukey_lambda import ResidualModel
    from eldata.calibration.defects import FixedPattern

_HALF = 8192  # cells on each side of 0
_CELLS_PER_SIGMA = 20
_GROUPS = 64  # of rows, whose scatter gives the standard errors
_CORE = 6 * _CELLS_PER_SIGMA  # cells that stay as they are; beyond, they merge to ever wider ones
_GROWTH = 1.05
_LEAST_IN_TAIL = 20  # residuals in the outermost cell of the likelihood

RELIABLE_SIGMA_DN = 0.7
"""Below this standard deviation of the read noise, rounding to whole DN is no longer independent of the noise.

In simulations the likelihood is then biased (by 0.002 in lambda and 0.5 % in sigma_TL at 0.55 DN, by 0.13 and 44 % at
0.22 DN), the probability plot less (0.001 and 0.2 %; 0.07 and 5 %), with a fixed pattern of 0.3 DN or more.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ResidualHistogram:
    """Counts of residuals.

    Attributes
    ----------
    counts
        (groups, cells): cell j is centred on (j - cells // 2) ``cell_dn``; the first and last hold all beyond.
    cell_dn
        Width of a cell.
    frames
        Over how many frames each pixel's mean was taken off; 1 if none was.
    row_pixels
        Over how many pixels each row's mean was taken off; infinity if none was.
    rounding_dn
        Step that the values had been rounded to before other things were taken off; 0 if the cells are that rounding
        (whole DN, counted as they are).
    reach_dn
        Residuals beyond, of either sign, count as "beyond" only: there the recorded values end at 0.
    """

    counts: NDArray[np.int64] = field(repr=False)
    cell_dn: float
    frames: int = 1
    row_pixels: float = math.inf
    rounding_dn: float = 1.0
    reach_dn: float = math.inf

    @property
    def values_dn(self) -> NDArray[np.float64]:
        """Centre of each cell."""
        cells = self.counts.shape[1]
        return np.asarray((np.arange(cells) - cells // 2) * self.cell_dn, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ReadNoise:
    """Read noise of one ISO.

    The reported values are those of the maximum likelihood, whose bias was below its standard error in simulations of
    1.6 to 6 megapixels wherever the noise was above :data:`RELIABLE_SIGMA_DN`. Below, the probability plot's are
    reported, and the errors include the difference of the two.

    Attributes
    ----------
    tukey_lambda, tukey_lambda_error
        Shape and its standard error.
    sigma_tl_dn, sigma_tl_error_dn
        Scale (not the standard deviation) without the rounding's share, and its standard error, DN.
    likelihood_lambda, likelihood_sigma_tl_dn
        Of the maximum likelihood, always.
    correlation
        Between the errors of the two.
    information_errors
        Standard errors of shape and scale from the information matrix, which takes all residuals for independent.
        The ones above come from the scatter of the score between groups of rows and allow for their dependence.
    sigma_gauss_dn, sigma_gauss_error_dn
        Standard deviation of the read noise without the rounding's share, and its standard error: the Gaussian model.
        Of what was recorded: clipping at 0 takes from it, as from the two probability plots.
    ppcc_lambda, ppcc_sigma_tl_dn
        Shape of the highest probability-plot correlation and the plot's slope, with the model's own answer to the same
        question compared with the truth it was made with, so that rounding and the mean over frames are allowed for.
    ppcc_lambda_plain, ppcc_sigma_plain_dn
        The same without that: what the published procedure gives on these residuals.
    curve
        (2, points): shapes and correlations, the PPCC plot.
    r_squared_tl, r_squared_gauss
        Of the probability plots of the residuals against Tukey lambda at its best shape and against the normal one.
    chi2_per_dof
        Of the fitted distribution over the cells with 25 residuals or more: far above 1, the noise is not of the
        family (or the fixed pattern is so faint that rounding shows as ripples, which average out of the estimates).
    residuals
        How many there were.
    beyond
        How many lay outside of the histogram (more than 400 standard deviations).
    is_reliable
        False below 0.7 DN of standard deviation: the errors are then no more than an order of magnitude.
    """

    tukey_lambda: float
    tukey_lambda_error: float
    sigma_tl_dn: float
    sigma_tl_error_dn: float
    likelihood_lambda: float
    likelihood_sigma_tl_dn: float
    correlation: float
    information_errors: tuple[float, float]
    sigma_gauss_dn: float
    sigma_gauss_error_dn: float
    ppcc_lambda: float
    ppcc_sigma_tl_dn: float
    ppcc_lambda_plain: float
    ppcc_sigma_plain_dn: float
    curve: NDArray[np.float64] = field(repr=False)
    r_squared_tl: float
    r_squared_gauss: float
    chi2_per_dof: float
    residuals: int
    beyond: int
    is_reliable: bool

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

    ordered_dn: NDArray[np.float64] = field(repr=False)
    normal: NDArray[np.float64] = field(repr=False)
    tukey_lambda: NDArray[np.float64] = field(repr=False)
    shape: float
    slope_normal_dn: float
    slope_tukey_lambda_dn: float


class Residuals:
    """Accumulates the residuals of the bias frames that made a fixed pattern, for :func:`read_noise`.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self._fixed = fixed
        self._pixels = sums_by_row(~fixed.defects, fixed.pattern)
        self._added = 0
        sigma = math.sqrt(float(np.mean(fixed.temporal_variance_dn2)))
        step = round(fixed.frames * sigma / _CELLS_PER_SIGMA)
        self._step = max(1, step - 1 + step % 2)  # odd, so that cell 0 is symmetric; in units of 1/n DN
        self._counts = np.zeros((min(_GROUPS, len(self._pixels) // 4), 2 * _HALF + 1), dtype=np.int64)

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a bias frame."""
        from eldata.calibration._kernels import residual_histogram

        fixed = self._fixed
        sums, _, _ = line_sums(mosaic, fixed)
        level = sums.sum(axis=0) / np.maximum(self._pixels.sum(axis=0), 1)
        row = (sums - self._pixels * level).sum(axis=1) / np.maximum(self._pixels.sum(axis=1), 1)
        phases = np.arange(len(row)) % len(fixed.pattern)
        offsets = np.rint(row[:, None] + level[fixed.pattern[phases]]).astype(np.int64)
        residual_histogram(
            mosaic, fixed.total_dn, fixed.defects, fixed.frames, offsets, self._step, len(self._counts), self._counts
        )
        self._added += 1

    def histogram(self) -> ResidualHistogram:
        """Return the counts so far.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern, or black is too close to 0.
        """
        fixed, frames = self._fixed, self._fixed.frames
        check_same_frames(self._added, fixed)
        pixels = float(self._pixels.sum(axis=1).mean())
        own = (1 - 1 / frames) * (1 - 1 / pixels)
        variance = max(fixed.temporal_variance_dn2)
        reach = own * min(fixed.level_dn) - 5 * math.sqrt(own * (1 - own) * variance)
        if reach < 2 * math.sqrt(variance):
            raise DatasetError(
                f"the black level ({min(fixed.level_dn):.1f} DN) is too close to 0 for noise of "
                f"{math.sqrt(variance):.1f} DN: much of it is clipped; calibrate raw files whose black level lies well "
                "above 0"
            )
        return ResidualHistogram(self._counts.copy(), self._step / frames, frames, pixels, reach_dn=reach)


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
    from eldata.calibration._tukey_lambda import HIGHEST, LOWEST, ResidualModel, correlation, normal_correlation

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
    folded = _folded(counts)
    starts = _cell_starts(folded.sum(axis=0), histogram.reach_dn / histogram.cell_dn)
    edges = np.maximum(starts - 0.5, 0.0) * histogram.cell_dn
    observed = np.add.reduceat(folded, starts, axis=1).astype(np.float64)
    variance = float(inner @ values**2) / float(inner.sum())
    start = (min(max(plain_lambda, LOWEST + 0.1), HIGHEST - 0.1), max(plain_sigma, 0.05 * math.sqrt(variance)))
    shape, sigma, probabilities, gradient = _maximised(observed.sum(axis=0), edges, model, start)
    covariance, information = _covariance(observed, probabilities, gradient)
    errors = np.sqrt(np.diag(covariance))

    # What the same probability plot says of the fitted model, whose truth is known.
    expected = _expected(histogram, model, shape, sigma)
    model_lambda, model_sigma, _ = ppcc(values, expected * number)
    best, _ = correlation(values[inner > 0], inner[inner > 0].astype(np.float64), plain_lambda)
    normal, _ = normal_correlation(values[inner > 0], inner[inner > 0].astype(np.float64))
    gauss, gauss_error = _standard_deviation(counts, histogram)
    filled = probabilities * number >= 25
    misfit = ((observed.sum(axis=0) - probabilities * number) ** 2 / (probabilities * number))[filled]
    ppcc_lambda, ppcc_sigma = plain_lambda + shape - model_lambda, plain_sigma * sigma / model_sigma
    is_reliable = gauss >= RELIABLE_SIGMA_DN
    lambda_error, sigma_error = float(errors[0]), float(errors[1]) * sigma
    if not is_reliable:
        lambda_error = math.hypot(lambda_error, ppcc_lambda - shape)
        sigma_error = math.hypot(sigma_error, ppcc_sigma - sigma)
    return ReadNoise(
        tukey_lambda=shape if is_reliable else ppcc_lambda,
        tukey_lambda_error=lambda_error,
        sigma_tl_dn=sigma if is_reliable else ppcc_sigma,
        sigma_tl_error_dn=sigma_error,
        likelihood_lambda=shape,
        likelihood_sigma_tl_dn=sigma,
        correlation=float(covariance[0, 1] / (errors[0] * errors[1])),
        information_errors=(math.sqrt(information[0, 0]), math.sqrt(information[1, 1]) * sigma),
        sigma_gauss_dn=gauss,
        sigma_gauss_error_dn=gauss_error,
        ppcc_lambda=ppcc_lambda,
        ppcc_sigma_tl_dn=ppcc_sigma,
        ppcc_lambda_plain=plain_lambda,
        ppcc_sigma_plain_dn=plain_sigma,
        curve=curve,
        r_squared_tl=best**2,
        r_squared_gauss=normal**2,
        chi2_per_dof=float(misfit.sum()) / max(1, len(misfit) - 3),
        residuals=number,
        beyond=beyond,
        is_reliable=is_reliable,
    )


def probability_plot(histogram: ResidualHistogram, *, points: int = 121) -> ProbabilityPlot:
    """Return the points of the two probability plots that :func:`read_noise` takes its R^2 from.

    Raises
    ------
    DatasetError
        If the histogram holds fewer than 1000 residuals.
    """
    from scipy.special import ndtr, ndtri

    from eldata.calibration._tukey_lambda import normal_correlation

    inner = histogram.counts[:, 1:-1].sum(axis=0)
    number = int(inner.sum())
    if number < 1000:
        raise DatasetError(f"{number} residuals do not show a distribution: give more pixels")
    values = histogram.values_dn[1:-1]
    shape, slope, _ = ppcc(values, inner)
    reach = float(-ndtri(100 / number)) if number > 1000 else 1.28
    normal = np.linspace(-reach, reach, points)
    levels = ndtr(normal)
    below = (np.cumsum(inner) - inner / 2) / number  # at the cells' centres
    filled = inner > 0
    tails = 1 - levels
    quantiles = np.log(levels / tails) if abs(shape) < 1e-9 else (levels**shape - tails**shape) / shape
    return ProbabilityPlot(
        ordered_dn=np.interp(levels, below[filled], values[filled]),
        normal=normal,
        tukey_lambda=quantiles,
        shape=shape,
        slope_normal_dn=normal_correlation(values[filled], inner[filled].astype(np.float64))[1],
        slope_tukey_lambda_dn=slope,
    )


def ppcc(
    values: NDArray[np.float64], counts: NDArray[Any], *, points: int = 41
) -> tuple[float, float, NDArray[np.float64]]:
    """Return the shape of the highest probability-plot correlation, the plot's slope there, and the curve.

    The grouped form of :func:`scipy.stats.ppcc_max` with the Tukey-lambda family.

    Parameters
    ----------
    values
        Ascending values.
    counts
        How often each occurred.
    points
        Of the curve, (2, points): shapes from -0.45 to 0.55 and correlations.
    """
    from scipy.optimize import minimize_scalar

    from eldata.calibration._tukey_lambda import correlation

    used = counts > 1e-12 * np.max(counts)
    values, weights = values[used], np.asarray(counts, dtype=np.float64)[used]
    shapes = np.linspace(-0.45, 0.55, points)
    curve = np.array([correlation(values, weights, float(shape))[0] for shape in shapes])
    best = int(curve.argmax())
    around = (float(shapes[max(best - 1, 0)]), float(shapes[min(best + 1, points - 1)]) + (best == points - 1) * 1.4)
    found = minimize_scalar(
        lambda shape: -correlation(values, weights, float(shape))[0],
        bounds=around,
        method="bounded",
        options={"xatol": 1e-6},
    )
    shape = float(found.x)
    return shape, correlation(values, weights, shape)[1], np.stack([shapes, curve])


def _folded(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the counts of abs(residual): the distribution is symmetric."""
    centre = counts.shape[1] // 2
    folded = counts[:, centre:].copy()
    folded[:, 1:] += counts[:, :centre][:, ::-1]
    return folded


def _cell_starts(folded: NDArray[np.int64], reach: float) -> NDArray[np.int64]:
    """Return where the cells of the likelihood start: one by one in the core, then ever wider; the last is open."""
    starts = list(range(min(_CORE, len(folded) - 1)))
    width = 1.0
    while starts[-1] + math.ceil(width) < len(folded):
        starts.append(starts[-1] + math.ceil(width))
        width *= _GROWTH
    tail = np.cumsum(folded[::-1])[::-1]
    kept = [start for start in starts if start == 0 or (tail[start] >= _LEAST_IN_TAIL and start <= reach)]
    return np.array(kept, dtype=np.int64)


def _maximised(
    observed: NDArray[Any], edges: NDArray[Any], model: ResidualModel, start: tuple[float, float]
) -> tuple[float, float, NDArray[Any], NDArray[Any]]:
    """Return shape, scale, the cells' probabilities there and d ln P / d (shape, ln scale), by Fisher scoring."""
    from eldata.calibration._tukey_lambda import HIGHEST, LOWEST

    number = float(observed.sum())

    def evaluated(at: NDArray[Any]) -> tuple[float, NDArray[Any]]:
        probabilities = model.probabilities(edges, float(at[0]), math.exp(float(at[1])))
        return float(observed @ np.log(probabilities)), probabilities

    def gradient_at(at: NDArray[Any]) -> NDArray[Any]:
        step = 1e-4
        return np.stack(
            [
                (np.log(evaluated(at + step * unit)[1]) - np.log(evaluated(at - step * unit)[1])) / (2 * step)
                for unit in np.eye(2)
            ]
        )

    at = np.array([start[0], math.log(start[1])])
    value, probabilities = evaluated(at)
    gradient = gradient_at(at)
    for _ in range(60):
        information = (gradient * probabilities) @ gradient.T * number
        move = np.linalg.solve(information, gradient @ observed)
        scale = min(1.0, 0.1 / float(np.abs(move).max()))
        while scale > 1e-4:
            proposed = at + scale * move
            proposed[0] = min(max(float(proposed[0]), LOWEST + 1e-3), HIGHEST)
            new_value, new_probabilities = evaluated(proposed)
            if new_value >= value - 1e-9 * abs(value) * 1e-3:
                break
            scale /= 2
        else:
            break
        moved = float(np.abs(proposed - at).max())
        at, value, probabilities = proposed, new_value, new_probabilities
        gradient = gradient_at(at)
        if moved < 1e-6:
            break
    return float(at[0]), math.exp(float(at[1])), probabilities, gradient


def _covariance(
    observed: NDArray[Any], probabilities: NDArray[Any], gradient: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the covariance of (shape, ln scale) from the groups' scores, and the inverse information."""
    groups = len(observed)
    inverse = np.linalg.inv((gradient * probabilities) @ gradient.T * float(observed.sum()))
    if groups < 8:
        return inverse, inverse
    scores = observed @ gradient.T
    scores -= scores.sum(axis=0) * (observed.sum(axis=1) / observed.sum())[:, None]
    scatter = scores.T @ scores * groups / (groups - 1)
    return inverse @ scatter @ inverse, inverse


def _expected(histogram: ResidualHistogram, model: ResidualModel, shape: float, sigma: float) -> NDArray[Any]:
    """Return the probability of each inner cell of the histogram."""
    half = histogram.counts.shape[1] // 2
    wanted = np.count_nonzero(_folded(histogram.counts).sum(axis=0)[:half].cumsum() < histogram.counts[:, 1:-1].sum())
    cells = min(half, int(wanted) + 1)
    edges = np.concatenate([[0.0], np.arange(cells) + 0.5]) * histogram.cell_dn
    folded = np.zeros(half)
    folded[:cells] = model.probabilities(edges, shape, sigma)[:cells]
    return np.concatenate([folded[:0:-1] / 2, folded[:1], folded[1:] / 2])


def _standard_deviation(counts: NDArray[np.int64], histogram: ResidualHistogram) -> tuple[float, float]:
    """Return the standard deviation of the noise without the rounding's share, and its error between groups."""
    values = histogram.values_dn
    squares, numbers = counts @ values**2, counts.sum(axis=1)
    # A cell's width adds its own twelfth of a square; 1/own undoes what the means took.
    own = (1 - 1 / histogram.frames if histogram.frames > 1 else 1.0) * (1 - 1 / histogram.row_pixels)
    mean = float(squares.sum() / numbers.sum())
    variance = (mean - histogram.cell_dn**2 / 12) / own - histogram.rounding_dn**2 / 12
    groups = len(counts)
    error = math.nan
    if groups > 1:
        deviations = squares - numbers * mean
        error = math.sqrt(float(deviations @ deviations) * groups / (groups - 1)) / float(numbers.sum()) / own
    sigma = math.sqrt(max(variance, 0.0))
    return sigma, error / (2 * sigma) if sigma else math.nan
