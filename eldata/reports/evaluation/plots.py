"""Plots of an evaluation's scores, one by one: by camera, ISO and factor, and the rescaling that was found."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from eldata.evaluation.looking import columns_of, factors_of, finite_scores
from eldata.plots.axes import number
from eldata.plots.scores import draw_points, strips
from eldata.reports.figures import drawn_axes
from eldata.reports.html import plot_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from eldata.base.figures import Figure
    from eldata.evaluation.looking import Column, Grouping
    from eldata.evaluation.scores import UnitScore
    from eldata.plots.axes import Theme
    from eldata.protocols.kinds import Kind
    from eldata.reports.figures import Plot

_USUAL = (0.8, 1.25)


def score_plots(scores: Sequence[UnitScore], kind: Kind, *, rescaled: bool, scenes_shared: bool) -> tuple[Plot, ...]:
    """Return the plots of a result; none of no scores. Those of the rescaling only if the protocol rescales."""
    finite = finite_scores(scores, kind)
    if not finite:
        return ()
    left_out = len(scores) - len(finite)
    note = f" Not drawn: {left_out} without a finite score." if left_out else ""
    groupings: tuple[Grouping, ...] = ("camera", "iso") if any(score.iso for score in finite) else ("camera",)
    plots = [
        _strips(metric, columns_of(finite, by, scenes_shared=scenes_shared), by, kind, note)
        for by in groupings
        for metric in kind.metrics
    ]
    positive = [score for score in finite if math.isfinite(score.rescale) and score.rescale > 0]
    if rescaled and positive:
        columns = columns_of(positive, "camera", scenes_shared=scenes_shared)
        plots += [_rescaling_plot(columns, kind), _rescaling_scores_plot(positive, kind)]
    return tuple(plots)


# --- one column per group -----------------------------------------------------------------------------------------


def _strips(metric: Figure, columns: Sequence[Column], by: Grouping, kind: Kind, note: str) -> Plot:
    scores = [score for column in columns for score in column.scores]
    groups = list(dict.fromkeys(column.group for column in columns))
    values = [score.values[metric.name] for score in scores]

    def draw(axes: Axes, theme: Theme) -> None:
        strips(axes, [column.to_draw(metric.name) for column in columns], theme)
        axes.set_ylabel(metric.heading)

    alt = (
        f"{metric.heading} of {len(scores)} {kind.units} in {len(groups)} groups ({', '.join(groups)}), from "
        f"{min(values):.4g} to {max(values):.4g}."
    )
    by_what = f"{'ISO' if by == 'iso' else by}{'' if factors_of(scores) == [None] else ' and factor'}"
    said = plot_words("evaluation")["by-group"]
    return drawn_axes(
        f"{re.sub(r'[^a-z0-9]+', '-', metric.label.lower())}-{by}",
        said["title"].format(metric=metric.label, groups=by_what),
        alt,
        said["caption"].format(unit=kind.unit, note=note),
        draw,
    )


def _rescaling_plot(columns: Sequence[Column], kind: Kind) -> Plot:
    factors = [score.rescale for column in columns for score in column.scores]

    def draw(axes: Axes, theme: Theme) -> None:
        _exposure_band(axes, theme, horizontal=True)
        values = [column.to_draw("rescale", mean=False) for column in columns]
        strips(axes, values, theme)
        _factor_axis(axes, factors)
        axes.set_ylabel("rescaled by")

    alt = f"Factor of each of {len(factors)} predictions by camera, from {min(factors):.3g} to {max(factors):.3g}."
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
