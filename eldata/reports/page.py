"""The diagnostics as one HTML page: images and style inside, no script, nothing from the network."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

from eldata import __version__
from eldata.reports.comparison import LIMIT
from eldata.reports.diagnostics import CHANNELS, parameter_rows
from eldata.reports.plots import plots

if TYPE_CHECKING:
    from eldata.reports.comparison import Comparison, Diagnostics

_TEMPLATES = Path(__file__).parent / "templates"


def profile_page(diagnostics: Diagnostics) -> str:
    """Return the page; the same diagnostics give the same text."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.filters["typeset"] = _typeset
    environment.filters["signed"] = _signed
    groups = [
        _Group.of(check, tuple(comparisons))
        for check, comparisons in groupby(diagnostics.comparisons, lambda item: item.check)
    ]
    return environment.get_template("profile.html").render(
        diagnostics=diagnostics,
        profile=diagnostics.profile,
        parameters=parameter_rows(diagnostics.parameters),
        groups=groups,
        plots=plots(diagnostics),
        channels=CHANNELS,
        limit=LIMIT,
        version=__version__,
    )


@dataclass(frozen=True, slots=True)
class _Group:
    """A table: its caption, the heading and the labels of its first column, and the comparisons."""

    title: str
    heading: str
    labels: tuple[str, ...]
    comparisons: tuple[Comparison, ...]

    @classmethod
    def of(cls, check: str, comparisons: tuple[Comparison, ...]) -> _Group:
        units = {item.unit for item in comparisons}
        unit = comparisons[0].unit if len(units) == 1 else ""
        title = check[:1].upper() + check[1:] + (f" [{unit}]" if unit not in ("", "1") else "")
        labels = [item.symbol if unit else f"{item.symbol} [{item.unit}]" for item in comparisons]
        # What all labels begin with is said once.
        for heading, start in (("signal", "at "), ("quantile", "quantile ")):
            if all(label.startswith(start) for label in labels):
                return cls(title, heading, tuple(label.removeprefix(start) for label in labels), comparisons)
        return cls(title, "quantity", tuple(labels), comparisons)

    @property
    def off(self) -> tuple[Comparison, ...]:
        return tuple(item for item in self.comparisons if item.verdict == "off")

    @property
    def worst(self) -> Comparison:
        return max(self.comparisons, key=lambda item: abs(item.deviation or 0.0))


def _data_uri(svg: bytes) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode('ascii')}"


_TYPESET = (("DN^2", "DN²"), ("e-", "e⁻"), ("sigma_", "σ "), (" sigma", " σ"), ("lambda", "λ"))


def _typeset(text: str) -> str:
    """Return a symbol or a unit with the signs that a page has and a terminal may not."""
    for plain, typeset in _TYPESET:
        text = text.replace(plain, typeset)
    return text


def _signed(text: str) -> str:
    """Return a number with a minus sign in place of its hyphen."""
    return text.replace("-", "−")
