"""Shape and scale of the read noise from counts of residuals: maximum likelihood.

It takes rounding for an independent and uniform error, and so is a smooth function whatever the fixed pattern. In quiet
bodies whose pixels' levels share a fraction of a DN that is not so:
:func:`~eldata.calibration.core.read_noise.read_noise_findings` allows for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._tukey_lambda import HIGHEST, LOWEST

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Values
    from eldata.calibration.core._tukey_lambda import ResidualModel


CELLS_PER_SIGMA = 20
_CORE = 6 * CELLS_PER_SIGMA  # cells that stay as they are; beyond, they merge to ever wider ones
_GROWTH = 1.05
_NEAR = 0.1  # to the end, in errors that the parameters would have if all residuals were independent
_LEAST_IN_TAIL = 20  # residuals in the outermost cell of the likelihood


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
    is_cut
        Whether recorded values end below, so that the residuals above 0 alone tell the noise.
    squares_dn2
        (groups,) exact sums of the squared residuals; without, the counts tell them.
    level_waves
        By channel, how alike the fractions of a DN are that the pixels' means over the frames have: the mean of
        exp(2 pi i mean), near 0 where they lie everywhere between whole DN.
    """

    counts: NDArray[Any] = field(repr=False)
    cell_dn: float
    frames: int = 1
    row_pixels: float = math.inf
    rounding_dn: float = 1.0
    is_cut: bool = False
    squares_dn2: Values | None = field(default=None, repr=False)
    level_waves: NDArray[np.complexfloating[Any, Any]] = field(repr=False, default_factory=lambda: np.zeros(1, complex))

    @property
    def folded(self) -> Counts:
        """Counts of abs(residual), as the distribution is symmetric; where it is cut, of half of them."""
        centre = self.counts.shape[1] // 2
        both: Counts = self.counts[:, centre:].copy()
        if self.is_cut:
            both[:, 0] //= 2
        else:
            both[:, 1:] += self.counts[:, :centre][:, ::-1]
        return both

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
    def of(cls, histogram: ResidualHistogram) -> ResidualCells:
        """Merge the cells of a histogram."""
        both = histogram.folded
        starts = _cell_starts(both.sum(axis=0))
        return cls(starts, np.add.reduceat(both, starts, axis=1).astype(np.float64), histogram.cell_dn)

    @property
    def edges_dn(self) -> Values:
        """Lower edge of each cell."""
        return np.asarray(np.maximum(self.starts - 0.5, 0.0) * self.cell_dn)


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
    converged
        Whether the iteration came to an end.
    """

    shape: float
    scale: float
    probabilities: Values = field(repr=False)
    influence: Values = field(repr=False)
    information: Values = field(repr=False)
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


def residual_fit(cells: ResidualCells, model: ResidualModel, start: tuple[float, float]) -> ResidualFit:
    """Fit shape and scale to what was counted, from a shape and a scale to begin with."""
    likelihood = _Likelihood(cells, model)
    where, probabilities, scores, converged = likelihood.maximised(np.array([start[0], math.log(start[1])]))
    inverse = np.linalg.inv((scores * probabilities) @ scores.T * likelihood.number)
    influence = likelihood.scores_by_group(scores, probabilities) @ inverse
    return ResidualFit(float(where[0]), math.exp(where[1]), probabilities, influence, inverse, converged)


class _Likelihood:
    """The likelihood, with independent uniform rounding."""

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
            ascent = scores @ self.counts
            move = np.linalg.solve(information, ascent)
            is_near = float(ascent @ move) < _NEAR**2
            length = min(1.0, 0.1 / float(np.abs(move).max()))
            while length > 1e-4:
                proposed = _inside(at + length * move)
                found = self.probabilities(proposed)
                reached = float(self.counts @ np.log(found))
                if reached >= value - 1e-12 * abs(value):
                    break
                length /= 2
            else:
                break
            moved = float(np.abs(proposed - at).max())
            at, value, probabilities, scores = proposed, reached, found, self.scores(proposed)
            if moved < 1e-6:
                return at, probabilities, scores, True
        return at, probabilities, scores, is_near


def centred(by_group: Values, sizes: Values | Counts) -> Values:
    """Return sums by group less their share of the whole, by the groups' sizes."""
    return np.asarray(by_group - np.multiply.outer(sizes / sizes.sum(), by_group.sum(axis=0)))


def _inside(at: Values) -> Values:
    return np.array([min(max(float(at[0]), LOWEST + 1e-3), HIGHEST), float(at[1])])


def _cell_starts(both: Counts) -> Counts:
    """Return where the cells of the likelihood start: one by one in the core, then ever wider; the last is open."""
    starts = list(range(min(_CORE, len(both) - 1)))
    width = 1.0
    while starts[-1] + math.ceil(width) < len(both):
        starts.append(starts[-1] + math.ceil(width))
        width *= _GROWTH
    tail = np.cumsum(both[::-1])[::-1]
    kept = [start for start in starts if start == 0 or tail[start] >= _LEAST_IN_TAIL]
    return np.array(kept, dtype=np.int64)
