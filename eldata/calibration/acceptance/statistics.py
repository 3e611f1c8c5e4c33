"""The numbers of many pairs on both sides, as the statistics that get a verdict each."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.acceptance.pairs import LAGS, distance, same_pattern, same_sizes, tail_share, tail_threshold
from eldata.calibration.acceptance.results import Curve, FrameStatistic
from eldata.calibration.acceptance.verdicts import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.acceptance.pairs import FrameScale, PairFigures

    Plane = NDArray[np.float32]

_TAILS = (0.01, 0.001, 0.0001)
_FEWEST_IN_A_TAIL = 20  # values of a pair: a mean of fewer is not one of many

_DARK = (
    ("drift", ("level", "from frame to frame", "DN")),
    ("frame sigma", ("one frame", "standard deviation", "DN")),
    ("frame skewness", ("one frame", "skewness", "1")),
    ("frame KS", ("one frame", "distance of values (KS)", "1")),
    ("sigma", ("difference of two", "standard deviation", "DN")),
    ("KS", ("difference of two", "distance of values (KS)", "1")),
    ("row halves", ("rows", "shared by left and right half", "DN^2")),
    ("row colours", ("rows", "shared by their colours", "DN^2")),
    *((f"row {band}", ("rows", f"spectrum, {band} frequencies", "dB")) for band in ("low", "middle", "high")),
    ("column halves", ("columns", "shared by upper and lower half", "DN^2")),
    *((f"column {band}", ("columns", f"spectrum, {band} frequencies", "dB")) for band in ("low", "middle", "high")),
    *((f"lag {y} {x}", ("neighbours", f"correlation {y} down, {x} across", "1")) for y, x in LAGS),
    ("pattern", ("fixed pattern", "energy", "DN^2")),
    ("pattern columns", ("fixed pattern", "energy of columns", "DN^2")),
    ("pattern rows", ("fixed pattern", "energy of rows", "DN^2")),
    ("pattern shading", ("fixed pattern", "energy of shading", "DN^2")),
    ("same pattern", ("fixed pattern", "energy in common with the model's", "DN^2")),
    ("hot", ("fixed pattern", "share of hot pixels", "1")),
)
_SIZES = ("pixels", "unlike in noise (telegraph)", "1")
_FLAT = (
    ("transfer", ("variance over mean", "DN")),
    ("KS", ("distance of values (KS)", "1")),
    ("row halves", ("shared by halves of a row", "DN^2")),
    ("pattern", ("fixed pattern over signal^2", "1")),
)


@dataclass(slots=True)
class PairNumbers:
    """The numbers of one side's pairs.

    Attributes
    ----------
    units
        By pair, the numbers by name.
    fours
        By two pairs, the covariance of sizes.
    values, differences, row_power, column_power
        By pair (:class:`~eldata.calibration.acceptance.pairs.PairFigures`).
    """

    units: list[dict[str, float]] = field(default_factory=list)
    fours: list[float] = field(default_factory=list)
    values: list[NDArray[np.int64]] = field(default_factory=list)
    differences: list[NDArray[np.int64]] = field(default_factory=list)
    row_power: list[NDArray[np.float64]] = field(default_factory=list)
    column_power: list[NDArray[np.float64]] = field(default_factory=list)
    _odd: PairFigures | None = None

    def add(self, pair: PairFigures, pattern_dn: Plane | None = None) -> None:
        """Add a pair; its planes are let go of. ``pattern_dn`` is the reference's mean."""
        shared = {} if pattern_dn is None else {"same pattern": same_pattern(pair, pattern_dn)}
        self.units.append(pair.numbers | shared)
        self.values.append(pair.values)
        self.differences.append(pair.differences)
        self.row_power.append(pair.row_power_dn2)
        self.column_power.append(pair.column_power_dn2)
        if self._odd is None:
            self._odd = pair
        else:
            self.fours.append(same_sizes(self._odd, pair))
            self._odd = None

    def of(self, name: str) -> list[float]:
        """Return one of the numbers of every pair."""
        return [unit[name] for unit in self.units]


def dark_statistics(
    reference: PairNumbers, camera: PairNumbers, model: PairNumbers, values: int
) -> list[FrameStatistic]:
    """Return the statistics of bias frames; ``values`` is the number of pixels of a pair."""
    channels = sum(name.startswith("level") for name in camera.units[0])
    names = CHANNELS if channels == len(CHANNELS) else ("R", "G", "B")
    statistics = [
        FrameStatistic.of(("level", f"mean of {names[index]}", "DN"), *_both(camera, model, f"level {index}"))
        for index in range(channels)
    ]
    for side in (camera, model):
        _add_distances(side, reference, "values", "frame KS")
        _add_distances(side, reference, "differences", "KS")
    tails = _tails(camera, model, "values", (0.001,), (-1, 1), values)
    tails_of_difference = _tails(camera, model, "differences", _TAILS, (0,), values // 2)
    for name, named in _DARK:
        least = 2 / values if name == "hot" else 0.0
        statistics.append(FrameStatistic.of(named, *_both(camera, model, name), least))
        statistics += {"frame KS": tails, "KS": tails_of_difference}.get(name, [])
    if camera.fours:
        statistics.append(FrameStatistic.of(_SIZES, camera.fours, model.fours))
    return statistics


def flat_statistics(
    check: str, reference: PairNumbers, camera: PairNumbers, model: PairNumbers, values: int
) -> list[FrameStatistic]:
    """Return the statistics of flats of one exposure; ``values`` is the number of pixels."""
    for side in (camera, model):
        _add_distances(side, reference, "differences", "KS")
    tails = [replace(tail, check=check) for tail in _tails(camera, model, "differences", _TAILS[:2], (0,), values)]
    statistics = []
    for name, named in _FLAT:
        statistics.append(FrameStatistic.of((check, *named), *_both(camera, model, name)))
        statistics += tails if name == "KS" else []
    return statistics


def _both(camera: PairNumbers, model: PairNumbers, name: str) -> tuple[list[float], list[float]]:
    return camera.of(name), model.of(name)


def _add_distances(side: PairNumbers, reference: PairNumbers, kind: str, name: str) -> None:
    counts = np.sum(getattr(reference, kind), axis=0)
    shares = counts / counts.sum()
    for unit, own in zip(side.units, getattr(side, kind), strict=True):
        unit[name] = distance(own, shares)


def _tails(
    camera: PairNumbers, model: PairNumbers, kind: str, wanted: Sequence[float], sides: Sequence[int], values: int
) -> list[FrameStatistic]:
    """Compare the shares beyond thresholds that both sides' distributions, weighed alike, put a share beyond."""
    shares = [np.mean([own / own.sum() for own in getattr(side, kind)], axis=0) for side in (camera, model)]
    both = (shares[0] + shares[1]) / 2
    check = "one frame" if kind == "values" else "difference of two"
    statistics = []
    for share in wanted:
        if share * values < _FEWEST_IN_A_TAIL:
            continue
        for side in sides:
            threshold = tail_threshold(both, share, side)
            symbol = {-1: f"share below -{threshold} DN", 0: f"share beyond {threshold} DN"}.get(
                side, f"share above {threshold} DN"
            )
            found = [[tail_share(own, threshold, side) for own in getattr(one, kind)] for one in (camera, model)]
            # A count that is small is one of few values: it scatters by one at least.
            statistics.append(FrameStatistic.of((check, symbol, "1"), found[0], found[1], 1 / values))
    return statistics


def curves_of(camera: PairNumbers, model: PairNumbers, scale: FrameScale) -> tuple[Curve, ...]:
    """Return what the plots show: shares beyond a difference, and spectra of the lines."""
    beyond = []
    for side in (camera, model):
        counts = np.sum(side.differences, axis=0)
        middle = len(counts) // 2
        folded = counts[middle:] + np.where(np.arange(middle + 1) > 0, counts[middle::-1], 0)
        beyond.append(np.cumsum(folded[::-1])[::-1] / counts.sum())
    steps = np.arange(len(beyond[0]), dtype=np.float64) / (2**0.5 * scale.sigma_dn)
    curves = [Curve("tails", steps, *beyond)]
    for name, of in (("row-spectrum", "row_power"), ("column-spectrum", "column_power")):
        power = [np.mean(getattr(side, of), axis=0) for side in (camera, model)]
        lines = 2 * (len(power[0]) - 1)
        groups = np.array_split(np.arange(1, len(power[0]) - 1), min(24, max(1, (len(power[0]) - 2) // 4)))
        frequency = np.array([group.mean() / lines for group in groups])
        curves.append(Curve(name, frequency, *(np.array([of_side[g].mean() for g in groups]) for of_side in power)))
    return tuple(curves)
