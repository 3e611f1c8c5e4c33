"""A store of as many small frames as one likes, in a minute: for what grows with their number."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.manifest.card import CameraCard, Card, card_text
from eldata.manifest.catalogue import load_manifest
from eldata.manifest.table import table_text
from eldata.raw.levels import bayer_cfa
from eldata.records import Exposure, FrameRecord, Sensor
from eldata.sources.store.read import StoredFrame, frame_key
from eldata.sources.store.write import Source, pixels_digest, write_frames

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

SIDE = 34  # of a mosaic: crops of 16 packed pixels, turned
_NOISY = 9  # of each reference
_LONG, _SHORT = Exposure(Fraction(100), Fraction(10)), Exposure(Fraction(800), Fraction(1, 10))
_CAMERA = Sensor("eldata", "Small", bayer_cfa(), (512.0,) * 4, 16383.0, SIDE, SIDE)


def small_manifest(frames: int) -> tuple[bytes, bytes]:
    """Return manifest and card of so many frames, of one camera: nine noisy ones after each reference."""
    records = []
    for number in range(frames):
        scene, place = divmod(number, _NOISY + 1)
        path = f"Small/scene-{scene:06d}/{place}.dng"
        if place == 0:
            reference = path
            record = FrameRecord(path=path, role="reference", camera="Small", scene=f"scene-{scene}")
            exposure = _LONG
        else:
            record = FrameRecord(path=path, role="noisy", camera="Small", scene=f"scene-{scene}", reference=reference)
            record, exposure = replace(record, ratio=Fraction(25, 2)), _SHORT
        records.append(replace(record, iso=exposure.iso, exposure_s=exposure.exposure_s, split="train"))
    noisy = sum(record.role == "noisy" for record in records)
    counts = {"noisy": noisy, "reference": frames - noisy}
    cameras = {"Small": CameraCard(("Small",))}
    card = Card("small", "Small frames", "1", "small", "none", "CC0", "none", "bayer", cameras, counts)
    return table_text(Path("small.csv"), records).encode(), card_text(card).encode()


def write_small_store(path: Path, frames: int) -> Path:
    """Write a store of so many frames, as eldata pack does."""
    manifest = load_manifest(path.with_suffix(".csv"), listing := small_manifest(frames))
    files = tuple((record.path, record.role) for record in manifest.records)
    source = Source("small", path.parent, files, manifest, listing)
    generator = np.random.default_rng(0)

    def decoded() -> Iterator[tuple[NDArray[np.uint16], StoredFrame]]:
        for number, record in enumerate(manifest.records):
            mosaic = _pixels(generator)
            exposure, digest = _LONG if record.role == "reference" else _SHORT, pixels_digest(mosaic)
            yield mosaic, StoredFrame(frame_key(number), record.path, record.role, digest, _sensor(number), exposure)

    write_frames(path, source, "none", decoded())
    return path


def _pixels(generator: np.random.Generator) -> NDArray[np.uint16]:
    return generator.integers(500, 16000, (SIDE, SIDE), np.uint16)


def _sensor(number: int) -> Sensor:
    """Return the sensor as a file states it: the white balance is of its scene."""
    return replace(_CAMERA, white_balance=(2.0 + number // (_NOISY + 1) % 1000 / 1000, 1.0, 1.5, 1.0))
