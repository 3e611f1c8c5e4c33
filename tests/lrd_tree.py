"""LRD's files on disk: the published names, with small DNG files inside, made from seeds."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eldata.manifest.catalogue import Manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor
from tests.trees import place_of, write_each_once

# Sixteen bits, as the published code has it, but another white level than its 65535: a test sees which was taken.
SENSOR = Sensor("Maker", "Drone", ((0, 1), (3, 2)), (4095.0, 4096.0, 4098.0, 4096.0), 65000.0, 40, 48)


def mosaic_of(record: FrameRecord) -> NDArray[np.uint16]:
    """Pixels of a frame, (H, W) in DN: a reference spans all levels, a noisy frame lies below it by its ratio."""
    generator = np.random.default_rng(zlib.crc32(record.path.encode()))
    top = 65536 if record.role == "reference" else 4090 + 60000 // int(record.ratio or 1)
    return generator.integers(4000, top, (SENSOR.height, SENSOR.width), dtype=np.uint16)


def write_frames(folder: Path, records: Iterable[FrameRecord]) -> None:
    """Write frames below the dataset's folder, each with pixels of its own."""
    for record in records:
        write_dng(place_of(record, folder), mosaic_of(record), SENSOR, Exposure(record.iso, record.exposure_s))


def build_lrd_tree(manifest: Manifest, folder: Path) -> None:
    """Write every file of LRD; equal exposures are one file."""
    write_each_once(
        folder, manifest.records, lambda one: (one.iso, one.exposure_s), lambda one: write_frames(folder, [one])
    )
