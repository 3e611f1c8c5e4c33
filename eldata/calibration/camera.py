"""A camera's bias and flat-field frames to its noise profile."""

from __future__ import annotations

import copy
import math
from contextlib import suppress
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from eldata import __version__
from eldata.base.numbers import checked_number, counted
from eldata.base.workers import AnyWorkers, Failed, Workers, require_files
from eldata.calibration.checks import take_step
from eldata.calibration.frames import WHOLE, FramesError, IsoFrames, check_crop, crop_text, picture_crop, sort_frames
from eldata.calibration.iso_results import (
    BLACK,
    LIGHT,
    FailedIso,
    IsoCalibration,
    IsoGain,
    check_acceptance,
    fill_sentence,
)
from eldata.calibration.joint import fit_modes, whole_ranges
from eldata.calibration.one_iso import calibrate_iso, decodings
from eldata.calibration.results import Calibration
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.errors import ArgumentError
from eldata.manifest.verify_report import Problem
from eldata.noise.profile import CameraProfile, profile_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from eldata.calibration.iso_results import Finding

_LEVELS_APART = 0.001  # of the range


def calibrate(
    frames: CalibrationFrames | Path | str,
    camera: str | None = None,
    *,
    isos: Collection[int] | None = None,
    gains: Mapping[float, float] | CameraProfile | None = None,
    modes: Sequence[float] | None = None,
    accept: Collection[str] = (),
    crop: tuple[slice, slice] | None = None,
    workers: AnyWorkers = 1,
) -> Calibration:
    """Measure a camera's noise from its bias and flat-field frames (sections 3.2.1 and 3.2.2 of the paper).

    Parameters
    ----------
    frames
        The frames, or the folder that holds them (:class:`~eldata.datasets.calibration_frames.CalibrationFrames`).
    camera
        The camera's name, if a folder is given and holds several, or if the profile is to have another name.
    isos
        Only these ISOs, if a folder is given.
    gains
        System gain K [DN/e-] by ISO, or a profile that knows it, for ISOs whose flats are missing or do not give it.
        A measured K counts before a stated one, and a stated one is marked as such.
    modes
        The first ISO of each gain mode of the camera but the lowest, such as ``[2000]``; an empty list for a camera
        that has one. By default it has one too, and a step over the ISOs that looks like another is remarked.
    accept
        Names of checks, such as ``("light",)``: figures that they withhold are given with a larger error, and the
        profile says so (``accepted``). The remarks name the checks that can be accepted.
    crop
        Rows and columns of the mosaics to use, such as ``np.s_[8:-8, 16:]``. By default all but a border without
        picture, if the first bias frame or the first flat shows one (:func:`~eldata.raw.damage.picture_area`): a remark
        names it.
    workers
        Number of threads that decode, or an executor that measures whole ISOs side by side, with a thread each
        (:mod:`eldata.base.workers`). The figures do not depend on it, and the memory hardly does.

    Returns
    -------
    Calibration
        Figures with standard errors by ISO, fits, remarks, and the profile for the noise model. ISOs whose frames are
        missing, unreadable or unfit are not in it: ``failed`` has them, with every problem by file.

    Raises
    ------
    FramesError
        If that is so of every ISO.
    ArgumentError
        If ``isos`` is given with frames that are chosen already, ``workers`` is not positive, ``gains`` holds what
        is not a gain or belongs to no ISO of the frames, ``modes`` are not ascending ISOs among
        those of the frames, ``accept`` names what is no check or one that leaves nothing to give, or ``crop`` is not
        two slices without a step.
    DatasetError
        If there are no frames.

    References
    ----------
    K. Wei, Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography", IEEE
    Transactions on Pattern Analysis and Machine Intelligence, 2021.

    Examples
    --------
    >>> from eldata import CalibrationFrames, calibrate
    >>> frames = CalibrationFrames("eldata-calibration/data/calibration", "DemoGamma", isos=[100, 400, 1600])
    >>> calibration = calibrate(frames)
    >>> [round(row.gain_dn_per_e, 1) for row in calibration.profile.rows]
    [0.1, 0.4, 1.5]
    """
    if not isinstance(frames, CalibrationFrames):
        frames = CalibrationFrames(frames, camera, isos=isos)
    elif isos is not None:
        raise ArgumentError("isos is for a folder; choose them with CalibrationFrames(..., isos=...)")
    workers, accept = Workers.of(workers), check_acceptance(accept)
    stated = stated_gains(frames, gains)
    starts = None if modes is None else _check_starts(frames, modes)
    # The headers of a folder are read here: they are small, and an executor takes whole ISOs.
    chosen = sort_frames(frames, Workers(workers.jobs))
    failed = [FailedIso(float(of_iso.iso), of_iso.problems) for of_iso in chosen if of_iso.problems]
    usable = [of_iso for of_iso in chosen if not of_iso.problems]
    area = picture_crop(frames, usable) if crop is None else check_crop(crop)
    usable = [
        replace(of_iso, stated_gain_dn_per_e=stated.get(float(of_iso.iso)), accept=accept, crop=area or WHOLE)
        for of_iso in usable
    ]
    notes = []
    if area is not None:
        why = "around them there is no picture (--crop states another area)" if crop is None else "as stated"
        notes = [fill_sentence("remarks.area", area=crop_text(area), why=why)]
    measured = []
    for of_iso, outcome in zip(usable, _calibrate(frames, usable, workers), strict=True):
        if isinstance(outcome, FramesError):
            failed.append(FailedIso(float(of_iso.iso), outcome.problems))
        else:
            measured.append(outcome)
    if not measured:
        problems = [problem for left_out in failed for problem in left_out.problems]
        raise FramesError(sorted(problems, key=lambda problem: problem.path))
    return join_isos(camera or frames.camera, measured, failed, starts, notes)


def _check_starts(frames: CalibrationFrames, modes: Sequence[float]) -> tuple[float, ...]:
    """Check the stated first ISOs of the further gain modes: ascending, within the frames' range."""
    low, high = min(frames.isos), max(frames.isos)
    starts = tuple(checked_number("modes", iso, above=float(low)) for iso in modes)
    if any(iso > high for iso in starts) or list(starts) != sorted(set(starts)):
        raise ArgumentError(
            f"modes are the first ISOs of the further gain modes, ascending, above ISO {float(low):g} and up to "
            f"{float(high):g}, those of the frames; found {', '.join(f'{iso:g}' for iso in starts)}"
        )
    return starts


def stated_gains(frames: CalibrationFrames, gains: Mapping[float, float] | CameraProfile | None) -> dict[float, float]:
    """Return the stated K by ISO; of a profile, at the frames' ISOs that it knows.

    Raises
    ------
    ArgumentError
        If K is not finite and positive, there are no frames of its ISO, or a profile is of another camera or knows K at
        none of the ISOs.
    """
    isos = [float(iso) for iso in frames.isos]
    listed = ", ".join(f"{iso:g}" for iso in isos)
    if isinstance(gains, CameraProfile):
        profile_of(frames.camera, [gains], otherwise="its K in numbers: --gain ISO=K (gains={ISO: K})")
        known = {}
        for iso in isos:
            with suppress(ArgumentError):
                known[iso] = gains.gain_at_iso(iso)
        if not known:
            raise ArgumentError(f"the profile of {gains.camera} knows K at none of the frames' ISOs ({listed})")
        return known
    stated = {float(iso): float(gain) for iso, gain in (gains or {}).items()}
    for iso, gain in stated.items():
        checked_number(f"K at ISO {iso:g}", gain, above=0)
        if iso not in isos:
            raise ArgumentError(f"K is stated at ISO {iso:g}, of which there are no frames; there are {listed}")
    return stated


def _calibrate(frames: CalibrationFrames, chosen: Sequence[IsoFrames], workers: Workers) -> list[IsoGain | FramesError]:
    """Calibrate each ISO, here or by worker processes; an ISO that fails gives its error."""
    label = f"calibrating {frames.camera}"
    if workers.executor is not None:
        # Frames are summed where they are decoded: to send them would take longer than that. Workers have folders of
        # their own to start from.
        there = copy.copy(frames)
        there.root = frames.root.absolute()
        outcomes = workers.attempt(partial(_calibrate_elsewhere, there), chosen, label=label, unit="ISO")
        return [_to_frames_error(frames, outcome) if isinstance(outcome, Failed) else outcome for outcome in outcomes]
    measured: list[IsoGain | FramesError] = []
    with tqdm(total=sum(map(decodings, chosen)), desc=label, unit="frame", disable=None, leave=False) as bar:
        for of_iso in chosen:
            try:
                measured.append(calibrate_iso(frames, of_iso, workers, done=bar.update))
            except FramesError as error:
                measured.append(error)
    return measured


def _calibrate_elsewhere(frames: CalibrationFrames, chosen: IsoFrames) -> IsoGain:
    """Calibrate one ISO in a worker process."""
    require_files(*map(frames.path, chosen.records))
    return calibrate_iso(frames, chosen)


def _to_frames_error(frames: CalibrationFrames, failed: Failed[IsoFrames]) -> FramesError:
    """Turn a failure in a worker into an error of the ISO's frames."""
    if isinstance(failed.error, FramesError):
        return failed.error
    where = f"{frames.camera}, ISO {float(failed.unit.iso):g}"
    advice = "look into it where the work runs, or leave this ISO out"
    return FramesError([Problem(frames.camera, where, "work", "a finished estimate", failed.reason, advice)])


def join_isos(
    camera: str,
    measured: Iterable[IsoGain],
    failed: Iterable[FailedIso] = (),
    modes: Sequence[float] | None = None,
    notes: Iterable[str] = (),
) -> Calibration:
    """Return the calibration of a camera from its ISOs: fits over K, profile, remarks.

    Parameters
    ----------
    camera
        Its name.
    measured
        What was measured at each ISO, one or more.
    failed
        The ISOs that are left out.
    modes
        The first ISO of each gain mode but the lowest, where they are stated.
    notes
        Further remarks.
    """
    everything: list[IsoGain] = sorted(measured, key=attrgetter("iso"))
    left_out = tuple(sorted(failed, key=attrgetter("iso")))
    remarks = [*notes, *(failed_iso.remark for failed_iso in left_out), *overall_remarks(everything)]
    with_bias = check_stated_black([record for record in everything if isinstance(record, IsoCalibration)])
    isos, step_dn = _take_common_step(with_bias, everything, remarks)
    fitted, problem = fit_modes(isos, modes, remarks)
    black, white = _find_common_levels(everything, remarks)
    bias, flat = sum(record.bias_frames for record in isos), sum(record.flat_frames for record in everything)
    frames = f"{bias} bias and {flat} flat frames"
    if flat and not any(record.transfer for record in everything):
        frames = f"{bias} bias frames, {flat} flats of which none could be used,"
    source = f"eldata {__version__} calibrate: {frames} at {counted(len(everything), 'ISO')}"
    if stated := sum(record.gain is not None and record.gain.is_stated for record in isos):
        source += f", K stated at {stated} of them"
    calibration = Calibration(
        camera=camera,
        isos=isos,
        source=source,
        modes=fitted,
        remarks=tuple(remarks),
        made_profile=None,
        no_profile=_explain_no_profile(isos) or problem,
        gains=tuple(record for record in everything if not isinstance(record, IsoCalibration)),
        failed=left_out,
    )
    if calibration.no_profile:
        return calibration
    gain_modes = [line.mode for line in fitted]
    gain_range, iso_range = whole_ranges(gain_modes)
    only = gain_modes[0] if len(gain_modes) == 1 else None  # its lines are the profile's own
    profile = CameraProfile(
        camera=camera,
        source=source,
        gain_range_dn_per_e=gain_range,
        **{f"{scale}_fit": getattr(only, f"{scale}_fit", None) for scale in ("tukey_lambda", "gauss", "row")},
        rows=tuple(filter(None, (record.profile_row for record in isos))),
        iso_range=iso_range,
        black_level_dn=black,
        white_level_dn=white,
        notes=calibration.all_remarks,
        modes=() if only is not None else tuple(gain_modes),
        accepted=calibration.accepted,
        quantisation_step_dn=step_dn,
    )
    return replace(calibration, made_profile=profile)


def _take_common_step(
    isos: tuple[IsoCalibration, ...], everything: Sequence[IsoGain], remarks: list[str]
) -> tuple[tuple[IsoCalibration, ...], float]:
    """Return the ISOs, and the profile's step: the greatest common divisor of all; add to the remarks."""
    step = math.gcd(*(record.step_dn for record in everything)) or 1
    if any(record.step_dn not in {0, step} for record in everything):
        listed = ", ".join(f"{record.step_dn} at ISO {record.iso:g}" for record in everything if record.step_dn)
        remarks.append(fill_sentence("remarks.steps-differ", steps=listed, step=step))
    elif step > 1:
        remarks.append(fill_sentence("remarks.steps-alike", step=step))
    return tuple(take_step(record) if record.step_dn == step else record for record in isos), float(step)


def _find_common_levels(isos: Sequence[IsoGain], remarks: list[str]) -> tuple[float | None, float | None]:
    """Return the black and the white level that hold for all frames, ``None`` where one does not; add to the remarks.

    Cameras record black levels that differ by channel or ISO by a DN or some. A profile's levels are there to scale
    values by their difference: what is a thousandth of it changes no figure by more than that.
    """
    blacks = [level for record in isos for level in record.sensor.black_level_dn]
    whites = [record.sensor.white_level_dn for record in isos]
    least = _LEVELS_APART * (min(whites) - max(blacks))

    def find_common(name: str, levels: Sequence[float]) -> float | None:
        """Find the level that all have, or nearly; else ``None``, with a remark."""
        if max(levels) - min(levels) <= least:
            return float(np.median(levels))
        listed = ", ".join(f"{level:g}" for level in sorted(set(levels))[:6])
        remarks.append(fill_sentence("remarks.levels-differ", name=name, levels=listed))
        return None

    return find_common("black", blacks), find_common("white", whites)


def _explain_no_profile(isos: Sequence[IsoCalibration]) -> str:
    """Return the reason that these figures make no profile; empty if they make one."""
    if not isos:
        return fill_sentence("no-profile.flats-alone")
    if not any(record.gain for record in isos):
        return fill_sentence(
            f"no-profile.{'k-withheld' if any('gain' in record.withheld for record in isos) else 'no-k'}"
        )
    if not any(record.profile_row for record in isos):
        return fill_sentence("no-profile.no-dark")
    if not any(record.gain and record.sigma_tl_dn for record in isos):
        return fill_sentence("no-profile.never-both")
    return ""


# --- ISOs together ----------------------------------------------------------------------------------------------------

_GAIN_TOLERANCE = 0.1  # of K / ISO around its median


def check_stated_black(isos: Sequence[IsoCalibration]) -> tuple[IsoCalibration, ...]:
    """Return the ISOs, with a finding on each whose colour bias is unlike the others'.

    It is beyond 3 % of white, or jumps: by more than a thousandth of white, the noise, and five times what the others
    differ by. One that jumps is withheld.
    """
    means = {record.iso: float(np.mean(record.bias.bias_dn)) for record in isos if record.colour_bias is not None}

    def find_wrong_black(record: IsoCalibration) -> Iterator[Finding]:
        """Yield a finding if the colour bias at an ISO is unlike the other ISOs'."""
        others = [mean for iso, mean in means.items() if iso != record.iso]
        if record.iso not in means or not others:
            return
        usual, white, mean = float(np.median(others)), record.sensor.white_level_dn, means[record.iso]
        noise = 0.0 if record.read is None else record.read.sigma_gauss_dn
        scatter = max(abs(other - usual) for other in others)
        moved, limit, far = abs(mean - usual), max(0.001 * white, noise, 5.0 * scatter), 0.03 * white
        jumps = moved > limit and abs(mean) > abs(usual)
        if not jumps and abs(mean) <= far:
            return
        stated = float(np.mean(record.sensor.black_level_dn))
        is_lit = any(finding.check == LIGHT.name for finding in record.findings)
        advice = ": the stated black is probably wrong at this ISO; look it up, and state it where you use the files"
        words = {"own": stated + mean, "stated": stated, "bias": mean, "usual": usual}
        text = fill_sentence("findings.wrong-black", **words, advice="" if is_lit else advice)
        statistics = (moved, limit) if jumps else (abs(mean), far)
        # What other ISOs do not show is drawn with the gain of any (row="any").
        withheld = ("withheld", BLACK.figures) if jumps and not is_lit else ()
        yield BLACK.find(*statistics, text, *withheld)

    return tuple(replace(record, findings=(*record.findings, *find_wrong_black(record))) for record in isos)


def overall_remarks(isos: Sequence[IsoGain]) -> list[str]:
    """Return remarks on K / ISO, which show only when the ISOs are seen together."""
    ratios = {record.iso: record.gain_dn_per_e / record.iso for record in isos if record.gain_dn_per_e is not None}
    usual = float(np.median(list(ratios.values()))) if len(ratios) > 2 else math.inf
    odd = {iso: ratio for iso, ratio in ratios.items() if abs(ratio - usual) > _GAIN_TOLERANCE * usual}
    if not odd:
        return []
    listed = ", ".join(f"ISO {iso:g} ({ratio / usual:.2f} of it)" for iso, ratio in odd.items())
    return [fill_sentence("remarks.odd-gains", usual=usual, isos=listed)]
