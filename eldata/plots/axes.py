"""What all drawings share: colours, sizes, axes and their ticks, and the style that they are drawn in.

Figures are made without pyplot, so no window, no global figure list and no backend setting is touched.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, LogLocator, NullLocator

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

Point: TypeAlias = tuple[float, float, float]
"""Gain, scale and the scale's standard error."""

Fit: TypeAlias = tuple["Callable[[float, float], float]", float, float]
"""A line of ln sigma over ln K, from a gain to a gain: sigma at a gain, so many residual deviations above the line."""

SIZE_INCHES = (4.4, 3.6)
"""About a phone's width at the page's own letter size."""

MARKERS = ("o", "s", "^", "D")
"""One per channel, so that colour is never the only sign."""

_STYLE = Path(__file__).parent / "plots.mplstyle"
_POINTS_SHOWN = 161
_TAIL_SHOWN = 15
_TICK_LETTERS = 9.5
_LEGEND_ROW = 14  # points
_LEVELS_SHOWN = 20  # of a channel; more are pooled
_ISOS_LABELLED = 5


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


class TransferLine(Protocol):
    """The photon transfer line of one channel, with its points."""

    @property
    def signal_dn(self) -> NDArray[np.floating[Any]]:
        """Means of the points over black."""

    def variance_at(self, signal_dn: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return the line's variance at these signals."""

    def pooled(
        self, levels: int
    ) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
        """Return signal, variance and its standard error of at most so many points."""


def use_style(theme: Theme, **more: Any) -> AbstractContextManager[None]:
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
    set_ticks(axis, LogLocator(10, (1, 2, 5) if decades < 3 else (1,), numticks=20))


def set_ticks(axis: Axis, places: Locator, form: Callable[..., str] | None = None) -> None:
    """Put ticks at some places alone, and label them, by default with plain numbers."""
    axis.set_major_locator(places)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(form or number))


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


def bars(axes: Axes, at: Sequence[float], values: Sequence[float], errors: Sequence[float], theme: Theme) -> None:
    """Draw measured values with their standard errors."""
    axes.errorbar(at, values, yerr=errors, fmt="o", color=theme.found, capsize=3, label="measured")


def draw_quantiles(
    axes: Axes,
    theme: Theme,
    *,
    points: tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]],
    line: tuple[float, float],
    names: tuple[str, str],
    labels: tuple[str, str],
    note: str = "",
) -> None:
    """Draw points (expected quantiles, ordered values), with a line of a slope and a level.

    ``names`` are those of the line and the points, ``labels`` those of the axes. The note stands in the lower right
    corner, which rising points leave free.
    """
    ends = points[0][[0, -1]]
    axes.plot(ends, line[0] * ends + line[1], color=theme.theory, label=names[0])
    axes.plot(*points, "o", markersize=3, color=theme.found, label=names[1])
    axes.text(0.98, 0.04, note, transform=axes.transAxes, ha="right", va="bottom", fontsize=9.5)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.legend(loc="upper left")


def legend_above(axes: Axes, *, middle: float = 0.45, most: int = 4, handle: float = 1.4) -> None:
    """Put the legend above the axes, where no point can be, with ``most`` entries in a row, and the title above it."""
    spaces = {"columnspacing": 1, "handlelength": handle, "handletextpad": 0.4}
    legend = axes.legend(loc="lower center", bbox_to_anchor=(middle, 1), ncols=most, **spaces)
    if axes.get_title():
        rows = -(-len(legend.get_texts()) // most)
        axes.set_title(axes.get_title(), pad=8 + _LEGEND_ROW * rows)


def spread_evenly(size: int, most: int) -> NDArray[np.int64]:
    """Choose the indices of at most ``most`` values to draw, evenly spread."""
    return np.linspace(0, size - 1, min(size, most)).round().astype(np.int64)


def thin_out(size: int) -> NDArray[np.int64]:
    """Choose the indices of ordered values to draw: a few hundred evenly, and the tails in full."""
    tail = np.arange(min(size, _TAIL_SHOWN))
    return np.unique(np.concatenate([spread_evenly(size, _POINTS_SHOWN), tail, size - 1 - tail]))


# --- calibrated figures -------------------------------------------------------------------------------------------


def scale_over_gain(axes: Axes, name: str, fits: Sequence[Fit], points: Sequence[Point], theme: Theme) -> None:
    """Draw measured scales over the gain, and fitted lines with bands of one and two residual deviations.

    One line goes on a little beyond its gains. Several are those of gain modes, and end where their modes do.
    """
    beyond = 1.15 if len(fits) == 1 else 1.0
    for place, (scale_at, low, high) in enumerate(fits):
        gains = np.geomspace(low / beyond, high * beyond, 50)
        for width, alpha in ((2.0, 0.13), (1.0, 0.2)):
            lower, upper = ([scale_at(float(gain), z) for gain in gains] for z in (-width, width))
            axes.fill_between(gains, lower, upper, color=theme.theory, alpha=alpha, linewidth=0)
        # matplotlib leaves labels with an underscore out of the legend: one entry for all.
        label = "_" if place else "fit, ±1σ, ±2σ"
        axes.plot(gains, [scale_at(float(gain), 0.0) for gain in gains], color=theme.theory, label=label)
    if points:
        # A bar down to 0 has no end on a logarithmic axis.
        errors = [bar(min(error, 0.9 * scale)) for _, scale, error in points]
        bars(axes, [gain for gain, _, _ in points], [scale for _, scale, _ in points], errors, theme)
    axes.set(xscale="log", yscale="log", xlabel="K [DN/e⁻]", ylabel=rf"$\sigma_\mathrm{{{name}}}$ [DN]")
    for axis in (axes.xaxis, axes.yaxis):
        log_ticks(axis, 2)
    if len(points) == 1:
        gain, scale, _ = points[0]
        axes.set(xlim=(gain / 2.2, gain * 2.2), ylim=(scale / 2.2, scale * 2.2))
    axes.legend(loc="upper left")


def bar(error: float) -> float:
    """Return the length of an error's bar: none of an error that is not known."""
    return error if math.isfinite(error) and error > 0 else 0.0


def gain_over_iso(
    axes: Axes, isos: Sequence[float], gains: Sequence[float], errors: Sequence[float], usual: float, theme: Theme
) -> None:
    """Draw K over the ISO, and the line of the usual K / ISO."""
    ends = np.array([isos[0] / 1.3, isos[-1] * 1.3])
    axes.plot(ends, usual * ends, color=theme.theory, label="constant K / ISO")
    bars(axes, isos, gains, errors, theme)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    log_ticks(axes.yaxis, round(math.log10(high / low)))
    axes.set_ylabel("K [DN/e⁻]")
    axes.legend(loc="upper left")


def iso_axis(axes: Axes, isos: Sequence[float]) -> None:
    """Set up a logarithmic axis of ISOs."""
    axes.set_xscale("log")
    axes.set_xlabel("ISO")
    set_ticks(axes.xaxis, FixedLocator(list(isos[:: math.ceil(len(isos) / _ISOS_LABELLED)])))
    axes.set_xlim(isos[0] / 1.4, isos[-1] * 1.4)


def transfer_lines(
    main: Axes, below: Axes | None, names: Sequence[str], lines: Sequence[TransferLine], theme: Theme
) -> float:
    """Draw the variance over the signal with the fitted lines; below, if wanted, the deviations from them.

    Returns
    -------
    float
        The furthest deviation, in standard errors.
    """
    furthest = 0.0
    for name, line, marker, colour in zip(names, lines, MARKERS, theme.channels, strict=False):
        signal, variance, error = line.pooled(_LEVELS_SHOWN)
        deviation = (variance - line.variance_at(signal)) / error
        furthest = max(furthest, float(np.abs(deviation).max()))
        main.errorbar(signal, variance, yerr=error, fmt=marker, markersize=4, color=colour, label=name)
        if below is not None:
            below.plot(signal, deviation, marker, markersize=3.5, color=colour)
    ends = np.array([0.0, max(float(line.signal_dn.max()) for line in lines)])
    for index, line in enumerate(lines):
        main.plot(ends, line.variance_at(ends), color=theme.theory, label="fitted" if index == 0 else "_")
    main.set_ylabel("variance [DN²]")
    (below or main).set_xlabel("signal [DN]")
    legend_above(main, most=5)
    return furthest


# --- figures of their own -----------------------------------------------------------------------------------------


class Drawing(Figure):
    """A figure that a notebook shows whether or not pyplot was imported there."""

    def _repr_png_(self) -> bytes:
        """Draw the figure as a PNG, for notebooks."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def drawn_into(axes: Axes | None, title: str, draw: Callable[[Axes, Theme], object]) -> Figure:
    """Draw into the caller's axes, in their style, or into a new figure; return the figure."""
    if axes is None:
        return drawn_grid("", [(title, draw)])
    axes.set_title(drawable(title), parse_math=False)
    draw(axes, LIGHT)
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ArgumentError("ax is in no figure: it was removed from its own")
    return figure


def drawn_grid(title: str, draws: Sequence[tuple[str, Callable[[Axes, Theme], object]]]) -> Drawing:
    """Return a new figure of axes, each with its title, at most three in a row, on white: readable on any page."""
    columns = min(len(draws), 3 if len(draws) != 4 else 2)
    rows = -(-len(draws) // columns)
    width, height = SIZE_INCHES
    with use_style(LIGHT, **{"figure.facecolor": "white"}):
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
    """Return a text of at most so many letters, with a box for each letter that the plots' font lacks."""
    text = text if len(text) <= longest else f"{text[: longest - 1]}…"
    font = get_font(findfont("DejaVu Sans"))
    return "".join(letter if letter == "\n" or font.get_char_index(ord(letter)) else "□" for letter in text)


def nothing_to_draw(what: str, why: str) -> ArgumentError:
    """Return the error that a figure would be empty."""
    return ArgumentError(f"there is nothing to draw of {what}: {why}")
