"""What the estimates assume, and what became of it: each check leaves a finding for each figure that it touches."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

from eldata.base.tables import with_error
from eldata.errors import ArgumentError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

Figure = Literal["gain", "read noise", "row noise", "colour bias"]
"""What a calibration measures at one ISO. Read noise is lambda, sigma_TL and sigma_G."""

SYMBOLS: Final[Mapping[Figure, str]] = {
    "gain": "K",
    "read noise": "lambda, sigma_TL, sigma_G",
    "row noise": "sigma_row",
    "colour bias": "the colour bias",
}


def named(figures: Collection[Figure]) -> str:
    """Return the figures' symbols as a list."""
    return ", ".join(symbol for figure, symbol in SYMBOLS.items() if figure in figures)


Effect = Literal["withheld", "wider", "remark"]

ACCEPTABLE: Final = (
    *("light", "dark signal", "correlated noise", "filtered outliers", "coarse values", "banding", "slow row drift"),
    *("bent photon transfer", "channels' gains", "correlation in flats"),
)
"""Checks that know how far off a figure may be that they withhold: it can be accepted with that for its error."""


def checked_acceptance(accept: Iterable[str]) -> tuple[str, ...]:
    """Return the names of checks to be accepted; :class:`ArgumentError` if one of them is not a check that can be."""
    names = (accept,) if isinstance(accept, str) else tuple(accept)
    for name in names:
        if name not in ACCEPTABLE:
            raise ArgumentError(
                f"{name!r} is not a check whose withheld figures can be accepted; known are "
                f"{', '.join(map(repr, ACCEPTABLE))}{did_you_mean(str(name), ACCEPTABLE)}"
            )
    return names


@dataclass(frozen=True, slots=True)
class Finding:
    """One check of one ISO's frames that an assumption did not pass.

    Attributes
    ----------
    check
        Its name, as docs/calibration.md lists it.
    figures
        The figures that rest on the assumption; empty for a remark.
    effect
        ``"withheld"``: the figures are not given. ``"wider"``: their errors are made larger by ``allowance``.
        ``"remark"``: the figures hold, and a person should know.
    statistic, threshold
        What the check measured, and beyond what it speaks.
    text
        What was seen, and what to do about it, in a sentence or two. What becomes of the figures is added to it.
    allowance
        What is added in quadrature to the standard errors of effect ``"wider"``, as a share of the figure; of lambda as
        it is, of the colour bias in DN. Of effect ``"withheld"``: what would be, if the finding is accepted.
    is_accepted
        Whether the figures would be withheld, and are given because somebody has accepted the check.
    """

    check: str
    figures: tuple[Figure, ...]
    effect: Effect
    statistic: float
    threshold: float
    text: str
    allowance: float = 0.0
    is_accepted: bool = False

    @property
    def is_acceptable(self) -> bool:
        """Whether withheld figures can be given with a larger error: not if they may be off by all of themselves."""
        is_small = 0 < self.allowance < (math.inf if self.figures == ("colour bias",) else 1)
        return self.effect == "withheld" and self.check in ACCEPTABLE and is_small

    @property
    def option(self) -> str:
        """How ``eldata calibrate`` is told to accept this check."""
        return f'--accept "{self.check}"'

    @property
    def remark(self) -> str:
        """The text, and what becomes of the figures for it."""
        if self.effect == "remark" or not self.figures:
            return self.text
        fate = f"withheld: {named(self.figures)}"
        if self.is_acceptable:
            fate += f"; to have it all the same, with a larger error: {self.option}"
        elif self.is_accepted:
            fate = f"accepted, with a larger error: {named(self.figures)}"
        elif self.effect == "wider":
            fate = f"errors made larger: {named(self.figures)}"
        return f"{self.text} ({fate})"


@dataclass(frozen=True, slots=True)
class GivenFigure:
    """A figure as it is given.

    Attributes
    ----------
    value
        The figure.
    error
        Its standard error with all allowances; nan if it is not known.
    is_stated
        Whether it was not measured: somebody has said so.
    """

    value: float
    error: float
    is_stated: bool = False

    @property
    def text(self) -> str:
        """The figure with its error in as many digits as they bear; a stated one says that it is."""
        return with_error(self.value, self.error) + (" (stated)" if self.is_stated else "")


def given(findings: Iterable[Finding], figure: Figure, value: float, error: float, scale: float) -> GivenFigure | None:
    """Return a figure with what findings add to its error, each a share of ``scale``; ``None`` if it is withheld."""
    of_it = [one for one in findings if figure in one.figures]
    if any(one.effect == "withheld" for one in of_it):
        return None
    return GivenFigure(value, math.hypot(error, *(one.allowance * scale for one in of_it if one.effect == "wider")))


def with_accepted(findings: Iterable[Finding], accept: Collection[str]) -> tuple[Finding, ...]:
    """Return findings that give with a larger error what accepted checks among them would withhold."""
    return tuple(
        replace(one, effect="wider", is_accepted=True) if one.is_acceptable and one.check in accept else one
        for one in findings
    )


def withheld(findings: Iterable[Finding]) -> frozenset[Figure]:
    """Return the figures that are not given."""
    return frozenset(figure for one in findings if one.effect == "withheld" for figure in one.figures)


def widened(findings: Iterable[Finding]) -> frozenset[Figure]:
    """Return the figures that are given with a larger error."""
    found = tuple(findings)
    return frozenset(figure for one in found if one.effect == "wider" for figure in one.figures) - withheld(found)
