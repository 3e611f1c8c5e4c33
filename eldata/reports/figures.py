"""Plots of a page: SVG that looks the same everywhere.

Letters are drawn as outlines, the background is transparent, and the same data give the same bytes. Each plot comes for
a light and for a dark page.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.plots.axes import DARK, LIGHT, one_axes, styled

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.plots.axes import Theme


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
    buffer = io.BytesIO()
    with styled(theme, **{"svg.hashsalt": name}):
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
