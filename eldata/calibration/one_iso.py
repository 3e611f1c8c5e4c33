"""One ISO's frames to its figures: two passes over the bias frames, one over the flats, a frame at a time."""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from operator import methodcaller
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import in_threads
from eldata.base.numbers import counted
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration import checks, iso_results
from eldata.calibration.bias_sums import BiasPairs, BiasSums, colour_bias, power_spectrum, row_noise
from eldata.calibration.defects import ADVISED_FRAMES, MINIMUM_FRAMES, BiasStack, fixed_pattern, too_few_frames
from eldata.calibration.flats import FlatPairs, photon_transfer
from eldata.calibration.frames import FrameReader, FramesError, IsoFrames, measure_frame, measure_pair, unequal_pair
from eldata.calibration.held_out import compared_piece, reproduction
from eldata.calibration.iso_results import IsoCalibration, IsoGain, accept_findings, fill_sentence
from eldata.calibration.residuals import probability_plot, read_noise
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.verify_report import Problem
from eldata.raw.container import lossy_compression

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from eldata.calibration.bias_sums import BiasStatistics, ResidualHistogram
    from eldata.calibration.defects import FixedPattern
    from eldata.calibration.iso_results import Finding
    from eldata.calibration.sums import Mosaic
    from eldata.datasets.calibration_frames import CalibrationFrames, FlatPair
    from eldata.records import FrameRecord, RawFrame, Sensor

HOLD_OUT_FROM = 6
"""From this many bias frames on, the last one is kept from the estimators, to test the result."""


def calibrate_iso(
    frames: CalibrationFrames,
    chosen: IsoFrames,
    workers: Workers = IN_THIS_PROCESS,
    *,
    done: Callable[[], object] = lambda: None,
) -> IsoGain:
    """Measure what there are frames for at one ISO: the noise, or of flats alone K, from the recorded black level.

    Parameters
    ----------
    frames
        Where the files are.
    chosen
        The ISO's frames (:func:`~eldata.calibration.frames.sort_frames`).
    workers
        The threads that decode; the result does not depend on them. One frame more than that is in memory, besides
        the sums.
    done
        Called after each decoded frame; :func:`decodings` says how many there will be.

    Raises
    ------
    FramesError
        If frames differ in size, CFA or levels, or are odd; or if the estimators cannot use the bias frames, and
        there are no flats to give K. Every problem found is in it. Flats without a line are no error: K is withheld.
    """
    start = partial(FrameReader, frames, workers, done, chosen.crop)
    with as_frames_error(frames, chosen):
        if not chosen.bias and chosen.pairs:
            return _measure_gain(start(), chosen)
        try:
            return _measure_all(start(), chosen)
        except DatasetError as error:
            if isinstance(error, FramesError) or not chosen.pairs:
                raise
            text = f"the bias frames cannot be used: {error}"
            lost = iso_results.SHAPE.withhold(math.nan, math.nan, text, iso_results.CLIPPED.figures)
            return _measure_gain(start(), chosen, lost)


def bias_pattern(
    frames: CalibrationFrames, chosen: IsoFrames, workers: Workers, done: Callable[[], object]
) -> tuple[Sensor, FixedPattern]:
    """Return the sensor, and what stays from frame to frame, of all bias frames of one ISO, each decoded once.

    Raises
    ------
    FramesError
        As of :func:`calibrate_iso`.
    """
    with as_frames_error(frames, chosen):
        reader = FrameReader(frames, workers, done)
        fixed, _, _ = _first_pass(reader, chosen.bias, ())
        return reader.sensor, fixed


@contextmanager
def as_frames_error(frames: CalibrationFrames, chosen: IsoFrames) -> Iterator[None]:
    """Turn what the estimators say of one ISO's frames into its problem."""
    try:
        yield
    except FramesError:
        raise
    except (DatasetError, ArgumentError) as error:
        where = f"{frames.camera}, ISO {float(chosen.iso):g}"
        raise FramesError(
            [Problem(frames.camera, where, "frames", "what the estimate needs", str(error), "or leave this ISO out")]
        ) from error


def decodings(chosen: IsoFrames) -> int:
    """Return the number of frames that are decoded for an ISO: bias frames twice."""
    estimated, held_out = _hold_out(chosen.bias)
    return 2 * len(estimated) + len(held_out) + 2 * len(chosen.pairs)


def _hold_out(bias: Sequence[FrameRecord]) -> tuple[Sequence[FrameRecord], Sequence[FrameRecord]]:
    """Split off the last bias frame, to test the model on it, if there are enough frames."""
    return (bias[:-1], bias[-1:]) if len(bias) >= HOLD_OUT_FROM else (bias, ())


def _measure_all(reader: FrameReader, chosen: IsoFrames) -> IsoCalibration:
    """Measure noise and gain of one ISO from its bias frames and flats."""
    fixed, estimated, held_out = _first_pass(reader, *_hold_out(chosen.bias))
    sums, pairs = BiasSums(fixed), BiasPairs(fixed)
    for source, frame in reader.read(estimated):
        if source == estimated[0]:
            spectrum = power_spectrum(frame.mosaic, fixed)
        in_threads(methodcaller("add", frame.mosaic), [sums, pairs], reader.workers.jobs)
        del frame
    reader.refuse()
    # The flats decode while the bias frames' figures are worked out.
    sensor = reader.sensor
    work = (partial(_estimate, sums, pairs, sensor), partial(_measure_flats, reader, chosen, fixed))
    (estimates, residuals, statistics), of_flats = in_threads(methodcaller("__call__"), work, reader.workers.jobs)
    bias, rows, read = estimates["bias"], estimates["rows"], estimates["read"]
    step = math.gcd(checks.code_step(statistics.codes), of_flats.step_dn)
    if read is None:
        findings: tuple[Finding, ...] = (checks.find_clipping(sums),)
    else:
        step_dn = float(step) if step > 1 else checks.mean_step(statistics.codes)
        of_fit = checks.read_noise_findings(read, bias, rows.rows, step_dn)
        of_bias = checks.bias_findings(statistics, bias, rows, read, step_dn)
        findings = accept_findings((*of_fit, *of_bias), chosen.accept)
    of_gain = {each.name: getattr(of_flats, each.name) for each in fields(of_flats)}
    of_gain |= {"findings": (*findings, *of_flats.findings), "step_dn": step}
    record = IsoCalibration(
        **of_gain,
        bias_frames=len(estimated),
        pattern=fixed.summary,
        spectrum_dn2=spectrum,
        stepped=None if residuals is None else checks.read_noise_in_steps(residuals, step),
        **estimates,
    )
    parameters = checks.take_step(record).parameters
    if held_out is not None and parameters is not None:
        # Its own generator: the comparison of one ISO does not depend on which others are calibrated with it.
        generator = np.random.default_rng(int(chosen.iso))
        record = replace(record, reproduction=reproduction(held_out, fixed, sensor, parameters, generator))
    files = map(reader.frames.path, (*estimated[:1], *(pair.first for pair in chosen.pairs[:1])))
    lossy = next(filter(None, map(lossy_compression, files)), None)
    remarks = (*reader.remarks, *bias_remarks(record, chosen, lossy), *of_flats.remarks, *transfer_remarks(record))
    return replace(record, remarks=remarks)


def _estimate(
    sums: BiasSums, pairs: BiasPairs, sensor: Sensor
) -> tuple[dict[str, Any], ResidualHistogram | None, BiasStatistics]:
    """Return the estimates of an ISO's record, what the read noise is of, and what the checks look at."""
    rows = row_noise(sums)
    estimates: dict[str, Any] = {"bias": colour_bias(sums, rows, sensor.black_level_dn), "rows": rows}
    if sums.fixed.clips_at_black:
        return {**estimates, "read": None, "plot": None}, None, pairs.statistics()
    residuals = sums.residuals()
    read = read_noise(residuals)
    return {**estimates, "read": read, "plot": probability_plot(residuals, read)}, residuals, pairs.statistics()


def _measure_gain(reader: FrameReader, chosen: IsoFrames, *lost: Finding) -> IsoGain:
    """Measure K from flats alone."""
    record = _measure_flats(reader, chosen, None)
    alone = () if lost else (fill_sentence("remarks.k-alone"),)
    remarks = (*reader.remarks, *alone, *record.remarks, *transfer_remarks(record))
    return replace(record, remarks=remarks, findings=(*lost, *record.findings))


def _first_pass(
    reader: FrameReader, estimated: Sequence[FrameRecord], held_out: Sequence[FrameRecord]
) -> tuple[FixedPattern, Sequence[FrameRecord], Mosaic | None]:
    """Return the fixed pattern, the frames that it is of, and the piece of the frame that is kept out."""
    stack, kept, used = None, None, []
    for record, frame in reader.read((*estimated, *held_out)):
        reader.figures[record] = measure_frame(frame.mosaic)
        stack = stack or BiasStack(frame.sensor.cfa)
        is_copy = reader.is_copy(record, frame.mosaic)
        if record in held_out and not is_copy:
            kept = compared_piece(frame.mosaic, len(frame.sensor.cfa))
        elif not is_copy:
            stack.add(frame.mosaic)
            used.append(record)
        del frame  # before the next one is decoded
    reader.refuse()
    if stack is None or len(used) < MINIMUM_FRAMES:
        raise too_few_frames(len(used), reader.remarks)
    return fixed_pattern(stack), used, kept


def _measure_flats(reader: FrameReader, chosen: IsoFrames, fixed: FixedPattern | None) -> IsoGain:
    """Measure K; without bias frames, black is what the files record and no pixel is a defect."""
    stated, step = chosen.stated_gain_dn_per_e, 0
    flats: FlatPairs | None = None
    used: list[str] = []
    remarks: list[str] = []

    def make_record(*findings: Finding, **more: Any) -> IsoGain:
        """Make the ISO's record from all that is known so far."""
        known: dict[str, Any] = {"iso": float(chosen.iso), "sensor": reader.sensor, "stated_gain_dn_per_e": stated}
        return IsoGain(**known, remarks=tuple(remarks), findings=findings, step_dn=step, **more)

    if not chosen.pairs:
        remarks += [no_pairs(chosen)] if stated is None else []
        return make_record()
    for pair, first, second in _read_pairs(reader, chosen.pairs):
        if flats is None:
            sensor = first.sensor
            # The measured level of no light: the recorded one may be off by the colour bias.
            black, defects = (sensor.black_level_dn, None) if fixed is None else (fixed.level_dn, fixed.defects)
            floor_dn = 0 if fixed is None else fixed.floor_dn or 0
            flats = FlatPairs(sensor.cfa, black, sensor.white_level_dn, defects=defects, floor_dn=floor_dn)
        names, levels_dn = f"{pair.first.path} and {pair.second.path}", measure_pair(first, second)
        if unequal := unequal_pair(names, levels_dn):
            remarks.append(unequal)
        else:
            used.append(f"{names} ({levels_dn[0]:.0f} and {levels_dn[1]:.0f} DN)")
            flats.add(first.mosaic, second.mosaic)
        del first, second  # before the next ones are decoded
    reader.refuse()
    remarks += flat_remarks(chosen)
    if flats is None or not flats.frames:
        return make_record(iso_results.TRANSFER.withhold(math.nan, math.nan, "no pair of flats is usable"))
    step = checks.code_step(flats.counts[:, : math.ceil(flats.limit_dn)])
    of_saturation = tuple(checks.find_saturation(flats))
    try:
        transfer = photon_transfer(flats)
    except DatasetError as error:
        text = f"{error}; pairs used: {', '.join(used)}"
        lost = iso_results.TRANSFER.withhold(math.nan, math.nan, text)
        return make_record(*of_saturation, lost, flat_frames=flats.frames)
    of_line = (*checks.find_flat_correlation(transfer), *checks.find_bent_line(transfer))
    of_steps = checks.find_uneven_steps(flats, transfer)
    findings = accept_findings((*of_saturation, *of_steps, *of_line), chosen.accept)
    return make_record(*findings, transfer=transfer, flat_frames=transfer.frames)


def _read_pairs(reader: FrameReader, pairs: Sequence[FlatPair]) -> Iterator[tuple[FlatPair, RawFrame, RawFrame]]:
    """Yield the pairs of which both frames can be used; the reader names the others."""
    pair_of = {pair.second: pair for pair in pairs}
    waiting: tuple[FrameRecord, RawFrame] | None = None
    for record, frame in reader.read([record for pair in pairs for record in (pair.first, pair.second)]):
        pair = pair_of.get(record)
        if reader.is_copy(record, frame.mosaic):  # the difference of a frame and its copy holds no noise
            pass
        elif pair is None:
            waiting = record, frame
        elif waiting is not None and waiting[0] == pair.first:
            yield pair, waiting[1], frame
            waiting = None
        del frame  # before the next one is decoded


# --- remarks ----------------------------------------------------------------------------------------------------------

_LONGEST_BIAS_S = 1 / 250
_DRIFT_DN = 0.25  # of the error that it makes
_OF_DEFECTS_DN = 0.1
_LEAST_PAIRS = 4
_DISAGREEMENT = 6.0  # of K with what was stated, standard errors


def bias_remarks(record: IsoCalibration, chosen: IsoFrames, lossy: str | None) -> tuple[str, ...]:
    """Return remarks on the bias frames and the figures from them."""
    rows, columns, pattern, compared = record.rows.rows, record.rows.columns, record.pattern, record.reproduction
    remarks, has_rows = [], "row noise" not in record.withheld
    if record.bias_frames < ADVISED_FRAMES - 1:
        remarks.append(fill_sentence("remarks.few-bias", frames=record.bias_frames, advised=ADVISED_FRAMES))
    if chosen.bias_exposure_s is not None and chosen.bias_exposure_s > _LONGEST_BIAS_S:
        remarks.append(fill_sentence("remarks.long-bias", exposure_s=float(chosen.bias_exposure_s)))
    if lossy is not None:
        remarks.append(fill_sentence("remarks.lossy", loss=lossy))
    if has_rows and rows.sigma_dn == 0:
        remarks.append(fill_sentence("remarks.no-rows", error=rows.sigma_error_dn))
    elif has_rows and rows.shapiro_p < 1e-3 and abs(rows.excess_kurtosis) > 0.5:
        remarks.append(fill_sentence("remarks.rows-not-normal", p=rows.shapiro_p, kurtosis=rows.excess_kurtosis))
    of_columns = columns.variance_dn2 > 5 * columns.variance_error_dn2 and columns.sigma_dn > 0.3 * rows.sigma_dn
    if has_rows and of_columns:
        remarks.append(fill_sentence("remarks.columns", sigma=columns.sigma_dn))
    error = max(record.bias.standard_error_dn)
    if record.bias.drifts and error > _DRIFT_DN:
        remarks.append(fill_sentence("remarks.drift", error=error))
    of_defects = max(record.bias.of_defects_dn, key=abs)
    if abs(of_defects) > max(2 * error, _OF_DEFECTS_DN) and "colour bias" not in record.withheld:
        remarks.append(fill_sentence("remarks.defects", defects=pattern.defects, bias=of_defects))
    if pattern.defects > 0.01 * pattern.pixels:
        shares = {name: getattr(pattern, name) / pattern.pixels for name in ("defects", "stuck", "off_level")}
        remarks.append(fill_sentence("remarks.left-out", **shares))
    if compared is not None and compared.histogram_distance > max(4 * compared.histogram_distance_by_chance, 0.02):
        distances = {"distance": compared.histogram_distance, "chance": compared.histogram_distance_by_chance}
        remarks.append(fill_sentence("remarks.unlike-model", **distances))
    return tuple(remarks)


def no_pairs(chosen: IsoFrames) -> str:
    """Return the remark on an ISO whose K is not known."""
    single = f"{counted(len(chosen.single), 'flat frame')} and no two of one exposure"
    return fill_sentence("remarks.no-pairs", flats=single if chosen.single else "no flat frames")


def flat_remarks(chosen: IsoFrames) -> tuple[str, ...]:
    """Return remarks on the flats."""
    remarks = []
    if chosen.single:
        names = ", ".join(record.path for record in chosen.single[:3])
        more = f" and {len(chosen.single) - 3} more" if len(chosen.single) > 3 else ""
        remarks.append(fill_sentence("remarks.single-flats", names=names + more))
    if len(chosen.pairs) < _LEAST_PAIRS:
        remarks.append(
            fill_sentence("remarks.few-pairs", pairs=counted(len(chosen.pairs), "pair"), advised=_LEAST_PAIRS)
        )
    return tuple(remarks)


def transfer_remarks(record: IsoGain) -> tuple[str, ...]:
    """Return remarks on K, measured and stated."""
    transfer, sensor, gain, stated = record.transfer, record.sensor, record.gain, record.stated_gain_dn_per_e
    remarks = []
    if gain is not None and stated is not None:
        if gain.is_stated:
            remarks.append(fill_sentence("remarks.k-stated", stated=stated))
        elif abs(stated - gain.value) > _DISAGREEMENT * gain.error:
            remarks.append(fill_sentence("remarks.k-measured", stated=stated))
    if transfer is None:
        return tuple(remarks)
    if transfer.left_out > 0.5:
        remarks.append(fill_sentence("remarks.too-bright", share=transfer.left_out))
    brightest = max(float(line.signal_dn.max()) for line in transfer.channels)
    share = brightest / (sensor.white_level_dn - float(np.mean(sensor.black_level_dn)))
    if share < 0.25:
        remarks.append(fill_sentence("remarks.too-dark", share=share))
    return tuple(remarks)
