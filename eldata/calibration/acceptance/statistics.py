"""The numbers of many pairs on both sides, as the statistics that get a verdict each."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.acceptance.pairs import (
    FLAT_KS,
    FRAME_KS,
    HOT,
    KS,
    SAME_PATTERN,
    distance,
    same_pattern,
    same_sizes,
    tail_share,
    tail_threshold,
)
from eldata.calibration.acceptance.results import Curve, FrameStatistic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.acceptance.pairs import Name, PairFigures, PairScale

    Plane = NDArray[np.float32]

_TAILS = (0.01, 0.001, 0.0001)
_FEWEST_IN_A_TAIL = 20  # values of a pair: a mean of fewer is not one of many
_SIZES = ("pixels", "unlike in noise (telegraph)", "1")
_KINDS = {FRAME_KS: "values", KS: "differences", FLAT_KS: "differences"}


@dataclass(slots=True)
class PairNumbers:
    """The numbers of one side's pairs, without their planes; ``fours``: by two pairs, the covariance of sizes."""

    pairs: list[PairFigures] = field(default_factory=list)
    fours: list[float] = field(default_factory=list)
    _odd: Plane | None = None

    def add(self, pair: PairFigures, pattern_dn: Plane | None = None) -> None:
        """Add a pair, whose planes are let go of. ``pattern_dn`` is the reference's mean."""
        if pattern_dn is not None and SAME_PATTERN in pair.numbers:
            pair.numbers[SAME_PATTERN] = same_pattern(pair.mean_dn, pattern_dn)
        if self._odd is None:
            self._odd = pair.sizes_dn
        else:
            self.fours.append(same_sizes(self._odd, pair.sizes_dn))
            self._odd = None
        nothing = np.zeros((0, 0), np.float32)
        self.pairs.append(replace(pair, mean_dn=nothing, sizes_dn=nothing))

    def of(self, name: Name) -> list[float]:
        """Return one of the numbers of every pair."""
        return [pair.numbers[name] for pair in self.pairs]

    def counts(self, kind: str) -> list[NDArray[np.int64]]:
        """Return the counts of every pair's values, or of its differences."""
        return [getattr(pair, kind) for pair in self.pairs]


def frame_statistics(
    reference: PairNumbers, camera: PairNumbers, model: PairNumbers, pixels: int, flats: str = ""
) -> list[FrameStatistic]:
    """Return the statistics of pairs of frames of so many pixels; ``flats`` is the name of their check."""
    statistics: list[FrameStatistic] = []
    for name in camera.pairs[0].numbers:
        kind = _KINDS.get(name)
        if kind is not None:
            for side in (camera, model):
                _add_distances(side, reference, kind, name)
        least = 1 / pixels if name == HOT else 0.0
        statistics.append(FrameStatistic.of(name, camera.of(name), model.of(name), least))
        if name == FRAME_KS:
            statistics += _tails(camera, model, kind="values", wanted=(0.001,), sides=(-1, 1), values=2 * pixels)
        elif kind is not None:
            wanted = _TAILS[:2] if flats else _TAILS
            statistics += _tails(camera, model, kind="differences", wanted=wanted, sides=(0,), values=pixels)
    if flats:
        return [replace(one, check=flats) for one in statistics]
    if camera.fours:
        statistics.append(FrameStatistic.of(_SIZES, camera.fours, model.fours))
    return statistics


def _add_distances(side: PairNumbers, reference: PairNumbers, kind: str, name: Name) -> None:
    counts = np.sum(reference.counts(kind), axis=0)
    shares = counts / counts.sum()
    for pair, own in zip(side.pairs, side.counts(kind), strict=True):
        pair.numbers[name] = distance(own, shares)


def _tails(
    camera: PairNumbers, model: PairNumbers, *, kind: str, wanted: Sequence[float], sides: Sequence[int], values: int
) -> list[FrameStatistic]:
    """Compare the shares beyond thresholds that both sides' distributions, weighed alike, put a share beyond."""
    shares = [np.mean([own / own.sum() for own in side.counts(kind)], axis=0) for side in (camera, model)]
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
            found = [[tail_share(own, threshold, side) for own in one.counts(kind)] for one in (camera, model)]
            # A count that is small is one of few values: it scatters by one at least.
            statistics.append(FrameStatistic.of((check, symbol, "1"), found[0], found[1], 1 / values))
    return statistics


def curves_of(camera: PairNumbers, model: PairNumbers, scale: PairScale) -> tuple[Curve, ...]:
    """Return what the plots show: shares beyond a difference, and spectra of the lines."""
    beyond = []
    for side in (camera, model):
        counts = np.sum(side.counts("differences"), axis=0)
        middle = len(counts) // 2
        folded = counts[middle:] + np.where(np.arange(middle + 1) > 0, counts[middle::-1], 0)
        beyond.append(np.cumsum(folded[::-1])[::-1] / counts.sum())
    steps = np.arange(len(beyond[0]), dtype=np.float64) / (2**0.5 * scale.sigma_dn)
    curves = [Curve("tails", steps, *beyond)]
    for name, of in (("row-spectrum", "row_power_dn2"), ("column-spectrum", "column_power_dn2")):
        power = [np.mean([getattr(pair, of) for pair in side.pairs], axis=0) for side in (camera, model)]
        lines = 2 * (len(power[0]) - 1)
        groups = np.array_split(np.arange(1, len(power[0]) - 1), min(24, max(1, (len(power[0]) - 2) // 4)))
        frequency = np.array([group.mean() / lines for group in groups])
        curves.append(Curve(name, frequency, *(np.array([of_side[g].mean() for g in groups]) for of_side in power)))
    return tuple(curves)
