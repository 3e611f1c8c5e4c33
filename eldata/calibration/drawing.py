"""What of a calibration is drawn: the scales over the gain with their lines, on pages too; and its own figure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.calibration.core.figures import SCALES
from eldata.calibration.iso_results import usual_gain_per_iso
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes

    from eldata.calibration.core.findings import Figure
    from eldata.calibration.iso_results import IsoCalibration, IsoGain
    from eldata.calibration.joint import FittedMode, LogLogEstimate
    from eldata.noise.gain_modes import GainMode
    from eldata.plots.axes import Drawing, Theme
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


def scale_panels(modes: Sequence[FittedMode], isos: Sequence[IsoCalibration]) -> tuple[ScalePanel, ...]:
    """Return the scales over K that can be drawn: of the read noise by either model, and of the row noise."""
    panels = []
    for scale in SCALES:
        known = ((one.gain_dn_per_e, scale.given(one)) for one in isos)
        points = tuple(
            (gain, found.value, found.error)
            for gain, found in known
            if gain is not None and found is not None and 0 < found.value < math.inf
        )
        lines = ((one.mode, one.estimate(scale)) for one in modes)
        if points:
            drawn = tuple((mode, line) for mode, line in lines if line is not None)
            panels.append(ScalePanel(scale.label.removeprefix("sigma_"), scale.basis or "read noise", drawn, points))
    return tuple(panels)


def calibration_figure(
    camera: str, isos: Sequence[IsoGain], panels: Sequence[ScalePanel], iso: float | None
) -> Drawing:
    """Draw what was found, an axes each: photon transfer at an ISO, by default the middle one; K; scales over K."""
    from eldata.plots.axes import drawn_grid, nothing_to_draw
    from eldata.plots.gains import bar, gain_over_iso, iso_axis, scale_over_gain, transfer_lines

    transfers = {one.iso: (one.channels, one.transfer) for one in isos if one.transfer is not None}
    known = sorted(transfers)
    if iso is not None and iso not in transfers:
        listed = ", ".join(f"{one:g}" for one in known) or "none"
        raise ArgumentError(f"no photon transfer was measured at ISO {iso:g}; ISOs with one: {listed}")
    draws: list[tuple[str, Callable[[Axes, Theme], object]]] = []
    if known:
        chosen = known[len(known) // 2] if iso is None else iso
        names, transfer = transfers[chosen]

        def draw_transfer(axes: Axes, theme: Theme) -> None:
            transfer_lines(axes, None, names, transfer.channels, theme)
            axes.set_xlabel("signal [DN]")

        draws.append((f"photon transfer, ISO {chosen:g}", draw_transfer))
    gains = [(one.iso, one.gain.value, one.gain.error) for one in isos if one.gain is not None]
    if gains:

        def draw_gains(axes: Axes, theme: Theme) -> None:
            known, values, errors = zip(*gains, strict=True)
            usual = usual_gain_per_iso(isos)
            gain_over_iso(axes, known, values, [bar(error) for error in errors], usual, theme)
            iso_axis(axes, known)

        draws.append(("system gain", draw_gains))
    for panel in panels:

        def draw_scales(axes: Axes, theme: Theme, panel: ScalePanel = panel) -> None:
            spans = [(line.fit, low, high) for line, low, high in panel.spans]
            scale_over_gain(axes, panel.name, spans, panel.points, theme)

        draws.append((panel.figure if panel.name == "row" else f"{panel.figure}, {panel.name}", draw_scales))
    if not draws:
        raise nothing_to_draw(f"the calibration of {camera}", "no ISO has flats or both K and bias frames")
    return drawn_grid(f"Calibration of {camera}", draws)
