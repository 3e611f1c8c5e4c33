"""LRID's files on disk: the published names, small DNG files and references in .npy inside, made from seeds."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eldata.manifest.catalogue import Manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor
from tests.trees import place_of, write_each_once

# Ten bits, as the published code has it, but other levels than its 64 and 1023: a test sees which were taken.
SENSOR = Sensor("Maker", "Phone", ((0, 1), (3, 2)), (63.0, 64.0, 66.0, 64.0), 1020.0, 40, 48)
DARK_MS = (16,) * 6


def mosaic_of(record: FrameRecord, sensor: Sensor = SENSOR) -> NDArray[np.uint16]:
    """Pixels of a frame, (H, W) in DN: a reference has all levels, a noisy one is darker, a dark one around black."""
    generator = np.random.default_rng(zlib.crc32(record.path.encode()))
    if record.role == "bias":
        columns = np.random.default_rng(0).normal(0, 2, sensor.width)  # what dark shading is there for
        return np.rint(64 + columns + generator.normal(0, 3, (sensor.height, sensor.width))).astype(np.uint16)
    scene = np.random.default_rng(zlib.crc32(str(record.scene).encode())).gamma(2, 250, (sensor.height, sensor.width))
    light = scene / float(record.ratio or 1)
    return np.clip(np.rint(64 + light + generator.normal(0, 12, light.shape)), 0, 1023).astype(np.uint16)


def write_frames(folder: Path, records: Iterable[FrameRecord], sensor: Sensor = SENSOR) -> None:
    """Write frames below the dataset's folder, each with pixels of its own; of a pattern, six dark frames."""
    for record in records:
        path = place_of(record, folder)
        if record.role == "reference":  # fused from several frames: fractions of a DN
            np.save(path, mosaic_of(record, sensor).astype(np.float32) + np.float32(0.25))
        elif record.role == "bias":
            for number, ms in enumerate(DARK_MS):
                time = f"2022_08_05_19_33_00_{number}00_{ms}"
                name = f"{number:06d}_exp-{ms}000000_iso-6400_{time}_orientation_0_camera-0.dng"
                frame = replace(record, path=record.path.replace("*.dng", name))
                write_dng(
                    folder / frame.path, mosaic_of(frame, sensor), sensor, Exposure(record.iso, Fraction(ms, 1000))
                )
        else:
            write_dng(path, mosaic_of(record, sensor), sensor, Exposure(record.iso, record.exposure_s))


def build_lrid_tree(manifest: Manifest, folder: Path) -> None:
    """Write every file of LRID; noisy frames of one exposure are one file."""

    def kind(record: FrameRecord) -> tuple[object, ...]:
        return (record.path if record.role == "bias" else record.role, record.iso, record.exposure_s)

    write_each_once(folder, manifest.records, kind, lambda record: write_frames(folder, [record]))
