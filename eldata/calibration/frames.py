"""The frames of one ISO: sorted by what their headers state, read a frame at a time, and what is wrong with them."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.datasets.calibration_frames import CalibrationFrames, FlatPair, flat_pairs
from eldata.errors import ArgumentError, DatasetError, EldataError, RawFileError, UnusableRawError
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.table import number_text
from eldata.manifest.verify_report import Problem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from fractions import Fraction

    from eldata.calibration.sums import Mosaic
    from eldata.records import FrameRecord, RawFrame, RawHeader, Sensor

Crop = tuple[slice, slice]
"""Rows and columns of a mosaic."""

WHOLE: Crop = (slice(None), slice(None))


class FramesError(DatasetError):
    """Frames that cannot be calibrated from: ``problems`` lists every one."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__(problems)
        self.problems = tuple(problems)

    def __str__(self) -> str:
        more = f" (and {len(self.problems) - 1} more problems)" if len(self.problems) > 1 else ""
        return f"{self.problems[0]}{more}"


@dataclass(frozen=True, slots=True)
class IsoFrames:
    """The frames of one ISO, sorted out.

    Attributes
    ----------
    iso
        ISO speed.
    bias, pairs, single
        Bias frames, pairs of equal flats, and flats without a partner.
    bias_exposure_s
        Exposure time of the bias frames; ``None`` if none states it.
    problems
        What the headers show to be wrong with them; if anything is, the ISO cannot be used.
    stated_gain_dn_per_e
        K, where somebody states it.
    accept
        Checks whose withheld figures are to be given with a larger error.
    crop
        The part of each frame that is used.
    """

    iso: Fraction
    bias: tuple[FrameRecord, ...]
    pairs: tuple[FlatPair, ...]
    single: tuple[FrameRecord, ...]
    bias_exposure_s: Fraction | None
    problems: tuple[Problem, ...] = ()
    stated_gain_dn_per_e: float | None = None
    accept: tuple[str, ...] = ()
    crop: Crop = WHOLE

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """The frames that are read."""
        return (*self.bias, *(flat for pair in self.pairs for flat in (pair.first, pair.second)))


def sort_frames(frames: CalibrationFrames, workers: Workers = IN_THIS_PROCESS) -> tuple[IsoFrames, ...]:
    """Read every frame's header and sort the frames by ISO.

    A problem of an ISO is a file that is missing or unreadable, was taken by another camera model, at another ISO than
    its folder or row says or another exposure time than its row says, or states no exposure; and bias frames that
    differ in exposure time.
    """

    def read_header(record: FrameRecord) -> RawHeader | EldataError:
        """Read a frame's header, or return the error."""
        try:
            return frames.header(record)
        except EldataError as error:
            return error

    problems: dict[Fraction | None, list[Problem]] = defaultdict(list)
    headers: dict[FrameRecord, RawHeader] = {}
    for record, header in zip(frames.records, workers.read_ahead(read_header, frames.records), strict=True):
        if isinstance(header, EldataError):
            problems[record.iso].append(unreadable_problem(record, header))
        else:
            headers[record] = header
    models = Counter(header.model for header in headers.values())
    model = models.most_common(1)[0][0] if models else ""
    for record, header in headers.items():
        problems[record.iso] += _compare_with_row(record, header, model)
    time_of = {record: header.exposure.exposure_s for record, header in headers.items()}
    sorted_out = []
    for iso in frames.isos:
        bias = frames.of("bias", iso)
        usual, odd = _usual_time({record: time_of.get(record) for record in bias}, iso)
        problems[iso] += odd
        flats = [replace(record, exposure_s=time_of.get(record)) for record in frames.of("flat", iso)]
        pairs, single = flat_pairs(flats)
        wrong = tuple(sorted(problems[iso], key=lambda problem: problem.path))
        sorted_out.append(IsoFrames(iso, bias, pairs, single, usual, wrong))
    return tuple(sorted_out)


def _compare_with_row(record: FrameRecord, header: RawHeader, model: str) -> Iterator[Problem]:
    """Yield the differences between a file's header and its row, or the camera of most frames."""
    iso, exposure_s, stated = header.exposure.iso, header.exposure.exposure_s, record.exposure_s
    if header.model != model:
        yield frame_problem(record, "camera", model, header.model or "no model", "move it to its own camera")
    if iso is None or exposure_s is None:
        lost, advice = "ISO" if iso is None else "exposure time", "the file has lost its EXIF: copy the original"
        yield frame_problem(record, "exposure", "ISO and exposure time", f"no {lost}", advice)
    elif iso != record.iso and record.iso is not None:
        advice = "move it to the folder (or row) of its ISO"
        yield frame_problem(record, "iso", number_text(record.iso), number_text(iso), advice)
    elif stated is not None and abs(exposure_s - stated) > RATIO_TOLERANCE * stated:
        advice = "correct the manifest's row, or put the file that it means there"
        yield frame_problem(record, "exposure_s", _time_text(stated), _time_text(exposure_s), advice)


def _usual_time(times: Mapping[FrameRecord, Fraction | None], iso: Fraction) -> tuple[Fraction | None, list[Problem]]:
    """Find the exposure time of most bias frames of an ISO, if any is known, and problems of the others."""
    known = {record: time for record, time in times.items() if time is not None}
    if not known:
        return None, []
    usual = Counter(known.values()).most_common(1)[0][0]
    expected = f"{_time_text(usual)} like the other bias frames of ISO {float(iso):g}"
    advice = "take all bias frames at the shortest exposure; is this a flat?"
    odd = [(record, _time_text(time)) for record, time in known.items() if time != usual]
    return usual, [frame_problem(record, "exposure_s", expected, found, advice) for record, found in odd]


def _time_text(exposure_s: Fraction) -> str:
    """Return an exposure time as cameras show it."""
    return f"{exposure_s if exposure_s.numerator == 1 else number_text(exposure_s)} s"


def frame_problem(record: FrameRecord, field: str, expected: str, found: str, advice: str) -> Problem:
    """Return the problem of one frame."""
    return Problem(record.camera, record.path, field, expected, found, advice)


# --- reading ------------------------------------------------------------------------------------------------------


class FrameReader:
    """Decodes frames ahead, and leaves out those that are unlike the first one.

    Parameters
    ----------
    frames
        Where the files are.
    workers
        The threads that decode.
    done
        Called after each decoded frame.
    crop
        The part of each frame that is given.
    """

    def __init__(
        self, frames: CalibrationFrames, workers: Workers, done: Callable[[], object], crop: Crop = WHOLE
    ) -> None:
        self.frames, self.workers, self._done, self._crop = frames, workers, done, crop
        self._sensors: dict[FrameRecord, Sensor] = {}
        self.problems: list[Problem] = []
        self.remarks: list[str] = []
        self.figures: dict[FrameRecord, tuple[float, float]] = {}
        """Level and spread of the bias frames, among which odd ones are looked for."""
        self._digests: dict[bytes, FrameRecord] = {}

    def read(self, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, RawFrame]]:
        """Yield the frames that are like the first one; :meth:`refuse` reports the others."""
        decoded = self.workers.read_ahead(self._decode_crop, records)
        for record in records:  # no zip: it holds on to the last frame while the next one is decoded
            frame = next(decoded)
            self._done()
            if isinstance(frame, RawFileError):
                self.problems.append(unreadable_problem(record, frame))
                continue
            self._sensors[record] = frame.sensor
            if not compare_sensors(record, frame.sensor, self.sensor, ""):
                yield record, frame
            del frame

    def is_copy(self, record: FrameRecord, mosaic: Mosaic) -> bool:
        """Tell whether a frame repeats the pixels of another one, and remark on it.

        Evenly spread rows of a frame, 4 MB of them, are compared by a digest: two frames of a sensor never agree in a
        thousand pixels that are not saturated. Frames with fewer of them are taken for new.
        """
        from hashlib import blake2b

        rows = np.ascontiguousarray(mosaic[:: max(1, mosaic.nbytes // (1 << 22))])
        if np.count_nonzero(rows < rows.max()) < 1000:
            return False
        first = self._digests.setdefault(blake2b(rows.data, digest_size=16).digest(), record)
        if first is record:
            return False
        self.remarks.append(
            f"{record.path} has the same pixels as {first.path} and was left out: a copy, or noise too small for the "
            "values' steps"
        )
        return True

    def _decode_crop(self, record: FrameRecord) -> RawFrame | RawFileError:
        """Decode the chosen area of a frame, or return the error."""
        try:
            return crop_frame(self.frames.read(record), self._crop)
        except RawFileError as error:
            return error

    @property
    def sensor(self) -> Sensor:
        """The first frame's, which all frames must be like."""
        return next(iter(self._sensors.values()))

    def refuse(self) -> None:
        """Raise the problems of the frames so far, if there are any."""
        problems = [*self.problems, *odd_sensors(self._sensors), *odd_bias_frames(self.figures)]
        if problems:
            raise FramesError(sorted(problems, key=lambda problem: problem.path))


def crop_frame(frame: RawFrame, crop: Crop) -> RawFrame:
    """Crop a frame; the CFA of the part begins at its own first pixel."""
    from eldata.raw.levels import cfa_from

    mosaic = np.ascontiguousarray(frame.mosaic[crop])
    if not mosaic.size:
        raise ArgumentError(f"crop {crop_text(crop)} leaves nothing of {frame.mosaic.shape}")
    top, left = (part.indices(size)[0] for part, size in zip(crop, frame.mosaic.shape, strict=True))
    height, width = mosaic.shape
    sensor = replace(frame.sensor, cfa=cfa_from(frame.sensor.cfa, top, left), height=height, width=width)
    return replace(frame, mosaic=mosaic, sensor=sensor)


def picture_crop(frames: CalibrationFrames, chosen: Sequence[IsoFrames]) -> Crop | None:
    """Return the area with picture of the first readable bias frame and flat; ``None``: all of them."""
    from eldata.raw.damage import picture_area

    parts = []
    bias = [record for of_iso in chosen for record in of_iso.bias]
    for records in (bias, [pair.first for of_iso in chosen for pair in of_iso.pairs]):
        for record in records:
            with suppress(RawFileError):  # who measures says why
                mosaic = frames.read(record).mosaic
                area = zip(picture_area(mosaic), mosaic.shape, strict=True)
                parts.append([(part.start, part.stop - side) for part, side in area])
                break
    # Counted from both ends: a frame of another size must keep it, to be found.
    rows, columns = (
        slice(max(start for start, _ in ends) or None, min(stop for _, stop in ends) or None)
        for ends in zip(*parts or [[(0, 0)] * 2], strict=True)
    )
    return None if (rows, columns) == WHOLE else (rows, columns)


def check_crop(crop: Crop) -> Crop:
    """Return two slices without a step; raise :class:`ArgumentError` for anything else."""
    parts: tuple[object, ...] = crop
    if len(parts) != 2 or any(not isinstance(part, slice) or part.step is not None for part in parts):
        raise ArgumentError(f"crop is two slices without a step, of rows and of columns; found {crop!r}")
    return crop


def crop_text(crop: Crop) -> str:
    """Return rows and columns as ``--crop`` states them."""
    return ",".join(f"{'' if p.start is None else p.start}:{'' if p.stop is None else p.stop}" for p in crop)


def compare_sensors(record: FrameRecord, sensor: Sensor, usual: Sensor, example: str) -> list[Problem]:
    """Return the differences between a frame's sensor and the usual one of its ISO, as in the file ``example``."""
    problems = []
    advice = "take all frames of a camera in one raw mode, and leave this one out"
    for field in ("height", "width", "cfa", "black_level_dn", "white_level_dn"):
        expected, differs = getattr(usual, field), getattr(sensor, field)
        if field == "black_level_dn" and len(expected) == len(differs):
            # LibRaw measures some black levels in each file's masked pixels.
            expected = differs if all(abs(a - b) < 1 for a, b in zip(expected, differs, strict=True)) else expected
        if expected != differs:
            problems.append(frame_problem(record, field, f"{expected} as in {example}", str(differs), advice))
    return problems


def odd_sensors(sensors: Mapping[FrameRecord, Sensor]) -> list[Problem]:
    """Return the differences between some frames of one ISO and most of them."""
    kinds: dict[FrameRecord, list[FrameRecord]] = {}  # by the first of each
    for record, sensor in sensors.items():
        first = next((like for like in kinds if not compare_sensors(record, sensor, sensors[like], "")), record)
        kinds.setdefault(first, []).append(record)
    if len(kinds) < 2:
        return []
    usual = max(kinds, key=lambda first: len(kinds[first]))  # the first of equals
    others = (record for record in sensors if record not in kinds[usual])
    return [
        problem for record in others for problem in compare_sensors(record, sensors[record], sensors[usual], usual.path)
    ]


def unreadable_problem(record: FrameRecord, error: EldataError) -> Problem:
    """Return the problem of a file that cannot be read."""
    found, advice = error.reason if isinstance(error, RawFileError) else str(error), "copy it again, or leave it out"
    if isinstance(error, UnusableRawError):
        found, advice = error.found, error.advice
    return frame_problem(record, "content", "a whole raw file", found, advice)


# --- frames by their levels -------------------------------------------------------------------------------------------

# Of the brighter. Pairs are scaled to each other, and K is right at any ratio; beyond this it is doubtful that nothing
# but the light has changed.
_UNLIKE_PAIR = 0.25
_OF_NORMAL = 1.287  # standard deviation over the mean distance of the nearer 99 %


def measure_frame(mosaic: Mosaic) -> tuple[float, float]:
    """Return a frame's mean, and the standard deviation by all but one in a hundred, of some 100,000 pixels; DN."""
    step = max(1, math.isqrt(mosaic.size // 100_000)) | 1  # odd: every site of the CFA takes part
    sample = mosaic[::step, ::step]
    away = np.abs(sample - np.median(sample))
    spread = _OF_NORMAL * float(away[away <= np.quantile(away, 0.99)].mean())
    return float(sample.mean(dtype=np.float64)), spread


def odd_bias_frames(figures: Mapping[FrameRecord, tuple[float, float]]) -> list[Problem]:
    """Return the bias frames whose level or spread is not like the others' (light leak, lens cap off, another ISO).

    Off by more than 10 robust standard deviations of the frames' levels, a DN, and half the noise; or with a spread
    that differs by a quarter and a DN.
    """
    if not figures:
        return []
    levels, spreads = np.array(list(figures.values())).T
    level, spread = float(np.median(levels)), float(np.median(spreads))
    scatter = 1.4826 * float(np.median(np.abs(levels - level)))
    advice = "is it a bias frame of this ISO? look for light and for a lens without its cap, and leave it out"
    problems = []
    for record, (own_level, own_spread) in figures.items():
        for field, value, usual, tolerance in (
            ("level", own_level, level, max(10 * scatter, 1.0, 0.5 * spread)),
            ("noise", own_spread, spread, max(0.25 * spread, 1.0)),
        ):
            if abs(value - usual) > tolerance:
                expected = f"about {usual:.1f} DN as in the others"
                problems.append(frame_problem(record, field, expected, f"{value:.1f} DN", advice))
                break
    return problems


def measure_pair(first: RawFrame, second: RawFrame) -> tuple[float, float]:
    """Return the mean levels over black of two flats, DN."""
    black = float(np.mean(first.sensor.black_level_dn))
    return measure_frame(first.mosaic)[0] - black, measure_frame(second.mosaic)[0] - black


def unequal_pair(names: str, levels_dn: tuple[float, float]) -> str | None:
    """Return a remark if the two flats of a pair are too unlike to be one scene in one light, else ``None``."""
    apart = abs(levels_dn[0] - levels_dn[1]) - 1.0  # a DN is no difference
    if apart <= _UNLIKE_PAIR * max(*levels_dn, 1.0):
        return None
    return (
        f"{names} were left out: their levels over black are {levels_dn[0]:.0f} and {levels_dn[1]:.0f} DN; equal "
        f"exposures of a constant light differ by some per cent, and beyond {_UNLIKE_PAIR:.0%} they are not taken for "
        "two frames of one scene"
    )
