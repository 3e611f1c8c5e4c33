"""What all drawings share: colours, sizes, axes and their ticks, and the style that they are drawn in.

Figures are made without pyplot, so no window, no global figure list and no backend setting is touched.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

SIZE_INCHES = (4.4, 3.6)
"""About a phone's width at the page's own letter size."""

MARKERS = ("o", "s", "^", "D")
"""One per channel, so that colour is never the only sign."""

_STYLE = Path(__file__).parent / "plots.mplstyle"
_POINTS_SHOWN = 161
_TAIL_SHOWN = 15
_TICK_LETTERS = 9.5
_LEGEND_ROW = 14  # points


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


class LogLogLine(Protocol):
    """A line of ln sigma over ln K with its spread."""

    def scale_dn(self, gain_dn_per_e: float, standard_normal: float) -> float:
        """Return sigma at a gain, ``standard_normal`` residual deviations above the line."""


def styled(theme: Theme, **more: Any) -> AbstractContextManager[None]:
    """Return the context in which figures of a theme are made, with more of matplotlib's settings."""
    inked = ("axes.edgecolor", "axes.labelcolor", "legend.labelcolor", "text.color", "xtick.color", "ytick.color")
    style = {"grid.color": theme.grid} | dict.fromkeys(inked, theme.ink) | more
    return matplotlib.style.context(["default", _STYLE, style])


def empty_figure(ratio: float | None = None) -> tuple[Figure, tuple[Axes, ...]]:
    """Return a figure of the size that all plots have, and its axes: one that fills it, or two.

    Two stand above each other, the upper ``ratio`` times as high as the lower.
    """
    drawing = Figure(figsize=SIZE_INCHES, layout="constrained")
    if ratio is None:
        return drawing, (drawing.subplots(),)
    return drawing, tuple(drawing.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [ratio, 1]}))


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


def deviation_band(axes: Axes, furthest: float, limit: float, theme: Theme) -> None:
    """Set up axes of deviations in standard errors, with the band that counts as ok: up to ``limit``."""
    axes.axhspan(-limit, limit, color=theme.theory, alpha=0.13, linewidth=0)
    axes.axhline(0, color=theme.theory, linewidth=1)
    reach = max(limit + 1, 1.15 * furthest)
    axes.set_ylim(-reach, reach)
    if reach == limit + 1:
        axes.yaxis.set_major_locator(FixedLocator([-4, 0, 4]))
    axes.set_ylabel("dev. [s.e.]")


def fit_bands(axes: Axes, fits: Sequence[tuple[LogLogLine, float, float]], theme: Theme) -> None:
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


def draw_quantiles(
    axes: Axes,
    theme: Theme,
    *,
    expected: NDArray[np.floating[Any]],
    found: NDArray[np.floating[Any]],
    line: tuple[float, float],
    names: tuple[str, str],
    labels: tuple[str, str],
    note: str = "",
) -> None:
    """Draw ordered values over expected quantiles, with a line of a slope and a level.

    ``names`` are those of the line and the points, ``labels`` those of the axes. The note stands in the lower right
    corner, which rising points leave free.
    """
    ends = expected[[0, -1]]
    axes.plot(ends, line[0] * ends + line[1], color=theme.theory, label=names[0])
    axes.plot(expected, found, "o", markersize=3, color=theme.found, label=names[1])
    axes.text(0.98, 0.04, note, transform=axes.transAxes, ha="right", va="bottom", fontsize=9.5)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.legend(loc="upper left")


def legend_above(axes: Axes, *, middle: float = 0.45, most: int = 4, handle: float = 1.4) -> None:
    """Put the legend above the axes, where no point can be, with ``most`` entries in a row, and the title above it."""
    legend = axes.legend(
        loc="lower center",
        bbox_to_anchor=(middle, 1),
        ncols=most,
        columnspacing=1,
        handlelength=handle,
        handletextpad=0.4,
    )
    if axes.get_title():
        rows = -(-len(legend.get_texts()) // most)
        axes.set_title(axes.get_title(), pad=8 + _LEGEND_ROW * rows)


def evenly(size: int, most: int) -> NDArray[np.int64]:
    """Return which of ``size`` values to draw: ``most`` of them at most, evenly spread."""
    return np.linspace(0, size - 1, min(size, most)).round().astype(np.int64)


def thinned(size: int) -> NDArray[np.int64]:
    """Return which of many ordered values to draw: a few hundred evenly, and the tails in full."""
    tail = np.arange(min(size, _TAIL_SHOWN))
    return np.unique(np.concatenate([evenly(size, _POINTS_SHOWN), tail, size - 1 - tail]))


# --- figures of their own -----------------------------------------------------------------------------------------


class Drawing(Figure):
    """A figure that a notebook shows whether or not pyplot was imported there."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def drawn_into(axes: Axes | None, title: str, draw: Callable[[Axes, Theme], object]) -> Figure:
    """Draw into somebody's axes, in their style, or into those of a new figure; return the figure."""
    if axes is None:
        return drawn_grid("", [(title, draw)])
    axes.set_title(drawable(title), parse_math=False)
    draw(axes, LIGHT)
    found = axes.get_figure(root=True)
    if found is None:
        raise ArgumentError("ax is in no figure: it was removed from its own")
    return found


def drawn_grid(title: str, draws: Sequence[tuple[str, Callable[[Axes, Theme], object]]]) -> Drawing:
    """Return a new figure of axes, each with its title, at most three in a row, on white: readable on any page."""
    columns = min(len(draws), 3 if len(draws) != 4 else 2)
    rows = -(-len(draws) // columns)
    width, height = SIZE_INCHES
    with styled(LIGHT, **{"figure.facecolor": "white"}):
        made = Drawing(figsize=(width * columns, height * rows), layout="constrained")
        if title:
            made.suptitle(drawable(title), parse_math=False)
        for place, (name, draw) in enumerate(draws):
            axes = made.add_subplot(rows, columns, place + 1)
            axes.set_title(drawable(name), parse_math=False)  # first: a legend above moves it
            draw(axes, LIGHT)
            # Ticks are made when they are drawn, and would have the style of that moment.
            axes.tick_params(colors=LIGHT.ink, labelsize=_TICK_LETTERS)
    return made


def drawable(text: str, longest: int = 120) -> str:
    """Return a text of at most so many letters, with a box in place of those that the plots' font lacks."""
    text = text if len(text) <= longest else f"{text[: longest - 1]}…"
    font = get_font(findfont("DejaVu Sans"))
    return "".join(letter if letter == "\n" or font.get_char_index(ord(letter)) else "□" for letter in text)


def nothing_to_draw(what: str, why: str) -> ArgumentError:
    """Return the error that a figure would be empty."""
    return ArgumentError(f"there is nothing to draw of {what}: {why}")
