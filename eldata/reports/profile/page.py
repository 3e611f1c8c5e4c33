"""The diagnostics of a noise profile as one HTML page."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from eldata.calibration.acceptance.verdicts import CHANNELS, LIMIT, parameter_rows
from eldata.reports.html import rendered
from eldata.reports.profile.plots import plots

if TYPE_CHECKING:
    from eldata.calibration.acceptance.verdicts import Diagnostics, TheoryCheck


def profile_page(diagnostics: Diagnostics) -> str:
    """Return the page; the same diagnostics give the same text."""
    groups = [
        _Group.of(check, tuple(comparisons))
        for check, comparisons in groupby(diagnostics.comparisons, lambda item: item.check)
    ]
    return rendered(
        "profile.html",
        diagnostics=diagnostics,
        profile=diagnostics.profile,
        parameters=parameter_rows(diagnostics.parameters),
        groups=groups,
        plots=plots(diagnostics),
        channels=CHANNELS,
        limit=LIMIT,
    )


@dataclass(frozen=True, slots=True)
class _Group:
    """A table: its caption, the heading and the labels of its first column, and the comparisons."""

    title: str
    heading: str
    labels: tuple[str, ...]
    comparisons: tuple[TheoryCheck, ...]

    @classmethod
    def of(cls, check: str, comparisons: tuple[TheoryCheck, ...]) -> _Group:
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
    def off(self) -> tuple[TheoryCheck, ...]:
        return tuple(item for item in self.comparisons if item.verdict == "off")

    @property
    def worst(self) -> TheoryCheck:
        return max(self.comparisons, key=lambda item: abs(item.deviation or 0.0))
