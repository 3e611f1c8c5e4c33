"""Scenes of the released protocol as a simulated photographer takes them, with a mishap at one frame or another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from eldata.demo.camera import BASE_ISO, CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_radiance
from eldata.demo.tree import demo_card
from eldata.manifest import Manifest
from eldata.manifest.catalogue import save_manifest
from eldata.manifest.layouts import EldCamera, eld_records
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord

ALPHA, BETA = CAMERAS
SIZE = (384, 576)
METERED_S = Fraction(4)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What reaches the sensor, and what the file says: a mishap changes either."""

    radiance: NDArray[np.float32]
    iso: int
    exposure_s: Fraction
    exif: Exposure

    def lit(self, factor: NDArray[np.float64] | float) -> Shot:
        return replace(self, radiance=(self.radiance * factor).astype(np.float32))

    def moved(self, down: float, right: float) -> Shot:
        """By splines of the fifth order."""
        shifted = [ndimage.shift(plane, (down, right), order=5, mode="nearest") for plane in self.radiance]
        return replace(self, radiance=np.clip(np.stack(shifted), 0, None))

    def blurred(self, sigma: float) -> Shot:
        return replace(self, radiance=ndimage.gaussian_filter(self.radiance, (0, sigma, sigma)))


@cache
def radiance(scene: int, size: tuple[int, int] = SIZE) -> NDArray[np.float32]:
    return scene_radiance(scene, *size)


def write_scenes(
    folder: Path, mishaps: Mapping[tuple[int, int], Callable[[Shot], Shot]] | None = None, *,
    scenes: Sequence[int] = (1,), camera: SimulatedCamera = ALPHA, seed: int = 0, size: tuple[int, int] = SIZE,
    ids: Sequence[int] = range(1, 17), picture: Callable[[int, tuple[int, int]], NDArray[np.float32]] = radiance,
    digital: Mapping[int, Callable[[NDArray[np.uint16]], NDArray[np.uint16]]] | None = None,
) -> Manifest:  # fmt: skip
    """Photograph scenes into ``folder``; ``mishaps`` are by scene and frame number, ``digital``, of DN, by frame."""
    camera = camera.with_size(*size)
    eld = EldCamera(camera.name, ".dng", BASE_ISO, dict.fromkeys(scenes, METERED_S))
    records = [record for record in eld_records([eld], scenes) if number_of(record) in ids]
    for record in records:
        scene, number = int(record.scene.removeprefix("scene-")), number_of(record)
        iso, exposure_s = int(cast("Fraction", record.iso)), cast("Fraction", record.exposure_s)
        shot = Shot(picture(scene, size), iso, exposure_s, Exposure(Fraction(iso), exposure_s))
        mishap = (mishaps or {}).get((scene, number))
        shot = shot if mishap is None else mishap(shot)
        generator = np.random.default_rng([seed, scene, number])
        mosaic = camera.photograph(shot.radiance, shot.exposure_s / METERED_S, shot.iso, generator)
        if digital and number in digital:
            mosaic = digital[number](mosaic)
        path = folder / "data" / "MY" / record.path
        path.parent.mkdir(parents=True, exist_ok=True)
        write_dng(path, mosaic, camera.sensor, shot.exif, compression="none")
    (folder / "manifests").mkdir(parents=True, exist_ok=True)
    card = demo_card("my", "Mine", "MY", {camera.name: camera.sensor}, records, "simulated")
    return save_manifest(folder / "manifests" / "my.csv", card, records)


def number_of(record: FrameRecord) -> int:
    return int(record.path.rpartition("_")[2].removesuffix(".dng"))
