"""Plots of a method against another: image by image, and the mean differences of groups with their intervals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from matplotlib.ticker import FixedLocator

from eldata.reports.evaluation.plots import draw_points, drawable
from eldata.reports.figures import drawn, figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from eldata.evaluation.comparison import Comparison, Pairing
    from eldata.protocols.kinds import Kind
    from eldata.reports.figures import Plot, Theme

_LONGEST_NAME = 22


def gain_plots(comparison: Comparison, index: int) -> tuple[Plot, ...]:
    """Return the plots of the method of this index among all but the first; none of no finite scores."""
    finite = [one for one in comparison.pairings(index) if one.is_finite]
    if not finite:
        return ()
    names, kind = (comparison.methods[0].name, comparison.methods[index + 1].name), comparison.kind
    return (
        _groups_plot(comparison, index, names),
        _scatter(finite, names, index, kind),
        _by_level(finite, names, index),
    )


def _short(name: str) -> str:
    return drawable(name, _LONGEST_NAME)


def _groups_plot(comparison: Comparison, index: int, names: tuple[str, str]) -> Plot:
    groups = [group for group in comparison.groups if math.isfinite(group.gains[index]["psnr_db"].interval.mean)]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        axes.axvline(0, color=theme.theory, linewidth=1)
        for place, group in enumerate(groups):
            interval = group.gains[index]["psnr_db"].interval
            if interval.is_known:
                axes.plot([interval.low, interval.high], [place, place], color=theme.ink, linewidth=1.4)
            axes.plot([interval.mean], [place], color=theme.found, marker="o", linestyle="none")
        axes.yaxis.set_major_locator(FixedLocator(list(range(len(groups)))))
        axes.set_yticklabels([_short(group.name.replace(" x", " ×")) for group in groups], parse_math=False)
        axes.set_ylim(len(groups) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("difference of PSNR [dB]")
        return made

    return drawn(
        f"gain-groups-{index}",
        "Mean difference by group",
        f"Mean difference of PSNR, {names[1]} minus {names[0]}, of {len(groups)} groups.",
        f"Right of the line: {names[1]} is better. Bars are the intervals over scenes, where there are enough.",
        draw,
    )


def _scatter(pairings: Sequence[Pairing], names: tuple[str, str], index: int, kind: Kind) -> Plot:
    points = [(one.first.ratio, one.first.psnr_db, one.other.psnr_db) for one in pairings]
    values = [value for _, *both in points for value in both]
    margin = 0.04 * (max(values) - min(values)) + 0.1
    limits = min(values) - margin, max(values) + margin
    better = sum(one.gain_db > 0 for one in pairings)

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        axes.plot(limits, limits, color=theme.theory, linewidth=1)
        draw_points(axes, points, theme, alpha=0.6)
        axes.set_xlim(*limits)
        axes.set_ylim(*limits)
        axes.set_xlabel(f"{_short(names[0])} [dB]", parse_math=False)
        axes.set_ylabel(f"{_short(names[1])} [dB]", parse_math=False)
        return made

    return drawn(
        f"gain-scatter-{index}",
        f"{kind.unit.capitalize()} by {kind.unit}",
        f"PSNR of {names[1]} against that of {names[0]} on {len(points)} {kind.units}; it is higher on {better}.",
        f"One point per {kind.unit}. Above the line {names[1]} is better: on {better} of {len(points)} {kind.units}.",
        draw,
    )


def _by_level(pairings: Sequence[Pairing], names: tuple[str, str], index: int) -> Plot:
    points = [(one.first.ratio, one.first.psnr_db, one.gain_db) for one in pairings]
    gains = [gain for _, _, gain in points]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        axes.axhline(0, color=theme.theory, linewidth=1)
        draw_points(axes, points, theme, alpha=0.6)
        axes.set_xlabel(f"{_short(names[0])} [dB]", parse_math=False)
        axes.set_ylabel("difference [dB]")
        return made

    return drawn(
        f"gain-level-{index}",
        "Difference by difficulty",
        f"Difference of PSNR, from {min(gains):.2f} to {max(gains):.2f} dB, against the PSNR of {names[0]}.",
        f"What {names[0]} finds hard is to the left. A slope says that one method wins where it is dark.",
        draw,
    )
