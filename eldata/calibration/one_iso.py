"""One ISO's frames to its figures: two passes over the bias frames, one over the flats, a frame at a time."""

from __future__ import annotations

import math
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from operator import methodcaller
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.compiled import in_threads
from eldata.base.numbers import counted
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration.audit.bias_checks import (
    BiasAudit,
    BiasSeen,
    BiasStatistics,
    bias_findings,
    code_step,
    mean_step,
    read_noise_in_steps,
)
from eldata.calibration.audit.flat_checks import flat_findings, saturation, uneven_steps
from eldata.calibration.audit.frames import ADVISED_BIAS_FRAMES, FrameFigures, PairLevels, unequal_pair, uneven_light
from eldata.calibration.core.bias_figures import BiasFigures, BiasSums
from eldata.calibration.core.defects import MINIMUM_FRAMES, BiasStack, FixedPattern, fixed_pattern
from eldata.calibration.core.findings import CLIPPED, NO_LINE, SHAPE, TRANSFER, with_accepted
from eldata.calibration.core.photon_transfer import FlatPairs, photon_transfer
from eldata.calibration.core.read_noise import read_noise_findings
from eldata.calibration.core.single_frame import FlatFrames, power_spectrum, single_frame_plot, spatial_photon_transfer
from eldata.calibration.frames import FrameReader, FramesError
from eldata.calibration.iso_results import IsoCalibration, IsoGain
from eldata.calibration.remarks import bias_remarks, flat_remarks, no_pairs, transfer_remarks
from eldata.calibration.reproduction import compared_piece, reproduction
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.verify_report import Problem
from eldata.raw.container import lossy_compression

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from eldata.calibration.core._frames import Mosaic
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.frames import IsoFrames
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
        The ISO's frames (:func:`~eldata.calibration.frames.sorted_frames`).
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
    with _unusable(frames, chosen):
        if chosen.bias or not chosen.pairs:
            try:
                return _calibrated(FrameReader(frames, workers, done, chosen.crop), chosen)
            except FramesError:
                raise
            except DatasetError as error:
                if not chosen.pairs:
                    raise
                lost = SHAPE.seen(math.nan, math.nan, f"the bias frames cannot be used: {error}")
                return _gain(
                    FrameReader(frames, workers, done, chosen.crop), chosen, lost.of("withheld", CLIPPED.figures)
                )
        return _gain(FrameReader(frames, workers, done, chosen.crop), chosen)


def bias_pattern(
    frames: CalibrationFrames,
    chosen: IsoFrames,
    workers: Workers = IN_THIS_PROCESS,
    *,
    done: Callable[[], object] = lambda: None,
) -> tuple[Sensor, FixedPattern]:
    """Return the sensor, and what stays from frame to frame, of all bias frames of one ISO, each decoded once.

    Raises
    ------
    FramesError
        As of :func:`calibrate_iso`.
    """
    with _unusable(frames, chosen):
        reader = FrameReader(frames, workers, done)
        fixed, _, _ = _first_pass(reader, chosen.bias, ())
        return reader.sensor, fixed


@contextmanager
def _unusable(frames: CalibrationFrames, chosen: IsoFrames) -> Iterator[None]:
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
    """Return how many frames are decoded for an ISO: bias frames twice."""
    estimated, held_out = _split(chosen.bias)
    return 2 * len(estimated) + len(held_out) + 2 * len(chosen.pairs)


def _split(bias: Sequence[FrameRecord]) -> tuple[Sequence[FrameRecord], Sequence[FrameRecord]]:
    return (bias[:-1], bias[-1:]) if len(bias) >= HOLD_OUT_FROM else (bias, ())


def _calibrated(reader: FrameReader, chosen: IsoFrames) -> IsoCalibration:
    fixed, estimated, held_out = _first_pass(reader, *_split(chosen.bias))
    sensor, is_clipped = reader.sensor, fixed.clips_at_black
    bias_sums, audit = BiasSums(fixed), BiasAudit(fixed)
    sums = [bias_sums, audit]
    spectrum, single = None, None
    for _, frame in reader.read(estimated):
        if spectrum is None:
            spectrum = power_spectrum(frame.mosaic, fixed)
            single = None if is_clipped else single_frame_plot(frame.mosaic, fixed)
        in_threads(methodcaller("add", frame.mosaic), sums, reader.workers.jobs)
        del frame
    reader.refuse()
    if spectrum is None:
        raise DatasetError("no bias frame could be read")

    def from_bias_frames() -> tuple[BiasFigures, BiasStatistics]:
        return bias_sums.figures(sensor.black_level_dn), audit.statistics()

    # The flats decode while the bias frames' figures are worked out.
    work = (from_bias_frames, partial(_flats, reader, chosen, fixed))
    (found, seen), of_flats = in_threads(methodcaller("__call__"), work, reader.workers.jobs)
    step = math.gcd(code_step(seen.codes), of_flats.step_dn)
    dark = IsoCalibration(
        iso=float(chosen.iso),
        sensor=sensor,
        flat_frames=of_flats.flat_frames,
        transfer=of_flats.transfer,
        spatial=of_flats.spatial,
        bias_frames=len(estimated),
        bias=found.bias,
        rows=found.rows,
        read=found.read,
        plot=found.plot,
        pattern=fixed.summary,
        spectrum_dn2=spectrum,
        single_frame=single,
        findings=found.findings,
        stated_gain_dn_per_e=chosen.stated_gain_dn_per_e,
        step_dn=step,
        stepped=None if found.residuals is None else read_noise_in_steps(found.residuals, step),
    )
    of_bias = dark.findings
    if found.read is not None:
        step_dn = float(step) if step > 1 else mean_step(seen.codes)
        of_read = read_noise_findings(found.read, dark.bias, dark.rows.rows, step_dn)
        of_audit = bias_findings(BiasSeen(seen, dark.bias, dark.rows, found.read, step_dn))
        of_bias = with_accepted((*of_read, *of_audit), chosen.accept)
    whole = replace(dark, findings=(*of_bias, *of_flats.findings))
    parameters = whole.in_steps.parameters
    if held_out is not None and parameters is not None:
        # Its own generator: the comparison of one ISO does not depend on which others are calibrated with it.
        generator = np.random.default_rng(int(chosen.iso))
        compared = reproduction(held_out, fixed, sensor, parameters, generator)
        whole = replace(whole, reproduction=compared)
    files = (reader.frames.path(one) for one in (*estimated[:1], *(pair.first for pair in chosen.pairs[:1])))
    lossy = next(filter(None, map(lossy_compression, files)), None)
    remarks = (*reader.copies.remarks, *bias_remarks(whole, chosen, lossy))
    return replace(whole, remarks=(*remarks, *of_flats.remarks, *transfer_remarks(whole)))


def _gain(reader: FrameReader, chosen: IsoFrames, *lost: Finding) -> IsoGain:
    found = _flats(reader, chosen, None)
    alone = () if lost else ("there are no bias frames, so K is all that is known",)
    remarks = (*reader.copies.remarks, *alone, *found.remarks, *transfer_remarks(found))
    return replace(found, remarks=remarks, findings=(*lost, *found.findings))


def _first_pass(
    reader: FrameReader, estimated: Sequence[FrameRecord], held_out: Sequence[FrameRecord]
) -> tuple[FixedPattern, Sequence[FrameRecord], Mosaic | None]:
    """Return what stays from frame to frame, of which frames, and what is compared of the frame that is kept out."""
    if len(estimated) < MINIMUM_FRAMES:
        raise _too_few(len(estimated))
    stack, kept, used = None, None, []
    for record, frame in reader.read((*estimated, *held_out)):
        reader.figures.append(FrameFigures.of(record, frame.mosaic))
        stack = stack or BiasStack(frame.sensor.cfa)
        is_copy = reader.copies.original(record, frame.mosaic) is not None
        if record in held_out and not is_copy:
            kept = compared_piece(frame.mosaic, len(frame.sensor.cfa))
        elif not is_copy:
            stack.add(frame.mosaic)
            used.append(record)
        del frame  # before the next one is decoded
    reader.refuse()
    if stack is None:
        raise DatasetError("no bias frame could be read")
    if len(used) < MINIMUM_FRAMES and kept is not None:  # without its copies, the set has none to spare
        for _, frame in reader.read(held_out):
            stack.add(frame.mosaic)
        used, kept = [*used, *held_out], None
    if len(used) < MINIMUM_FRAMES:
        raise _too_few(len(used), reader.copies.remarks)
    return fixed_pattern(stack), used, kept


def _too_few(number: int, because: Sequence[str] = ()) -> DatasetError:
    return DatasetError(
        f"{counted(number, 'bias frame')}, and {MINIMUM_FRAMES} are needed, {ADVISED_BIAS_FRAMES} or more advised: "
        "take them with the lens capped, at the shortest exposure" + "".join(f"; {reason}" for reason in because)
    )


def _flats(reader: FrameReader, chosen: IsoFrames, fixed: FixedPattern | None) -> IsoGain:
    """Read the flats; without bias frames, black is what the files record and no pixel is a defect."""
    stated = chosen.stated_gain_dn_per_e

    def found(remarks: Sequence[str], *findings: Finding, **more: Any) -> IsoGain:
        known: dict[str, Any] = {"iso": float(chosen.iso), "sensor": reader.sensor, "stated_gain_dn_per_e": stated}
        return IsoGain(**known, remarks=tuple(remarks), findings=findings, step_dn=step, **more)

    step = 0
    if not chosen.pairs:
        return found(() if stated is not None else (no_pairs(chosen),))
    pairs, singles = None, None
    used: list[PairLevels] = []
    remarks: list[str] = []
    for pair, first, second in _pairs(reader, chosen.pairs):
        if pairs is None or singles is None:
            sensor = first.sensor
            # The measured level of no light: the recorded one may be off by the colour bias.
            black, defects = (sensor.black_level_dn, None) if fixed is None else (fixed.level_dn, fixed.defects)
            options: dict[str, Any] = {"defects": defects, "floor_dn": 0 if fixed is None else fixed.floor_dn or 0}
            pairs = FlatPairs(sensor.cfa, black, sensor.white_level_dn, **options)
            singles = FlatFrames(sensor.cfa, black, sensor.white_level_dn, **options)
        levels = PairLevels.of(pair, first, second)
        unequal = unequal_pair(levels)
        if unequal is not None:
            remarks.append(unequal)
        else:
            used.append(levels)
            pairs.add(first.mosaic, second.mosaic)
            singles.add(first.mosaic)
            singles.add(second.mosaic)
        del first, second  # before the next ones are decoded
    reader.refuse()
    if pairs is not None:
        step = code_step(pairs.counts[:, : math.ceil(pairs.limit_dn)])
    said = (*remarks, *flat_remarks(chosen))
    if pairs is None or singles is None or not pairs.frames:
        return found(said, _no_line("no pair of flats is usable"))
    try:
        transfer = photon_transfer(pairs)
    except DatasetError as error:
        no_line = _no_line(f"{error}; pairs used: {', '.join(map(str, used))}")
        return found(said, *saturation(pairs), no_line)
    of_line, spatial = tuple(flat_findings(transfer)), None
    if all(one.check != NO_LINE.name for one in of_line):  # of a scene, a frame's variance is the scene's own
        with suppress(DatasetError):  # it needs three brightnesses; it is for comparison alone
            spatial = spatial_photon_transfer(singles)
    of_values = (*saturation(pairs), *uneven_steps(pairs, transfer))
    findings = with_accepted((*uneven_light(used), *of_values, *of_line), chosen.accept)
    return found(said, *findings, transfer=transfer, spatial=spatial, flat_frames=transfer.frames)


def _no_line(why: str) -> Finding:
    """Return that there is no photon transfer line; the read noise is measured all the same."""
    return TRANSFER.seen(math.nan, math.nan, why).of("withheld", TRANSFER.figures)


def _pairs(reader: FrameReader, pairs: Sequence[FlatPair]) -> Iterator[tuple[FlatPair, RawFrame, RawFrame]]:
    """Yield the pairs of which both frames can be used; the reader names the others."""
    pair_of = {pair.second: pair for pair in pairs}
    waiting: tuple[FrameRecord, RawFrame] | None = None
    for record, frame in reader.read_new([record for pair in pairs for record in (pair.first, pair.second)]):
        pair = pair_of.get(record)
        if pair is None:
            waiting = record, frame
        elif waiting is not None and waiting[0] == pair.first:
            yield pair, waiting[1], frame
            waiting = None
        del frame
