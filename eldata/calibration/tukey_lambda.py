"""The Tukey-lambda distribution, the model of residuals, and the probability-plot correlation on a histogram."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from scipy import interpolate, special

from eldata.base.compiled import kernel
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from eldata.calibration.sums import Values

    Nodes: TypeAlias = tuple[Values, Values]

LOWEST, HIGHEST = -0.49, 1.0
"""Shapes that are searched: finite variance, up to nearly uniform."""

NEARLY_NORMAL = 0.14
"""The shape at which the distribution is nearest to the normal one."""

NOTHING: Nodes = (np.zeros(1), np.ones(1))
"""A discrete distribution, as nodes and weights: of what is always 0."""

_LEGENDRE = np.polynomial.legendre.leggauss(4)
_TABLE = np.linspace(0.0, 9.0, 1201)  # arsinh(x / standard deviation): to 4000 standard deviations
_SIZE = 1 << 14  # cells of the distribution of the other frames' share
_CELLS = 16  # of it, per standard deviation of one frame's share
_LEAST_SIGMA_STEPS = 0.1  # below, all is lost in rounding
_MANY_STEPS = 5  # above, a ripple is below one in a million


@kernel
def tukey_lambda_tail(x: Any, shape: float) -> Any:
    """Return P(X > x) for scale 1: the v with ((1 - v)^l - v^l) / l = x, by Newton's method in ln((1 - v) / v).

    It starts at the solution of (1 - exp(-l t)) / l = x and approaches from one side, as x(t) is convex or concave.
    """
    if x < 0.0:
        return 1.0 - tukey_lambda_tail(-x, shape)
    if abs(shape) < 1e-9:
        return 1.0 / (1.0 + np.exp(x))
    if shape * x >= 1.0:
        return 0.0
    t = -np.log1p(-shape * x) / shape
    for _ in range(50):
        v = 1.0 / (1.0 + np.exp(t))
        power = (1.0 - v) ** shape
        fall = np.exp(-shape * t)
        value = -power * np.expm1(-shape * t) / shape
        # dx/dt = v (1 - v) ((1 - v)^(l - 1) + v^(l - 1)), with v^l = power fall
        slope = power * (v + (1.0 - v) * fall)
        step = (x - value) / slope
        t = max(t + step, 0.0)
        if abs(step) < 1e-13 * (1.0 + t):
            break
    return 1.0 / (1.0 + np.exp(t))


def tukey_lambda_quantile(levels: Values, shape: float, above: Values | None = None) -> Values:
    """Return quantiles ``(u^l - v^l) / l`` of scale 1, v = 1 - u, and their limit ``ln(u / v)`` at l = 0."""
    return np.asarray(special.boxcox(levels, shape) - special.boxcox(1 - levels if above is None else above, shape))


@kernel
def smoothed_tails(x: Values, shape: float, scale: float, nodes: Values, weights: Values) -> Any:
    """Return P(scale X + U > x), U being the discrete distribution of nodes and weights."""
    tails = np.zeros(x.size)
    for i in range(x.size):
        for j in range(nodes.size):
            tails[i] += weights[j] * tukey_lambda_tail((x[i] - nodes[j]) / scale, shape)
    return tails


def _look_up(logs: interpolate.PchipInterpolator, unit: float, edges: Values, others: Nodes) -> Values:
    """Return P(X + Z > edge) for each edge: X by the logarithms of its tails in steps of ``unit``, Z discrete."""
    values, chances = others
    away = np.subtract.outer(edges, values) / unit
    beyond = np.exp(logs(np.minimum(np.arcsinh(np.abs(away)), _TABLE[-1])))
    return np.asarray(np.where(away < 0, 1 - beyond, beyond) @ chances)


@dataclass(frozen=True, slots=True)
class Ripple:
    """What rounding does to noise: how far its figures ripple as the mean goes from one step of the values to the next.

    Peak to peak: ``mean`` (of the values less the true one, in steps, and in their standard deviations), and
    ``variance`` as a share of its mean. They fall off exponentially with the noise: at 1 DN both are below a hundredth.
    """

    mean_steps: float
    mean: float
    variance: float

    @classmethod
    def of(cls, shape: float, sigma_steps: float) -> Ripple:
        """Compute the ripple for a Tukey-lambda distribution of this shape, and scale in steps of the values."""
        if not sigma_steps > _LEAST_SIGMA_STEPS:
            return cls(1.0, math.inf, math.inf)
        if sigma_steps > _MANY_STEPS:
            return cls(0.0, 0.0, 0.0)
        levels, values, chances = _round_levels(shape, sigma_steps)
        means = chances @ values
        variances = (chances * (values - means[:, None]) ** 2).sum(axis=1)
        typical, mean_steps = float(variances.mean()), float(np.ptp(means - levels))
        return cls(mean_steps, mean_steps / math.sqrt(typical), float(np.ptp(variances)) / typical)


def _round_levels(shape: float, sigma_steps: float) -> tuple[Values, Values, Values]:
    """Return levels from 0 to 1 step, recorded values, and the chance of each at each level, (levels, values)."""
    reach = math.ceil(20 + 30 * sigma_steps)
    levels, values = np.arange(16) / 16, np.arange(-reach, reach + 1.0)
    edges = np.append(values - 0.5, values[-1] + 0.5) - levels[:, None]
    tails = smoothed_tails(edges.ravel(), shape, sigma_steps, np.zeros(1), np.ones(1)).reshape(edges.shape)
    return levels, values, -np.diff(tails, axis=1)


def wave_of_rounding(shape: float, sigma: float, frames: int) -> float:
    """Return the mean of exp(2 pi i mean) over pixels whose levels lie anywhere: rounding draws means to whole DN."""
    if not _LEAST_SIGMA_STEPS < sigma < _MANY_STEPS:
        return float(sigma <= _LEAST_SIGMA_STEPS)
    _, values, chances = _round_levels(shape, sigma)
    return float(((chances @ np.exp(2j * math.pi * values / frames)) ** frames).mean().real)


@dataclass(frozen=True, slots=True)
class ResidualModel:
    """The distribution of one residual: ``own Y + Z`` with ``Y = sigma X + U``.

    X is Tukey lambda, U the rounding, uniform over ``rounding_dn``. Z is what the means that were taken off hold of
    other pixels' noise: of the n - 1 other frames in the same pixel (their exact distribution, by FFT: heavy tails
    show through a mean of ten), and of the row's other pixels (normal, with the exact variance).
    """

    frames: int
    row_pixels: float
    rounding_dn: float

    @property
    def own(self) -> float:
        """Share of the pixel's own noise in its residual."""
        return (1 - 1 / self.frames if self.frames > 1 else 1.0) * (1 - 1 / self.row_pixels)

    def tails(self, edges: Values, shape: float, sigma: float) -> Values:
        """Return P(residual > edge) for each edge."""
        unit = math.sqrt(sigma**2 * tukey_lambda_variance(shape) + self.rounding_dn**2 / 12)
        rounding = _LEGENDRE[0] * (self.rounding_dn / 2), _LEGENDRE[1] / 2
        of_table = smoothed_tails(unit * np.sinh(_TABLE), shape, sigma, *rounding)
        # Monotone, as tails of a positive shape end: a spline would ring there.
        logs = interpolate.PchipInterpolator(_TABLE, np.log(np.maximum(of_table, 1e-40)))
        return _look_up(logs, self.own * unit, edges, self._others(logs, unit))

    def probabilities(self, edges: Values, shape: float, sigma: float) -> Values:
        """Return P of each cell of abs(residual): between the edges (the first is 0) and beyond the last."""
        tails = self.tails(edges, shape, sigma)
        tails[0] = 0.5
        return np.maximum(-2 * np.diff(tails, append=0.0), 1e-300)

    def _others(self, logs: interpolate.PchipInterpolator, unit: float) -> Nodes:
        """Return the distribution of other pixels' noise, Z, as nodes and weights."""
        variance = self.own * (1 - self.own) * unit**2
        if variance <= 0:
            return NOTHING
        share = (1 - 1 / self.row_pixels) / self.frames
        width = share * unit / _CELLS
        edges = (np.arange(_SIZE // 2) + 0.5) * width
        tails = _look_up(logs, share * unit, edges, NOTHING)
        half = -np.diff(tails, append=0.0)
        cells = np.zeros(_SIZE)
        cells[0] = 1 - 2 * tails[0]
        cells[1 : _SIZE // 2] = half[:-1]
        cells[-1 : _SIZE // 2 : -1] = half[:-1]
        of_row = variance - (self.frames - 1) * (share * unit) ** 2
        frequency = 2 * math.pi * np.fft.rfftfreq(_SIZE, width)
        transform = np.fft.rfft(cells).real ** (self.frames - 1) * np.exp(-0.5 * max(of_row, 0.0) * frequency**2)
        density = np.maximum(np.fft.fftshift(np.fft.irfft(transform, _SIZE)), 0.0)
        return _compress((np.arange(_SIZE) - _SIZE // 2) * width, density, math.sqrt(variance))


def _compress(values: Values, weights: Values, spread: float) -> tuple[Values, Values]:
    """Replace a distribution by two nodes for each of some intervals, of the same mean and variance."""
    core = np.arange(-6.0, 6.01, 0.75)
    far = 6.0 * 1.35 ** np.arange(1.0, 20.0)
    limits = np.concatenate([-far[::-1], core, far]) * spread
    starts = np.unique(np.concatenate([[0], np.searchsorted(values, limits)]))
    starts = starts[starts < len(values)]
    totals = np.add.reduceat(weights, starts)
    kept = totals > 1e-13
    safe = np.where(kept, totals, 1.0)
    means = np.add.reduceat(weights * values, starts) / safe
    deviations = np.sqrt(np.maximum(np.add.reduceat(weights * values**2, starts) / safe - means**2, 0.0))
    nodes = np.concatenate([(means - deviations)[kept], (means + deviations)[kept]])
    shares = np.concatenate([totals[kept], totals[kept]]) / (2 * totals[kept].sum())
    return nodes, shares


def correlation(values: Values, counts: Values, shape: float) -> tuple[float, float]:
    """Return correlation and slope of the probability plot of a histogram against Tukey lambda.

    ``values`` ascend and no count is 0. Each cell is compared with the mean of the quantile function over its share of
    the probability, whose integral is ``(p^(l + 1) + (1 - p)^(l + 1) - 1) / (l (l + 1))``.
    """
    total = float(counts.sum())
    below = np.concatenate([[0.0], np.cumsum(counts)]) / total
    above = np.concatenate([np.cumsum(counts[::-1])[::-1], [0.0]]) / total
    weights = counts / total
    blocks = np.diff(_integrate_quantile(below, above, shape))
    # The quantile's spread inside a cell, by quadrature; without the outermost cells, where it has no bound.
    inside = 0.0
    means = blocks[1:-1] / weights[1:-1]
    for node, share in zip((_LEGENDRE[0] + 1) / 2, _LEGENDRE[1] / 2, strict=True):
        low, high = below[1:-2] + node * weights[1:-1], above[2:-1] + (1 - node) * weights[1:-1]
        quantiles = tukey_lambda_quantile(low, shape, high)
        inside += share * float(weights[1:-1] @ (quantiles - means) ** 2)
    return _correlate(values, weights, blocks, inside)


def normal_correlation(values: Values, counts: Values) -> tuple[float, float]:
    """Return correlation and slope of the normal probability plot: the quantile's integral is minus the density."""
    total = float(counts.sum())
    below, above = np.cumsum(counts)[:-1] / total, np.cumsum(counts[::-1])[::-1][1:] / total
    quantiles = np.where(below < above, special.ndtri(below), -special.ndtri(above))
    density = np.concatenate([[0.0], np.exp(-0.5 * quantiles**2) / math.sqrt(2 * math.pi), [0.0]])
    blocks, weights = -np.diff(density), counts / total
    second = np.concatenate([[0.0], below - quantiles * density[1:-1], [1.0]])  # the integral of the square
    inside = float((np.diff(second) - blocks**2 / weights)[1:-1].sum())
    return _correlate(values, weights, blocks, inside)


def _integrate_quantile(below: Values, above: Values, shape: float) -> Values:
    """Integrate the quantile function of scale 1 from 0 to each level ``below``; ``above`` = 1 - level."""
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = [
            np.where(share > 0, share * special.boxcox(share, shape), 0.0) for share in (below, above)
        ]  # 0 ln 0 is 0
    return np.asarray((terms[0] + terms[1]) / (shape + 1))


def _correlate(values: Values, weights: Values, blocks: Values, inside: float) -> tuple[float, float]:
    """Compute correlation and slope of a plot; ``blocks``: each cell's integral of the quantile function."""
    centred = values - float(weights @ values)
    cross = float(centred @ blocks)
    squares = float(blocks @ (blocks / weights)) + inside
    return cross / math.sqrt(squares * float(weights @ centred**2)), cross / squares
