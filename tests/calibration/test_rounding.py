"""What rounding does to residuals and row means, against plain simulations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats

from eldata.calibration.core._rounding import LevelFractions, RoundedResiduals
from eldata.calibration.core._tukey_lambda import ResidualModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAMES, ROWS, COLUMNS = 5, 400, 1000


@pytest.mark.parametrize(
    ("shape", "deviation", "level", "dsnu", "sigma_row"),
    [
        (-0.2, 0.75, 0.0, 0.0, 0.0),
        (-0.2, 0.5, 0.3, 0.3, 0.2),
        (0.1, 0.3, 0.5, 0.0, 0.05),
        (-0.2, 0.3, 0.0, 1.0, 0.3),
        (-0.2, 0.3, 0.2, 0.0, 3.0),
    ],
)
def test_the_distribution_is_that_of_simulated_residuals(
    shape: float, deviation: float, level: float, dsnu: float, sigma_row: float
) -> None:
    """Two million residuals. chi^2 over some 20 lattice points was 40 to 200,000 with independent uniform rounding.

    The residuals of a row share its offsets, so counts scatter by more than their roots: up to 18 times, in chi^2. What
    is left is weighed by the scatter of the 400 rows too (Hotelling's T^2), where chance passes once in 100,000.
    """
    generator = np.random.default_rng(15)
    scale = deviation / float(stats.tukeylambda(shape).std())
    levels = level + dsnu * generator.standard_normal((ROWS, COLUMNS))
    noise = scale * stats.tukeylambda.ppf(generator.random((FRAMES, ROWS, COLUMNS)), shape)
    offsets = sigma_row * generator.standard_normal((FRAMES, ROWS, 1))
    recorded = np.rint(levels + offsets + noise).astype(np.int64)
    total = recorded.sum(axis=0)
    scaled = FRAMES * recorded - total
    seen = scaled.mean(axis=2, keepdims=True)
    residuals = np.abs(scaled - np.rint(seen).astype(np.int64))

    own = recorded - recorded.mean(axis=0)
    pixel_variance = (own - own.mean(axis=2, keepdims=True)).var() / (1 - 1 / FRAMES) / (1 - 1 / COLUMNS)
    fractions = LevelFractions(
        remainders=np.bincount(total.ravel() % FRAMES, minlength=FRAMES)[None, None],
        local_levels=np.bincount([round(float(recorded.mean()) * 128) % 128], minlength=128)[None].astype(float),
        dsnu_dn=np.array([dsnu]),
        rows=np.ones((1, 1)),
        offset_variance_dn2=float((seen / FRAMES).var()) - pixel_variance * (1 - 1 / FRAMES) / COLUMNS,
        pixel_variance_dn2=pixel_variance,
    )
    rounded = RoundedResiduals(FRAMES, COLUMNS, fractions).at(shape, scale)
    edges = np.maximum(np.arange(61) - 0.5, 0.0) / FRAMES
    plain = ResidualModel(FRAMES, COLUMNS, 1.0)
    independent = plain.probabilities(edges, shape, scale)[:-1]
    observed = np.bincount(residuals.ravel(), minlength=60)[:60]

    def chi2(probabilities: NDArray[np.floating[Any]]) -> float:
        expected = probabilities * residuals.size
        kept = expected >= 25
        return float(((observed[kept] - expected[kept]) ** 2 / expected[kept]).mean())

    change = np.zeros(60)
    change[: min(60, rounded.change.size)] = rounded.change[:60]
    assert chi2(independent) > 25
    assert chi2(independent + change) < 12
    counted = (independent + change) * residuals[:, 0].size >= 5  # of a row, so that its counts are nearly normal
    by_row = np.stack(
        [np.bincount(row, minlength=60)[:60][counted] for row in residuals.swapaxes(0, 1).reshape(ROWS, -1)]
    )
    off = by_row.mean(axis=0) - (independent + change)[counted] * residuals[:, 0].size
    points = len(off)
    weighed = ROWS * off @ np.linalg.solve(np.cov(by_row.T), off) * (ROWS - points) / (points * (ROWS - 1))
    assert weighed < stats.f.isf(1e-5, points, ROWS - points)
    variance = float(((scaled - seen) / FRAMES).var())
    modelled = plain.own * (deviation**2 + 1 / 12) + rounded.variance_dn2
    assert modelled == pytest.approx(variance, rel=0.01)
    if sigma_row:
        found = rounded.response.sigma_dn(fractions.offset_variance_dn2 / (1 - 1 / FRAMES))
        assert found == pytest.approx(sigma_row, rel=6 / np.sqrt(2 * (FRAMES - 1) * ROWS) + 0.02)
