"""Figures: named numbers with a unit, each declared once. Tables, pages, drawings, files and help read the declaration.

Drawings are another thing: :mod:`eldata.plots` and :mod:`eldata.reports.figures`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

from eldata.base.tables import with_error

if TYPE_CHECKING:
    from collections.abc import Iterable

Better = Literal["higher", "lower", "neither"]

WITHHELD = "withheld"
"""In place of a value that an assumption forbids to give."""

NOT_KNOWN = "-"
"""In place of a value that there is none of."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """What is said of a number wherever it is shown: a score, such as PSNR, or a camera's, such as K.

    Attributes
    ----------
    name
        Its column in CSV and key in JSON, such as ``psnr_db``.
    label
        What tables and sentences call it, in plain letters, such as ``PSNR`` or ``sigma_TL``.
    meaning
        One line that says what it is.
    unit
        In plain letters, such as ``dB`` or ``DN/e-``; empty: it has none.
    symbol
        What pages and drawings call it, such as ``σ TL``. Default: the label.
    decimals
        Of a mean in a table; ``None``: as many as its standard error warrants.
    difference_decimals, single_decimals
        Of a difference of two, and of one value among many. Default: ``decimals``.
    better
        Which of two values is the better one.
    needs
        What it is computed from, in words, such as ``flat-field frames``.
    computed_by
        The function that does it, ``module:name``, so that a declaration imports nothing; empty: it is not told.
    """

    name: str
    label: str
    meaning: str
    unit: str = ""
    symbol: str = ""
    decimals: int | None = None
    difference_decimals: int | None = None
    single_decimals: int | None = None
    better: Better = "neither"
    needs: tuple[str, ...] = ()
    computed_by: str = ""

    def __post_init__(self) -> None:
        for name, default in (
            ("symbol", self.label),
            ("difference_decimals", self.decimals),
            ("single_decimals", self.decimals),
        ):
            if getattr(self, name) in ("", None):
                object.__setattr__(self, name, default)

    @property
    def heading(self) -> str:
        """Its label with the unit, as the head of a column of text, Markdown and LaTeX: ``PSNR [dB]``."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def page_heading(self) -> str:
        """Its symbol with the unit, as pages, notebooks and drawings have it: ``K [DN/e⁻]``."""
        return f"{self.symbol} [{self.page_unit}]" if self.unit else self.symbol

    @property
    def page_unit(self) -> str:
        """The unit as pages have it."""
        return self.unit.replace("e-", "e\N{SUPERSCRIPT MINUS}")

    @property
    def sign(self) -> int:
        """1 if a higher value is better, -1 if a lower one is, else 0: times a difference, who is ahead."""
        return {"higher": 1, "lower": -1, "neither": 0}[self.better]

    def format(self, value: float | None, error: float = math.nan) -> str:
        """Return a value as tables show it.

        Parameters
        ----------
        value
            ``None`` is ``withheld``, nan ``-``, an infinite one ``inf``.
        error
            Its standard error, which decides the digits of a figure without ``decimals``.
        """
        return self._written(value, self.decimals, error)

    def format_single(self, value: float | None) -> str:
        """Return one value among many, such as one image's, as :meth:`format` does a mean."""
        return self._written(value, self.single_decimals)

    def format_difference(self, value: float | None) -> str:
        """Return a difference of two values with its sign."""
        decimals = self.difference_decimals
        if value is None or math.isnan(value) or decimals is None:
            return self._written(value, decimals)
        return f"{value:+.{decimals}f}"

    def _written(self, value: float | None, decimals: int | None, error: float = math.nan) -> str:
        if value is None:
            return WITHHELD
        if math.isnan(value):
            return NOT_KNOWN
        return with_error(value, error) if decimals is None else f"{value:.{decimals}f}"


AnyFigure = TypeVar("AnyFigure", bound=Figure)


def by_name(figures: Iterable[AnyFigure]) -> dict[str, AnyFigure]:
    """Return a room's registry: its figures by their names, in their order.

    Raises
    ------
    ValueError
        If two have one name.
    """
    registry: dict[str, AnyFigure] = {}
    for figure in figures:
        if figure.name in registry:
            raise ValueError(f"two figures are called {figure.name}")
        registry[figure.name] = figure
    return registry
