"""Make the virtual benchmark: a set in ELD's layout, of two cameras whose noise is not the noise model's, calibrated.

    python examples/virtual_benchmark.py proof/benchmark        # 60 s of CPU, 560 MB

It writes `data/ELD-benchmark/<camera>/scene-<n>/IMG_<nnnn>.dng`: scenes 1 to 10 to test on, as ELD has them, and scenes
101 to 124 to train on, each with one long exposure and two takes at each ISO and factor; `data/calibration/<camera>`,
bias frames and pairs of flats of all ISOs; `manifests/eld-benchmark.csv` with the splits `test` and `train`; and
`profiles/<camera>.json`, `-shading.npz`, `-bias.h5`, what `eldata calibrate` and `eldata pack` make of the calibration
frames. The scenes are still lifes and, in turns, pictures that an installed scikit-image has in its folder.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from PIL import Image
from virtual_sensor import SENSORS, Specimen

from eldata.cli.main import main as run
from eldata.demo.camera import BASE_ISO, METERED_SHARE, mosaic_light
from eldata.demo.scenes import linear_light, scene_radiance
from eldata.demo.tree import METERED_S, demo_card, write_shot
from eldata.errors import EldataError
from eldata.manifest.card import Subset
from eldata.manifest.catalogue import save_manifest
from eldata.manifest.layouts import NOISY_ISOS, EldCamera, eld_records
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from virtual_sensor import Camera, SensorDesign

    from eldata.manifest import Manifest

NAME, FOLDER = "eld-benchmark", "ELD-benchmark"
# To train on, the factors that are scored; two takes of each, for Noise2Noise.
TRAINING_FACTORS, TAKES = (100, 200), 2
FIRST_TRAINING_SCENE = 101  # and its first still life: none that the test split has
BIAS_EXPOSURE_S = Fraction(1, 8000)
# Flats fill these shares of the range over black, in pairs; of the lowest ISO, the brightest take a tenth of a second.
FLAT_SHARES = (Fraction(4, 5), Fraction(2, 5), Fraction(1, 5), Fraction(1, 10), Fraction(1, 20))
LONGEST_FLAT_S = Fraction(1, 10)
FLAT_VIGNETTING = 0.1  # relative, in the corners
OF_SCENES, OF_CALIBRATION = 1, 2  # what a generator is for: the second number of its seed; the specimens' own is 0


# --- scenes -----------------------------------------------------------------------------------------------------------
# Pictures are read where they lie, and nothing is downloaded: scikit-image fetches its others when they are asked for.
# Those named here are in the public domain or CC0, as its documentation states of each. The two views of one stereo
# pair, or of one texture, never stand on both sides.

TEST_PICTURES = ("astronaut.png", "coffee.png", "motorcycle_left.png", "hubble_deep_field.jpg", "camera.png")
TRAINING_PICTURES = (
    *("chelsea.png", "rocket.jpg", "retina.jpg", "ihc.png", "brick.png", "grass.png", "gravel.png", "coins.png"),
    *("moon.png", "page.png", "cell.png"),
)
# The light on pictures without colour: under white light all channels would show the same.
TINTS = {
    "camera.png": (1.0, 0.92, 0.8),
    "brick.png": (1.0, 0.62, 0.45),
    "grass.png": (0.55, 0.9, 0.4),
    "gravel.png": (1.0, 0.9, 0.78),
    "coins.png": (1.0, 0.8, 0.5),
    "moon.png": (0.85, 0.92, 1.0),
    "page.png": (1.0, 0.95, 0.8),
    "cell.png": (0.7, 0.85, 1.0),
}


def picture_folder() -> Path | None:
    """Return where an installed scikit-image keeps its pictures; ``None`` if it is not installed."""
    found = find_spec("skimage")
    return None if found is None or found.origin is None else Path(found.origin).parent / "data"


def pictures_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of the pictures that are there, in their order."""
    folder = picture_folder()
    return () if folder is None else tuple(name for name in names if (folder / name).is_file())


def picture_radiance(name: str, height: int, width: int) -> NDArray[np.float32]:
    """Return a picture's middle, scaled, as linear light: float32 (3, height, width), sRGB primaries, 0 to 1."""
    folder = picture_folder()
    if folder is None:
        raise EldataError(f"the picture {name} is scikit-image's: pip install scikit-image")
    with Image.open(folder / name) as image:
        srgb = np.asarray(image.convert("RGB"))
    high, wide = srgb.shape[:2]
    cut_high, cut_wide = min(high, round(wide * height / width)), min(wide, round(high * width / height))
    top, left = (high - cut_high) // 2, (wide - cut_wide) // 2
    light = linear_light(srgb[top : top + cut_high, left : left + cut_wide])
    channels = [
        Image.fromarray(np.ascontiguousarray(light[..., channel])).resize((width, height), Image.Resampling.BICUBIC)
        for channel in range(3)
    ]
    tint = np.array(TINTS.get(name, (1.0, 1.0, 1.0)), np.float32)[:, None, None]
    return np.clip(np.stack([np.asarray(channel, np.float32) for channel in channels]), 0, 1) * tint


@dataclass(frozen=True, slots=True)
class Scene:
    """One scene: ``picture`` is a file of scikit-image's, or empty for the still life of number ``still_life``."""

    number: int
    split: Literal["test", "train"]
    picture: str = ""
    still_life: int = 0

    @property
    def name(self) -> str:
        """Its folder."""
        return f"scene-{self.number}"

    @property
    def metered_s(self) -> Fraction:
        """The time of its references."""
        return METERED_S[(self.number - 1) % len(METERED_S)]

    def radiance(self, height: int, width: int) -> NDArray[np.float32]:
        """Return its light, (3, height, width), linear sRGB in [0, 1]."""
        if self.picture:
            return picture_radiance(self.picture, height, width)
        return scene_radiance(self.still_life, height, width)


def choose_scenes(test: int, training: int) -> list[Scene]:
    """Return the scenes of both splits, none of which is in the other: still lifes and pictures in turns.

    Where there are not enough pictures, or none, because scikit-image is not installed, still lifes stand for them.
    """
    found = []
    splits: tuple[tuple[Literal["test", "train"], int, int, tuple[str, ...]], ...] = (
        ("test", test, 1, TEST_PICTURES),
        ("train", training, FIRST_TRAINING_SCENE, TRAINING_PICTURES),
    )
    for split, count, first, names in splits:
        pictures, still_life = list(pictures_of(names)), first
        for index in range(count):
            if index % 2 and pictures:
                found.append(Scene(first + index, split, picture=pictures.pop(0)))
            else:
                found.append(Scene(first + index, split, still_life=still_life))
                still_life += 1
    return found


# --- files ------------------------------------------------------------------------------------------------------------


def photograph(
    folder: Path,
    *,
    scenes: int = 10,
    training_scenes: int = 24,
    size: tuple[int, int] = (384, 576),
    bias_frames: int = 20,
    seed: int = 0,
) -> Manifest:
    """Write scenes, calibration frames and manifest; the same seed, and pictures installed, give the same files."""
    chosen = choose_scenes(scenes, training_scenes)
    designs = [design.with_size(*size) for design in SENSORS]
    records = sorted(
        (row for design in designs for row in rows_of(design.name, chosen)), key=lambda record: record.path
    )
    for index, design in enumerate(designs):
        specimen = Specimen(design, np.random.default_rng([seed, 0, index]))
        for scene in chosen:
            rows = [row for row in records if (row.camera, row.scene) == (design.name, scene.name)]
            take_scene(folder / "data" / FOLDER, specimen, scene, rows, (seed, OF_SCENES, index))
        for iso in design.isos[1:]:
            take_calibration(folder / "data" / "calibration", specimen, iso, bias_frames, (seed, OF_CALIBRATION, index))
    sensors = {design.name: design.sensor for design in designs}
    card = demo_card(NAME, "Virtual benchmark in ELD's layout", FOLDER, sensors, records, "virtual_benchmark.py")
    titles = {"test": "scenes that nothing is trained on", "train": "the scenes to train on"}
    subsets = tuple(
        Subset(
            name=split,
            title=title,
            source="virtual_benchmark.py",
            pairs=sum(record.role == "noisy" and record.split == split for record in records),
            splits=(split,),
        )
        for split, title in titles.items()
    )
    (folder / "manifests").mkdir(parents=True, exist_ok=True)
    return save_manifest(folder / "manifests" / f"{NAME}.csv", replace(card, subsets=subsets), records)


def rows_of(camera: str, scenes: Sequence[Scene]) -> list[FrameRecord]:
    """Return a camera's rows: the test scenes as ELD has them, then those to train on."""
    metered_s = {scene.number: scene.metered_s for scene in scenes}
    tested = [scene.number for scene in scenes if scene.split == "test"]
    rows = [*eld_records([EldCamera(camera, ".dng", BASE_ISO, metered_s)], tested)]
    for scene in scenes:
        if scene.split == "test":
            continue
        place = f"{camera}/{scene.name}/IMG_{{:04d}}.dng".format
        long = FrameRecord(
            place(1), "reference", camera, scene.name, "train", iso=Fraction(BASE_ISO), exposure_s=scene.metered_s
        )
        rows.append(long)
        settings = [(iso, factor) for iso in NOISY_ISOS for factor in TRAINING_FACTORS for _ in range(TAKES)]
        for number, (iso, factor) in enumerate(settings, 2):
            rows.append(
                replace(
                    long,
                    path=place(number),
                    role="noisy",
                    iso=Fraction(iso),
                    exposure_s=BASE_ISO * scene.metered_s / (iso * factor),
                    ratio=Fraction(factor),
                    reference=long.path,
                )
            )
    return rows


def take_scene(
    folder: Path, specimen: Specimen, scene: Scene, records: Sequence[FrameRecord], seed: tuple[int, ...]
) -> None:
    """Take all frames of a scene and write them."""
    design = specimen.design
    light = mosaic_light(scene.radiance(design.sensor.height, design.sensor.width), design.sensor)
    metered_e = light * (METERED_SHARE * design.span_dn / design.base_gain_dn_per_e)
    for index, record in enumerate(records):
        # Both are known: the references' are given.
        iso, exposure_s = cast("Fraction", record.iso), cast("Fraction", record.exposure_s)
        electrons = metered_e * float(exposure_s / scene.metered_s)
        generator = np.random.default_rng([*seed, scene.number, index])
        mosaic = specimen.frame(electrons, float(exposure_s), int(iso), generator)
        write_shot(folder / record.path, mosaic, design.sensor, iso, exposure_s)


def take_calibration(folder: Path, specimen: Camera, iso: int, bias_frames: int, seed: tuple[int, ...]) -> None:
    """Take the bias frames and flats of an ISO and write them."""
    design = specimen.design
    y, x = (np.linspace(-1, 1, side) for side in (design.sensor.height, design.sensor.width))
    lamp = 1 - FLAT_VIGNETTING / 2 * (y[:, None] ** 2 + x**2)
    exposures = [("bias", Fraction(0), BIAS_EXPOSURE_S)] * bias_frames
    for share in FLAT_SHARES:
        # One constant lamp: the time alone makes the signal, in proportion to time and gain.
        exposures += [("flat", share, LONGEST_FLAT_S * share / max(FLAT_SHARES) * design.isos[1] / iso)] * 2
    for index, (role, share, exposure_s) in enumerate(exposures):
        electrons = lamp * (float(share) * design.span_dn / design.gain_dn_per_e(iso))
        generator = np.random.default_rng([*seed, iso, index])
        mosaic = specimen.frame(electrons, float(exposure_s), iso, generator)
        place = folder / design.name / role / f"ISO{iso}" / f"IMG_{index + 1:04d}.dng"
        write_shot(place, mosaic, design.sensor, Fraction(iso), exposure_s)


def calibrate(folder: Path, design: SensorDesign) -> None:
    """Make a camera's profile, dark shading and store of bias frames from its calibration frames.

    Where its conversion gain switches is told, as a camera's handbook tells it.
    """
    profiles, frames = folder / "profiles", folder / "data" / "calibration"
    profiles.mkdir(exist_ok=True)
    profile, shading, store = (str(profiles / f"{design.name}{end}") for end in (".json", "-shading.npz", "-bias.h5"))
    mode = next(iso for iso in design.isos if iso >= design.high_gain_iso)
    camera = ["--camera", design.name]
    for command in (
        ["calibrate", str(frames), *camera, "--mode", str(mode), "-o", profile, "--dark-shading", shading],
        ["pack", "calibration", "--root", str(frames.parent), *camera, "-o", store],
    ):
        if run(command):
            raise EldataError(f"eldata {command[0]} ended with an error")


def main(argv: Sequence[str] | None = None) -> None:
    """Make everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="new")
    folder = parser.parse_args(argv).folder
    photograph(folder)
    for design in SENSORS:
        calibrate(folder, design)


if __name__ == "__main__":
    main()
