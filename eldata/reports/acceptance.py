"""The acceptance test of a noise model as one HTML page."""

from __future__ import annotations

from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

from eldata.calibration.acceptance.verdicts import LIMIT, parameter_rows
from eldata.plots.axes import log_ticks
from eldata.reports.figures import draw_plot
from eldata.reports.html import plot_words, rendered

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from eldata.calibration.acceptance.results import Acceptance, Curve, IsoAcceptance
    from eldata.plots.axes import Theme
    from eldata.reports.figures import Plot

_LABELS = {
    "tails": ("difference [σ]", "share beyond"),
    "row-spectrum": ("cycles per row", "power of row means [DN²]"),
    "column-spectrum": ("cycles per column", "power of column means [DN²]"),
}
_REACH = 20.0  # standard errors: beyond, a point lies at the edge


def acceptance_page(acceptance: Acceptance) -> str:
    """Return the page; the same result gives the same text."""
    isos = [
        {
            "found": found,
            "name": f"{found.iso:g}",
            "parameters": parameter_rows(found.parameters),
            "plots": _plots(found),
            "groups": [(check, tuple(group)) for check, group in groupby(found.statistics, lambda one: one.check)],
        }
        for found in acceptance.isos
    ]
    return rendered("acceptance.html", acceptance=acceptance, isos=isos, limit=LIMIT)


def _plots(found: IsoAcceptance) -> list[Plot]:
    """Draw the verdicts and the curves of one ISO."""
    worst = max((abs(one.deviation or 0.0) for one in found.statistics), default=0.0)
    alt = f"Deviations of {len(found.statistics)} statistics; {len(found.off)} are off, the furthest {worst:.3g} s.e."
    drawn = [("deviations", alt, partial(_draw_deviations, found))]
    for curve in found.curves:
        title = plot_words("acceptance")[curve.name]["title"]
        drawn.append((curve.name, f"{title}: the held-out frames and the model.", partial(_draw_curve, curve)))
    return [draw_plot("acceptance", kind, alt, draw, name=f"{kind}-{found.iso:g}") for kind, alt, draw in drawn]


def _draw_deviations(found: IsoAcceptance, axes: Axes, theme: Theme) -> None:
    checks = list(dict.fromkeys(one.check for one in found.statistics))
    axes.axvspan(-LIMIT, LIMIT, color=theme.theory, alpha=0.13, linewidth=0)
    axes.axvline(0, color=theme.theory, linewidth=1)
    for verdict, marker in (("ok", "o"), ("off", "X")):
        points = [
            (max(-_REACH, min(_REACH, one.deviation)), checks.index(one.check))
            for one in found.statistics
            if one.deviation is not None and one.verdict == verdict
        ]
        if points:
            axes.plot(*zip(*points, strict=True), marker, color=theme.found, alpha=0.7, label=verdict)
    axes.set_yticks(range(len(checks)), checks)
    axes.invert_yaxis()
    axes.set_xlim(-1.1 * _REACH, 1.1 * _REACH)
    axes.set_xlabel("model − frames [s.e.]")


def _draw_curve(curve: Curve, axes: Axes, theme: Theme) -> None:
    for values, style, colour, label in (
        (curve.frames, "-", theme.theory, "held-out frames"),
        (curve.model, "--", theme.found, "model"),
    ):
        shown = values > 0
        axes.plot(curve.x[shown], values[shown], style, color=colour, label=label)
    axes.set_yscale("log")
    if curve.name != "tails":  # room for three decades: the wiggles of chance look as small as they are
        middle = float(curve.model[len(curve.model) // 2]) or 1.0
        axes.set_ylim(min(middle / 30, *curve.frames), max(middle * 30, *curve.frames))
    log_ticks(axes.yaxis, 3)
    xlabel, ylabel = _LABELS[curve.name]
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.legend(loc="upper right")
