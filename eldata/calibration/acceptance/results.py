"""What the acceptance test of a noise model found: one verdict a statistic, on the same frames for every model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.tables import text_table
from eldata.calibration.acceptance.verdicts import LIMIT, TheoryCheck

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

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
    x: NDArray[np.float64] = field(repr=False)
    frames: NDArray[np.float64] = field(repr=False)
    model: NDArray[np.float64] = field(repr=False)


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
            (
                "" if index else check,
                one.symbol,
                one.unit,
                *one.cells()[:4],
                f"{one.held_out}, {one.simulated}",
                one.verdict,
            )
            for check, group in groupby(self.statistics, lambda one: one.check)
            for index, one in enumerate(group)
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
