"""DRV's files on disk: preprocessed PNG and camera raws under the published folder names, made from seeds."""

from __future__ import annotations

import os
import zlib
from collections.abc import Collection
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from eldata.manifest.catalogue import Manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, Sensor
from tests.trees import Tree, list_scenes

RGB_SIZE = (48, 56)

# Black and white near the real ones and different from every constant that is quoted (512, 800, 16383).
SENSOR = Sensor("SONY", "DSC-RX100M6", ((0, 1), (3, 2)), (801.0, 799.0, 802.0, 800.0), 16300.0, 96, 112)
NOISY = Exposure(Fraction(6400), Fraction(1, 50), Fraction(4))
REFERENCE = Exposure(Fraction(200), Fraction(64), Fraction(4))  # (200 * 64) / (6400 / 50) = 100


def generator_of(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


def write_png(path: Path, pixels: NDArray[np.generic]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels)))


def still_of(clip: str, size: tuple[int, int] = RGB_SIZE) -> NDArray[np.uint16]:
    """A clip's reference, (H, W, 3) uint16."""
    height, width = size
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / (3 + c)) + np.cos(y / (5 - c)) for c in range(3)]
    noise = generator_of(clip).uniform(0, 0.4, (height, width, 3))
    return np.clip((np.stack(waves, axis=-1) / 4 + 0.4 + noise) * 50000, 0, 65535).astype(np.uint16)


def rgb_frame_of(clip: str, number: int, size: tuple[int, int] = RGB_SIZE) -> NDArray[np.uint16]:
    """A preprocessed noisy frame, (H, W, 3) uint16."""
    noise = generator_of(f"{clip}/{number}").normal(0, 2500, (*size, 3))
    return np.clip(still_of(clip, size) + noise, 0, 65535).astype(np.uint16)


def write_rgb_clip(folder: Path, clip: str, frames: int, *, size: tuple[int, int] = RGB_SIZE) -> None:
    """Write the frames ``0001.png`` ... of a clip and, unless it is dynamic, its reference."""
    for number in range(1, frames + 1):
        write_png(folder / "VBM4D_rawRGB" / clip / f"{number:04d}.png", rgb_frame_of(clip, number, size))
    if not clip.startswith("M"):
        write_png(folder / "long" / clip / "half0001_0.png", still_of(clip, size))


def mosaic_of(name: str, exposure: Exposure, sensor: Sensor = SENSOR) -> NDArray[np.uint16]:
    """Pixels of a raw frame, (H, W) in DN: a reference spans the range, a short frame lies around the black level."""
    low, high = (790, 15000) if exposure == REFERENCE else (780, 980)
    return generator_of(name).integers(low, high, (sensor.height, sensor.width), dtype=np.uint16)


def write_raw(path: Path, exposure: Exposure, *, sensor: Sensor = SENSOR) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_dng(path, mosaic_of(path.name + path.parent.name, exposure, sensor), sensor, exposure)


def write_raw_clip(folder: Path, clip: str, frames: int, *, short: str = "short", sensor: Sensor = SENSOR) -> None:
    """Write ``DSC00998.ARW`` ... of a clip and, unless it is dynamic, its long exposure."""
    for number in range(998, 998 + frames):
        write_raw(folder / short / clip / f"DSC{number:05d}.ARW", NOISY, sensor=sensor)
    if not clip.startswith("M"):
        write_raw(folder / "long" / clip / "DSC00001.ARW", REFERENCE, sensor=sensor)


def build_drv_tree(manifest: Manifest, folder: Path, frames: int = 5) -> None:
    """Write some frames and a reference for every clip of the manifest: one file under many names (hard links)."""
    write_rgb_clip(folder, "0001", frames)
    for record in manifest.records:
        if record.scene == "0001":
            continue
        place = (folder / record.path).parent
        place.mkdir(parents=True)
        for path in (folder / place.parent.name / "0001").iterdir():
            os.link(path, place / path.name)


@dataclass(frozen=True)
class SmallDrv(Tree):
    """Some clips of DRV with a manifest of just these."""

    folder: str = "DRV"


def small_drv(folder: Path, clips: Collection[str], frames: int, *, size: tuple[int, int] = RGB_SIZE) -> SmallDrv:
    """Write preprocessed clips and a manifest of their patterns."""
    tree = SmallDrv(list_scenes("drv", folder, clips), folder / "data")
    for clip in clips:
        write_rgb_clip(tree.data, clip, frames, size=size)
    return tree
