"""SID's files on disk: the published names, with small DNG files inside, made from seeds."""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eldata.manifest.catalogue import Manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor
from tests.raw.helpers import xtrans_at
from tests.trees import Tree, list_scenes, place_of, write_each_once

NAMES = ("sid-sony", "sid-fuji")

# Levels near the real ones and different from every published constant, so that a test sees which ones were taken. The
# X-Trans pixels do not fill whole periods: packing crops.
SENSORS = {
    "sid-sony": Sensor("Maker", "ILCE-7SM2", ((0, 1), (3, 2)), (510.0, 511.0, 513.0, 514.0), 16300.0, 40, 60),
    "sid-fuji": Sensor("Maker", "X-T2", xtrans_at(0, 0), (1022.0,) * 3, 16200.0, 50, 63),
}


def mosaic_of(name: str, record: FrameRecord) -> NDArray[np.uint16]:
    """Pixels of a frame, (H, W) in DN: a reference spans all levels, a short frame lies around the black level."""
    sensor = SENSORS[name]
    generator = np.random.default_rng(zlib.crc32(record.path.encode()))
    black = int(min(sensor.black_level_dn))
    low, high = (black - 30, 16384) if record.role == "reference" else (black - 12, black + 70)
    mosaic = generator.integers(low, high, (sensor.height, sensor.width), dtype=np.uint16)
    mosaic[:5, :7] = 16383 if record.role == "reference" else black + 300  # saturated, the second after amplification
    return mosaic


def exposure_of(record: FrameRecord) -> Exposure:
    """Exposure as the lists have it; a frame of uncertain ISO takes what the list says of it, 12800."""
    return Exposure(record.iso or Fraction(12800), record.exposure_s, Fraction(8))


def write_frame(name: str, folder: Path, record: FrameRecord) -> None:
    """Write one frame of a half of SID below the dataset's folder."""
    write_dng(place_of(record, folder), mosaic_of(name, record), SENSORS[name], exposure_of(record))


def write_frames(name: str, folder: Path, records: Iterable[FrameRecord]) -> None:
    """Write frames, each with pixels of its own."""
    for record in records:
        write_frame(name, folder, record)


def build_sid_tree(manifest: Manifest, folder: Path) -> None:
    """Write every file of a half of SID; equal exposures are one file."""
    write_each_once(folder, manifest.records, exposure_of, partial(write_frame, manifest.name, folder))


def frames_of(manifest: Manifest, noisy: Collection[str]) -> list[FrameRecord]:
    """Return the records of some short frames and of their references."""
    wanted = {*noisy, *(record.reference for record in manifest.records if record.path in noisy)}
    return [record for record in manifest.records if record.path in wanted]


@dataclass(frozen=True)
class SmallTree(Tree):
    """Some scenes of a half of SID, with a manifest of just these."""

    folder: str = "SID"


def build_small_tree(name: str, folder: Path, scenes: Collection[str]) -> SmallTree:
    """Write all files of some scenes and a manifest that lists them alone."""
    tree = SmallTree(list_scenes(name, folder, scenes), folder / "data")
    write_frames(name, tree.data, tree.manifest.records)
    return tree
