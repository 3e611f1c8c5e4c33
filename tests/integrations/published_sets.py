"""A small set of one's own for the published code: real DNG files, named as SID's, of a camera with channel whites."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from eldata.manifest.card import CameraCard, Card
from eldata.manifest.catalogue import save_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest

# LibRaw has a white level per channel of this model, 15311, which is not the file's: LED divides by it.
SENSOR = Sensor(
    "NIKON CORPORATION", "NIKON D850", ((2, 3), (1, 0)), (400.0, 401.0, 402.0, 401.0), 16000.0, 50, 68, (2.0, 1, 1.5, 1)
)
LONG_S = Fraction(10)
SHORT_S = {"0.04": Fraction(1, 25), "0.1": Fraction(1, 10), "0.033": Fraction(1, 30)}
RATIO = {"0.04": 250, "0.1": 100, "0.033": 300}


def photograph(path: Path, iso: int, seconds: Fraction, seed: int, sensor: Sensor = SENSOR) -> None:
    """A frame with pixels below black and above white."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mosaic = np.random.default_rng(seed).integers(300, 16384, (sensor.height, sensor.width), dtype=np.uint16)
    mosaic[: sensor.height // 2] //= 16  # dark enough that amplifying does not saturate it
    mosaic[: sensor.height // 2] += 350
    write_dng(path, mosaic, sensor, Exposure(Fraction(iso), seconds))


def sid_like(folder: Path, suffix: str = "ARW", sensor: Sensor = SENSOR) -> Manifest:
    """SID's names: scenes 00001 (train), 10003 (test) and 20004 (val), two shots of each time; ISO 200 throughout."""
    records, number = [], 0
    for scene, split in (("00001", "train"), ("10003", "test"), ("20004", "val")):
        long = f"Own/long/{scene}_00_10s.{suffix}"
        photograph(folder / "data/OWN" / long, 200, LONG_S, number := number + 1, sensor)
        records.append(FrameRecord(long, "reference", "Own", scene, split, Fraction(200), LONG_S))
        for text, seconds in SHORT_S.items():
            for burst in range(2):
                path = f"Own/short/{scene}_{burst:02d}_{text}s.{suffix}"
                photograph(folder / "data/OWN" / path, 200, seconds, number := number + 1, sensor)
                ratio = Fraction(RATIO[text])
                records.append(FrameRecord(path, "noisy", "Own", scene, split, Fraction(200), seconds, ratio, long))
    return _saved(folder, "own", records)


def _saved(folder: Path, name: str, records: list[FrameRecord]) -> Manifest:
    noisy = sum(record.role == "noisy" for record in records)
    card = Card(
        name=name,
        title="A set of one's own",
        version="1.0",
        folder="OWN",
        citation="",
        licence="CC0-1.0",
        homepage="",
        cfa="bayer",
        cameras={"Own": CameraCard(("NIKON D850",))},
        counts={"noisy": noisy, "reference": len(records) - noisy},
    )
    return save_manifest(folder / f"{name}.csv", card, records)
