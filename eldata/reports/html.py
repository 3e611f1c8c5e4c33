"""What the pages of every report share: templates, plots, and the signs that a page has and a terminal may not.

A page is one file: images and style inside, nothing from the network, and no script but ours where a page has one. Its
plots are SVG that looks the same everywhere: letters are outlines, the background is transparent, the same data give
the same bytes, and each comes for a light and for a dark page.
"""

from __future__ import annotations

import base64
import hashlib
import io
import math
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

from eldata import __version__
from eldata.base.fields import shipped_toml
from eldata.base.tables import with_error
from eldata.base.visible import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

TEMPLATES = Path(__file__).parent / "templates"


def render_page(template: str, templates: Path = TEMPLATES, /, **values: object) -> str:
    """Return a page from a template in the folder ``templates``; every text that is put in is escaped.

    It states the template's name as its generator, by which the next run knows its own page.
    """
    page = Path(template).stem
    return _make_environment(templates).get_template(template).render(version=__version__, page=page, **values)


def render_with_script(template: str, *more: str, **values: object) -> str:
    """Return a page whose template puts ``script`` into a script element, as it is; no other may run there.

    It is evaluation.js, and after it the scripts named in ``more``: they sort tables, move sliders and link crops.
    """
    script = "\n".join((TEMPLATES / name).read_text(encoding="utf-8") for name in ("evaluation.js", *more))
    return render_page(template, script=script, script_policy=f"; script-src '{policy_hash(script)}'", **values)


def policy_hash(text: str) -> str:
    """Hash a script or style, as a page's policy names the one that may run."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"


@cache
def _make_environment(templates: Path) -> jinja2.Environment:
    """Make a jinja2 environment that escapes every text and refuses undefined names."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_make_visible,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    filters = (uri, typeset, signed, prose)
    environment.filters |= {function.__name__: function for function in filters}
    return environment


def _make_visible(value: object) -> object:
    """Return a value for a page with only characters that show."""
    # Of what is markup already, autoescape and our own filters have made every part.
    return visible(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def uri(picture: bytes, kind: str) -> str:
    """Return a picture, of a kind such as ``png``, as the address of itself."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode('ascii')}"


_TYPESET = (
    (re.compile(r"DN\^2"), "DN²"),
    (re.compile(r"\be-(?!\w)"), "e⁻"),
    (re.compile(r"\bsigma_"), "σ "),
    (re.compile(r"(?<![\w-])sigma\b"), "σ"),
    (re.compile(r"(?<![\w-])lambda\b"), "λ"),
    (re.compile(r"\bR2\b"), "R²"),
)


def typeset(text: str) -> str:
    """Return a symbol or a unit with the signs that a page has and a terminal may not."""
    for plain, sign in _TYPESET:
        text = plain.sub(sign, text)
    return text


def signed(text: str) -> str:
    """Return a number with a minus sign instead of its hyphen."""
    return text.replace("-", "−")


def prose(text: str) -> str:
    """Return a sentence with typeset symbols, and minus signs where a number is negative."""
    return re.sub(r"(?<![\w.)-])-(?=\.?\d)", "−", typeset(text))


def digits(value: float, count: int = 3) -> str:
    """Return a number with ``count`` significant digits; "not known" if it is not finite."""
    return signed(f"{value:.{count}g}") if math.isfinite(value) else "not known"


def format_measured(value: float, error: float, unit: str = "") -> str:
    """Return a value with its standard error, where it has one, and its unit."""
    if not math.isfinite(value):
        return "not known"
    return f"{signed(with_error(value, error))} {unit}".rstrip()


def format_count(count: int) -> str:
    """Return a count with its digits in threes."""
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def join_words(items: Sequence[str]) -> str:
    """Return items in a sentence: with commas, and "and" before the last."""
    return " and ".join([", ".join(items[:-1]), items[-1]]) if len(items) > 1 else items[0]


# --- plots --------------------------------------------------------------------------------------------------------


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
    report: str, kind: str, alt: str, draw: Callable[..., object], *,
    name: str = "", ratio: float | None = None, caption: str = "caption", more: str = "",
    words: Mapping[str, object] | None = None,
) -> Plot:  # fmt: skip
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
    from eldata.plots.axes import DARK, LIGHT, empty_figure, use_style  # pages without plots do without matplotlib

    said = shipped_toml(TEMPLATES / f"{report}.toml")[kind]
    buffer, name = io.BytesIO(), name or kind
    with use_style(LIGHT, **{"svg.hashsalt": name}):
        figure, axes = empty_figure(ratio)
        draw(*axes, LIGHT)
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    light = _slim_svg(buffer.getvalue().decode("utf-8"))
    # Only the colours of the dark page's plot differ, and drawing is what takes time.
    inks = ((one.ink, one.grid, one.theory, one.found, *one.channels) for one in (LIGHT, DARK))
    colours = dict(zip(*inks, strict=True))
    dark = re.sub("|".join(colours), lambda match: colours[match[0]], light)
    title, shown = (said[key].format(**(words or {})) for key in ("title", caption))
    return Plot(name, title, alt, shown + more, light.encode("utf-8"), dark.encode("utf-8"))


def _slim_svg(svg: str) -> str:
    """Shorten an SVG to about half its characters, the picture unchanged: a page holds a hundred of them."""
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
    changes = 1
    while changes:
        svg, changes = re.subn(r"<g>((?:(?!</?g[ >]).)*)</g>", r"\1", svg)  # groups that say nothing
    return svg
