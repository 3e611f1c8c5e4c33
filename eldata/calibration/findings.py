"""Findings and remarks: what the frames show of the assumptions of the estimates, and what a person should know.

Each check (:mod:`eldata.calibration.checks`) leaves a finding for the figures that it touches: they are withheld, or
given with a larger error. A remark touches none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.fixed_pattern import ADVISED_FRAMES
from eldata.errors import ArgumentError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from eldata.calibration.frames import IsoFrames
    from eldata.calibration.results import IsoCalibration, IsoGain

Quantity = Literal["gain", "shape", "read noise", "row noise", "colour bias"]
"""What a calibration measures at one ISO. Shape is that of the read noise with its scale: lambda and sigma_TL."""

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
    figures: tuple[Quantity, ...]
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
        fate = f"withheld: {list_symbols(self.figures)}"
        if self.is_acceptable:
            fate += f"; to have it all the same, with a larger error: {self.option}"
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
        The share of a figure beyond which it is not given; up to it, its error allows for it. Infinite: it is never
        withheld, since the figures are those of the distribution of the family that is most like the noise.
    is_acceptable
        Whether a person may have what it withholds all the same: it knows how far off the figure may be.
    """

    name: str
    figures: tuple[Quantity, ...] = ()
    most_allowed: float = 0.05
    is_acceptable: bool = False

    def find(
        self,
        statistic: float,
        threshold: float,
        text: str,
        effect: Effect = "remark",
        figures: tuple[Quantity, ...] = (),
        allowance: float = 0.0,
    ) -> Finding:
        """Return a finding of this check; by default a remark."""
        return Finding(self.name, figures, effect, statistic, threshold, text, allowance)

    def judge(
        self, statistic: float, threshold: float, text: str, shares: Mapping[Quantity, tuple[float, float]]
    ) -> Iterator[Finding]:
        """Yield what follows from what was seen, given by what share it may put each figure off, and its own error."""
        off = {figure: share for figure, (share, _) in shares.items() if share > self.most_allowed}
        wider = {figure: share for figure, (share, error) in shares.items() if error < share <= self.most_allowed}
        if off:
            yield self.find(statistic, threshold, text, "withheld", tuple(off), max(off.values()))
        if wider:
            yield self.find(statistic, threshold, text, "wider", tuple(wider), max(wider.values()))
        if not off and not wider:
            yield self.find(statistic, threshold, text)


READ: Final[tuple[Quantity, ...]] = ("shape", "read noise")
_TOO_WIDE: Final = 0.1
"""Of K: beyond it, no error says how wrong it may be."""

LIGHT: Final = Check("light", (*READ, "colour bias"), is_acceptable=True)
CORRELATED: Final = Check("correlated noise", (*READ, "row noise"), is_acceptable=True)
COARSE: Final = Check("coarse values", (*READ, "row noise", "gain"), is_acceptable=True)
NO_LINE: Final = Check("uneven flats", ("gain",), _TOO_WIDE, is_acceptable=True)
FLATS_CORRELATED: Final = Check("correlation in flats", ("gain",), _TOO_WIDE, is_acceptable=True)
SATURATION: Final = Check("saturation", ("gain",))
UNEVEN: Final = Check("pairs of unequal brightness")
TRANSFER: Final = Check("photon transfer", ("gain",))
SHAPE: Final = Check("shape of the read noise", READ)
FIT: Final = Check("fit of the read noise", READ)
ROUNDING: Final = Check("rounding", (*READ, "row noise", "colour bias"))
CLIPPED: Final = Check("clipped black", (*READ, "row noise", "colour bias"))
STEP: Final = Check("a step over the ISOs")
BLACK: Final = Check("stated black", ("colour bias",))

CHECKS: Final = (
    *(LIGHT, CORRELATED, COARSE, NO_LINE, FLATS_CORRELATED, SATURATION),
    *(UNEVEN, TRANSFER, SHAPE, FIT, ROUNDING, CLIPPED, STEP, BLACK),
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
    """Return findings that give with a larger error what accepted checks among them would withhold."""
    return tuple(
        replace(one, effect="wider", is_accepted=True) if one.is_acceptable and one.check in accept else one
        for one in findings
    )


# --- remarks ----------------------------------------------------------------------------------------------------------

_LONGEST_BIAS_S = 1 / 250
_DRIFT_DN = 0.25  # of the error that it makes
_OF_DEFECTS_DN = 0.1
_LEAST_PAIRS = 4
_DISAGREEMENT = 6.0  # of K with what was stated, standard errors
_GAIN_TOLERANCE = 0.1  # of K / ISO around its median


def bias_remarks(found: IsoCalibration, chosen: IsoFrames, lossy: str | None) -> tuple[str, ...]:
    """Return what the bias frames and the figures from them show."""
    rows, columns = found.rows.rows, found.rows.columns
    remarks = []
    if found.bias_frames < ADVISED_FRAMES - 1:
        remarks.append(f"{found.bias_frames} bias frames were used; {ADVISED_FRAMES} or more are advised")
    if chosen.bias_exposure_s is not None and chosen.bias_exposure_s > _LONGEST_BIAS_S:
        remarks.append(
            f"the bias frames were exposed for {float(chosen.bias_exposure_s):g} s, so dark current is in them; take "
            "them at the camera's shortest exposure"
        )
    if lossy is not None:
        remarks.append(f"the files have {lossy}, which changes noise: no figure here is the sensor's own")
    if "row noise" in found.withheld:
        pass
    elif rows.sigma_dn == 0:
        remarks.append(f"no row noise was seen; {rows.sigma_error_dn:.2g} DN would just have been visible")
    elif rows.shapiro_p < 1e-3 and abs(rows.excess_kurtosis) > 0.5:
        remarks.append(
            f"the row noise is not normal (Shapiro-Wilk p = {rows.shapiro_p:.1g}, excess kurtosis "
            f"{rows.excess_kurtosis:.1f}); the model takes it for normal"
        )
    of_columns = columns.variance_dn2 > 5 * columns.variance_error_dn2 and columns.sigma_dn > 0.3 * rows.sigma_dn
    if of_columns and "row noise" not in found.withheld:
        remarks.append(
            f"columns have noise of their own, {columns.sigma_dn:.2g} DN, which the model leaves out and the read "
            "noise contains"
        )
    error = max(found.bias.standard_error_dn)
    if found.bias.drifts and error > _DRIFT_DN:
        remarks.append(f"black drifts from frame to frame: the colour bias is uncertain by {error:.2g} DN")
    of_defects = max(found.bias.of_defects_dn, key=abs)
    if abs(of_defects) > max(2 * error, _OF_DEFECTS_DN) and "colour bias" not in found.withheld:
        remarks.append(
            f"the colour bias is the mean of all pixels, as in the paper: {found.pattern.defects} defects make "
            f"{of_defects:.2g} DN of it"
        )
    if found.pattern.defects > 0.01 * found.pattern.pixels:
        remarks.append(
            f"{found.pattern.defects / found.pattern.pixels:.1%} of the pixels were left out: "
            f"{found.pattern.stuck / found.pattern.pixels:.1%} never change, "
            f"{found.pattern.off_level / found.pattern.pixels:.1%} are off the level of those around them"
        )
    compared = found.reproduction
    if compared is not None and compared.histogram_distance > max(4 * compared.histogram_distance_by_chance, 0.02):
        remarks.append(
            f"a bias frame kept out differs from simulated ones by {compared.histogram_distance:.1%} of its histogram "
            f"({compared.histogram_distance_by_chance:.1%} by chance)"
        )
    return tuple(remarks)


def no_pairs(chosen: IsoFrames) -> str:
    """Return the remark on an ISO whose K is not known."""
    what = (
        "no flat frames"
        if not chosen.single
        else f"{counted(len(chosen.single), 'flat frame')} and no two of one exposure"
    )
    return f"{what}, so K is not known: this ISO does not take part in the fits; take flats in pairs of equal exposure"


def flat_remarks(chosen: IsoFrames) -> tuple[str, ...]:
    """Return what the flats show."""
    remarks = []
    if chosen.single:
        names = ", ".join(record.path for record in chosen.single[:3])
        more = f" and {len(chosen.single) - 3} more" if len(chosen.single) > 3 else ""
        remarks.append(f"flats without a partner of the same exposure were left out: {names}{more}")
    if len(chosen.pairs) < _LEAST_PAIRS:
        remarks.append(
            f"K comes from {counted(len(chosen.pairs), 'pair')} of flats; {_LEAST_PAIRS} levels or more are advised"
        )
    return tuple(remarks)


def transfer_remarks(found: IsoGain) -> tuple[str, ...]:
    """Return what is to be said of K: what the photon transfer shows, and what somebody states."""
    transfer, sensor, remarks = found.transfer, found.sensor, list[str]()
    stated = found.stated_gain_dn_per_e
    if found.gain is not None and stated is not None:
        if found.gain.is_stated:
            remarks.append(f"K is stated, not measured: {stated:g} DN/e-")
        elif abs(stated - found.gain.value) > _DISAGREEMENT * found.gain.error:
            remarks.append(f"K is measured here, and the stated {stated:g} DN/e- does not count")
    if transfer is None:
        return tuple(remarks)
    if transfer.left_out > 0.5:
        remarks.append(
            f"{transfer.left_out:.0%} of the flats' area is saturated or clipped and was left out; expose less"
        )
    brightest = max(float(line.signal_dn.max()) for line in transfer.channels)
    share = brightest / (sensor.white_level_dn - float(np.mean(sensor.black_level_dn)))
    if share < 0.25:
        remarks.append(f"the brightest usable flat reaches {share:.0%} of the range; some nine tenths are better")
    return tuple(remarks)


def check_stated_black(isos: Sequence[IsoCalibration]) -> tuple[IsoCalibration, ...]:
    """Return the ISOs, with a finding on each whose colour bias is not like that of the others.

    It is beyond 3 % of white, or jumps: by more than a thousandth of white, the noise, and five times what the others
    differ by. One that jumps is withheld.
    """
    given = [one for one in isos if one.colour_bias is not None]
    means = {one.iso: float(np.mean(one.bias.bias_dn)) for one in given}
    judged = []
    for one in isos:
        others = [mean for iso, mean in means.items() if iso != one.iso]
        if one.iso not in means or not others:
            judged.append(one)
            continue
        usual, white, mean = float(np.median(others)), one.sensor.white_level_dn, means[one.iso]
        noise = 0.0 if one.read is None else one.read.sigma_gauss_dn
        scatter = max(abs(other - usual) for other in others)
        moved, limit, far = abs(mean - usual), max(0.001 * white, noise, 5.0 * scatter), 0.03 * white
        jumps = moved > limit and abs(mean) > abs(usual)
        if not jumps and abs(mean) <= far:
            judged.append(one)
            continue
        black = float(np.mean(one.sensor.black_level_dn))
        text = (
            f"the bias frames' own black is {black + mean:.1f} DN, the files state {black:g} (a colour bias of "
            f"{mean:.3g} DN; at the other ISOs {usual:.3g})"
        )
        is_lit = any(finding.check == LIGHT.name for finding in one.findings)
        if not is_lit:
            text += ": the stated black is probably wrong at this ISO; look it up, and state it where you use the files"
        # What other ISOs do not show is drawn with the gain of any (row="any").
        finding = BLACK.find(moved, limit, text) if jumps else BLACK.find(abs(mean), far, text)
        if jumps and not is_lit:
            finding = replace(finding, effect="withheld", figures=BLACK.figures)
        judged.append(replace(one, findings=(*one.findings, finding)))
    return tuple(judged)


def usual_gain_per_iso(isos: Iterable[IsoGain]) -> float:
    """Return the median of K / ISO, DN per electron at ISO 1; nan if no gain is known."""
    ratios = [one.gain_dn_per_e / one.iso for one in isos if one.gain_dn_per_e is not None]
    return float(np.median(ratios)) if ratios else math.nan


def overall_remarks(isos: Sequence[IsoGain]) -> list[str]:
    """Return what shows only when the ISOs are seen together."""
    ratios = {one.iso: one.gain_dn_per_e / one.iso for one in isos if one.gain_dn_per_e is not None}
    if len(ratios) < 3:
        return []
    usual = usual_gain_per_iso(isos)
    odd = {iso: ratio for iso, ratio in ratios.items() if abs(ratio - usual) > _GAIN_TOLERANCE * usual}
    if not odd:
        return []
    listed = ", ".join(f"ISO {iso:g} ({ratio / usual:.2f} of it)" for iso, ratio in odd.items())
    return [f"K / ISO is usually {usual:.4g} DN/e-, but not at {listed}: an extended ISO, or frames of another one?"]
