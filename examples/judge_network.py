"""Judge networks beside BM3D and DCT, on photographs and charts that none was trained on, by cameras that none knows.

    python examples/judge_network.py judged --photographs photographs
    python examples/judge_network.py judged --weights new=run/noise_aware.safetensors --sheet seeding coffee.png

The cameras are the virtual benchmark's, whose noise is not the noise model's; each is calibrated from bias frames and
flats of its own, and all methods are told the same profile. Targets are the light itself. `judged/scores.csv` gets a
line per picture, camera, ISO, factor and method, and what stands there is not made again. Shown are mean PSNRs, and by
how much each network is above BM3D with the 95 % interval of the pictures' mean (Student's t). `--sheet` draws
pictures whose names begin so, twice as large, all methods beside each other. With `--pyxel` the camera is one that
Pyxel simulates (pip install pyxel-sim), and the table is of its pictures alone.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch
from photographs import JUDGE, fetch_photographs, photograph_radiance, picture_path
from safetensors.torch import load_file
from scipy.stats import t
from virtual_benchmark import calibrate, picture_radiance, pictures_of, take_calibration
from virtual_sensor import SENSORS, Specimen

from eldata.base.files import atomic_write
from eldata.baselines.classical import BASELINES, noise_of_parameters
from eldata.baselines.unet import NoiseAwareUNet
from eldata.demo.camera import METERED_SHARE, mosaic_light
from eldata.demo.evaluation import write_contact_sheet
from eldata.demo.scenes import scene_radiance
from eldata.isp.rendering import preview
from eldata.noise import CameraProfile
from eldata.raw import pack

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from numpy.typing import NDArray
    from virtual_sensor import Camera, SensorDesign

    from eldata.baselines.classical import SignalNoise
    from eldata.records import Sensor

    Values = NDArray[np.float32]
    Method = Callable[[Values, SignalNoise], Values]

    Row = list[tuple[str, NDArray[np.uint8]]]

ISOS, FACTORS, METERED_S = (800, 3200), (1, 10, 100, 200), 1.0
CHARTS = (702, 706, 710)  # resolution charts of the demo's kind, beyond all that any network was trained on
UNSEEN_PICTURES = ("astronaut.png", "coffee.png", "motorcycle_left.png", "camera.png")
SIZE = (384, 576)
DRAWN = (3200, 100)  # ISO and factor, by the first camera
CALIBRATED_ISOS, BIAS_FRAMES = (200, 6400), 20  # from, to
REFERENCE = "anscombe-bm3d"


def main() -> None:
    """Judge, and show the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="for scores, calibration and pictures")
    parser.add_argument("--photographs", type=Path, default="photographs", help="(default: %(default)s)")
    parser.add_argument(
        "--weights",
        type=name_file,
        nargs="*",
        default=(),
        metavar="NAME=FILE",
        help="networks beside the one that ships",
    )
    parser.add_argument("--sheet", nargs="*", default=(), metavar="NAME", help="pictures to draw")
    text = "judge by a camera of Pyxel's, the simulator of ESA and ESO, instead of the virtual benchmark's"
    parser.add_argument("--pyxel", action="store_true", help=text)
    options = parser.parse_args()
    torch.set_num_threads(1)
    methods: dict[str, Method] = {name: BASELINES[name].denoise for name in ("input", "dct", REFERENCE, "network")}
    for name, file in options.weights:
        network = NoiseAwareUNet()
        network.load_state_dict(load_file(file))
        methods[name] = partial(denoise_by, network)
    fetch_photographs(options.photographs)
    path = options.folder / "scores.csv"
    rows: list[Row] = []
    lines: list[dict[Hashable, object]] = pd.read_csv(path).to_dict("records") if path.exists() else []
    done = {(line["title"], line["method"]) for line in lines}
    specimens = make_cameras(options.pyxel)
    for specimen in specimens:
        design = specimen.design
        profile = calibrated_profile(options.folder, specimen)
        for kind, name, radiance in scenes(options.photographs):
            title = f"{design.name}-{name}"
            is_drawn = specimen is specimens[0] and name.startswith(tuple(options.sheet))
            missing = {key: methods[key] for key in methods if is_drawn or (title, key) not in done}
            if missing:
                made = judge_scene(design, specimen, profile, radiance, missing, title, rows if is_drawn else None)
                lines.extend({"title": title, "kind": kind, "picture": name, **line} for line in made)
            scores = pd.DataFrame(lines).drop_duplicates(["title", "iso", "factor", "method"])
            with atomic_write(path) as file:
                scores.to_csv(file, index=False)
    if rows:
        write_contact_sheet(options.folder / "contact-sheet.png", rows)
    of_cameras = scores["title"].str.startswith(tuple(f"{specimen.design.name}-" for specimen in specimens))
    print(summarise(scores[of_cameras]).to_string(float_format="{:.2f}".format))


def name_file(text: str) -> tuple[str, str]:
    """Split NAME=FILE."""
    name, file = text.split("=", 1)
    return name, file


def make_cameras(with_pyxel: bool) -> list[Camera]:
    """Return a specimen of each of the virtual benchmark's cameras, or of Pyxel's."""
    designs: tuple[SensorDesign, ...] = SENSORS
    make: Callable[[SensorDesign, np.random.Generator], Camera] = Specimen
    if with_pyxel:
        try:
            from pyxel_sensor import PYXEL_CMOS, PyxelSpecimen
        except ImportError as error:
            text = "--pyxel needs Pyxel of ESA and ESO: pip install pyxel-sim (pyxel alone is a game engine)"
            raise SystemExit(text) from error
        designs, make = (PYXEL_CMOS,), PyxelSpecimen
    return [
        make(design.with_size(*SIZE), np.random.default_rng([11, len(design.name), ord(design.name[-1])]))
        for design in designs
    ]


def denoise_by(network: NoiseAwareUNet, image: Values, noise: SignalNoise) -> Values:
    """Denoise by a network as the one that ships is used."""
    less = torch.from_numpy((image - np.array(noise.black)[:, None, None]).astype(np.float32))[None]
    with torch.inference_mode():
        return np.asarray(network(less, torch.tensor([noise.slope]), torch.tensor([noise.offset]))[0].numpy())


def calibrated_profile(folder: Path, specimen: Camera) -> CameraProfile:
    """Return a camera's profile by `eldata calibrate`, from bias frames and flats; both are made once."""
    path = folder / "profiles" / f"{specimen.design.name}.json"
    if not path.exists():
        low, high = CALIBRATED_ISOS
        for iso in (iso for iso in specimen.design.isos if low <= iso <= high):
            take_calibration(folder / "data" / "calibration", specimen, iso, BIAS_FRAMES, (11, 2))
        calibrate(folder, specimen.design)
    return CameraProfile.load(path)


def scenes(photographs: Path) -> Iterator[tuple[str, str, Values]]:
    """Yield kind, name and light of each scene, (3, h, w)."""
    height, width = SIZE
    for kind, names in JUDGE.items():
        for name in names:
            path = picture_path(photographs, name)
            if not path.exists():
                print(f"{name} is left out: pip install scikit-learn brings it")
                continue
            light = photograph_radiance(path, 2 if kind == "large" else 1)
            missing = [max(side - length, 0) for side, length in zip(SIZE, light.shape[1:], strict=True)]
            light = np.pad(light, [(0, 0), *((0, lacks) for lacks in missing)], mode="symmetric")
            top, left = ((length - side) // 2 for side, length in zip(SIZE, light.shape[1:], strict=True))
            yield kind, Path(name).stem, light[:, top : top + height, left : left + width].astype(np.float32)
    for name in pictures_of(UNSEEN_PICTURES):
        yield "scikit-image", name, picture_radiance(name, height, width)
    for number in CHARTS:
        yield "chart", f"chart-{number}", scene_radiance(number, height, width)


def judge_scene(
    design: SensorDesign,
    specimen: Camera,
    profile: CameraProfile,
    radiance: Values,
    methods: dict[str, Method],
    title: str,
    rows: list[Row] | None,
) -> Iterator[dict[Hashable, object]]:
    """Photograph a scene at all ISOs and factors, and yield a score for each method; draw one row of a sheet."""
    light = mosaic_light(radiance, design.sensor) * METERED_SHARE
    target = np.clip(pack(light.astype(np.float32), design.sensor.cfa), 0, 1)
    for iso in ISOS:
        parameters = profile.measured(iso)
        for factor in FACTORS:
            seconds = METERED_S * 100 / iso / factor
            electrons = light * design.span_dn / design.base_gain_dn_per_e * (100 / iso / factor)
            generator = np.random.default_rng([13, iso, factor, *map(ord, title)])
            dn = specimen.frame(electrons, seconds, iso, generator).astype(np.float32)
            black = np.array(design.sensor.black_level_dn)[:, None, None]
            noisy = ((pack(dn, design.sensor.cfa) - black) / design.span_dn * factor).astype(np.float32)
            noise = noise_of_parameters(parameters, ratio=factor, range_dn=design.span_dn)
            made = {name: np.clip(method(noisy, noise), 0, 1) for name, method in methods.items()}
            psnr_db = {
                name: -10 * np.log10(np.mean((image.astype(np.float64) - target) ** 2)) for name, image in made.items()
            }
            for name, value in psnr_db.items():
                yield {"iso": iso, "factor": factor, "method": name, "psnr_db": value}
            if rows is not None and (iso, factor) == DRAWN:
                pictures = {f"{title}, ISO {iso} x{factor}: the light": target}
                pictures |= {f"{name}: {psnr_db[name]:.1f} dB": image for name, image in made.items()}
                rows.append([(caption, draw(image, design.sensor)) for caption, image in pictures.items()])


def draw(packed: Values, sensor: Sensor) -> NDArray[np.uint8]:
    """Render a packed frame twice as large, pixels as squares."""
    return np.asarray(preview(packed, sensor).repeat(2, axis=0).repeat(2, axis=1))


def summarise(scores: pd.DataFrame) -> pd.DataFrame:
    """Return mean PSNRs by kind and factor, and how far networks are above BM3D, with the interval over pictures."""
    columns = ["kind", "factor"]
    by_picture = scores.pivot_table("psnr_db", [*columns, "picture"], "method", sort=False)
    table = by_picture.groupby(columns, sort=False).mean()
    for name in table.columns.drop(["input", "dct", REFERENCE]):
        above = (by_picture[name] - by_picture[REFERENCE]).groupby(columns, sort=False)
        count = above.count()
        table[f"{name} above"] = above.mean()
        table["+-"] = t.ppf(0.975, count - 1) * above.std() / count**0.5
        table = table.rename(columns={"+-": f"+- {name}"})
    return table


if __name__ == "__main__":
    main()
