"""What the plots of every report share: colours, sizes, axes, and SVG that looks the same everywhere.

Figures are made without pyplot, so no window, no global figure list and no backend setting is touched. Letters are
drawn as outlines, the background is transparent, and the same data give the same bytes. Each plot comes for a light
and for a dark page.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from eldata.noise.findings import LIMIT
from eldata.reports.html import TEMPLATES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

    from eldata.noise.gain_modes import LogLogFit

SIZE_INCHES = (4.4, 3.6)
"""About a phone's width at the page's own letter size."""

MARKERS = ("o", "s", "^", "D")
"""One per channel, so that colour is never the only sign."""

_POINTS_SHOWN = 161
_TAIL_SHOWN = 15


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of a plot. Found values are points in ``found``, the theory is lines in ``theory``."""

    ink: str
    grid: str
    theory: str
    found: str
    channels: tuple[str, str, str, str]


LIGHT = Theme("#1f2933", "#d5dbe1", "#c2410c", "#0b62b8", ("#c81e1e", "#15803d", "#1d4ed8", "#7c8a06"))
DARK = Theme("#e6eaee", "#434c56", "#ff9d5c", "#6cb6ff", ("#ff7b7b", "#56d364", "#7ab0ff", "#d3d35a"))


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot: an identifier, a heading, what it shows in words, what to look for, and the two images."""

    name: str
    title: str
    alt: str
    caption: str
    light: bytes
    dark: bytes


def drawn(name: str, title: str, alt: str, caption: str, draw: Callable[[Theme], Figure]) -> Plot:
    """Return the plot that a function draws."""
    light = _svg(draw, LIGHT, name)
    return Plot(name, title, alt, caption, light, _recoloured(light))


def drawn_axes(name: str, title: str, alt: str, caption: str, draw: Callable[[Axes, Theme], None]) -> Plot:
    """Return the plot that a function draws into axes that fill the figure."""

    def whole(theme: Theme) -> Figure:
        drawing, axes = one_axes()
        draw(axes, theme)
        return drawing

    return drawn(name, title, alt, caption, whole)


def _svg(draw: Callable[[Theme], Figure], theme: Theme, name: str) -> bytes:
    inked = ("axes.edgecolor", "axes.labelcolor", "legend.labelcolor", "text.color", "xtick.color", "ytick.color")
    style = {"grid.color": theme.grid, "svg.hashsalt": name} | dict.fromkeys(inked, theme.ink)
    buffer = io.BytesIO()
    with matplotlib.style.context(["default", TEMPLATES / "figures.mplstyle", style]):
        figure = draw(theme)
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _slimmed(buffer.getvalue().decode("utf-8")).encode("utf-8")


def _slimmed(svg: str) -> str:
    """Return the same picture in about half the characters: a page holds a hundred of them."""
    svg = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"\s+", " ", svg).replace("> <", "><")
    # A hundredth of a point cannot be seen. Scales of letters stay as they are.
    svg = re.sub(r' (?:d|x|y)="[^"]*"', lambda match: re.sub(r"(\.\d\d)\d+", r"\1", match[0]), svg)
    svg = re.sub(r' d="[^"]*"', lambda match: re.sub(r"(?<=\S) ?([MLQCz]) ?", r"\1", match[0]), svg)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    names = {name: f"i{index}" for index, name in enumerate(re.findall(r' id="([^"]*)"', svg))}
    svg = re.sub(r' id="([^"]*)"', lambda match: f' id="{names[match[1]]}"', svg)
    svg = re.sub(r"#([\w.-]+)", lambda match: f"#{names.get(match[1], match[1])}", svg)
    svg = svg.replace(' xmlns:xlink="http://www.w3.org/1999/xlink"', "").replace(" xlink:href=", " href=")
    found = 1
    while found:
        svg, found = re.subn(r"<g>((?:(?!</?g[ >]).)*)</g>", r"\1", svg)  # groups that say nothing
    # Neighbours of one look say so once: points, and lines that are not filled.
    point = r'<use href="[^"]*" x="[^"]*" y="[^"]*" '
    svg = re.sub(rf'{point}(style="[^"]*")/>(?:{point}\1/>)+', _grouped_points, svg)
    line = r'<path d="[^"]*" '
    return re.sub(rf'{line}((?:clip-path="[^"]*" )?style="fill: none[^"]*")/>(?:{line}\1/>)+', _joined_lines, svg)


def _grouped_points(points: re.Match[str]) -> str:
    return f"<g {points[1]}>{points[0].replace(' ' + points[1], '')}</g>"


def _joined_lines(lines: re.Match[str]) -> str:
    outline = "".join(re.findall(r' d="([^"]*)"', lines[0]))
    return f'<path d="{outline}" {lines[1]}/>'


def _recoloured(svg: bytes) -> bytes:
    """Return a plot of the light page for the dark one: only the colours differ, and drawing is what takes time."""
    colours = dict(zip(_colours(LIGHT), _colours(DARK), strict=True))
    return re.sub("|".join(colours), lambda match: colours[match[0]], svg.decode("utf-8")).encode("utf-8")


def _colours(theme: Theme) -> tuple[str, ...]:
    return (theme.ink, theme.grid, theme.theory, theme.found, *theme.channels)


def figure() -> Figure:
    """Return an empty figure of the size that all plots have."""
    return Figure(figsize=SIZE_INCHES, layout="constrained")


def one_axes() -> tuple[Figure, Axes]:
    """Return such a figure and the axes that fill it."""
    drawing = figure()
    return drawing, drawing.subplots()


def two_axes(ratio: float) -> tuple[Figure, Axes, Axes]:
    """Return such a figure with two axes above each other, the upper ``ratio`` times as high as the lower."""
    drawing = figure()
    return drawing, *drawing.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [ratio, 1]})


# --- axes ---------------------------------------------------------------------------------------------------------


def log_ticks(axis: Axis, decades: int) -> None:
    """Label a logarithmic axis with plain numbers: more in a decade, the fewer decades there are."""
    axis.set_major_locator(LogLocator(10, (1, 2, 5) if decades < 3 else (1,), numticks=20))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(number))


def plain_ticks(axis: Axis, at: Sequence[float]) -> None:
    """Label an axis with plain numbers at these places."""
    axis.set_major_locator(FixedLocator(list(at)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(number))


def number(value: float, _position: object = None) -> str:
    """Return a number for a tick, with a minus sign."""
    return f"{value:g}".replace("-", "−")


# --- panels -------------------------------------------------------------------------------------------------------


def deviation_band(axes: Axes, furthest: float, theme: Theme) -> None:
    """Set up axes of deviations in standard errors, with the band that counts as ok."""
    axes.axhspan(-LIMIT, LIMIT, color=theme.theory, alpha=0.13, linewidth=0)
    axes.axhline(0, color=theme.theory, linewidth=1)
    reach = max(LIMIT + 1, 1.15 * furthest)
    axes.set_ylim(-reach, reach)
    if reach == LIMIT + 1:
        axes.yaxis.set_major_locator(FixedLocator([-4, 0, 4]))
    axes.set_ylabel("dev. [s.e.]")


def fit_bands(axes: Axes, fits: Sequence[tuple[LogLogFit, float, float]], theme: Theme) -> None:
    """Draw log-log fits from a gain to a gain, with their bands of one and two residual deviations.

    One fit goes on a little beyond its gains. Several are those of gain modes, and end where their modes do.
    """
    beyond = 1.15 if len(fits) == 1 else 1.0
    for number, (fit, low, high) in enumerate(fits):
        gains = np.geomspace(low / beyond, high * beyond, 50)
        for width, alpha in ((2.0, 0.13), (1.0, 0.2)):
            lower, upper = ([fit.scale_dn(float(gain), z) for gain in gains] for z in (-width, width))
            axes.fill_between(gains, lower, upper, color=theme.theory, alpha=alpha, linewidth=0)
        # matplotlib leaves labels with an underscore out of the legend: one entry for all.
        label = "_" if number else "fit, ±1σ, ±2σ"
        axes.plot(gains, [fit.scale_dn(float(gain), 0.0) for gain in gains], color=theme.theory, label=label)


def log_log(axes: Axes, name: str) -> None:
    """Set up axes of the sigma of that name over the gain."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        log_ticks(axis, 2)
    axes.set_xlabel("K [DN/e⁻]")
    axes.set_ylabel(rf"$\sigma_\mathrm{{{name}}}$ [DN]")


def bars(axes: Axes, at: Sequence[float], values: Sequence[float], errors: Sequence[float], theme: Theme) -> None:
    """Draw measured values with their standard errors."""
    axes.errorbar(at, values, yerr=errors, fmt="o", color=theme.found, capsize=3, label="measured")


def quantile_plot(
    expected: NDArray[np.float64],
    found: NDArray[np.float64],
    line: tuple[float, float],
    theme: Theme,
    *,
    names: tuple[str, str],
    labels: tuple[str, str],
    note: str = "",
) -> Figure:
    """Draw ordered values over expected quantiles, with a line of a slope and a level.

    ``names`` are those of the line and the points, ``labels`` those of the axes. The note stands in the lower right
    corner, which rising points leave free.
    """
    drawing, axes = one_axes()
    ends = expected[[0, -1]]
    axes.plot(ends, line[0] * ends + line[1], color=theme.theory, label=names[0])
    axes.plot(expected, found, "o", markersize=3, color=theme.found, label=names[1])
    axes.text(0.98, 0.04, note, transform=axes.transAxes, ha="right", va="bottom", fontsize=9.5)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.legend(loc="upper left")
    return drawing


def legend_above(axes: Axes) -> None:
    """Put the legend above the axes, where no point can be."""
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.45, 1), ncols=4, columnspacing=1, handlelength=1.4, handletextpad=0.4
    )


def evenly(size: int, most: int) -> NDArray[np.int64]:
    """Return which of ``size`` values to draw: ``most`` of them at most, evenly spread."""
    return np.linspace(0, size - 1, min(size, most)).round().astype(np.int64)


def thinned(size: int) -> NDArray[np.int64]:
    """Return which of many ordered values to draw: a few hundred evenly, and the tails in full."""
    tail = np.arange(min(size, _TAIL_SHOWN))
    return np.unique(np.concatenate([evenly(size, _POINTS_SHOWN), tail, size - 1 - tail]))
