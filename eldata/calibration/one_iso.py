"""One ISO's frames to its figures: two passes over the bias frames, one over the flats, a frame at a time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from operator import methodcaller
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.compiled import in_threads
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration.colour_bias import ChannelMeans, colour_bias
from eldata.calibration.defects import MINIMUM_FRAMES, BiasStack, FixedPattern, fixed_pattern
from eldata.calibration.frame_checks import (
    ADVISED_BIAS_FRAMES,
    FrameFigures,
    FramesError,
    clipped_black,
    missing_codes,
    odd_bias_frames,
    unequal_pair,
    unlike,
    unlike_most,
    unreadable,
)
from eldata.calibration.photon_transfer import (
    FlatFrames,
    FlatPairs,
    PhotonTransfer,
    photon_transfer,
    spatial_photon_transfer,
)
from eldata.calibration.read_noise import Residuals, probability_plot, read_noise
from eldata.calibration.remarks import bias_remarks, flat_remarks, no_pairs, transfer_remarks
from eldata.calibration.reproduction import compared_piece, reproduction
from eldata.calibration.results import IsoCalibration
from eldata.calibration.row_noise import LineMeans, row_noise
from eldata.calibration.spectrum import power_spectrum
from eldata.errors import DatasetError, RawFileError
from eldata.manifest.verify import Problem
from eldata.raw.compression import lossy_compression

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.calibration.frame_checks import IsoFrames
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
) -> IsoCalibration:
    """Measure the noise at one ISO.

    Parameters
    ----------
    frames
        Where the files are.
    chosen
        The ISO's frames (:func:`~eldata.calibration.frame_checks.sorted_frames`).
    workers
        The threads that decode; the result does not depend on them. One frame more than that is in memory, besides
        the sums.
    done
        Called after each decoded frame; :func:`decodings` says how many there will be.

    Raises
    ------
    FramesError
        If frames differ in size, CFA or levels, are odd or clipped at 0; or if the estimators cannot use them. Every
        problem found is in it.
    """
    reader = _Reader(frames, workers, done)
    try:
        return _calibrated(reader, chosen)
    except FramesError:
        raise
    except DatasetError as error:
        where = f"{frames.camera}, ISO {float(chosen.iso):g}"
        raise FramesError(
            [Problem(frames.camera, where, "frames", "what the estimate needs", str(error), "or leave this ISO out")]
        ) from error


def decodings(chosen: IsoFrames) -> int:
    """Return how many frames :func:`calibrate_iso` decodes: bias frames twice."""
    estimated, held_out = _split(chosen.bias)
    return 2 * len(estimated) + len(held_out) + 2 * len(chosen.pairs)


def _split(bias: Sequence[FrameRecord]) -> tuple[Sequence[FrameRecord], Sequence[FrameRecord]]:
    return (bias[:-1], bias[-1:]) if len(bias) >= HOLD_OUT_FROM else (bias, ())


class _Reader:
    """Decodes frames ahead, and leaves out those that are unlike the first one."""

    def __init__(self, frames: CalibrationFrames, workers: Workers, done: Callable[[], object]) -> None:
        self._frames, self.workers, self._done = frames, workers, done
        self._sensor: Sensor | None = None
        self._sensors: dict[FrameRecord, Sensor] = {}
        self.problems: list[Problem] = []

    def read(self, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, RawFrame]]:
        """Yield the frames that are like the first one; :meth:`refuse` says what is wrong with the others."""
        decoded = self.workers.read_ahead(self._read, records)
        for record in records:  # no zip: it holds on to the last frame while the next one is decoded
            frame = next(decoded)
            self._done()
            if isinstance(frame, RawFileError):
                self.problems.append(unreadable(record, frame))
                continue
            self._sensor = self._sensor or frame.sensor
            self._sensors[record] = frame.sensor
            if not unlike(record, frame.sensor, self._sensor, ""):
                yield record, frame
            del frame

    def _read(self, record: FrameRecord) -> RawFrame | RawFileError:
        try:
            return self._frames.read(record)
        except RawFileError as error:
            return error

    @property
    def sensor(self) -> Sensor:
        """The first frame's, which all frames must be like."""
        if self._sensor is None:
            raise DatasetError("no bias frames: take ten or more with the lens capped, at the shortest exposure")
        return self._sensor

    def lossy(self, records: Sequence[FrameRecord]) -> str | None:
        """Return what loses data in the first of some files."""
        return next((lossy_compression(self._frames.path(record)) for record in records[:1]), None)

    def refuse(self) -> None:
        """Raise what is wrong with the frames so far, if anything is."""
        problems = [*self.problems, *unlike_most(self._sensors)]
        if problems:
            raise FramesError(sorted(problems, key=lambda problem: problem.path))


def _calibrated(reader: _Reader, chosen: IsoFrames) -> IsoCalibration:
    fixed, held_out = _first_pass(reader, chosen.bias)
    sensor = reader.sensor
    estimated = _split(chosen.bias)[0]
    lines, residuals = LineMeans(fixed), Residuals(fixed)
    means = ChannelMeans(sensor.cfa, defects=fixed.defects)
    spectrum, gaps = None, 0.0
    for _, frame in reader.read(estimated):
        if spectrum is None:
            spectrum, gaps = power_spectrum(frame.mosaic, fixed), missing_codes(frame.mosaic, fixed.pattern)
        in_threads(methodcaller("add", frame.mosaic), (residuals, lines, means), reader.workers.jobs)
        del frame
    reader.refuse()
    if spectrum is None:
        raise DatasetError("no bias frame could be read")
    histogram = residuals.histogram()
    first_spectrum = spectrum

    def from_bias_frames() -> IsoCalibration:
        dark = IsoCalibration(
            iso=float(chosen.iso),
            sensor=sensor,
            bias_frames=len(estimated),
            flat_frames=0,
            transfer=None,
            spatial=None,
            bias=colour_bias(means, sensor.black_level_dn),
            rows=row_noise(lines),
            read=read_noise(histogram),
            plot=probability_plot(histogram),
            pattern=fixed.summary,
            spectrum_dn2=first_spectrum,
            reproduction=None,
            remarks=(),
        )
        if held_out is None or dark.parameters is None:
            return dark
        # Its own generator: the comparison of one ISO does not depend on which others are calibrated with it.
        generator = np.random.default_rng(int(chosen.iso))
        return replace(dark, reproduction=reproduction(held_out, fixed, sensor, dark.parameters, generator))

    # The flats decode while the bias frames' figures are worked out.
    if reader.workers.jobs > 1:
        with ThreadPoolExecutor(1) as beside:
            waiting = beside.submit(from_bias_frames)
            transfer, spatial, flat_remarks = _flats(reader, chosen, fixed)
            found = waiting.result()
    else:
        found = from_bias_frames()
        transfer, spatial, flat_remarks = _flats(reader, chosen, fixed)
    if transfer is not None:
        found = replace(found, transfer=transfer, spatial=spatial, flat_frames=transfer.frames)
    if found.parameters is None:
        found = replace(found, reproduction=None)  # what the flats showed withholds one of its parameters
    lossy = reader.lossy(estimated) or reader.lossy([pair.first for pair in chosen.pairs])
    of_gain = transfer_remarks(found, sensor)
    return replace(found, remarks=(*bias_remarks(found, chosen, lossy, gaps), *flat_remarks, *of_gain))


def _first_pass(reader: _Reader, bias: Sequence[FrameRecord]) -> tuple[FixedPattern, NDArray[np.uint16] | None]:
    """Return what stays from frame to frame, and of the frame that the estimators do not see what is compared."""
    estimated, held_out = _split(bias)
    if len(estimated) < MINIMUM_FRAMES:
        raise DatasetError(
            f"{len(estimated)} bias frame(s), and {MINIMUM_FRAMES} are needed, {ADVISED_BIAS_FRAMES} or more advised: "
            "take them with the lens capped, at the shortest exposure"
        )
    stack, kept, figures = None, None, []
    for record, frame in reader.read(bias):
        reader.problems += clipped_black(record, frame.mosaic)
        figures.append(FrameFigures.of(record, frame.mosaic))
        stack = stack or BiasStack(frame.sensor.cfa)
        if record in held_out:
            kept = compared_piece(frame.mosaic, len(frame.sensor.cfa))
        else:
            stack.add(frame.mosaic)
        del frame  # before the next one is decoded
    reader.problems += odd_bias_frames(figures)
    reader.refuse()
    if stack is None:
        raise DatasetError("no bias frame could be read")
    return fixed_pattern(stack), kept


def _flats(
    reader: _Reader, chosen: IsoFrames, fixed: FixedPattern
) -> tuple[PhotonTransfer | None, PhotonTransfer | None, tuple[str, ...]]:
    """Return K from pairs, K as published, and remarks."""
    if not chosen.pairs:
        return None, None, (no_pairs(chosen),)
    sensor = reader.sensor
    # The measured level of no light: the recorded one may be off by the colour bias.
    pairs = FlatPairs(sensor.cfa, fixed.level_dn, sensor.white_level_dn, defects=fixed.defects)
    singles = FlatFrames(sensor.cfa, fixed.level_dn, sensor.white_level_dn, defects=fixed.defects)
    remarks: list[str] = []
    gaps = 0.0
    for pair, first, second in _pairs(reader, chosen.pairs):
        unequal = unequal_pair(pair, first, second)
        if unequal is not None:
            remarks.append(unequal)
        else:
            pairs.add(first.mosaic, second.mosaic)
            singles.add(first.mosaic)
            singles.add(second.mosaic)
            gaps = max(gaps, missing_codes(first.mosaic, fixed.pattern))
        del first, second  # before the next ones are decoded
    reader.refuse()
    if len(remarks) == len(chosen.pairs):
        raise DatasetError(f"no pair of flats is usable: {'; '.join(remarks)}")
    try:
        spatial = spatial_photon_transfer(singles)
    except DatasetError:
        spatial = None  # it needs three brightnesses; it is for comparison alone
    transfer = photon_transfer(pairs)
    return transfer, spatial, (*remarks, *flat_remarks(chosen, gaps))


def _pairs(reader: _Reader, pairs: Sequence[FlatPair]) -> Iterator[tuple[FlatPair, RawFrame, RawFrame]]:
    """Yield the pairs of which both frames can be used; the others are named by the reader."""
    pair_of = {pair.second: pair for pair in pairs}
    waiting: tuple[FrameRecord, RawFrame] | None = None
    for record, frame in reader.read([record for pair in pairs for record in (pair.first, pair.second)]):
        pair = pair_of.get(record)
        if pair is None:
            waiting = record, frame
        elif waiting is not None and waiting[0] == pair.first:
            yield pair, waiting[1], frame
            waiting = None
        del frame
