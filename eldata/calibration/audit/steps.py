"""The steps that recorded values go by, which of them never occur, and what rounding does to what checks are told."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core.findings import COARSE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from eldata.calibration.audit.bias_sums import BiasStatistics
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.read_noise import ReadNoise
    from eldata.calibration.core.row_noise import ColourBias, RowNoise

GAPS = 0.02
"""Share of DN values that never occur, from which on it is told."""

OF_LIGHTER_TAILS = 2.0
"""What is added to the noise makes its tails lighter: sigma_TL goes up by so many times sigma_G's share."""

_CENTRAL = (0.05, 0.95)
_FEW = 30  # occurrences per code, below which a gap may be chance
_COARSEST = 64  # DN: the largest step that is looked for
_STRAY = 1e-3  # of the differences: pixels that the camera has made up
_LEAST_SIGMA_STEPS = 0.1  # below, all is lost in rounding
_MANY_STEPS = 5  # above, a ripple is below one in a million


def missing_codes(mosaic: NDArray[np.uint16], pattern: NDArray[np.int64]) -> float:
    """Return the largest share, of any CFA site, of DN values that never occur though their neighbours do.

    A plain converter gives 0. Lossy compression by a curve leaves gaps in bright frames; multiplication after the
    conversion (the highest ISOs of some cameras, white balance) leaves them everywhere.
    """
    worst = 0.0
    period = len(pattern)
    for row in range(min(period, 2)):
        for column in range(min(period, 2)):
            counts = np.bincount(mosaic[row :: 2 * period, column::period].ravel())
            below = np.cumsum(counts)
            low, high = (int(np.searchsorted(below, share * int(below[-1]))) for share in _CENTRAL)
            inner = counts[low : high + 1]
            if inner.size < 8 or int(inner.sum()) < _FEW * inner.size:
                continue  # too few values, or too few of each, to tell a gap from chance
            worst = max(worst, float(np.count_nonzero(inner == 0)) / inner.size)
    return worst


def code_step(mosaic: NDArray[np.uint16], pattern: NDArray[np.int64]) -> int:
    """Return by how many DN the values of a bias frame step: 1, or 4 where 12 bits are stored as 14.

    Pixels of one column and CFA site, one period apart, differ by noise; all but one in a thousand of the differences
    are multiples of the step. Where fewer than a thousand differ, it is not known, and 1.
    """
    period = 2 * len(pattern)
    step = max(1, mosaic.shape[0] * mosaic.shape[1] // 2_000_000)
    block = mosaic[:, : mosaic.shape[1] // step].astype(np.int32)
    counts = np.bincount(np.abs(block[period:] - block[:-period]).ravel())
    counts[0] = 0
    changed = int(counts.sum())
    if changed < 1000:
        return 1
    multiples = (int(counts[::size].sum()) for size in range(_COARSEST, 0, -1))
    return next(
        size for size, kept in zip(range(_COARSEST, 0, -1), multiples, strict=True) if kept >= (1 - _STRAY) * changed
    )


@dataclass(frozen=True, slots=True)
class Ripple:
    """What rounding does to noise: how far its figures ripple as the mean goes from one step of the values to the next.

    Peak to peak: ``mean`` (of the values less the true one, in their standard deviations), ``variance`` and ``size``
    (the mean distance of two values) as shares of their means, and ``skewness``. They fall off exponentially with the
    noise: at 1 DN all are below a thousandth.
    """

    mean: float
    variance: float
    size: float
    skewness: float

    @classmethod
    def of(cls, shape: float, sigma_steps: float) -> Ripple:
        """Work it out for a Tukey-lambda distribution of this shape, and scale in steps of the values."""
        from eldata.calibration.core._tukey_lambda import smoothed_tails

        if not sigma_steps > _LEAST_SIGMA_STEPS:
            return cls(math.inf, math.inf, math.inf, math.inf)
        if sigma_steps > _MANY_STEPS:
            return cls(0.0, 0.0, 0.0, 0.0)
        values = np.arange(-math.ceil(20 + 30 * sigma_steps), math.ceil(20 + 30 * sigma_steps) + 1)
        figures = []
        for mean in np.arange(16) / 16:
            edges = np.append(values - 0.5, values[-1] + 0.5) - mean
            chances = -np.diff(smoothed_tails(edges, shape, sigma_steps, np.zeros(1), np.ones(1)))
            level = float(chances @ values)
            variance = float(chances @ (values - level) ** 2)
            distances = np.abs(np.arange(2 * values[0], 2 * values[-1] + 1))
            cubes = np.clip((values - level) / math.sqrt(max(variance, 1e-12)), -8, 8) ** 3
            figures.append(
                (level - mean, variance, float(np.convolve(chances, chances[::-1]) @ distances), float(chances @ cubes))
            )
        table = np.array(figures)
        typical, ripple = table.mean(axis=0), np.ptp(table, axis=0)
        mean, variance, size = ripple[:3] / (math.sqrt(typical[1]), typical[1], typical[2])
        return cls(float(mean), float(variance), float(size), float(ripple[3]))


@dataclass(frozen=True, eq=False)
class BiasSeen:
    """What the checks of bias frames are told.

    Attributes
    ----------
    statistics
        What :class:`~eldata.calibration.audit.bias_sums.BiasAudit` has summed up.
    bias, rows, read
        The figures from the same frames, with their errors: a finding that matters less is a remark.
    step, gaps
        What :func:`code_step` and :func:`missing_codes` say of a frame.
    is_clipped
        Whether values end at 0. The clip makes noise smaller where the level is lower, and goes for one side alone, so
        that neither tells of light, unlike pixels or lopsided noise.
    gain_dn_per_e
        K, if it is known: dark current makes the variance grow by it with each DN, and two levels by what they like.
    """

    statistics: BiasStatistics
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise
    step: int = 1
    gaps: float = 0.0
    is_clipped: bool = False
    gain_dn_per_e: float | None = None

    @cached_property
    def ripple(self) -> Ripple:
        """What rounding does to the noise."""
        return Ripple.of(self.read.tukey_lambda, self.read.sigma_tl_dn / self.step_dn)

    @property
    def step_dn(self) -> float:
        """How far recorded values lie apart in the mean."""
        return self.step if self.step > 1 else 1 / (1 - self.gaps)

    @property
    def read_error(self) -> float:
        """The smallest relative error among the figures of the read noise."""
        read = self.read
        of_scales = read.sigma_tl_error_dn / read.sigma_tl_dn, read.sigma_gauss_error_dn / read.sigma_gauss_dn
        return min(read.tukey_lambda_error, *of_scales)


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
    share = OF_LIGHTER_TAILS * (1 - math.sqrt(max(1 - added / max(seen.read.sigma_gauss_dn, 1e-12) ** 2, 0.0)))
    yield from COARSE.judged(size, 1 / (1 - GAPS), text, {"read noise": (share, seen.read_error)})
