"""Plots of a method against another: image by image, and the mean differences of groups with their intervals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from matplotlib.ticker import FixedLocator

from eldata.reports.evaluation.plots import drawable, legend_of_factors, look_of_factor
from eldata.reports.figures import drawn, figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from eldata.evaluation.comparison import Comparison
    from eldata.evaluation.saved import SavedScore
    from eldata.reports.figures import Plot, Theme

_LONGEST_NAME = 22


def gain_plots(comparison: Comparison, index: int) -> tuple[Plot, ...]:
    """Return the plots of the method of this index among all but the first; none of no finite scores."""
    pairs = [
        (scores[0], scores[index + 1])
        for scores in comparison.images
        if math.isfinite(scores[0].psnr_db) and math.isfinite(scores[index + 1].psnr_db)
    ]
    if not pairs:
        return ()
    names = comparison.methods[0].name, comparison.methods[index + 1].name
    return (_groups_plot(comparison, index, names), _scatter(pairs, names, index), _by_level(pairs, names, index))


def _short(name: str) -> str:
    return drawable(name, _LONGEST_NAME)


def _groups_plot(comparison: Comparison, index: int, names: tuple[str, str]) -> Plot:
    groups = [group for group in comparison.groups if math.isfinite(group.gains[index].psnr_db.interval.mean)]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        axes.axvline(0, color=theme.theory, linewidth=1)
        for place, group in enumerate(groups):
            interval = group.gains[index].psnr_db.interval
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


def _scatter(pairs: Sequence[tuple[SavedScore, SavedScore]], names: tuple[str, str], index: int) -> Plot:
    ratios = sorted({first.ratio for first, _ in pairs})
    values = [score.psnr_db for both in pairs for score in both]
    margin = 0.04 * (max(values) - min(values)) + 0.1
    limits = min(values) - margin, max(values) + margin
    better = sum(second.psnr_db > first.psnr_db for first, second in pairs)

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        axes.plot(limits, limits, color=theme.theory, linewidth=1)
        for number, ratio in enumerate(ratios):
            members = [both for both in pairs if both[0].ratio == ratio]
            axes.plot(
                [first.psnr_db for first, _ in members],
                [second.psnr_db for _, second in members],
                linestyle="none",
                alpha=0.6,
                **look_of_factor(number, ratio, theme),
            )
        axes.set_xlim(*limits)
        axes.set_ylim(*limits)
        axes.set_xlabel(f"{_short(names[0])} [dB]", parse_math=False)
        axes.set_ylabel(f"{_short(names[1])} [dB]", parse_math=False)
        legend_of_factors(axes, len(ratios))
        return made

    return drawn(
        f"gain-scatter-{index}",
        "Image by image",
        f"PSNR of {names[1]} against that of {names[0]} on {len(pairs)} images; it is higher on {better}.",
        f"A point an image. Above the line {names[1]} is better: on {better} of {len(pairs)} images.",
        draw,
    )


def _by_level(pairs: Sequence[tuple[SavedScore, SavedScore]], names: tuple[str, str], index: int) -> Plot:
    ratios = sorted({first.ratio for first, _ in pairs})
    gains = [second.psnr_db - first.psnr_db for first, second in pairs]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        axes.axhline(0, color=theme.theory, linewidth=1)
        for number, ratio in enumerate(ratios):
            members = [both for both in pairs if both[0].ratio == ratio]
            axes.plot(
                [first.psnr_db for first, _ in members],
                [second.psnr_db - first.psnr_db for first, second in members],
                linestyle="none",
                alpha=0.6,
                **look_of_factor(number, ratio, theme),
            )
        axes.set_xlabel(f"{_short(names[0])} [dB]", parse_math=False)
        axes.set_ylabel("difference [dB]")
        legend_of_factors(axes, len(ratios))
        return made

    return drawn(
        f"gain-level-{index}",
        "Difference by difficulty",
        f"Difference of PSNR, from {min(gains):.2f} to {max(gains):.2f} dB, against the PSNR of {names[0]}.",
        f"Images that {names[0]} finds hard are to the left. A slope says that one method wins where it is dark.",
        draw,
    )
