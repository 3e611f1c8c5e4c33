"""Frames of one ISO that are arrays, or are made when they are asked for, through the estimators."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration import BiasStack, BiasSums, FixedPattern, fixed_pattern
from eldata.calibration.frames import IsoFrames
from eldata.calibration.iso_results import IsoCalibration, IsoGain, MeasuredFigure
from eldata.calibration.one_iso import calibrate_iso
from eldata.datasets.calibration_frames import CalibrationFrames, FlatPair
from eldata.records import Exposure, FrameRecord, RawFrame, Role, Sensor
from tests.calibration.simulation import Camera

Mosaic = NDArray[np.uint16]
Pairs = Sequence[tuple[Mosaic, Mosaic]]

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


def measured_in_memory(
    sensor: Sensor, bias: int, pairs: int, take: Callable[[Role, int], Mosaic], workers: Workers = IN_THIS_PROCESS
) -> IsoGain:
    """Measure an ISO of so many bias frames and pairs of flats, each of another exposure: 0 and 1, 2 and 3, ..."""
    flats = [record("flat", number, Fraction(1 + number // 2, 1000)) for number in range(2 * pairs)]
    frames = IsoFrames(
        iso=Fraction(ISO),
        bias=tuple(record("bias", number) for number in range(bias)),
        pairs=tuple(map(FlatPair, flats[::2], flats[1::2])),
        single=(),
        bias_exposure_s=Fraction(1, 8000),
    )
    return calibrate_iso(cast("CalibrationFrames", FramesInMemory(sensor, take)), frames, workers)


def measured_arrays(sensor: Sensor, bias: Sequence[Mosaic], pairs: Sequence[tuple[Mosaic, Mosaic]]) -> IsoGain:
    """Measure an ISO from arrays."""
    by_role = {"bias": bias, "flat": [flat for pair in pairs for flat in pair]}
    return measured_in_memory(sensor, len(bias), len(pairs), lambda role, number: by_role[role][number])


def calibrated_arrays(sensor: Sensor, bias: Sequence[Mosaic], pairs: Sequence[tuple[Mosaic, Mosaic]]) -> IsoCalibration:
    """Calibrate an ISO from arrays, of which bias frames can be used."""
    record = measured_arrays(sensor, bias, pairs)
    assert isinstance(record, IsoCalibration)
    return record


def stacked(camera: Camera, frames: Sequence[Mosaic]) -> FixedPattern:
    stack = BiasStack(camera.cfa)
    for frame in frames:
        stack.add(frame)
    return fixed_pattern(stack)


def summed(fixed: FixedPattern, frames: Sequence[Mosaic]) -> BiasSums:
    sums = BiasSums(fixed)
    for frame in frames:
        sums.add(frame)
    return sums


def calibrated(camera: Camera, frames: Sequence[Mosaic], pairs: Pairs = ()) -> IsoCalibration:
    """Of all frames: the last is a copy, which is left out, so that none is held out."""
    return calibrated_arrays(camera.sensor, [*frames, frames[0]], pairs)


def figures_of(record: IsoCalibration, camera: Camera) -> dict[str, tuple[MeasuredFigure | None, float]]:
    """Figures of bias frames, None if they are withheld, each with the truth."""
    return {
        "lambda": (record.tukey_lambda, camera.tukey_lambda),
        "sigma_TL": (record.sigma_tl_dn, camera.sigma_tl),
        "sigma_G": (record.sigma_gauss_dn, camera.noise.sigma_gauss_dn),
        "sigma_row": (record.sigma_row_dn, camera.sigma_row),
    }
