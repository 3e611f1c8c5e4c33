"""A small ELD-like dataset of real DNG files, with its manifest and card."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, cast

import numpy as np
from tqdm import tqdm

from eldata.demo.camera import BASE_ISO, CAMERAS
from eldata.demo.folder import demo_card
from eldata.demo.scenes import scene_radiance
from eldata.manifest.eld import EldCamera, eld_records
from eldata.manifest.writing import save_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.demo.camera import SimulatedCamera
    from eldata.manifest.catalogue import Manifest

# What the simulated photographer metered: seconds at ISO 100. 3.2 s in every second scene, as in the real set.
METERED_S = (Fraction(4), Fraction(16, 5))
F_NUMBER = Fraction(28, 5)


def make_tree(
    folder: Path,
    *,
    scenes: int = 2,
    size: tuple[int, int] = (512, 768),
    seed: int = 0,
    cameras: Sequence[SimulatedCamera] = CAMERAS,
) -> Manifest:
    """Photograph the demo's scenes with its cameras, sixteen frames each, into ``folder``.

    Writes ``folder/data/ELD-demo/<camera>/scene-<n>/IMG_<nnnn>.dng`` and ``folder/manifests/eld-demo.{csv,json}``.

    Parameters
    ----------
    folder
        Made if it does not exist.
    scenes
        Number of scenes per camera.
    size
        (H, W) of the mosaics in pixels.
    seed
        The same seed gives the same files.
    cameras
        The simulated cameras.
    """
    data, manifests = folder / "data" / "ELD-demo", folder / "manifests"
    manifests.mkdir(parents=True, exist_ok=True)
    numbers = range(1, scenes + 1)
    metered_s = {number: METERED_S[(number - 1) % len(METERED_S)] for number in numbers}
    records = eld_records([EldCamera(camera.name, ".dng", BASE_ISO, metered_s) for camera in cameras], numbers)
    camera_of = {camera.name: (index, camera.with_size(*size)) for index, camera in enumerate(cameras)}
    radiance = {f"scene-{number}": scene_radiance(number, *size) for number in numbers}
    with tqdm(records, desc="photographing", unit="frame", disable=None, leave=False) as bar:
        for index, record in enumerate(bar):
            camera_index, camera = camera_of[record.camera]
            metered = metered_s[int(record.scene.removeprefix("scene-"))]
            # Both are known: the references' are given.
            iso, exposure_s = cast("Fraction", record.iso), cast("Fraction", record.exposure_s)
            generator = np.random.default_rng([seed, camera_index, index])
            mosaic = camera.photograph(radiance[record.scene], exposure_s / metered, int(iso), generator)
            path = data / record.path
            path.parent.mkdir(parents=True, exist_ok=True)
            exposure = Exposure(iso, exposure_s, F_NUMBER)
            write_dng(path, mosaic, camera.sensor, exposure, compression="lossless-jpeg")
    title, sources = "Simulated ELD-like set", "eldata.demo: procedural scenes, simulated cameras"
    sensors = {camera.name: camera.sensor for camera in cameras}
    card = demo_card("eld-demo", title, "ELD-demo", sensors, records, sources)
    return save_manifest(manifests / "eld-demo.csv", card, records)
