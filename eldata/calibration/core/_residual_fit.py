"""Shape and scale of the read noise from counts of residuals: maximum likelihood, then rounding as it is.

The likelihood takes rounding for independent and uniform, and so is a smooth function whatever the fixed pattern. Where
that is not so, the expectation of its scores s is not 0, but known (:mod:`eldata.calibration.core._rounding`): the
estimate solves ``sum s (counts - N P) = 0`` with the true probabilities P. Where rounding is independent both are the
same. So the estimate does not take ripples, whose size hangs on the fixed pattern, for information on the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._rounding import RoundedResiduals, ripples, rounding_matters
from eldata.calibration.core._tukey_lambda import HIGHEST, LOWEST
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Values
    from eldata.calibration.core._rounding import LevelFractions, Rounded
    from eldata.calibration.core._tukey_lambda import ResidualModel
    from eldata.calibration.core.row_noise import OffsetResponse


CELLS_PER_SIGMA = 20
_CORE = 6 * CELLS_PER_SIGMA  # cells that stay as they are; beyond, they merge to ever wider ones
_GROWTH = 1.05
_LEAST_IN_TAIL = 20  # residuals in the outermost cell of the likelihood
_MOST_STEPS = 30  # of the iteration; it converges in some six
_STEP = 2e-3  # of shape and ln scale, for derivatives of what rounding adds
_QUIET_DN = 0.7  # of the recorded values' standard deviation: below, the iteration begins at the best of a grid
_GRID = (np.array([-0.3, -0.15, 0.0, 0.15]), np.geomspace(0.1, 0.8, 12))  # shapes, standard deviations in DN


@dataclass(frozen=True, slots=True, eq=False)
class ResidualHistogram:
    """Counts of residuals.

    Attributes
    ----------
    counts
        (groups, cells): cell j is centred on (j - cells // 2) ``cell_dn``; the first and last hold all beyond. Whole
        numbers, or estimates of them, which in the tails may be negative.
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
    squares_dn2
        (groups,) exact sums of the squared residuals; without, the counts tell them.
    fractions
        Where between whole DN the pixels' levels lie; without, rounding counts as independent of the noise.
    """

    counts: NDArray[Any] = field(repr=False)
    cell_dn: float
    frames: int = 1
    row_pixels: float = math.inf
    rounding_dn: float = 1.0
    reach_dn: float = math.inf
    squares_dn2: Values | None = field(default=None, repr=False)
    fractions: LevelFractions | None = field(default=None, repr=False)

    @property
    def values_dn(self) -> Values:
        """Centre of each cell."""
        cells = self.counts.shape[1]
        return np.asarray((np.arange(cells) - cells // 2) * self.cell_dn, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualCells:
    """Counts of abs(residual), ready for a likelihood.

    Attributes
    ----------
    starts
        Cell of the histogram at which each cell of the likelihood starts; the last one is open.
    observed
        (groups, cells) counts.
    cell_dn
        Width of the histogram's cells.
    """

    starts: Counts = field(repr=False)
    observed: Values = field(repr=False)
    cell_dn: float

    @classmethod
    def of(cls, counts: Counts, cell_dn: float, reach_dn: float) -> ResidualCells:
        """Merge the cells of a histogram; beyond the reach all is one cell."""
        both = folded(counts)
        starts = _cell_starts(both.sum(axis=0), reach_dn / cell_dn)
        return cls(starts, np.add.reduceat(both, starts, axis=1).astype(np.float64), cell_dn)

    @property
    def edges_dn(self) -> Values:
        """Lower edge of each cell."""
        return np.asarray(np.maximum(self.starts - 0.5, 0.0) * self.cell_dn)

    def of_lattice(self, values: Values, frames: int) -> Values:
        """Add up what is given by points 0, 1, ... 1/n DN, (..., points), by cells: (..., cells)."""
        places = self.places(values.shape[-1], frames)
        firsts = np.flatnonzero(np.diff(places, prepend=-1))
        sums = np.zeros((*values.shape[:-1], len(self.starts)))
        sums[..., places[firsts]] = np.add.reduceat(values, firsts, axis=-1)
        return sums

    def places(self, points: int, frames: int) -> Counts:
        """Return the cell of each of the points 0, 1, ... 1/n DN."""
        step = round(self.cell_dn * frames)
        cell = (np.arange(points) + step // 2) // step
        return np.asarray(np.searchsorted(self.starts, cell, side="right") - 1, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualFit:
    """Shape and scale, and what errors and other figures are worked out from.

    Attributes
    ----------
    shape, scale
        Of the Tukey-lambda distribution, the scale in DN.
    probabilities
        Of the cells.
    influence
        (groups, 2): what each group of rows adds to the errors of shape and ln scale.
    information
        (2, 2) covariance of the two if all residuals were independent.
    rounded
        What rounding does there, ``None`` where it is independent and uniform.
    rounded_slope
        Its variance's derivatives by shape and ln scale.
    converged
        Whether the iteration came to an end.
    """

    shape: float
    scale: float
    probabilities: Values = field(repr=False)
    influence: Values = field(repr=False)
    information: Values = field(repr=False)
    rounded: Rounded | None = field(repr=False)
    rounded_slope: Values = field(repr=False)
    converged: bool

    @property
    def covariance(self) -> Values:
        """(2, 2) of shape and ln scale, from the scatter between groups of rows."""
        groups = len(self.influence)
        if groups < 8:
            return self.information
        return np.asarray(self.influence.T @ self.influence * groups / (groups - 1))

    def chi2_per_dof(self, cells: ResidualCells) -> tuple[float, int]:
        """Return chi^2 per degree of freedom over the cells where 25 residuals or more are expected, and these."""
        expected = self.probabilities * float(cells.observed.sum())
        filled = expected >= 25
        misfit = ((cells.observed.sum(axis=0) - expected) ** 2)[filled] / expected[filled]
        freedom = max(1, misfit.size - 3)
        return float(misfit.sum()) / freedom, freedom


def folded(counts: Counts) -> Counts:
    """Return the counts of abs(residual): the distribution is symmetric."""
    centre = counts.shape[1] // 2
    both = counts[:, centre:].copy()
    both[:, 1:] += counts[:, :centre][:, ::-1]
    return both


def residual_fit(
    cells: ResidualCells,
    model: ResidualModel,
    fractions: LevelFractions | None,
    start: tuple[float, float],
    deviation_dn: float,
) -> ResidualFit:
    """Fit shape and scale.

    Parameters
    ----------
    cells
        What was counted.
    model
        Of residuals with independent uniform rounding.
    fractions
        Where the pixels' levels lie between whole DN; without, rounding counts as independent.
    start
        Shape and scale to begin with.
    deviation_dn
        Standard deviation of the recorded values, rounding included.
    """
    smooth = _Smooth(cells, model)
    at = smooth.maximised(np.array([start[0], math.log(start[1])]))
    if fractions is not None and rounding_matters(math.exp(float(at[0][1]))):
        return _Rounding(smooth, fractions).solved(at[0], deviation_dn)
    where, probabilities, scores, converged = at
    rounded = None
    if fractions is not None and ripples(deviation_dn, model.frames, int(smooth.number)):
        rounded = RoundedResiduals(model.frames, model.row_pixels, fractions).at(float(where[0]), math.exp(where[1]))
        added = cells.of_lattice(rounded.change, model.frames)
        probabilities = np.maximum(probabilities + added, 1e-300)
    inverse = np.linalg.inv((scores * probabilities) @ scores.T * smooth.number)
    influence = smooth.scores_by_group(scores, probabilities) @ inverse
    return ResidualFit(
        float(where[0]), math.exp(where[1]), probabilities, influence, inverse, rounded, np.zeros(2), converged
    )


class _Smooth:
    """The likelihood with independent uniform rounding."""

    def __init__(self, cells: ResidualCells, model: ResidualModel) -> None:
        self.cells, self.model = cells, model
        self.counts = cells.observed.sum(axis=0)
        self.number = float(self.counts.sum())
        self._edges = cells.edges_dn

    def probabilities(self, at: Values) -> Values:
        """At shape and ln scale."""
        return self.model.probabilities(self._edges.copy(), float(at[0]), math.exp(float(at[1])))

    def scores(self, at: Values) -> Values:
        """Return d ln P / d (shape, ln scale), (2, cells)."""
        step = 1e-4
        return np.stack(
            [
                (np.log(self.probabilities(at + step * unit)) - np.log(self.probabilities(at - step * unit)))
                / (2 * step)
                for unit in np.eye(2)
            ]
        )

    def scores_by_group(self, scores: Values, probabilities: Values) -> Values:
        """Return what groups' counts add to the sum of scores less its expectation, (groups, 2)."""
        observed = self.cells.observed
        by_group: Values = (observed - observed.sum(axis=1, keepdims=True) * probabilities) @ scores.T
        return centred(by_group, observed.sum(axis=1))

    def maximised(self, at: Values) -> tuple[Values, Values, Values, bool]:
        """Return where the likelihood is highest, probabilities and scores there, by Fisher scoring."""
        probabilities = self.probabilities(at)
        value, scores = float(self.counts @ np.log(probabilities)), self.scores(at)
        for _ in range(60):
            information = (scores * probabilities) @ scores.T * self.number
            move = np.linalg.solve(information, scores @ self.counts)
            length = min(1.0, 0.1 / float(np.abs(move).max()))
            while length > 1e-4:
                proposed = _inside(at + length * move)
                found = self.probabilities(proposed)
                reached = float(self.counts @ np.log(found))
                if reached >= value - 1e-12 * abs(value):
                    break
                length /= 2
            else:
                return at, probabilities, scores, False
            moved = float(np.abs(proposed - at).max())
            at, value, probabilities, scores = proposed, reached, found, self.scores(proposed)
            if moved < 1e-6:
                return at, probabilities, scores, True
        return at, probabilities, scores, False


class _Rounding:
    """The scores of the smooth likelihood, with the expectation that they have with rounding as it is."""

    def __init__(self, smooth: _Smooth, fractions: LevelFractions) -> None:
        self._smooth, self._fractions = smooth, fractions
        self._residuals = RoundedResiduals(smooth.model.frames, smooth.model.row_pixels, fractions)

    def _at(self, at: Values) -> tuple[Values, Rounded]:
        """Return the cells' probabilities and what rounding does."""
        rounded = self._residuals.at(float(at[0]), math.exp(float(at[1])))
        added = self._smooth.cells.of_lattice(rounded.change, self._smooth.model.frames)
        return self._smooth.probabilities(at) + added, rounded

    def _begin(self, at: Values, deviation_dn: float) -> Values:
        """Return where the likelihood is highest, of a grid and the given point."""
        if deviation_dn > _QUIET_DN:
            return at
        points = [at]
        for shape in _GRID[0]:
            unit = math.sqrt(tukey_lambda_variance(float(shape)))
            points += [np.array([shape, math.log(deviation / unit)]) for deviation in _GRID[1]]
        values = [float(self._smooth.counts @ np.log(np.maximum(self._at(point)[0], 1e-12))) for point in points]
        return points[int(np.argmax(values))]

    def solved(self, at: Values, deviation_dn: float) -> ResidualFit:
        smooth = self._smooth
        at = self._begin(at, deviation_dn)
        converged = False
        for _ in range(_MOST_STEPS):
            scores = smooth.scores(at)
            probabilities, rounded = self._at(at)
            rest = scores @ (smooth.counts - smooth.number * probabilities)
            beside = [[self._at(at + sign * _STEP * unit) for sign in (1, -1)] for unit in np.eye(2)]
            slope = smooth.number * np.stack([scores @ (up[0] - down[0]) for up, down in beside], axis=1) / (2 * _STEP)
            variance_slope = np.array([up[1].variance_dn2 - down[1].variance_dn2 for up, down in beside]) / (2 * _STEP)
            if converged:
                break
            move = np.linalg.lstsq(slope, rest, rcond=1e-9)[0]
            proposed = _inside(at + move * min(1.0, 0.2 / max(float(np.abs(move).max()), 1e-12)))
            converged = float(np.abs(proposed - at).max()) < 1e-5
            at = proposed
        inverse = np.linalg.pinv(slope)
        # The scores' expectation hangs on the levels' fractions, whose estimate varies from group to group as well.
        points = rounded.by_fraction.shape[2]
        by_wave = smooth.number * rounded.by_wave(scores[:, smooth.cells.places(points, smooth.model.frames)].T)
        waves, pixels = self._fractions.waves(), self._fractions.pixels
        shares = pixels / pixels.sum(axis=0)
        of_waves = shares[..., None] * (waves - np.einsum("gc,gcw->cw", shares, waves))
        by_fractions = np.einsum("gcw,cwj->gj", of_waves, by_wave)
        influence = smooth.scores_by_group(scores, probabilities) - centred(by_fractions, pixels.sum(axis=1))
        influence = influence @ inverse.T
        rounded = replace(rounded, response=self._response(rounded, beside, influence))
        return ResidualFit(
            shape=float(at[0]),
            scale=math.exp(float(at[1])),
            probabilities=np.maximum(probabilities, 1e-300),
            influence=influence,
            information=inverse @ ((scores * np.maximum(probabilities, 0.0)) @ scores.T * smooth.number) @ inverse.T,
            rounded=rounded,
            rounded_slope=variance_slope,
            converged=converged,
        )

    def _response(
        self, rounded: Rounded, beside: list[list[tuple[Values, Rounded]]], influence: Values
    ) -> OffsetResponse:
        """Return the response with what the errors of shape and scale make of the offsets behind the measured ones."""
        n = self._smooth.model.frames
        seen = max(self._fractions.offset_variance_dn2, 1e-4) / (1 - 1 / n)
        slopes = [
            (up[1].response.sigma_dn(seen) - down[1].response.sigma_dn(seen)) / (2 * _STEP) for up, down in beside
        ]
        error = math.sqrt(float(np.sum((influence @ np.array(slopes)) ** 2)))
        return replace(rounded.response, relative_error=error / rounded.response.sigma_dn(seen))


def centred(by_group: Values, sizes: Values | Counts) -> Values:
    """Return sums by group less their share of the whole, by the groups' sizes."""
    return np.asarray(by_group - np.multiply.outer(sizes / sizes.sum(), by_group.sum(axis=0)))


def _inside(at: Values) -> Values:
    return np.array([min(max(float(at[0]), LOWEST + 1e-3), HIGHEST), float(at[1])])


def _cell_starts(both: Counts, reach: float) -> Counts:
    """Return where the cells of the likelihood start: one by one in the core, then ever wider; the last is open."""
    starts = list(range(min(_CORE, len(both) - 1)))
    width = 1.0
    while starts[-1] + math.ceil(width) < len(both):
        starts.append(starts[-1] + math.ceil(width))
        width *= _GROWTH
    tail = np.cumsum(both[::-1])[::-1]
    kept = [start for start in starts if start == 0 or (tail[start] >= _LEAST_IN_TAIL and start <= reach)]
    return np.array(kept, dtype=np.int64)
