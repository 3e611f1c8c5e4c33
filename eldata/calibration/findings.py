"""Findings: which assumption an ISO's frames do not keep, and what becomes of the figures that rest on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from eldata.errors import ArgumentError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

Quantity = Literal["gain", "shape", "read noise", "row noise", "colour bias"]
"""What a calibration measures at one ISO. Shape is that of the read noise with its scale: lambda and sigma_TL."""

Quantities: TypeAlias = tuple[Quantity, ...]

SYMBOLS: Final[Mapping[Quantity, str]] = {
    "gain": "K",
    "shape": "lambda, sigma_TL",
    "read noise": "sigma_G",
    "row noise": "sigma_row",
    "colour bias": "the colour bias",
}


def list_symbols(figures: Collection[Quantity]) -> str:
    """Return the figures' symbols as a list."""
    return ", ".join(symbol for figure, symbol in SYMBOLS.items() if figure in figures)


Effect = Literal["withheld", "wider", "remark"]

CHANCE: Final = 1e-5
"""That a check of bias frames speaks without a reason."""


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
    figures: Quantities
    effect: Effect
    statistic: float
    threshold: float
    text: str
    allowance: float = 0.0
    is_accepted: bool = False

    @property
    def is_acceptable(self) -> bool:
        """Whether withheld figures can be given with a larger error: not if they may be off by all of themselves."""
        most = math.inf if self.figures == ("colour bias",) else 1
        return self.effect == "withheld" and self.check in ACCEPTABLE and 0 < self.allowance < most

    @property
    def remark(self) -> str:
        """The text, and what becomes of the figures for it."""
        if self.effect == "remark" or not self.figures:
            return self.text
        fate = f"withheld: {list_symbols(self.figures)}"
        if self.is_acceptable:
            fate += f'; to have it all the same, with a larger error: --accept "{self.check}"'
        elif self.is_accepted:
            fate = f"accepted, with a larger error: {list_symbols(self.figures)}"
        elif self.effect == "wider":
            fate = f"errors made larger: {list_symbols(self.figures)}"
        return f"{self.text} ({fate})"


@dataclass(frozen=True, slots=True)
class Check:
    """What is looked at in the frames, and what of the figures rests on it.

    Attributes
    ----------
    name
        As docs/calibration.md lists it.
    figures
        What it withholds or gives with a larger error; empty: it only says what a person should know.
    most_allowed
        The share of a figure beyond which it is not given; up to it, its error allows for it.
    is_acceptable
        Whether a person may have what it withholds all the same: it knows how far off the figure may be.
    """

    name: str
    figures: Quantities = ()
    most_allowed: float = 0.05
    is_acceptable: bool = False

    def find(
        self, statistic: float, threshold: float, text: str, effect: Effect = "remark", figures: Quantities = (),
        allowance: float = 0.0,
    ) -> Finding:  # fmt: skip
        """Return a finding of this check; by default a remark."""
        return Finding(self.name, figures, effect, statistic, threshold, text, allowance)

    def withhold(
        self, statistic: float, threshold: float, text: str, figures: Quantities = (), allowance: float = 0.0
    ) -> Finding:
        """Return the finding that figures are withheld, by default all of this check."""
        return self.find(statistic, threshold, text, "withheld", figures or self.figures, allowance)

    def judge(
        self, statistic: float, threshold: float, text: str, shares: Mapping[Quantity, tuple[float, float]]
    ) -> Iterator[Finding]:
        """Yield the findings that follow, given the share by which each figure may be off, and its own error."""
        lost = {figure: share for figure, (share, _) in shares.items() if share > self.most_allowed}
        wider = {figure: share for figure, (share, error) in shares.items() if error < share <= self.most_allowed}
        if lost:
            yield self.withhold(statistic, threshold, text, tuple(lost), max(lost.values()))
        if wider:
            yield self.find(statistic, threshold, text, "wider", tuple(wider), max(wider.values()))
        if not lost and not wider:
            yield self.find(statistic, threshold, text)


READ: Final[Quantities] = ("shape", "read noise")
_TOO_WIDE: Final = 0.1
"""Of K: beyond it, no error says how wrong it may be."""

LIGHT: Final = Check("light", (*READ, "colour bias"), is_acceptable=True)
CORRELATED: Final = Check("correlated noise", (*READ, "row noise"), is_acceptable=True)
COARSE: Final = Check("coarse values", (*READ, "row noise", "gain"), is_acceptable=True)
NO_LINE: Final = Check("uneven flats", ("gain",), _TOO_WIDE, is_acceptable=True)
FLATS_CORRELATED: Final = Check("correlation in flats", ("gain",), _TOO_WIDE, is_acceptable=True)
SATURATION: Final = Check("saturation", ("gain",))
TRANSFER: Final = Check("photon transfer", ("gain",))
SHAPE: Final = Check("shape of the read noise", READ)
FIT: Final = Check("fit of the read noise", READ)
ROUNDING: Final = Check("rounding", (*READ, "row noise", "colour bias"))
CLIPPED: Final = Check("clipped black", (*READ, "row noise", "colour bias"))
STEP: Final = Check("a step over the ISOs")
BLACK: Final = Check("stated black", ("colour bias",))

CHECKS: Final = (
    *(LIGHT, CORRELATED, COARSE, NO_LINE, FLATS_CORRELATED, SATURATION),
    *(TRANSFER, SHAPE, FIT, ROUNDING, CLIPPED, STEP, BLACK),
)
"""Every one that there is."""

ACCEPTABLE: Final = tuple(check.name for check in CHECKS if check.is_acceptable)
"""Checks that know how far off a figure may be that they withhold: it can be accepted with that for its error."""


def check_acceptance(accept: Iterable[str]) -> tuple[str, ...]:
    """Return the names of checks to be accepted; :class:`ArgumentError` if one of them is not a check that can be."""
    names = (accept,) if isinstance(accept, str) else tuple(accept)
    for name in names:
        if name not in ACCEPTABLE:
            raise ArgumentError(
                f"{name!r} is not a check whose withheld figures can be accepted; known are "
                f"{', '.join(map(repr, ACCEPTABLE))}{did_you_mean(str(name), ACCEPTABLE)}"
            )
    return names


def accept_findings(findings: Iterable[Finding], accept: Collection[str]) -> tuple[Finding, ...]:
    """Change findings of accepted checks: figures get a larger error instead of being withheld."""
    return tuple(
        replace(one, effect="wider", is_accepted=True) if one.is_acceptable and one.check in accept else one
        for one in findings
    )
