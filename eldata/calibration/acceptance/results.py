"""What the acceptance test of a noise model found: one verdict a statistic, on the same frames for every model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.tables import text_table
from eldata.calibration.acceptance.pairs import (
    FLAT_KS,
    FRAME_KS,
    HOT,
    KS,
    SAME_PATTERN,
    distance,
    shared_energy,
    tail_share,
    tail_threshold,
)
from eldata.calibration.acceptance.verdicts import LIMIT, TheoryCheck, table_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.acceptance.pairs import Name, PairFigures, PairScale
    from eldata.calibration.core._frames import Counts, Plane, Values
    from eldata.noise.parameters import NoiseParameters


COLUMNS = ("check", "statistic", "unit", "frames", "model", "s.e.", "dev. [s.e.]", "n", "verdict")


@dataclass(frozen=True, slots=True)
class FrameStatistic(TheoryCheck):
    """One number of the model's frames, ``found``, against the same number of the held-out frames, ``expected``.

    Attributes
    ----------
    held_out, simulated
        Numbers of independent values that were averaged: pairs of frames, or fours.
    """

    held_out: int
    simulated: int

    @classmethod
    def of(
        cls,
        named: tuple[str, str, str],
        held_out: Sequence[float],
        simulated: Sequence[float],
        least_scatter: float = 0.0,
    ) -> FrameStatistic:
        """Compare the numbers of a pairs of held-out frames with those of b pairs of the model's.

        If the model is right, all a + b are draws of one distribution, and their means differ by a standard error of
        s sqrt(1 / a + 1 / b). For s the greater of the two sides' own standard deviations is taken. With the model's
        alone, the deviation would follow Student's law of b - 1 degrees of freedom, for numbers that are means over
        many pixels; the greater one only makes deviations smaller, so false alarms stay below that law's: beyond 4
        standard errors 0.04 % at b = 32, 0.12 % at b = 16. And it lets the camera's own wandering, which a model may
        lack, count as the error that it is. ``least_scatter`` is known beforehand, such as a count's, of 1.
        """
        a, b = len(held_out), len(simulated)
        spreads = [float(np.std(values, ddof=1)) for values in (held_out, simulated) if len(values) > 1]
        error = max(*spreads, least_scatter) * math.sqrt(1 / a + 1 / b) if spreads else None
        return cls(*named, float(np.mean(held_out)), float(np.mean(simulated)), error, a, b)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """What a plot shows of both sides: ``x`` in ``x_unit``, and a curve each."""

    name: str
    x: Values = field(repr=False)
    frames: Values = field(repr=False)
    model: Values = field(repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class IsoAcceptance:
    """The verdicts at one ISO.

    Attributes
    ----------
    iso
        ISO speed.
    parameters, measured
        What the model was told of the exposure, and whether a profile's row has it as it was measured.
    bias_frames, flat_frames
        Numbers of held-out frames.
    shape
        Rows and columns that are compared.
    statistics
        One after the other.
    curves
        For the plots: tails of the differences, spectra of rows and columns.
    remarks
        What a reader should know, such as frames that were left out.
    """

    iso: float
    parameters: NoiseParameters
    measured: bool
    bias_frames: int
    flat_frames: int
    shape: tuple[int, int]
    statistics: tuple[FrameStatistic, ...]
    curves: tuple[Curve, ...] = field(repr=False)
    remarks: tuple[str, ...] = ()

    @property
    def off(self) -> tuple[FrameStatistic, ...]:
        """The statistics that the model misses."""
        return tuple(one for one in self.statistics if one.verdict == "off")

    @property
    def frames(self) -> str:
        """What was compared, in words."""
        size = f"{self.shape[0]} x {self.shape[1]} pixels compared"
        return f"{self.bias_frames} bias frames and {self.flat_frames} flats held out, {size}"

    @property
    def missed(self) -> tuple[str, ...]:
        """The checks in which the model misses a statistic, in order."""
        return tuple(dict.fromkeys(one.check for one in self.off))

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells of the table, as :data:`COLUMNS` names them."""
        return [
            (*cells[:-1], f"{one.held_out}, {one.simulated}", one.verdict)
            for one, cells in zip(self.statistics, table_rows(self.statistics), strict=True)
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return all but the curves as plain types."""
        return {
            "iso": self.iso,
            "parameters": self.parameters.as_dict(),
            "parameters_as_measured": self.measured,
            "bias_frames": self.bias_frames,
            "flat_frames": self.flat_frames,
            "shape": list(self.shape),
            "ok": not self.off,
            "missed": list(self.missed),
            "statistics": [one.as_dict() for one in self.statistics],
            "remarks": list(self.remarks),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """What :func:`~eldata.calibration.acceptance.comparison.check_noise` found.

    Attributes
    ----------
    camera, model
        Whose frames, and what the model calls itself.
    seed, pairs
        Seed of the model's frames, and how many pairs of them were compared with each kind of held-out frames.
    isos
        By ISO, ascending.
    """

    camera: str
    model: str
    seed: int
    pairs: int
    isos: tuple[IsoAcceptance, ...]

    @property
    def off(self) -> tuple[FrameStatistic, ...]:
        """The statistics that the model misses, at all ISOs."""
        return tuple(statistic for one in self.isos for statistic in one.off)

    @property
    def summary(self) -> str:
        """The outcome in one sentence."""
        total = sum(len(one.statistics) for one in self.isos)
        if not self.off:
            return f"all {total} statistics within {LIMIT:g} standard errors of the held-out frames"
        missed = dict.fromkeys(
            "flats" if check.startswith("flats") else check for one in self.isos for check in one.missed
        )
        return (
            f"{len(self.off)} of {total} statistics off by more than {LIMIT:g} standard errors, in: {', '.join(missed)}"
        )

    def format_text(self) -> str:
        """Return the tables as text."""
        lines = []
        for one in self.isos:
            lines += [
                f"ISO {one.iso:g}: {one.frames}",
                *(f"  {remark}" for remark in one.remarks),
                "",
                text_table(COLUMNS, one.rows(), left=(0, 1, 2, 8)),
                "",
            ]
        return "\n".join([*lines, self.summary])

    def as_dict(self) -> dict[str, Any]:
        """Return camera, model and verdicts as plain types."""
        return {
            "camera": self.camera,
            "model": self.model,
            "seed": self.seed,
            "model_pairs": self.pairs,
            "limit_standard_errors": LIMIT,
            "ok": not self.off,
            "isos": [one.as_dict() for one in self.isos],
        }


# --- numbers of many pairs --------------------------------------------------------------------------------------------

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
            pair.numbers[SAME_PATTERN] = shared_energy(pair.mean_dn, pattern_dn)
        if self._odd is None:
            self._odd = pair.sizes_dn
        else:
            self.fours.append(shared_energy(self._odd, pair.sizes_dn))
            self._odd = None
        nothing = np.zeros((0, 0), np.float32)
        self.pairs.append(replace(pair, mean_dn=nothing, sizes_dn=nothing))

    def of(self, name: Name) -> list[float]:
        """Return one of the numbers of every pair."""
        return [pair.numbers[name] for pair in self.pairs]

    def counts(self, kind: str) -> list[Counts]:
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
