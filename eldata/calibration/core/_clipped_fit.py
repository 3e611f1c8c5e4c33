"""Noise of bias frames whose values end at 0: from what is left above, without each pixel's own mean.

A camera that takes black off before it writes its files records ``max(0, round(mu + g + r + e))``: level mu of the
channel, fixed pattern g of the pixel, offset r of the row in this frame, read noise e. Means over frames do not free e
of g then, as what lies below 0 is gone. But the distribution of all values of a channel is known from 0 up, with 0 one
open cell, and its likelihood is exact, rounding included, once the variances of g and r are known; both count as
normal. They follow from what two values share: those of one pixel in two frames, and those of one row in one frame. The
clip shrinks these covariances to the variances of what is recorded on average as g and as r vary
(:class:`ClippedNoise`). Shape, scale, levels and both variances are solved for together.

Every equation is a sum over groups of rows, whose scatter gives the errors: what is not known of the pattern and the
row noise is in the errors of shape and scale, and the other way round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._clipped_noise import ClippedNoise, laplace, normal, summed, variance
from eldata.calibration.core._tukey_lambda import HIGHEST, LOWEST
from eldata.calibration.core.read_noise import PLOT_POINTS, ProbabilityPlot, ReadNoise
from eldata.calibration.core.row_noise import OffsetResponse
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from eldata.calibration.core._clipped_noise import ClippedStatistics
    from eldata.calibration.core._frames import Values
    from eldata.calibration.core._tukey_lambda import Nodes
    from eldata.calibration.core.defects import FixedPattern

    _Expected = tuple[Values, Values, float]

_LEVEL_NODES = 15  # of the levels over the frame
_EVEN = 0.02  # of the noise: levels that vary less count as one
_STEP = 1e-3  # of shape, ln scale and the rest in scales, for derivatives
_MOST_STEPS = 40
_PASSES = 3  # of levels over the frame, then the rest
_EXPECTED = 25  # values in a cell that counts for chi^2


@dataclass(frozen=True, slots=True, eq=False)
class ClippedFit:
    """What lies behind values that end at 0.

    Attributes
    ----------
    read, plot
        The read noise, and its probability plots: of values less their channel's level, from the highest share of zeros
        up. The fitted quantiles are those of read noise, pattern and row noise together, over the read noise's scale.
    fixed
        What stays from frame to frame, with levels, non-uniformity and shading as they would be without the clip.
    level_variances_dn2
        Squared errors of the levels by channel, from the scatter between groups of rows.
    if_laplace
        (2 + channels,) by how much shape, ln scale and levels would be others if the pixels' levels followed a Laplace
        distribution, whose excess kurtosis is 3, in place of the normal one.
    recorded_slope
        By how much a channel's mean recorded value moves with its level.
    """

    read: ReadNoise
    plot: ProbabilityPlot
    fixed: FixedPattern
    level_variances_dn2: Values
    if_laplace: Values
    recorded_slope: Values


class ClippedEquations:
    """The equations, to be solved; a point is (shape, ln scale, levels, variance of pattern, variance of rows)."""

    def __init__(self, seen: ClippedStatistics) -> None:
        self._seen = seen
        self._counts = seen.counts.sum(axis=0)
        self._number = self._counts.sum(axis=1)
        self._pixels = seen.pixels.sum(axis=0)
        of_rows = np.stack([np.bincount(row, minlength=len(self._number)) for row in seen.fixed.pattern])
        self._kinds = of_rows / of_rows.sum()  # share of the pixels by kind of rows, and channel
        self._offsets = np.zeros((len(self._number), 1))  # of the levels over the frame, equally frequent
        self._shading = np.zeros(seen.fixed.summary.shading_dn.shape)
        self._converged = False

    def solved(self) -> ClippedFit:
        at = self._solve(self._start())
        for _ in range(_PASSES if self._converged else 0):
            before = self._offsets
            self._solve_shading(at)
            if before.shape == self._offsets.shape and np.allclose(before, self._offsets, atol=_STEP):
                break
            at = self._solve(at)
        expected, noise = self._expected(at), self._noise(at)
        scores, slope = self._slopes(at, expected)
        equations = self._equations(expected, scores)
        inverse = np.linalg.pinv(slope)
        influence = -equations @ inverse.T
        groups = len(influence)
        covariance = influence.T @ influence * groups / (groups - 1)
        unlike = self._equations(self._expected(at, laplace), scores).sum(axis=0)
        plot = self._plot(noise, at)
        dsnu, dsnu_error = self._dsnu(noise, at)
        fixed = self._seen.fixed
        summary = replace(
            fixed.summary,
            dsnu_dn=tuple(dsnu.tolist()),
            dsnu_error_dn=tuple(dsnu_error.tolist()),
            shading_dn=self._shading,
        )
        return ClippedFit(
            read=self._read_noise(at, expected, covariance[:2, :2], plot, self._row_error(slope, covariance, at)),
            plot=plot,
            fixed=replace(fixed, level_dn=tuple(at[2:-2].tolist()), summary=summary),
            level_variances_dn2=np.diag(covariance)[2:-2],
            if_laplace=-(inverse @ unlike)[:-2],
            recorded_slope=np.array([slopes.mean() for slopes in self._recorded_slopes(noise, at)]),
        )

    def _read_noise(
        self, at: Values, expected: _Expected, covariance: Values, plot: ProbabilityPlot, row_error: float
    ) -> ReadNoise:
        """Return the figures of the fitted shape and scale. What takes residuals, PPCC, there is none of: ``nan``."""
        shape, scale = plot.shape, plot.slope_tukey_lambda_dn
        gauss = scale * math.sqrt(tukey_lambda_variance(shape))
        growth = math.log(tukey_lambda_variance(shape + _STEP) / tukey_lambda_variance(shape - _STEP)) / (4 * _STEP)
        slopes = np.array([growth, 1.0])  # of ln sigma_G by shape and ln scale
        errors = np.sqrt(np.diag(covariance))
        weights = np.exp(-0.5 * plot.normal**2)
        chi2, freedom = self._chi2(expected[0])
        return ReadNoise(
            tukey_lambda=shape,
            tukey_lambda_error=float(errors[0]),
            sigma_tl_dn=scale,
            sigma_tl_error_dn=float(errors[1]) * scale,
            sigma_gauss_dn=gauss,
            sigma_gauss_error_dn=gauss * math.sqrt(float(slopes @ covariance @ slopes)),
            r_squared_tl=_correlation(plot.tukey_lambda, plot.ordered_dn, weights) ** 2,
            r_squared_gauss=_correlation(plot.normal, plot.ordered_dn, weights) ** 2,
            chi2_per_dof=chi2,
            chi2_freedom=freedom,
            residuals=int(self._number.sum()),
            converged=self._converged,
            response=self._response(at, row_error),
        )

    def _start(self) -> Values:
        """Return a point to begin with: normal values through two quantiles of each channel."""
        from scipy.special import ndtri

        levels, sigmas = [], []
        for counts, number in zip(self._counts, self._number, strict=True):
            below = np.cumsum(counts)[:-1] / number  # of the start of each cell but the first
            low = min(int(np.searchsorted(below, 0.16)), below.size - 2)
            high = int(np.searchsorted(below, 1 - 0.2 * (1 - max(float(below[0]), 0.16))))
            high = min(max(high, low + 1), below.size - 1)
            z = ndtri(np.clip(below[[low, high]], 1e-6, 1 - 1e-6))
            edges = self._seen.starts[[low + 1, high + 1]] - 0.5
            sigmas.append((edges[1] - edges[0]) / max(z[1] - z[0], 1e-3))
            levels.append(edges[0] - z[0] * sigmas[-1])
        rows = max(float(self._seen.rows.sum() / self._seen.lines.sum()), 0.0)
        pattern = max(float(self._seen.products.sum() / self._pixels.sum()), 0.0)
        whole = float(np.mean(np.square(sigmas)))
        scale = math.sqrt(max(whole - rows - pattern, 0.1 * whole) / tukey_lambda_variance(0.0))
        return np.array([0.0, math.log(scale), *levels, pattern, rows])

    def _solve(self, at: Values) -> Values:
        """Return where the equations hold, by Newton's method; ``_converged``: whether it came to an end."""
        unit = np.ones(len(at))
        self._converged = False
        for _ in range(_MOST_STEPS):
            expected = self._expected(at)
            scores, slope = self._slopes(at, expected)
            move = -np.linalg.lstsq(slope, self._equations(expected, scores).sum(axis=0), rcond=1e-12)[0]
            scale = math.exp(float(at[1]))
            unit[2:] = scale
            unit[-2:] = scale**2
            size = float(np.abs(move / unit).max())
            if not math.isfinite(size):
                return at
            at = at + move * min(1.0, 0.25 / size)
            at[0] = min(max(float(at[0]), LOWEST + 0.01), HIGHEST)
            if size < 1e-4:
                self._converged = True
                return at
        return at

    # --- what is expected at a point ------------------------------------------------------------------------------

    def _noise(self, at: Values, reach_dn: float = 0.0) -> ClippedNoise:
        reach = reach_dn + 7 * math.sqrt(abs(at[-2]) + abs(at[-1]) + self._seen.drift_dn2) + 5 * math.exp(at[1])
        levels = at[2:-2, None] + self._offsets
        return ClippedNoise(
            float(at[0]), math.exp(float(at[1])), float(levels.min()) - reach, float(levels.max()) + reach
        )

    def _expected(self, at: Values, pattern: Callable[[float], Nodes] = normal) -> _Expected:
        """Return (channels, cells); recorded variance of the pixels' levels, by channel, and of rows."""
        noise = self._noise(at)
        return self._cells(noise, at, pattern), *self._variances(noise, at, pattern)

    def _cells(self, noise: ClippedNoise, at: Values, pattern: Callable[[float], Nodes]) -> Values:
        rest = float(at[-1]) + self._seen.drift_dn2
        if pattern is not normal:
            return self._cells_with(noise, at, summed(pattern(float(at[-2])), normal(rest)))
        found = self._cells_with(noise, at, normal(rest + float(at[-2])))
        if rest + float(at[-2]) < 0:  # chance has put it below 0: as far to the other side
            found = 2 * self._cells_with(noise, at, normal(0.0)) - found
        return np.maximum(found, 1e-9)

    def _cells_with(self, noise: ClippedNoise, at: Values, others: Nodes) -> Values:
        cells = []
        for level, offsets in zip(at[2:-2], self._offsets, strict=True):
            tails = noise.tails(self._seen.starts[1:] - 0.5 - level, summed(self._even(offsets), others))
            cells.append(-np.diff(tails, prepend=1.0, append=0.0))
        return np.maximum(np.stack(cells), 1e-9)

    @staticmethod
    def _even(offsets: Values) -> Nodes:
        return offsets, np.full(offsets.size, 1 / offsets.size)

    def _variances(self, noise: ClippedNoise, at: Values, pattern: Callable[[float], Nodes]) -> tuple[Values, float]:
        """Return the recorded variance of the pixels' levels by channel, and of the rows' offsets."""
        others, rows = pattern(float(at[-2])), normal(float(at[-1]))
        over_time = normal(max(float(at[-1]) + self._seen.drift_dn2, 0.0))
        of_pixels, of_offsets = [], []
        for level, offsets in zip(at[2:-2], self._offsets, strict=True):
            values, chances = summed(self._even(offsets), others)
            found = float(variance(noise.recorded(level + values, over_time), chances))
            if at[-2] < 0:
                found = 2 * float(variance(noise.recorded(level + offsets, over_time), self._even(offsets)[1])) - found
            of_pixels.append(found)
            of_offsets.append(noise.recorded(np.add.outer(level + rows[0], values)) @ chances)
        of_kinds = self._kinds / self._kinds.sum(axis=1, keepdims=True) @ np.stack(of_offsets)
        of_rows = float(self._kinds.sum(axis=1) @ variance(of_kinds, rows[1]))
        return np.array(of_pixels), math.copysign(of_rows, at[-1])

    def _equations(self, expected: _Expected, scores: Values) -> Values:
        """Return what each group adds to the equations, (groups, 4 + channels): all sums are to be 0."""
        seen, (cells, pattern, rows) = self._seen, expected
        rest = seen.counts - seen.counts.sum(axis=2, keepdims=True) * cells
        return np.column_stack(
            [
                np.einsum("pcj,gcj->gp", scores, rest, optimize=True),
                (seen.products - seen.pixels * pattern).sum(axis=1),
                seen.rows - seen.lines * rows,
            ]
        )

    def _slopes(self, at: Values, expected: _Expected) -> tuple[Values, Values]:
        """Return the scores, (2 + channels, channels, cells), and the derivatives of the equations' sums."""
        scale = math.exp(float(at[1]))
        steps = _STEP * np.array([1.0, 1.0, *[scale] * (len(at) - 4), scale**2, scale**2])
        beside = [self._expected(at + step) for step in np.diag(steps)]
        cells, pattern, rows = (
            np.stack([(there - here) / step for there, step in zip(of_all, steps, strict=True)])
            for of_all, here in zip(zip(*beside, strict=True), expected, strict=True)
        )
        scores = cells[:-2] / expected[0]
        slope = np.concatenate(
            [
                np.einsum("pcj,qcj,c->pq", scores, cells, self._number, optimize=True),
                (pattern @ self._pixels)[None],
                (rows * self._seen.lines.sum())[None],
            ]
        )
        return scores, -slope

    # --- what follows from a solution -----------------------------------------------------------------------------

    def _within(self, noise: ClippedNoise, at: Values, channel: int) -> tuple[Values, Values]:
        """Return levels around a channel's, and what neighbourhoods of such a level record on average."""
        spread = 4 * noise.sigma + 2 * math.sqrt(abs(at[-2]) + abs(at[-1]))
        levels = np.linspace(at[2 + channel] - spread, at[2 + channel] + spread, 400)
        around = normal(max(float(at[-2] + at[-1]) + self._seen.drift_dn2, 0.0))
        return levels, noise.recorded(levels, around)

    def _recorded_slopes(self, noise: ClippedNoise, at: Values) -> Iterator[Values]:
        """Yield, for each channel, by how much the mean recorded value moves with the levels over the frame."""
        for channel, level in enumerate(at[2:-2]):
            levels, recorded = self._within(noise, at, channel)
            yield np.interp(level + self._offsets[channel], levels, np.gradient(recorded, levels))

    def _solve_shading(self, at: Values) -> None:
        """Find the levels of blocks that record what the frames' blocks do, the scatter by noise taken off."""
        fixed, noise = self._seen.fixed, self._noise(at)
        slopes = [float(of_channel.mean()) for of_channel in self._recorded_slopes(noise, at)]
        for channel, shading in enumerate(fixed.summary.shading_dn):
            levels, recorded = self._within(noise, at, channel)
            found = np.interp(shading + fixed.level_dn[channel], recorded, levels)
            found -= found.mean()
            by_noise = (fixed.shading_error_dn[channel] / slopes[channel]) ** 2
            self._shading[channel] = found * math.sqrt(max(1 - by_noise / max(float(found.var()), 1e-300), 0.0))
        ordered = np.sort(self._shading.reshape(len(self._shading), -1), axis=1)
        parts = np.array_split(ordered, min(_LEVEL_NODES, ordered.shape[1]), axis=1)
        nodes = np.stack([part.mean(axis=1) for part in parts], axis=1)
        self._offsets = nodes if float(nodes.std()) > _EVEN * noise.sigma else np.zeros((len(nodes), 1))

    def _dsnu(self, noise: ClippedNoise, at: Values) -> tuple[Values, Values]:
        """Return the standard deviations of levels inside blocks that record what is seen, and their errors."""
        over_time = normal(max(float(at[-1]) + self._seen.drift_dn2, 0.0))
        grid = np.linspace(0.0, 2 * math.sqrt(max(float(at[-2]), 0.0)) + noise.sigma, 80)
        summary = self._seen.fixed.summary
        found, errors = [], []
        for level, offsets, dsnu, error in zip(
            at[2:-2], self._offsets, summary.dsnu_dn, summary.dsnu_error_dn, strict=True
        ):
            seen = np.zeros(grid.size)
            for index, one in enumerate(grid):
                values, chances = normal(one**2)
                seen[index] = math.sqrt(
                    float(variance(noise.recorded(np.add.outer(level + offsets, values), over_time), chances).mean())
                )
            found.append(float(np.interp(dsnu, seen, grid)))
            errors.append(float(np.interp(dsnu + error, seen, grid)) - found[-1])
        return np.array(found), np.array(errors)

    def _row_error(self, slope: Values, covariance: Values, at: Values) -> float:
        """Return the relative error of sigma_row by what is not known of the rest.

        The response is that of an average row. Where levels vary from row to row, the rows' responses do, too, and the
        mean of their squares, which the rows' variance follows, is above the square of their mean.
        """
        by_rest = -slope[-1, :-1] / slope[-1, -1]
        error = math.sqrt(float(by_rest @ covariance[:-1, :-1] @ by_rest)) / (2 * max(float(at[-1]), 1e-300))
        squares = [
            float((slopes**2).mean() / slopes.mean() ** 2) for slopes in self._recorded_slopes(self._noise(at), at)
        ]
        return math.hypot(error, math.sqrt(float(np.mean(squares))) - 1) if at[-1] > 0 else 0.0

    def _response(self, at: Values, relative_error: float) -> OffsetResponse:
        scale = math.exp(float(at[1]))
        reach = 5 * max(4 * math.sqrt(max(float(at[-1]), 0.0)), scale)
        noise = self._noise(at, reach)
        nodes = np.linspace(-reach, reach, 801)
        pattern = normal(max(float(at[-2]), 0.0))
        seen = []
        for level, offsets in zip(at[2:-2], self._offsets, strict=True):
            values, chances = summed(self._even(offsets), pattern)
            seen.append(noise.recorded(np.add.outer(level + nodes, values)) @ chances)
        of_kinds = self._kinds / self._kinds.sum(axis=1, keepdims=True) @ np.stack(seen)
        at_0 = of_kinds[:, nodes.size // 2]
        return OffsetResponse(nodes, of_kinds - at_0[:, None], self._kinds.sum(axis=1), relative_error)

    def _chi2(self, cells: Values) -> tuple[float, int]:
        """Return chi^2 per degree of freedom and these, for counts that scatter as they do between groups.

        Values of one pixel, and of one row, share an offset, so that counts scatter by more than independent ones.
        With V their covariance over what independent counts scatter by, the sum of squares is on average tr V, and has
        (tr V)^2 / tr V^2 degrees of freedom (Satterthwaite).
        """
        expected = cells * self._number[:, None]
        kept = expected >= _EXPECTED
        of_groups = self._seen.counts.sum(axis=2) / self._number
        scatter = (self._seen.counts - of_groups[..., None] * self._counts)[:, kept] / np.sqrt(expected[kept])
        groups = len(scatter)
        gram = scatter @ scatter.T * (groups / (groups - 1))
        own = np.diag(gram)
        trace = float(own.sum())
        squares = float((gram**2).sum() - (own**2).sum())  # products of two groups: without their own noise's squares
        freedom = max(1.0, trace**2 / max(squares, 1e-300))
        statistic = float((((self._counts - expected)[kept]) ** 2 / expected[kept]).sum())
        return statistic / trace, round(min(freedom, float(np.count_nonzero(kept))))

    def _plot(self, noise: ClippedNoise, at: Values) -> ProbabilityPlot:
        from scipy.special import ndtr, ndtri

        number = float(self._number.sum())
        zeros = float((self._counts[:, 0] / self._number).max())
        reach = -float(ndtri(min(100 / number, 0.1)))
        lowest = max(float(ndtri(min(zeros + 0.01, 0.97))), -reach)
        plotted = np.linspace(lowest, reach, PLOT_POINTS)
        levels = ndtr(plotted)
        around = normal(max(float(at[-2] + at[-1]) + self._seen.drift_dn2, 0.0))
        grid = np.sinh(np.linspace(-5, 5, 2001)) * noise.sigma
        found, fitted = [], []
        for level, offsets, counts, total in zip(at[2:-2], self._offsets, self._counts, self._number, strict=True):
            found.append(np.interp(levels, np.cumsum(counts)[:-1] / total, self._seen.starts[1:] - 0.5) - level)
            fitted.append(
                np.interp(1 - levels, noise.tails(grid, summed(self._even(offsets), around))[::-1], grid[::-1])
            )
        quantiles, fitted_quantiles = np.mean(found, axis=0), np.mean(fitted, axis=0)
        weights, scale = np.exp(-0.5 * plotted**2), math.exp(float(at[1]))
        return ProbabilityPlot(
            ordered_dn=quantiles,
            normal=plotted,
            tukey_lambda=fitted_quantiles / scale,
            shape=float(at[0]),
            slope_normal_dn=float(weights @ (quantiles * plotted) / (weights @ plotted**2)),
            slope_tukey_lambda_dn=scale,
        )


def _correlation(first: Values, second: Values, weights: Values) -> float:
    one, two = (values - np.average(values, weights=weights) for values in (first, second))
    return float(weights @ (one * two) / math.sqrt(float(weights @ one**2) * float(weights @ two**2)))
