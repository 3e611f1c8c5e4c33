"""Frames of a camera that were kept from a noise model: read a pair at a time, and what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration.acceptance.reproduction import compared_place
from eldata.calibration.audit.frame_checks import (
    Copies,
    FrameFigures,
    FramesError,
    clipped_black,
    odd_bias_frames,
    unlike,
    unlike_most,
    unreadable,
)
from eldata.errors import RawFileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.datasets.calibration_frames import CalibrationFrames, FlatPair
    from eldata.manifest.verify_report import Problem
    from eldata.records import FrameRecord, RawFrame, Sensor

    Mosaic = NDArray[np.uint16]


@dataclass(slots=True)
class HeldOutFrames:
    """Reads the frames of one ISO, a pair at a time, and collects what is wrong with them."""

    frames: CalibrationFrames
    workers: Workers = IN_THIS_PROCESS
    sensor: Sensor | None = None
    example: str = ""
    sensors: dict[FrameRecord, Sensor] = field(default_factory=dict)
    figures: list[FrameFigures] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    copies: Copies = field(default_factory=Copies)

    def read(self, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, Mosaic]]:
        """Yield frames that are like the first one, and no copies; threads decode ahead."""
        decoded = self.workers.read_ahead(self._decoded, records)
        for record in records:  # no zip: it holds on to the last frame while the next one is decoded
            mosaic = self._taken(record, next(decoded))
            if mosaic is not None:
                yield record, mosaic
            del mosaic

    def _decoded(self, record: FrameRecord) -> RawFrame | RawFileError:
        try:
            return self.frames.read(record)
        except RawFileError as error:
            return error

    def _taken(self, record: FrameRecord, raw: RawFrame | RawFileError) -> Mosaic | None:
        if isinstance(raw, RawFileError):
            self.problems.append(unreadable(record, raw))
            return None
        if self.sensor is None:
            self.sensor, self.example = raw.sensor, record.path
        self.sensors[record] = raw.sensor
        if unlike(record, raw.sensor, self.sensor, self.example) or self.copies.original(record, raw.mosaic):
            return None
        return raw.mosaic

    def bias_pairs(self, records: Sequence[FrameRecord]) -> Iterator[tuple[Mosaic, Mosaic]]:
        """Yield pairs of pieces of bias frames that share no frame."""
        first: Mosaic | None = None
        for record, mosaic in self.read(records):
            self.problems += clipped_black(record, mosaic)
            self.figures.append(FrameFigures.of(record, mosaic))
            piece = self.cut(mosaic)
            if first is None:
                first = piece
            else:
                yield first, piece
                first = None

    def flats(self, pair: FlatPair) -> tuple[Mosaic, Mosaic] | None:
        """Return a pair of whole flats."""
        found = [mosaic for _, mosaic in self.read((pair.first, pair.second))]
        return (found[0], found[1]) if len(found) == 2 else None

    def known(self) -> Sensor:
        """Return the sensor of the frames.

        Raises
        ------
        FramesError
            If none could be read.
        """
        if self.sensor is None:
            raise FramesError(self.problems)
        return self.sensor

    def cut(self, mosaic: NDArray[np.generic]) -> Mosaic:
        """Return a copy of the piece that is compared."""
        return mosaic[compared_place(mosaic.shape, len(self.known().cfa))].copy()  # type: ignore[return-value]

    def refuse(self) -> None:
        """Raise what is wrong with the frames so far, if anything is."""
        problems = [*self.problems, *unlike_most(self.sensors), *odd_bias_frames(self.figures)]
        if problems:
            raise FramesError(sorted(problems, key=lambda problem: problem.path))
