"""What of a calibration is drawn: the scales over the gain with their lines, as pages and figures have them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.core.findings import Figure, GivenFigure
    from eldata.calibration.joint import FittedMode, LogLogEstimate
    from eldata.noise.gain_modes import GainMode
    from eldata.plots.gains import Point


@dataclass(frozen=True, slots=True)
class ScalePanel:
    """The scale of one component over K.

    Attributes
    ----------
    name, figure
        Index of its sigma, and the figure that is withheld with it.
    lines
        The fitted ones, with their gain modes.
    points
        K, scale and its standard error where both are given and a logarithmic axis can show them; never empty.
    """

    name: str
    figure: Figure
    lines: tuple[tuple[GainMode, LogLogEstimate], ...]
    points: tuple[Point, ...]

    @property
    def spans(self) -> list[tuple[LogLogEstimate, float, float]]:
        """The lines, each with the lowest and the highest gain of its mode's points."""
        spans = []
        for mode, line in self.lines:
            inside = [gain for gain, _, _ in self.points if mode.distance(gain) == 0]
            spans.append((line, min(inside), max(inside)))
        return spans


def scale_panel(
    name: str,
    figure: Figure,
    lines: Sequence[tuple[FittedMode, LogLogEstimate | None]],
    scales: Sequence[tuple[float | None, GivenFigure | None]],
) -> ScalePanel | None:
    """Return what is drawn of the given gains and scales; ``None`` if nothing can be."""
    points = tuple(
        (gain, scale.value, scale.error)
        for gain, scale in scales
        if gain is not None and scale is not None and 0 < scale.value < math.inf
    )
    fitted = tuple((one.mode, line) for one, line in lines if line is not None)
    return ScalePanel(name, figure, fitted, points) if points else None
