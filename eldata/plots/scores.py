"""Scores one by one, in columns and as points by factor, and mean differences of groups."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from matplotlib.ticker import FixedLocator

from eldata.plots.axes import MARKERS, Theme, drawable, legend_above

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes


Mean: TypeAlias = tuple[float, float, float]
"""A mean and the ends of its interval, which are nan where there is none."""

_LONGEST_LABEL = 14
_LETTERS_ACROSS = 40
_LONGEST_NAME = 22
_GOLDEN = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True, slots=True)
class Strip:
    """Values of one group at one factor, and the mean that is drawn over them, if one is."""

    group: str
    ratio: float | None
    values: tuple[float, ...]
    mean: Mean | None = None


def draw_points(axes: Axes, points: Sequence[tuple[float | None, float, float]], theme: Theme, *, alpha: float) -> None:
    """Draw points (factor, x, y), with a look and a legend entry for each factor."""
    ratios = sorted({ratio for ratio, _, _ in points}, key=lambda ratio: ratio or 0.0)
    for index, ratio in enumerate(ratios):
        xs, ys = zip(*((x, y) for factor, x, y in points if factor == ratio), strict=True)
        axes.plot(xs, ys, linestyle="none", alpha=alpha, **look_of_factor(index, ratio, theme))
    legend_of_factors(axes, ratios)


def strips(axes: Axes, values: Sequence[Strip], theme: Theme) -> None:
    """Draw the values of each group and factor in a column of their own, the factors of a group side by side."""
    groups = list(dict.fromkeys(strip.group for strip in values))
    ratios = sorted({strip.ratio for strip in values}, key=lambda ratio: -1.0 if ratio is None else ratio)
    width = 0.8 / len(ratios)
    for index, ratio in enumerate(ratios):
        xs: list[float] = []
        ys: list[float] = []
        for strip in values:
            if strip.ratio != ratio:
                continue
            ordered = sorted(strip.values)
            middle = groups.index(strip.group) + (index - (len(ratios) - 1) / 2) * width
            # Neighbours in value lie far apart, the same each time.
            xs += [middle + (((rank * _GOLDEN) % 1) - 0.5) * 0.6 * width for rank in range(len(ordered))]
            ys += ordered
            if strip.mean is not None:
                _draw_mean(axes, middle, 0.42 * width, strip.mean, theme)
        axes.plot(xs, ys, linestyle="none", alpha=0.55, **look_of_factor(index, ratio, theme))
    axes.set_xlim(-0.55, len(groups) - 0.45)
    axes.xaxis.set_major_locator(FixedLocator(list(range(len(groups)))))
    labels = [drawable(name, _LONGEST_LABEL) for name in groups]
    # A label is turned where it would touch the next: the axes are about 40 letters wide.
    turned = len(groups) > 1 and max(map(len, labels)) + 1 > _LETTERS_ACROSS / len(groups)
    turn: dict[str, Any] = {"rotation": 25, "ha": "right"} if turned else {"rotation": 0, "ha": "center"}
    axes.set_xticklabels(labels, parse_math=False, rotation_mode="anchor", **turn)
    axes.grid(visible=False, axis="x")
    legend_of_factors(axes, ratios)


def _draw_mean(axes: Axes, x: float, half: float, mean: Mean, theme: Theme) -> None:
    """Draw a mean as a level bar, and its interval, where known, as an upright line."""
    middle, low, high = mean
    axes.plot([x - half, x + half], [middle] * 2, color=theme.ink, linewidth=2, zorder=4)
    if math.isfinite(low) and math.isfinite(high):
        axes.plot([x, x], [low, high], color=theme.ink, linewidth=1.2, zorder=4)


def look_of_factor(index: int, ratio: float | None, theme: Theme) -> dict[str, Any]:
    """Choose the look of a factor's points; ``index`` is its place among the factors."""
    colours = (theme.found, theme.theory, *theme.channels[1:])
    return {
        "color": colours[index % len(colours)],
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 4.2,
        "markeredgewidth": 0,
        "label": "" if ratio is None else f"×{ratio:g}",
    }


def legend_of_factors(axes: Axes, ratios: Sequence[float | None]) -> None:
    """Put the legend above the axes, where no point can be; none where no factor is stated."""
    if list(ratios) == [None]:
        return
    legend_above(axes, middle=0.5, most=min(len(ratios), 5), handle=1)


def short(name: str) -> str:
    """Return the name of a method or a group as axes have room for it."""
    return drawable(name, _LONGEST_NAME)


def mean_gains(axes: Axes, groups: Sequence[str], means: Sequence[Mean], theme: Theme) -> None:
    """Draw a method's mean differences from the first, a row for each group, with their intervals.

    A mean that is not finite is not drawn.
    """
    axes.axvline(0, color=theme.theory, linewidth=1)
    look = look_of_factor(0, None, theme) | {"markersize": 5}
    shown = [(place, mean) for place, mean in enumerate(means) if math.isfinite(mean[0])]
    for place, (_, low, high) in shown:
        if math.isfinite(low) and math.isfinite(high):
            axes.plot([low, high], [place, place], color=theme.ink, linewidth=1.4)
    axes.plot([mean for _, (mean, _, _) in shown], [place for place, _ in shown], linestyle="none", **look)
    axes.yaxis.set_major_locator(FixedLocator(list(range(len(groups)))))
    axes.set_yticklabels([short(name.replace(" x", " ×")) for name in groups], parse_math=False)
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
