"""Plots of a method against another: image by image, and the mean differences of groups with their intervals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.plots.scores import draw_points, mean_gains, short
from eldata.reports.figures import drawn_axes
from eldata.reports.html import plot_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from eldata.evaluation.comparison import Comparison, Pairing
    from eldata.plots.axes import Theme
    from eldata.protocols.kinds import Kind
    from eldata.reports.figures import Plot


def gain_plots(comparison: Comparison, index: int) -> tuple[Plot, ...]:
    """Return the plots of the method of this index among all but the first; none of no finite scores."""
    finite = [one for one in comparison.pairings(index) if one.is_finite]
    if not finite:
        return ()
    names, kind = (comparison.methods[0].name, comparison.methods[index + 1].name), comparison.kind
    return (
        _groups_plot(comparison, index, names),
        _scatter(finite, names, index, kind),
        _by_level(finite, names, index, kind),
    )


def _groups_plot(comparison: Comparison, index: int, names: tuple[str, str]) -> Plot:
    groups = [group for group in comparison.groups if math.isfinite(group.gains[index]["psnr_db"].interval.mean)]

    def draw(axes: Axes, theme: Theme) -> None:
        means = [group.gains[index]["psnr_db"].interval.ends for group in groups]
        mean_gains(axes, [group.name for group in groups], [(names[1], means)], theme)
        axes.set_xlabel("difference of PSNR [dB]")

    alt = f"Mean difference of PSNR, {names[1]} minus {names[0]}, of {len(groups)} groups."
    said = plot_words("compare")["gain-groups"]
    return drawn_axes(f"gain-groups-{index}", said["title"], alt, said["caption"].format(other=names[1]), draw)


def _scatter(pairings: Sequence[Pairing], names: tuple[str, str], index: int, kind: Kind) -> Plot:
    points = [(one.first.ratio, one.first.psnr_db, one.other.psnr_db) for one in pairings]
    values = [value for _, *both in points for value in both]
    margin = 0.04 * (max(values) - min(values)) + 0.1
    limits = min(values) - margin, max(values) + margin
    better = sum(one.gain_db > 0 for one in pairings)

    def draw(axes: Axes, theme: Theme) -> None:
        axes.plot(limits, limits, color=theme.theory, linewidth=1)
        draw_points(axes, points, theme, alpha=0.6)
        axes.set(xlim=limits, ylim=limits)
        axes.set_xlabel(f"{short(names[0])} [dB]", parse_math=False)
        axes.set_ylabel(f"{short(names[1])} [dB]", parse_math=False)

    alt = f"PSNR of {names[1]} against that of {names[0]} on {len(points)} {kind.units}; it is higher on {better}."
    facts = {"Unit": kind.unit.capitalize(), "unit": kind.unit, "units": kind.units}
    said = plot_words("compare")["gain-scatter"]
    caption = said["caption"].format(**facts, other=names[1], better=better, count=len(points))
    return drawn_axes(f"gain-scatter-{index}", said["title"].format(**facts), alt, caption, draw)


def _by_level(pairings: Sequence[Pairing], names: tuple[str, str], index: int, kind: Kind) -> Plot:
    points = [(one.first.ratio, one.first.psnr_db, one.gain_db) for one in pairings]
    gains = [gain for _, _, gain in points]

    def draw(axes: Axes, theme: Theme) -> None:
        axes.axhline(0, color=theme.theory, linewidth=1)
        draw_points(axes, points, theme, alpha=0.6)
        axes.set_xlabel(f"{short(names[0])} [dB]", parse_math=False)
        axes.set_ylabel("difference [dB]")

    alt = f"Difference of PSNR, from {min(gains):.2f} to {max(gains):.2f} dB, against the PSNR of {names[0]}."
    said = plot_words("compare")["gain-level"]
    caption = said["caption"].format(Units=kind.units.capitalize(), first=names[0])
    return drawn_axes(f"gain-level-{index}", said["title"], alt, caption, draw)
