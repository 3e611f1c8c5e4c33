"""Plots of a page: SVG that looks the same everywhere.

Letters are drawn as outlines, the background is transparent, and the same data give the same bytes. Each plot comes for
a light and for a dark page.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.plots.axes import DARK, LIGHT, empty_figure, styled
from eldata.reports.html import plot_words

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

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


def draw_plot(
    report: str,
    kind: str,
    alt: str,
    draw: Callable[..., object],
    *,
    name: str = "",
    ratio: float | None = None,
    caption: str = "caption",
    more: str = "",
    words: Mapping[str, object] | None = None,
) -> Plot:
    """Draw a plot with the words of its kind.

    Parameters
    ----------
    report, kind
        Which file of words, and which title and caption in it.
    alt
        What it shows, in words.
    draw
        Draws: called with the axes, the upper ones first where there are two, and the theme.
    name
        Its identifier; by default its kind.
    ratio
        Of the heights of two axes (:func:`~eldata.plots.axes.empty_figure`); one axes by default.
    caption, more
        Which caption, and a further sentence.
    words
        What title and caption are completed by.
    """
    said = plot_words(report)[kind]
    buffer, name = io.BytesIO(), name or kind
    with styled(LIGHT, **{"svg.hashsalt": name}):
        figure, axes = empty_figure(ratio)
        draw(*axes, LIGHT)
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    light = _slimmed(buffer.getvalue().decode("utf-8"))
    # Only the colours of the dark page's plot differ, and drawing is what takes time.
    colours = dict(zip(_colours(LIGHT), _colours(DARK), strict=True))
    dark = re.sub("|".join(colours), lambda match: colours[match[0]], light)
    title, shown = (said[key].format(**(words or {})) for key in ("title", caption))
    return Plot(name, title, alt, shown + more, light.encode("utf-8"), dark.encode("utf-8"))


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


def _colours(theme: Theme) -> tuple[str, ...]:
    return (theme.ink, theme.grid, theme.theory, theme.found, *theme.channels)
