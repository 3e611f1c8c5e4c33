"""What the estimates assume, and what became of it: each check leaves a finding for each figure that it touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Iterable

Figure = Literal["gain", "read noise", "row noise", "colour bias"]
"""What a calibration measures at one ISO. Read noise is lambda, sigma_TL and sigma_G."""

Effect = Literal["withheld", "wider", "remark"]


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
        What was seen, and what to do about it, in a sentence or two.
    allowance
        Of effect ``"wider"``: what is added in quadrature to the standard errors, as a share of the figure (of lambda:
        as it is).
    """

    check: str
    figures: tuple[Figure, ...]
    effect: Effect
    statistic: float
    threshold: float
    text: str
    allowance: float = 0.0


def withheld(findings: Iterable[Finding]) -> frozenset[Figure]:
    """Return the figures that are not given."""
    return frozenset(figure for one in findings if one.effect == "withheld" for figure in one.figures)
