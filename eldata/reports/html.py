"""What the pages of every report share: templates, and the signs that a page has and a terminal may not.

A page is one file: images and style inside, nothing from the network, and no script but ours where a page has one.
"""

from __future__ import annotations

import base64
import hashlib
import math
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2

from eldata import __version__
from eldata.base.fields import TextFile
from eldata.base.tables import with_error
from eldata.base.visible import visible
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Mapping

TEMPLATES = Path(__file__).parent / "templates"


def rendered(template: str, templates: Path = TEMPLATES, /, **values: object) -> str:
    """Return a page from a template in the folder ``templates``; every text that is put in is escaped.

    It states the template's name as its generator, by which the next run knows its own page.
    """
    page = Path(template).stem
    return _environment(templates).get_template(template).render(version=__version__, page=page, **values)


def rendered_with_script(template: str, *more: str, **values: object) -> str:
    """Return a page whose template puts ``script`` into a script element, as it is; no other may run there.

    It is evaluation.js, and after it the scripts named in ``more``: they sort tables, move sliders and link crops.
    """
    script = "\n".join((TEMPLATES / name).read_text(encoding="utf-8") for name in ("evaluation.js", *more))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return rendered(template, script=script, script_policy=f"; script-src 'sha256-{digest}'", **values)


@cache
def plot_words(report: str) -> Mapping[str, Any]:
    """Return the title and the caption of each kind of plot and picture of a report, from its file of words."""
    return TextFile(TEMPLATES / f"{report}.toml", EldataError).toml().data


@cache
def _environment(templates: Path) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_seen,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    filters = (uri, typeset, signed, prose)
    environment.filters |= {function.__name__: function for function in filters}
    return environment


def _seen(value: object) -> object:
    """Return what is put in a page with only characters that show."""
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
    """Return a number with a minus sign in place of its hyphen."""
    return text.replace("-", "−")


def prose(text: str) -> str:
    """Return a sentence with typeset symbols, and minus signs where a number is negative."""
    return re.sub(r"(?<![\w.)-])-(?=\.?\d)", "−", typeset(text))


def digits(value: float, count: int = 3) -> str:
    """Return a number with ``count`` significant digits; "not known" for what is not a number."""
    return signed(f"{value:.{count}g}") if math.isfinite(value) else "not known"


def measured(value: float, error: float, unit: str = "") -> str:
    """Return a value with its standard error, where it has one, and its unit."""
    if not math.isfinite(value):
        return "not known"
    return f"{signed(with_error(value, error))} {unit}".rstrip()


def grouped(count: int) -> str:
    """Return a count with its digits in threes."""
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
