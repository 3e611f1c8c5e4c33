"""What a person should know before believing a calibration: each remark says what was seen and what to do about it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import counted
from eldata.calibration.audit.frames import ADVISED_BIAS_FRAMES
from eldata.calibration.core.findings import BLACK, LIGHT
from eldata.calibration.iso_results import usual_gain_per_iso

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.frames import IsoFrames
    from eldata.calibration.iso_results import IsoCalibration, IsoGain

_LONGEST_BIAS_S = 1 / 250
_DRIFT_DN = 0.25  # of the error that it makes
_OF_DEFECTS_DN = 0.1
_LEAST_PAIRS = 4
_DISAGREEMENT = 6.0  # of K with what was stated, standard errors
_GAIN_TOLERANCE = 0.1  # of K / ISO around its median
_FAR, _JUMP = 0.03, 0.001  # of white: a colour bias, and its distance from that of other ISOs
_OF_OTHERS = 5.0  # times what the other ISOs' differ by


def bias_remarks(found: IsoCalibration, chosen: IsoFrames, lossy: str | None) -> tuple[str, ...]:
    """Return what the bias frames and the figures from them show."""
    rows, columns = found.rows.rows, found.rows.columns
    remarks = []
    if found.bias_frames < ADVISED_BIAS_FRAMES - 1:
        remarks.append(f"{found.bias_frames} bias frames were used; {ADVISED_BIAS_FRAMES} or more are advised")
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


def with_stated_black(isos: Sequence[IsoCalibration]) -> tuple[IsoCalibration, ...]:
    """Return the ISOs, with a finding on each whose colour bias is not like that of the others.

    It is beyond 3 % of white, or jumps: by more than a thousandth of white, the noise, and five times what the others
    differ by. One that jumps is withheld.
    """
    given = [one for one in isos if one.colour_bias is not None]
    means = {one.iso: float(np.mean(one.bias.bias_dn)) for one in given}
    found = []
    for one in isos:
        others = [mean for iso, mean in means.items() if iso != one.iso]
        if one.iso not in means or not others:
            found.append(one)
            continue
        usual, white, mean = float(np.median(others)), one.sensor.white_level_dn, means[one.iso]
        noise = 0.0 if one.read is None else one.read.sigma_gauss_dn
        moved, limit = (
            abs(mean - usual),
            max(_JUMP * white, noise, _OF_OTHERS * max(abs(other - usual) for other in others)),
        )
        jumps = moved > limit and abs(mean) > abs(usual)
        if not jumps and abs(mean) <= _FAR * white:
            found.append(one)
            continue
        black = float(np.mean(one.sensor.black_level_dn))
        text = (
            f"the bias frames' own black is {black + mean:.1f} DN, the files state {black:g} (a colour bias of "
            f"{mean:.3g} DN; at the other ISOs {usual:.3g})"
        )
        is_lit = any(finding.check == LIGHT.name for finding in one.findings)
        if not is_lit:
            text += ": the stated black is probably wrong at this ISO; look it up, and state it where you use the files"
        seen = BLACK.seen(moved, limit, text) if jumps else BLACK.seen(abs(mean), _FAR * white, text)
        # What other ISOs do not show is drawn with the gain of any (row="any").
        found.append(
            replace(one, findings=(*one.findings, seen.of("withheld", BLACK.figures) if jumps and not is_lit else seen))
        )
    return tuple(found)


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
