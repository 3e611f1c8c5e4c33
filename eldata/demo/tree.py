"""The folder that a demo writes into, its own and nobody else's, and a small ELD-like set of real DNG files in it."""

from __future__ import annotations

import shlex
import shutil
from fractions import Fraction
from typing import TYPE_CHECKING, cast

import numpy as np
from tqdm import tqdm

from eldata.base.files import remove_leftovers, write_text
from eldata.demo.camera import BASE_ISO, CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_radiance
from eldata.errors import EldataError
from eldata.manifest.card import CameraCard, Card, counts_of
from eldata.manifest.catalogue import Manifest, save_manifest
from eldata.manifest.layouts import EldCamera, eld_records
from eldata.manifest.verify import verify
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


# What the simulated photographer metered: seconds at ISO 100. 3.2 s in every second scene, as in the real set.
METERED_S = (Fraction(4), Fraction(16, 5))
F_NUMBER = Fraction(28, 5)

_MARKER = ".eldata-demo"
_MADE = ("data", "manifests", "profiles", "predictions", "trained")


def demo_card(
    name: str, title: str, folder: str, sensors: Mapping[str, Sensor], records: Iterable[FrameRecord], source: str
) -> Card:
    """Return the card of simulated files, taken by cameras with these sensors."""
    return Card(
        name=name,
        title=title,
        version="1.0",
        folder=folder,
        citation="none: made by eldata demo",
        licence="CC0-1.0",
        homepage="made by eldata demo",
        cfa="bayer" if all(len(sensor.cfa) == 2 for sensor in sensors.values()) else "xtrans",
        cameras={camera: CameraCard((sensor.model,)) for camera, sensor in sensors.items()},
        counts=counts_of(records),
        protocol="eld",
        sources=(source,),
    )


def write_shot(path: Path, mosaic: NDArray[np.uint16], sensor: Sensor, iso: Fraction, exposure_s: Fraction) -> None:
    """Write a frame as a DNG, its folder made; all are taken at one aperture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_dng(path, mosaic, sensor, Exposure(iso, exposure_s, F_NUMBER), compression="lossless-jpeg")


def prepare_folder(folder: Path) -> None:
    """Make the folder, or empty it of what an earlier demo, finished or not, has left.

    Raises
    ------
    EldataError
        If it holds something that no demo made, or cannot be written.
    """
    marker = folder / _MARKER
    if folder.is_dir():
        remove_leftovers(folder)  # of a demo that was killed before it had marked the folder
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not marker.is_file())):
        raise EldataError(f"{folder}: holds something else; give a new folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(marker, "Made by eldata demo, which may empty its folders {}.\n".format(", ".join(_MADE)))
        for name in _MADE:
            if (folder / name).is_dir():
                shutil.rmtree(folder / name)
    except OSError as error:
        raise EldataError(f"{error.filename or folder}: {error.strerror}") from error


def verify_own(manifest: Manifest, root: Path) -> None:
    """Verify a demo's own files; print the command that does the same, and the report.

    Raises
    ------
    EldataError
        If they do not verify.
    """
    listed, place = (shlex.quote(str(path)) for path in (manifest.path.parent, root))
    print(f"\n$ eldata verify {listed} --root {place} --level metadata")
    verified = verify([manifest], root, level="metadata")
    print(verified.format_text())
    if not verified.ok:
        raise EldataError("the demo's own files do not verify")


# --- a set of photographs ---------------------------------------------------------------------------------------------


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
            write_shot(data / record.path, mosaic, camera.sensor, iso, exposure_s)
    title, sources = "Simulated ELD-like set", "eldata.demo: procedural scenes, simulated cameras"
    sensors = {camera.name: camera.sensor for camera in cameras}
    card = demo_card("eld-demo", title, "ELD-demo", sensors, records, sources)
    return save_manifest(manifests / "eld-demo.csv", card, records)


def make_clean(folder: Path, scenes: Iterable[int], *, size: tuple[int, int] = (512, 768), seed: int = 0) -> Path:
    """Photograph scenes as a reference each, to train on; parameters as :func:`make_tree` has them.

    Writes ``folder/data/clean/<camera>/scene-<n>.dng``, and returns ``folder/data/clean``.
    """
    clean = folder / "data" / "clean"
    for number in scenes:
        radiance = scene_radiance(number, *size)
        for index, design in enumerate(CAMERAS):
            camera = design.with_size(*size)
            # Four numbers; make_tree seeds by three.
            mosaic = camera.photograph(radiance, Fraction(1), BASE_ISO, np.random.default_rng([seed, index, number, 0]))
            place = clean / camera.name / f"scene-{number}.dng"
            write_shot(place, mosaic, camera.sensor, Fraction(BASE_ISO), METERED_S[0])
    return clean
