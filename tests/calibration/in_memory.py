"""Frames of one ISO that are arrays, or are made when they are asked for, as ``calibrate_iso`` takes them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from eldata.base.workers import IN_THIS_PROCESS
from eldata.calibration.frames import IsoFrames
from eldata.calibration.iso_results import IsoCalibration
from eldata.calibration.one_iso import calibrate_iso
from eldata.datasets.calibration_frames import FlatPair
from eldata.records import Exposure, FrameRecord, RawFrame

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.base.workers import Workers
    from eldata.calibration.residuals import ReadNoise
    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.records import Role, Sensor

    Mosaic = NDArray[np.uint16]

ISO = 100


@dataclass(frozen=True)
class FramesInMemory:
    """Stands for :class:`~eldata.datasets.calibration_frames.CalibrationFrames`: ``take`` makes the n-th frame."""

    sensor: Sensor
    take: Callable[[Role, int], Mosaic]
    camera: str = "Simulated"

    def read(self, record: FrameRecord) -> RawFrame:
        mosaic = self.take(record.role, int(Path(record.path).stem))
        exposure = Exposure(Fraction(ISO), Fraction(1, 8000), Fraction(8))
        return RawFrame(Path(record.path), mosaic, self.sensor, exposure)

    def path(self, _: FrameRecord) -> Path:
        """A file that says nothing about compression."""
        return Path(os.devnull)


def record(role: Role, number: int, exposure_s: Fraction | None = None) -> FrameRecord:
    return FrameRecord(f"{role}/{number}.dng", role, "Simulated", iso=Fraction(ISO), exposure_s=exposure_s)


def iso_frames(bias: int, pairs: int) -> IsoFrames:
    """So many bias frames and pairs of flats, each pair of another exposure, whose frames are 0 and 1, 2 and 3, ..."""
    flats = [record("flat", number, Fraction(1 + number // 2, 1000)) for number in range(2 * pairs)]
    return IsoFrames(
        iso=Fraction(ISO),
        bias=tuple(record("bias", number) for number in range(bias)),
        pairs=tuple(map(FlatPair, flats[::2], flats[1::2])),
        single=(),
        bias_exposure_s=Fraction(1, 8000),
    )


def calibrated_in_memory(
    sensor: Sensor,
    bias: int,
    pairs: int,
    take: Callable[[Role, int], Mosaic],
    workers: Workers = IN_THIS_PROCESS,
    **options: Any,
) -> IsoCalibration:
    """Calibrate an ISO of so many frames as :func:`iso_frames` numbers them."""
    frames = cast("CalibrationFrames", FramesInMemory(sensor, take))
    found = calibrate_iso(frames, iso_frames(bias, pairs), workers, **options)
    assert isinstance(found, IsoCalibration)
    return found


def read_of(one: IsoCalibration) -> ReadNoise:
    """The read noise of an ISO whose values do not end at 0."""
    assert one.read is not None
    return one.read


def calibrated_arrays(sensor: Sensor, bias: Sequence[Mosaic], pairs: Sequence[tuple[Mosaic, Mosaic]]) -> IsoCalibration:
    """Calibrate an ISO from arrays."""
    flats = [flat for pair in pairs for flat in pair]
    by_role = {"bias": bias, "flat": flats}
    return calibrated_in_memory(sensor, len(bias), len(pairs), lambda role, number: by_role[role][number])
