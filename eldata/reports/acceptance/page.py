"""The acceptance test of a noise model as one HTML page."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from eldata.calibration.acceptance.verdicts import LIMIT, parameter_rows
from eldata.reports.acceptance.plots import acceptance_plots
from eldata.reports.html import rendered

if TYPE_CHECKING:
    from eldata.calibration.acceptance.results import Acceptance, FrameStatistic, IsoAcceptance
    from eldata.reports.figures import Plot


def acceptance_page(acceptance: Acceptance) -> str:
    """Return the page; the same result gives the same text."""
    return rendered(
        "acceptance.html",
        acceptance=acceptance,
        isos=[_Iso(one) for one in acceptance.isos],
        limit=LIMIT,
    )


class _Iso:
    """What the page shows of one ISO."""

    def __init__(self, found: IsoAcceptance) -> None:
        self.found = found
        self.name = f"{found.iso:g}"
        self.parameters = parameter_rows(found.parameters)
        self.plots: tuple[Plot, ...] = acceptance_plots(found)
        self.groups: list[tuple[str, tuple[FrameStatistic, ...]]] = [
            (check, tuple(group)) for check, group in groupby(found.statistics, lambda one: one.check)
        ]
