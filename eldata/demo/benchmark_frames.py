"""The virtual benchmark's files: a test and a training split of scenes, calibration frames, and frames held out."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, cast

import numpy as np
from PIL import Image

from eldata.base.files import write_json
from eldata.base.numbers import checked_whole
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.demo.camera import BASE_ISO, METERED_SHARE, mosaic_light
from eldata.demo.scenes import linear_light, scene_radiance
from eldata.demo.sensor import BENCHMARK_SENSORS, Specimen
from eldata.demo.tree import METERED_S, demo_card, write_shot
from eldata.errors import ArgumentError, EldataError
from eldata.manifest.card import Subset
from eldata.manifest.eld import NOISY_ISOS, EldCamera, eld_records
from eldata.manifest.writing import save_manifest
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.demo.sensor import SensorDesign
    from eldata.manifest.catalogue import Manifest

NAME: Final = "eld-benchmark"
FOLDER: Final = "ELD-benchmark"
CALIBRATION: Final = "calibration"
HELD_OUT: Final = "held-out"

# Of the training split, as of the test split: the factors that are scored. Two takes of each, for Noise2Noise.
TRAINING_FACTORS: Final = (100, 200)
TAKES: Final = 2
_FIRST_TRAINING_SCENE = 101  # and its first still life: none that the test split has

_BIAS_EXPOSURE_S = Fraction(1, 8000)
# Flats fill these shares of the range over black, in pairs; of the lowest ISO, the brightest take a tenth of a second.
_FLAT_SHARES: Final = (Fraction(4, 5), Fraction(2, 5), Fraction(1, 5), Fraction(1, 10), Fraction(1, 20))
_HELD_OUT_SHARES: Final = (Fraction(2, 5), Fraction(1, 10))
_HELD_OUT_BIAS_FRAMES: Final = 8
_LONGEST_FLAT_S = Fraction(1, 10)
_FLAT_VIGNETTING = 0.1  # relative, in the corners

# What a generator is for: the second number of its seed. The specimens' own is 0.
_OF_SCENES, _OF_CALIBRATION, _OF_HELD_OUT = 1, 2, 3


# --- photographs as scenes ------------------------------------------------------------------------------------------
# Those that an installed scikit-image has in its folder. Files are read where they lie, and nothing is downloaded:
# scikit-image fetches the rest of its pictures when they are asked for. All that are named here are in the public
# domain or CC0, as its documentation states of each.

# The two views of one stereo pair, or of one texture, never stand on both sides.
TEST_PICTURES: Final = ("astronaut.png", "coffee.png", "motorcycle_left.png", "hubble_deep_field.jpg", "camera.png")
TRAINING_PICTURES: Final = (
    *("chelsea.png", "rocket.jpg", "retina.jpg", "ihc.png", "brick.png", "grass.png", "gravel.png", "coins.png"),
    *("moon.png", "page.png", "cell.png"),
)
# The light on pictures without colour: under white light all channels would show the same.
_TINTS: Final = {
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
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent / "data"


def pictures_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of the pictures that are there, in their order."""
    folder = picture_folder()
    return () if folder is None else tuple(name for name in names if (folder / name).is_file())


def picture_radiance(name: str, height: int, width: int) -> NDArray[np.float32]:
    """Return a picture's middle as linear light: float32 (3, height, width) in sRGB primaries, from 0 to 1.

    Parameters
    ----------
    name
        One of those that :func:`pictures_of` has found.
    height, width
        The size that it is scaled to, in pixels.

    Raises
    ------
    EldataError
        If scikit-image is not installed.
    """
    folder = picture_folder()
    if folder is None:
        raise EldataError(f"the picture {name} is scikit-image's: pip install 'eldata[baselines]'")
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
    tint = np.array(_TINTS.get(name, (1.0, 1.0, 1.0)), np.float32)[:, None, None]
    return np.clip(np.stack([np.asarray(channel, np.float32) for channel in channels]), 0, 1) * tint


# --- what is photographed ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BenchmarkScene:
    """One scene: ``picture`` is a file of scikit-image's, or empty for the still life of number ``still_life``."""

    number: int
    split: Literal["test", "train"]
    picture: str = ""
    still_life: int = 0

    @property
    def name(self) -> str:
        """Its folder."""
        return f"scene-{self.number}"

    def radiance(self, height: int, width: int) -> NDArray[np.float32]:
        """Return its light, (3, height, width), linear sRGB in [0, 1]."""
        if self.picture:
            return picture_radiance(self.picture, height, width)
        return scene_radiance(self.still_life, height, width)


def benchmark_scenes(test: int, training: int) -> tuple[BenchmarkScene, ...]:
    """Return the scenes of both splits, none of which is in the other: still lifes and pictures in turns.

    Where there are not enough pictures, or none, because scikit-image is not installed, still lifes stand for them.
    """
    found = []
    splits: tuple[tuple[Literal["test", "train"], int, int, tuple[str, ...]], ...] = (
        ("test", test, 1, TEST_PICTURES),
        ("train", training, _FIRST_TRAINING_SCENE, TRAINING_PICTURES),
    )
    for split, count, first, names in splits:
        pictures, still_life = list(pictures_of(names)), first
        for index in range(count):
            if index % 2 and pictures:
                found.append(BenchmarkScene(first + index, split, picture=pictures.pop(0)))
            else:
                found.append(BenchmarkScene(first + index, split, still_life=still_life))
                still_life += 1
    return tuple(found)


@dataclass(frozen=True, slots=True)
class _Body:
    """Which specimen: its design's number, the size of its frames, and the seed of its pixels."""

    index: int
    height: int
    width: int
    seed: int

    @property
    def design(self) -> SensorDesign:
        return BENCHMARK_SENSORS[self.index].with_size(self.height, self.width)


@lru_cache(maxsize=len(BENCHMARK_SENSORS))
def _specimen(body: _Body) -> Specimen:
    """Draw the pixels, once in each process."""
    return Specimen(body.design, np.random.default_rng([body.seed, 0, body.index]))


@dataclass(frozen=True, slots=True)
class _SceneShots:
    """All frames of one scene by one camera: small, for worker processes."""

    body: _Body
    scene: BenchmarkScene
    metered_s: Fraction
    records: tuple[FrameRecord, ...]
    folder: Path


@dataclass(frozen=True, slots=True)
class _CalibrationShots:
    """Bias frames and pairs of flats of one camera at one ISO."""

    body: _Body
    iso: int
    bias_frames: int
    shares: tuple[Fraction, ...]
    purpose: int
    folder: Path


@dataclass(frozen=True, slots=True)
class BenchmarkPlan:
    """How large a benchmark is.

    Attributes
    ----------
    scenes, training_scenes
        How many scenes each camera photographs for either split, 1 or more; 100 to test on at most.
    size
        (H, W) of the mosaics in pixels; a calibration wants 256 x 256 or more.
    bias_frames
        Bias frames of each ISO, 2 or more.
    seed
        Of specimens and frames. The same seed, and the same pictures installed, give the same files.

    Raises
    ------
    ArgumentError
        If a number is out of its range.
    """

    scenes: int = 10
    training_scenes: int = 24
    size: tuple[int, int] = (384, 576)
    bias_frames: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("scenes", 1), ("training_scenes", 1), ("bias_frames", 2), ("seed", 0)):
            checked_whole(name, getattr(self, name), at_least=least)
        if self.scenes >= _FIRST_TRAINING_SCENE:
            raise ArgumentError(
                f"scenes must be below {_FIRST_TRAINING_SCENE}, the first to train on; found {self.scenes}"
            )


DEFAULT_PLAN: Final = BenchmarkPlan()


def make_benchmark(folder: Path, plan: BenchmarkPlan = DEFAULT_PLAN, *, workers: Workers = IN_THIS_PROCESS) -> Manifest:
    """Photograph the benchmark with the cameras of :data:`~eldata.demo.sensor.BENCHMARK_SENSORS`, into ``folder``.

    Writes ``folder/data/ELD-benchmark/<camera>/scene-<n>/IMG_<nnnn>.dng``: the test scenes as ELD has them, sixteen
    frames each, and the training scenes, from 101 on, with one long exposure and two takes at each ISO and factor;
    ``folder/data/calibration/<camera>/{bias,flat}/ISO<iso>/...`` of all ISOs, ``folder/data/held-out/...`` alike, of
    those that are scored, for the acceptance test of a model; ``folder/manifests/eld-benchmark.{csv,json}`` with splits
    ``test`` and ``train``; and ``folder/truth.json``, all that is known of cameras and scenes.

    Parameters
    ----------
    folder
        Made if it is not there.
    plan
        How much.
    workers
        What runs the work.
    """
    data, manifests = folder / "data", folder / "manifests"
    manifests.mkdir(parents=True, exist_ok=True)
    chosen = benchmark_scenes(plan.scenes, plan.training_scenes)
    bodies = [_Body(index, *plan.size, plan.seed) for index in range(len(BENCHMARK_SENSORS))]
    metered_s = {scene.number: METERED_S[(scene.number - 1) % len(METERED_S)] for scene in chosen}
    records = _records(chosen, metered_s)
    by_scene: dict[tuple[str, str], list[FrameRecord]] = {}
    for record in records:
        by_scene.setdefault((record.camera, record.scene), []).append(record)
    shots = [
        _SceneShots(body, scene, metered_s[scene.number], tuple(by_scene[body.design.name, scene.name]), data / FOLDER)
        for scene in chosen
        for body in bodies
    ]
    for _ in workers.run(_photograph, shots, label="photographing", unit="scene"):
        pass
    calibration = [
        *(
            _CalibrationShots(body, iso, plan.bias_frames, _FLAT_SHARES, _OF_CALIBRATION, data / CALIBRATION)
            for body in bodies
            for iso in body.design.isos
            if iso != BASE_ISO
        ),
        *(
            _CalibrationShots(body, iso, _HELD_OUT_BIAS_FRAMES, _HELD_OUT_SHARES, _OF_HELD_OUT, data / HELD_OUT)
            for body in bodies
            for iso in NOISY_ISOS
        ),
    ]
    for _ in workers.run(_calibration_frames, calibration, label="bias frames and flats", unit="ISO"):
        pass
    write_json(folder / "truth.json", _truth(bodies, chosen), indent=1)
    _specimen.cache_clear()  # a caller's process need not keep its arrays
    sensors = {body.design.name: body.design.sensor for body in bodies}
    source = "eldata.demo: still lifes and scikit-image's pictures, simulated sensors; truth.json holds their figures"
    card = demo_card(NAME, "Virtual benchmark in ELD's layout", FOLDER, sensors, records, source)
    return save_manifest(manifests / f"{NAME}.csv", replace(card, subsets=_subsets(records)), records)


def _records(scenes: tuple[BenchmarkScene, ...], metered_s: dict[int, Fraction]) -> tuple[FrameRecord, ...]:
    cameras = [EldCamera(design.name, ".dng", BASE_ISO, metered_s) for design in BENCHMARK_SENSORS]
    rows = [*eld_records(cameras, [scene.number for scene in scenes if scene.split == "test"])]
    for camera in cameras:
        for scene in scenes:
            if scene.split == "train":
                rows += _training_records(camera.name, scene, metered_s[scene.number])
    return tuple(sorted(rows, key=lambda row: row.path))


def _training_records(camera: str, scene: BenchmarkScene, metered_s: Fraction) -> list[FrameRecord]:
    """Return a long exposure, and two takes at each ISO and factor: frames 2 and 3, 4 and 5, and so on."""
    place = f"{camera}/{scene.name}/IMG_{{:04d}}.dng".format
    long = FrameRecord(
        place(1), "reference", camera, scene.name, scene.split, iso=Fraction(BASE_ISO), exposure_s=metered_s
    )
    rows = [long]
    for iso in NOISY_ISOS:
        for factor in TRAINING_FACTORS:
            for _ in range(TAKES):
                rows.append(
                    replace(
                        long,
                        path=place(len(rows) + 1),
                        role="noisy",
                        iso=Fraction(iso),
                        exposure_s=BASE_ISO * metered_s / (iso * factor),
                        ratio=Fraction(factor),
                        reference=long.path,
                    )
                )
    return rows


def _subsets(records: tuple[FrameRecord, ...]) -> tuple[Subset, ...]:
    """Return the splits as subsets; the first is what ``eldata evaluate`` scores."""
    titles = {"test": "scenes that nothing is trained on", "train": "the scenes to train on"}
    return tuple(
        Subset(
            name=split,
            title=title,
            source="eldata.demo",
            pairs=sum(record.role == "noisy" and record.split == split for record in records),
            splits=(split,),
        )
        for split, title in titles.items()
    )


def _photograph(shots: _SceneShots) -> None:
    """Take all frames of a scene and write them."""
    body, specimen = shots.body, _specimen(shots.body)
    design = body.design
    light = mosaic_light(shots.scene.radiance(body.height, body.width), design.sensor)
    metered_e = light * (METERED_SHARE * design.span_dn / design.base_gain_dn_per_e)
    for index, record in enumerate(shots.records):
        # Both are known: the references' are given.
        iso, exposure_s = cast("Fraction", record.iso), cast("Fraction", record.exposure_s)
        generator = np.random.default_rng([body.seed, _OF_SCENES, body.index, shots.scene.number, index])
        electrons = metered_e * float(exposure_s / shots.metered_s)
        mosaic = specimen.frame(electrons, float(exposure_s), int(iso), generator)
        write_shot(shots.folder / record.path, mosaic, design.sensor, iso, exposure_s)


def _calibration_frames(shots: _CalibrationShots) -> None:
    """Take the bias frames and flats of an ISO and write them."""
    body, specimen = shots.body, _specimen(shots.body)
    design, iso = body.design, shots.iso
    y, x = (np.linspace(-1, 1, side) for side in (body.height, body.width))
    lamp = 1 - _FLAT_VIGNETTING / 2 * (y[:, None] ** 2 + x**2)
    lowest = next(one for one in design.isos if one != BASE_ISO)
    exposures = [("bias", Fraction(0), _BIAS_EXPOSURE_S)] * shots.bias_frames
    for share in shots.shares:
        # One constant lamp: the time alone makes the signal, in proportion to time and gain.
        exposures += [("flat", share, _LONGEST_FLAT_S * share / max(_FLAT_SHARES) * lowest / iso)] * 2
    for index, (role, share, exposure_s) in enumerate(exposures):
        generator = np.random.default_rng([body.seed, shots.purpose, body.index, iso, index])
        electrons = lamp * (float(share) * design.span_dn / design.gain_dn_per_e(iso))
        mosaic = specimen.frame(electrons, float(exposure_s), iso, generator)
        place = shots.folder / design.name / role / f"ISO{iso}" / f"IMG_{index + 1:04d}.dng"
        write_shot(place, mosaic, design.sensor, Fraction(iso), exposure_s)


def _truth(bodies: list[_Body], scenes: tuple[BenchmarkScene, ...]) -> dict[str, object]:
    """Return all that is known, for JSON."""
    return {
        "seed": bodies[0].seed,
        "cameras": {
            body.design.name: {
                **{name: value for name, value in asdict(body.design).items() if name not in ("name", "sensor")},
                "telegraph_pixels": int(_specimen(body).trapped.size),
                "gain_dn_per_e": {str(iso): body.design.gain_dn_per_e(iso) for iso in body.design.isos},
            }
            for body in bodies
        },
        "scenes": {
            scene.name: {"split": scene.split, "shows": scene.picture or f"still life {scene.still_life}"}
            for scene in scenes
        },
    }
