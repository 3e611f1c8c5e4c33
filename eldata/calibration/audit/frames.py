"""The frames of one ISO: sorted by what their headers state, read a frame at a time, and what is wrong with them.

What their pixels show, frame by frame, comes last.
"""

from __future__ import annotations

import copy
import math
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from eldata.base.workers import IN_THIS_PROCESS, Workers, require_files
from eldata.calibration.core.findings import UNEVEN
from eldata.datasets.calibration_frames import flat_pairs
from eldata.errors import DatasetError, EldataError, RawFileError, UnusableRawError
from eldata.manifest.table import number_text
from eldata.manifest.verify import RATIO_TOLERANCE
from eldata.manifest.verify_report import Problem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from fractions import Fraction

    from eldata.calibration.core._frames import Mosaic
    from eldata.calibration.core.findings import Finding
    from eldata.datasets.calibration_frames import CalibrationFrames, FlatPair
    from eldata.records import FrameRecord, RawFrame, RawHeader, Sensor

Found = TypeVar("Found")

_DIGESTED_BYTES = 1 << 22  # of a frame
_COMPARED = 1000  # pixels, at least, that tell a copy


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
    """

    iso: Fraction
    bias: tuple[FrameRecord, ...]
    pairs: tuple[FlatPair, ...]
    single: tuple[FrameRecord, ...]
    bias_exposure_s: Fraction | None
    problems: tuple[Problem, ...] = ()
    stated_gain_dn_per_e: float | None = None
    accept: tuple[str, ...] = ()

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """The frames that are read."""
        return (*self.bias, *(flat for pair in self.pairs for flat in (pair.first, pair.second)))


def work_elsewhere(
    work: Callable[[CalibrationFrames, IsoFrames], Found], frames: CalibrationFrames
) -> Callable[[IsoFrames], Found]:
    """Return work on one ISO as workers do it, which have folders of their own to start from."""
    there = copy.copy(frames)
    there.root = frames.root.absolute()
    return partial(_work_there, work, there)


def _work_there(
    work: Callable[[CalibrationFrames, IsoFrames], Found], frames: CalibrationFrames, chosen: IsoFrames
) -> Found:
    require_files(*map(frames.path, chosen.records))
    return work(frames, chosen)


def sorted_frames(frames: CalibrationFrames, workers: Workers = IN_THIS_PROCESS) -> tuple[IsoFrames, ...]:
    """Read every frame's header and sort the frames by ISO.

    A problem of an ISO is a file that is missing or unreadable, was taken by another camera model, at another ISO than
    its folder or row says or another exposure time than its row says, or states no exposure; and bias frames that
    differ in exposure time.
    """

    def header_of(record: FrameRecord) -> RawHeader | EldataError:
        try:
            return frames.header(record)
        except EldataError as error:
            return error

    problems: dict[Fraction | None, list[Problem]] = defaultdict(list)
    headers: dict[FrameRecord, RawHeader] = {}
    for record, found in zip(frames.records, workers.read_ahead(header_of, frames.records), strict=True):
        if isinstance(found, EldataError):
            problems[record.iso].append(unreadable(record, found))
        else:
            headers[record] = found
    models = Counter(header.model for header in headers.values())
    model = models.most_common(1)[0][0] if models else ""
    for record, header in headers.items():
        problems[record.iso] += _unlike_its_row(record, header, model)
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


def _unlike_its_row(record: FrameRecord, header: RawHeader, model: str) -> Iterator[Problem]:
    """Yield how a file's header differs from its row, and its camera from that of most frames."""
    iso, exposure_s, stated = header.exposure.iso, header.exposure.exposure_s, record.exposure_s
    if header.model != model:
        yield problem_of(record, "camera", model, header.model or "no model", "move it to its own camera")
    if iso is None or exposure_s is None:
        lost, advice = "ISO" if iso is None else "exposure time", "the file has lost its EXIF: copy the original"
        yield problem_of(record, "exposure", "ISO and exposure time", f"no {lost}", advice)
    elif iso != record.iso and record.iso is not None:
        advice = "move it to the folder (or row) of its ISO"
        yield problem_of(record, "iso", number_text(record.iso), number_text(iso), advice)
    elif stated is not None and abs(exposure_s - stated) > RATIO_TOLERANCE * stated:
        advice = "correct the manifest's row, or put the file that it means there"
        yield problem_of(record, "exposure_s", _time_text(stated), _time_text(exposure_s), advice)


def _usual_time(times: Mapping[FrameRecord, Fraction | None], iso: Fraction) -> tuple[Fraction | None, list[Problem]]:
    """Return the exposure time of most bias frames of an ISO, if any is known, and what is wrong with the others."""
    known = {record: time for record, time in times.items() if time is not None}
    if not known:
        return None, []
    usual = Counter(known.values()).most_common(1)[0][0]
    expected = f"{_time_text(usual)} like the other bias frames of ISO {float(iso):g}"
    advice = "take all bias frames at the shortest exposure; is this a flat?"
    odd = [(record, _time_text(time)) for record, time in known.items() if time != usual]
    return usual, [problem_of(record, "exposure_s", expected, found, advice) for record, found in odd]


def _time_text(exposure_s: Fraction) -> str:
    """Return an exposure time as cameras show it."""
    return f"{exposure_s if exposure_s.numerator == 1 else number_text(exposure_s)} s"


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
    """

    def __init__(
        self, frames: CalibrationFrames, workers: Workers = IN_THIS_PROCESS, done: Callable[[], object] = lambda: None
    ) -> None:
        self.frames, self.workers, self._done = frames, workers, done
        self._sensors: dict[FrameRecord, Sensor] = {}
        self.problems: list[Problem] = []
        self.figures: list[FrameFigures] = []
        """Of the bias frames, among which odd ones are looked for."""
        self.copies = Copies()

    def read(self, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, RawFrame]]:
        """Yield the frames that are like the first one; :meth:`refuse` says what is wrong with the others."""
        decoded = self.workers.read_ahead(self._read, records)
        for record in records:  # no zip: it holds on to the last frame while the next one is decoded
            frame = next(decoded)
            self._done()
            if isinstance(frame, RawFileError):
                self.problems.append(unreadable(record, frame))
                continue
            self._sensors[record] = frame.sensor
            if not unlike(record, frame.sensor, self.sensor, ""):
                yield record, frame
            del frame

    def read_new(self, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, RawFrame]]:
        """Yield the frames without copies of others: the difference of a frame and its copy holds no noise."""
        for record, frame in self.read(records):
            if self.copies.original(record, frame.mosaic) is None:
                yield record, frame
            del frame  # before the next one is decoded

    def _read(self, record: FrameRecord) -> RawFrame | RawFileError:
        try:
            return self.frames.read(record)
        except RawFileError as error:
            return error

    @property
    def sensor(self) -> Sensor:
        """The first frame's, which all frames must be like."""
        return next(iter(self._sensors.values()))

    def refuse(self) -> None:
        """Raise what is wrong with the frames so far, if anything is."""
        problems = [*self.problems, *unlike_most(self._sensors), *odd_bias_frames(self.figures)]
        if problems:
            raise FramesError(sorted(problems, key=lambda problem: problem.path))


def unlike(record: FrameRecord, found: Sensor, usual: Sensor, example: str) -> list[Problem]:
    """Return how a frame's sensor differs from those of its ISO's other frames, such as the file ``example``."""
    problems = []
    advice = "take all frames of a camera in one raw mode, and leave this one out"
    for field in ("height", "width", "cfa", "black_level_dn", "white_level_dn"):
        expected, differs = getattr(usual, field), getattr(found, field)
        # LibRaw measures some black levels in each file's masked pixels.
        if expected != differs and not (field == "black_level_dn" and _within_1_dn(expected, differs)):
            problems.append(problem_of(record, field, f"{expected} as in {example}", str(differs), advice))
    return problems


def _within_1_dn(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    return len(first) == len(second) and all(abs(a - b) < 1 for a, b in zip(first, second, strict=True))


def unlike_most(sensors: Mapping[FrameRecord, Sensor]) -> list[Problem]:
    """Return how some frames of one ISO differ from most of them."""
    kinds: dict[FrameRecord, list[FrameRecord]] = {}  # by the first of each
    for record, sensor in sensors.items():
        first = next((one for one in kinds if not unlike(record, sensor, sensors[one], "")), record)
        kinds.setdefault(first, []).append(record)
    if len(kinds) < 2:
        return []
    usual = max(kinds, key=lambda first: len(kinds[first]))  # the first of equals
    others = (record for record in sensors if record not in kinds[usual])
    return [problem for record in others for problem in unlike(record, sensors[record], sensors[usual], usual.path)]


def unreadable(record: FrameRecord, error: EldataError) -> Problem:
    """Return the problem of a file that cannot be read."""
    found, advice = error.reason if isinstance(error, RawFileError) else str(error), "copy it again, or leave it out"
    if isinstance(error, UnusableRawError):
        found, advice = error.found, error.advice
    return problem_of(record, "content", "a whole raw file", found, advice)


class Copies:
    """Tells frames whose pixels were seen before.

    Evenly spread rows of a frame are compared, by a digest: two frames of a sensor never agree in a thousand pixels
    that are not saturated. Frames with fewer of them are taken for new.
    """

    def __init__(self) -> None:
        self._seen: dict[bytes, FrameRecord] = {}
        self.remarks: list[str] = []

    def original(self, record: FrameRecord, mosaic: Mosaic) -> FrameRecord | None:
        """Return the frame that this one is a copy of, and remark on it; ``None`` for one that is new."""
        from hashlib import blake2b

        rows = np.ascontiguousarray(mosaic[:: max(1, mosaic.nbytes // _DIGESTED_BYTES)])
        if np.count_nonzero(rows < rows.max()) < _COMPARED:
            return None
        first = self._seen.setdefault(blake2b(rows.data, digest_size=16).digest(), record)
        if first is record:
            return None
        self.remarks.append(
            f"{record.path} has the same pixels as {first.path} and was left out: copies hide noise; shoot each anew"
        )
        return first


# --- pixels -----------------------------------------------------------------------------------------------------------

ADVISED_BIAS_FRAMES = 10

_CLIPPED_SHARE = 0.01  # of pixels at 0 DN
# Of the signal. Pairs are scaled to each other, and K is right at any ratio; but light that changes so much between two
# equal exposures is worth a word, and beyond the second limit it is doubtful that nothing else has changed.
_PAIR_DIFFERENCE = 0.05
_UNLIKE_PAIR = 0.25


def problem_of(record: FrameRecord, field: str, expected: str, found: str, advice: str) -> Problem:
    """Return what is wrong with a frame."""
    return Problem(record.camera, record.path, field, expected, found, advice)


@dataclass(frozen=True, slots=True)
class FrameFigures:
    """A frame in two figures, DN: its mean, and half the distance of its 16th and 84th percentile."""

    record: FrameRecord
    level_dn: float
    spread_dn: float

    @classmethod
    def of(cls, record: FrameRecord, mosaic: Mosaic) -> FrameFigures:
        """Measure a frame on some 100,000 of its pixels."""
        step = max(1, math.isqrt(mosaic.size // 100_000)) | 1  # odd: every site of the CFA takes part
        sample = mosaic[::step, ::step]
        low, high = np.quantile(sample, (0.159, 0.841))
        return cls(record, float(sample.mean(dtype=np.float64)), float(high - low) / 2)


def clipped_black(record: FrameRecord, mosaic: Mosaic) -> list[Problem]:
    """Return a problem if more than 1 % of a bias frame's pixels are 0, where whole noise is needed."""
    share = (mosaic.size - int(np.count_nonzero(mosaic))) / mosaic.size
    if share <= _CLIPPED_SHARE:
        return []
    return [
        problem_of(
            record,
            "black",
            "noise on both sides of a black level above 0",
            f"{share:.0%} of the pixels at 0 DN",
            "black is clipped in this file, and half of the noise cannot be compared: use raw files that keep the "
            "black level; a calibration takes these",
        )
    ]


def odd_bias_frames(figures: Sequence[FrameFigures]) -> list[Problem]:
    """Return the bias frames whose level or spread is not like the others' (light leak, lens cap off, another ISO).

    Off by more than 10 robust standard deviations of the frames' levels, a DN, and half the noise; or with a spread
    that differs by a quarter and a DN.
    """
    if not figures:
        return []
    levels = np.array([one.level_dn for one in figures])
    spreads = np.array([one.spread_dn for one in figures])
    level, spread = float(np.median(levels)), float(np.median(spreads))
    scatter = 1.4826 * float(np.median(np.abs(levels - level)))
    advice = "is it a bias frame of this ISO? look for light and for a lens without its cap, and leave it out"
    problems = []
    for one in figures:
        for field, found, usual, tolerance in (
            ("level", one.level_dn, level, max(10 * scatter, 1.0, 0.5 * spread)),
            ("noise", one.spread_dn, spread, max(0.25 * spread, 1.0)),
        ):
            if abs(found - usual) > tolerance:
                expected = f"about {usual:.1f} DN as in the others"
                problems.append(problem_of(one.record, field, expected, f"{found:.1f} DN", advice))
                break
    return problems


@dataclass(frozen=True, slots=True)
class PairLevels:
    """The mean levels over black of a pair of flats, DN."""

    pair: FlatPair
    first_dn: float
    second_dn: float

    @classmethod
    def of(cls, pair: FlatPair, first: RawFrame, second: RawFrame) -> PairLevels:
        """Measure a pair on some 100,000 pixels of each frame."""
        black = float(np.mean(first.sensor.black_level_dn))
        one, two = (FrameFigures.of(pair.first, frame.mosaic).level_dn - black for frame in (first, second))
        return cls(pair, one, two)

    @property
    def difference(self) -> float:
        """Of the two, as a share of the brighter; a DN is none."""
        apart = max(0.0, abs(self.first_dn - self.second_dn) - 1.0)
        return apart / max(self.first_dn, self.second_dn, 1.0)

    def __str__(self) -> str:
        return f"{self.pair.first.path} and {self.pair.second.path} ({self.first_dn:.0f} and {self.second_dn:.0f} DN)"


def unequal_pair(levels: PairLevels) -> str | None:
    """Return a remark if the two flats of a pair are too unlike to be one scene in one light, else ``None``."""
    if levels.difference <= _UNLIKE_PAIR:
        return None
    return (
        f"{levels.pair.first.path} and {levels.pair.second.path} were left out: their levels over black are "
        f"{levels.first_dn:.0f} and {levels.second_dn:.0f} DN; equal exposures of a constant light differ by less than "
        f"{_PAIR_DIFFERENCE:.0%}, and beyond {_UNLIKE_PAIR:.0%} they are not taken for two frames of one scene"
    )


def uneven_light(used: Sequence[PairLevels]) -> Iterator[Finding]:
    """Yield a remark if pairs differ by more than equal exposures of a constant light do."""
    uneven = [levels for levels in used if levels.difference > _PAIR_DIFFERENCE]
    if uneven:
        worst = max(uneven, key=lambda levels: levels.difference)
        yield UNEVEN.seen(
            worst.difference,
            _PAIR_DIFFERENCE,
            f"{len(uneven)} of {len(used)} pairs of flats differ in light by up to {worst.difference:.0%}: {worst}; "
            "they were scaled to each other, so K holds, but a constant light and a mechanical shutter are better",
        )
