"""Plots of an evaluation's scores, one by one: by camera, ISO and factor, and the rescaling that was found."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.font_manager import findfont, get_font
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from eldata.evaluation.looking import columns_of, factors_of, finite_scores
from eldata.reports.figures import MARKERS, drawn_axes, number
from eldata.reports.html import plot_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from eldata.evaluation.looking import Column, Grouping
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.statistics import Interval
    from eldata.protocols.kinds import Kind, Metric
    from eldata.reports.figures import Plot, Theme

_LONGEST_LABEL = 14
_GOLDEN = (math.sqrt(5) - 1) / 2
_USUAL = (0.8, 1.25)


def score_plots(scores: Sequence[UnitScore], kind: Kind, *, rescaled: bool) -> tuple[Plot, ...]:
    """Return the plots of a result; none of no scores. Those of the rescaling only if the protocol rescales."""
    finite = finite_scores(scores, kind)
    if not finite:
        return ()
    left_out = len(scores) - len(finite)
    note = f" Not drawn: {left_out} without a finite score." if left_out else ""
    groupings: tuple[Grouping, ...] = ("camera", "iso") if any(score.iso for score in finite) else ("camera",)
    plots = [_strips(metric, by, finite, kind, note) for by in groupings for metric in kind.metrics]
    positive = [score for score in finite if math.isfinite(score.rescale) and score.rescale > 0]
    if rescaled and positive:
        plots += [_rescaling_plot(positive, kind), _rescaling_scores_plot(positive, kind)]
    return tuple(plots)


# --- one column per group -----------------------------------------------------------------------------------------


def _strips(metric: Metric, by: Grouping, scores: Sequence[UnitScore], kind: Kind, note: str) -> Plot:
    columns = columns_of(scores, by)
    groups = list(dict.fromkeys(column.group for column in columns))
    values = [score.values[metric.name] for score in scores]

    def draw(axes: Axes, theme: Theme) -> None:
        _columns(axes, columns, metric.name, theme, means=True)
        axes.set_ylabel(metric.head)

    alt = (
        f"{metric.head} of {len(scores)} {kind.units} in {len(groups)} groups ({', '.join(groups)}), from "
        f"{min(values):.4g} to {max(values):.4g}."
    )
    by_what = f"{'ISO' if by == 'iso' else by}{'' if factors_of(scores) == [None] else ' and factor'}"
    said = plot_words("evaluation")["by-group"]
    return drawn_axes(
        f"{metric.label.lower()}-{by}",
        said["title"].format(metric=metric.label, groups=by_what),
        alt,
        said["caption"].format(unit=kind.unit, note=note),
        draw,
    )


def _rescaling_plot(scores: Sequence[UnitScore], kind: Kind) -> Plot:
    factors = [score.rescale for score in scores]

    def draw(axes: Axes, theme: Theme) -> None:
        _exposure_band(axes, theme, horizontal=True)
        _columns(axes, columns_of(scores, "camera"), "rescale", theme, means=False)
        _factor_axis(axes, factors)
        axes.set_ylabel("rescaled by")

    alt = f"Factor of each of {len(scores)} predictions by camera, from {min(factors):.3g} to {max(factors):.3g}."
    said = plot_words("evaluation")["rescaling"]
    return drawn_axes("rescaling", said["title"], alt, said["caption"].format(units=kind.units), draw)


def _rescaling_scores_plot(scores: Sequence[UnitScore], kind: Kind) -> Plot:
    factors = [score.rescale for score in scores]
    points = [(score.ratio, score.rescale, score.psnr_db) for score in scores]

    def draw(axes: Axes, theme: Theme) -> None:
        _exposure_band(axes, theme, horizontal=False)
        draw_points(axes, points, theme, alpha=0.7)
        _factor_axis(axes, factors, horizontal=True)
        axes.set(xlabel="rescaled by", ylabel="PSNR [dB]")

    alt = f"PSNR of {len(scores)} {kind.units} against the factor that each prediction was multiplied by."
    said = plot_words("evaluation")["rescaling-psnr"]
    return drawn_axes("rescaling-psnr", said["title"], alt, said["caption"].format(units=kind.units), draw)


def draw_points(axes: Axes, points: Sequence[tuple[float | None, float, float]], theme: Theme, *, alpha: float) -> None:
    """Draw points (factor, x, y), those of each factor alike, with a legend of the factors."""
    ratios = sorted({ratio for ratio, _, _ in points}, key=lambda ratio: ratio or 0.0)
    for index, ratio in enumerate(ratios):
        members = [(x, y) for of, x, y in points if of == ratio]
        axes.plot(
            [x for x, _ in members],
            [y for _, y in members],
            linestyle="none",
            alpha=alpha,
            **look_of_factor(index, ratio, theme),
        )
    legend_of_factors(axes, ratios)


def _columns(axes: Axes, columns: Sequence[Column], field: str, theme: Theme, *, means: bool) -> None:
    """Draw the points of each group and factor in a column of their own, beside each other by factor."""
    groups = list(dict.fromkeys(column.group for column in columns))
    ratios = factors_of(score for column in columns for score in column.scores)
    width = 0.8 / len(ratios)
    for index, ratio in enumerate(ratios):
        xs: list[float] = []
        ys: list[float] = []
        for column in columns:
            if column.ratio != ratio:
                continue
            values = sorted(score.values[field] for score in column.scores)
            middle = groups.index(column.group) + (index - (len(ratios) - 1) / 2) * width
            # Neighbours in value lie far apart, the same each time.
            xs += [middle + (((rank * _GOLDEN) % 1) - 0.5) * 0.6 * width for rank in range(len(values))]
            ys += values
            if means:
                _mean_bar(axes, middle, 0.42 * width, column.interval(field), theme)
        axes.plot(xs, ys, linestyle="none", alpha=0.55, **look_of_factor(index, ratio, theme))
    axes.set_xlim(-0.55, len(groups) - 0.45)
    axes.xaxis.set_major_locator(FixedLocator(list(range(len(groups)))))
    labels = [drawable(name, _LONGEST_LABEL) for name in groups]
    turned = len(groups) > 2 and sum(map(len, labels)) > 40
    axes.set_xticklabels(
        labels,
        parse_math=False,
        rotation=25 if turned else 0,
        ha="right" if turned else "center",
        rotation_mode="anchor",
    )
    axes.grid(visible=False, axis="x")
    legend_of_factors(axes, ratios)


def _mean_bar(axes: Axes, x: float, half: float, interval: Interval, theme: Theme) -> None:
    axes.plot([x - half, x + half], [interval.mean] * 2, color=theme.ink, linewidth=2, zorder=4)
    if interval.is_known:
        axes.plot([x, x], [interval.low, interval.high], color=theme.ink, linewidth=1.2, zorder=4)


def look_of_factor(index: int, ratio: float | None, theme: Theme) -> dict[str, Any]:
    """Return how the points of a factor look; ``index`` is its place among the factors."""
    colours = (theme.found, theme.theory, *theme.channels[1:])
    return {
        "color": colours[index % len(colours)],
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 4.2,
        "markeredgewidth": 0,
        "label": "" if ratio is None else f"×{ratio:g}",
    }


def drawable(name: str, longest: int) -> str:
    """Return a name of at most so many letters, with a box in place of those that the plots' font lacks."""
    name = name if len(name) <= longest else f"{name[: longest - 1]}…"
    font = get_font(findfont("DejaVu Sans"))
    return "".join(letter if font.get_char_index(ord(letter)) else "□" for letter in name)


def legend_of_factors(axes: Axes, ratios: Sequence[float | None]) -> None:
    """Put the legend above the axes, where no point can be; none where no factor is stated."""
    if list(ratios) == [None]:
        return
    axes.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1),
        ncols=min(len(ratios), 5),
        columnspacing=1,
        handlelength=1,
        handletextpad=0.4,
    )


def _exposure_band(axes: Axes, theme: Theme, *, horizontal: bool) -> None:
    (axes.axhspan if horizontal else axes.axvspan)(*_USUAL, color=theme.theory, alpha=0.13, linewidth=0)
    (axes.axhline if horizontal else axes.axvline)(1, color=theme.theory, linewidth=1)


def _factor_axis(axes: Axes, factors: Sequence[float], *, horizontal: bool = False) -> None:
    """Set up a logarithmic axis of factors, wide enough for the band."""
    low, high = min(0.7, *factors), max(1.43, *factors)
    low, high = low / 1.05, high * 1.05
    (axes.set_xscale if horizontal else axes.set_yscale)("log", base=2)
    (axes.set_xlim if horizontal else axes.set_ylim)(low, high)
    axis = axes.xaxis if horizontal else axes.yaxis
    doublings = math.log2(high / low)
    ticks = [0.7, 0.8, 0.9, 1, 1.1, 1.25, 1.4] if doublings < 1.3 else [0.5, 0.7, 1, 1.4, 2]
    if doublings > 2.5:
        step = max(1, math.ceil(doublings / 7))
        exponents = np.arange(math.ceil(math.log2(low) / step), math.floor(math.log2(high) / step) + 1) * step
        ticks = [float(2.0**exponent) for exponent in exponents]
    axis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _position: number(float(f"{value:.3g}"))))
