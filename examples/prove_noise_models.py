"""Train one small U-Net on each noise model in turn, and score all on a camera whose noise is none of them.

    python examples/virtual_benchmark.py proof/benchmark
    python examples/prove_noise_models.py proof                       # all rows, both cameras, three seeds
    python examples/prove_noise_models.py docs/proof --table          # only the table of what is recorded

`proof/<camera>.json` records the scores of each row and seed that is finished. What it has is not done again, and a
training goes on from its checkpoint in `proof/runs`, so that the same command goes on after any end; two cameras may
run beside each other. All predictions are scored by `eldata evaluate`'s protocol, on scenes that nothing is trained
on. Clean frames are the benchmark's long exposures; the noise of the model's rows is that of the calibrated profile at
the three ISOs that are scored, at factors from 100 to 200, as the real pairs have it.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from eldata import PackedStore, SyntheticPairs
from eldata.base.fields import TextFile
from eldata.base.files import write_json
from eldata.base.tables import markdown_table
from eldata.baselines import BaselineDenoiser, Training, UNet, write_predictions
from eldata.datasets import CleanFrames, DarkFrames, Noise2Noise, training_loader
from eldata.errors import EldataError
from eldata.evaluation import evaluate
from eldata.evaluation.statistics import interval_of_mean
from eldata.manifest import load_manifest
from eldata.noise import LED_RANGES, CameraProfile, NoiseModel, VirtualCameras
from eldata.sources.store.write import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from eldata.baselines import NoisyFrame
    from eldata.raw.levels import Clip

ISOS, RATIOS = (800, 1600, 3200), (100.0, 200.0)
BATCH, CROP, EPOCH = 8, 64, 250  # crops in packed pixels; steps between checkpoints
CLIP: Clip = "none"  # in training and in the test alike
RATE = 1e-3


@dataclass(frozen=True)
class Recipe:
    """What all rows have in common: by default 66,136 parameters, and what two CPU cores train in two hours."""

    steps: int = 1500
    width: int = 12
    depth: int = 2
    crop: int = CROP
    batch: int = BATCH
    rate: float = RATE
    clip: str = CLIP

    def network(self, seed: int) -> UNet:
        """Return the network with its first weights."""
        network = UNet(4, width=self.width, depth=self.depth, seed=seed)
        # The layout in which a CPU takes two thirds of the time for a step.
        return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload,no-any-return] # torch's stub


@dataclass(frozen=True)
class Bench:
    """The benchmark's folder, and what is made of it for one camera."""

    folder: Path
    camera: str

    @property
    def manifest(self) -> Path:
        """Of the benchmark."""
        return self.folder / "benchmark" / "manifests" / "eld-benchmark.csv"

    @property
    def root(self) -> Path:
        """The folder of its data."""
        return self.folder / "benchmark" / "data"

    @property
    def profile(self) -> CameraProfile:
        """As calibrated."""
        return CameraProfile.load(str(self.folder / "benchmark" / "profiles" / f"{self.camera}.json"))

    @property
    def dark_frames(self) -> DarkFrames:
        """The bias frames that it was calibrated from."""
        return DarkFrames(str(self.folder / "benchmark" / "profiles" / f"{self.camera}-bias.h5"), isos=ISOS)

    def clean(self) -> CleanFrames:
        """Return the long exposures to train on as a source, decoded once."""
        manifest = load_manifest(self.manifest)
        wanted = ("reference", "train", self.camera)
        rows = [row for row in manifest.records if (row.role, row.split, row.camera) == wanted]
        return CleanFrames([manifest.folder(self.root) / row.path for row in rows], keep=len(rows))

    @property
    def shading(self) -> Path:
        """The calibration's dark shading."""
        return self.folder / "benchmark" / "profiles" / f"{self.camera}-shading.npz"

    def pairs(self, seed: int) -> PackedStore:
        """Return the real pairs to train on, from a store that is made once."""
        store = self.folder / f"{self.camera}-train.h5"
        if not store.exists():
            name, cameras = "eld-benchmark", [self.camera]
            source = source_of_dataset(name, root=self.root, manifest=self.manifest, cameras=cameras, split="train")
            build_store(source, store)
        pairs = PackedStore(store, clip=CLIP)
        per = math.ceil(EPOCH * BATCH / len(pairs))
        return PackedStore(store, clip=CLIP, crop=CROP, crops_per_frame=per, augment=True, seed=seed)

    def synthetic(self, seed: int, model: Any, cameras: Any = None, iso: Any = ISOS) -> SyntheticPairs:
        """Return clean crops with a model's noise."""
        clean = self.clean()
        return SyntheticPairs(
            clean,
            cameras or self.profile,
            model=model,
            iso=None if iso is None else list(iso),
            ratio=RATIOS,
            clip=CLIP,
            crop=CROP,
            crops_per_frame=math.ceil(EPOCH * BATCH / len(clean)),
            seed=seed,
        )


def noise_model(bench: Bench, spec: str) -> NoiseModel:
    """Return the model of a specification; D gets the camera's dark frames."""
    return NoiseModel(spec, dark_frames=bench.dark_frames if spec.endswith("D") else None)


FULL, LESS = "P*+G*+B+R+U", "P*+G*+R+U"
UNTRAINED = {"input": "amplified input", "anscombe-bm3d": "A-BM3D"}
SPECS = ("G", "P+G", "P*+G*", "P*+G*+B", FULL, "P*+D")
TRAINED = (*SPECS, "shading", "any ISO", "virtual", "noise2noise", "paired")
TITLES = UNTRAINED | {
    "P*+D": "P*+D, dark frames",
    "shading": f"{LESS}, dark shading subtracted",
    "any ISO": f"{FULL}, any K",
    "virtual": f"{FULL}, virtual cameras",
    "noise2noise": "Noise2Noise",
    "paired": "paired",
}


def training_data(bench: Bench, row: str, seed: int) -> Any:
    """Return what a row is trained on."""
    if row in SPECS:
        return bench.synthetic(seed, noise_model(bench, row))
    if row == "shading":
        return bench.synthetic(seed, NoiseModel(LESS))
    if row == "any ISO":
        return bench.synthetic(seed, NoiseModel(FULL), iso=None)
    if row == "virtual":
        return bench.synthetic(seed, NoiseModel(FULL), VirtualCameras(5, LED_RANGES, seed=0), iso=None)
    return bench.pairs(seed) if row == "paired" else Noise2Noise(bench.pairs(seed))


def main(argv: Sequence[str] | None = None) -> None:
    """Do what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with the benchmark in it, or with records")
    parser.add_argument("--steps", type=int, default=Recipe.steps, help="(default: %(default)s)")
    parser.add_argument("--width", type=int, default=Recipe.width, help="of the network (default: %(default)s)")
    parser.add_argument("--depth", type=int, default=Recipe.depth, help="of the network (default: %(default)s)")
    parser.add_argument("--device", default="cpu", help="to train on (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, help="(default: %(default)s)")
    parser.add_argument("--rows", nargs="+", choices=(*UNTRAINED, *TRAINED), default=[*UNTRAINED, *TRAINED])
    parser.add_argument("--cameras", nargs="+", default=["BenchAlpha", "BenchBeta"])
    parser.add_argument("--table", action="store_true", help="only print the table of what is recorded")
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    recipe = Recipe(options.steps, options.width, options.depth)
    files = {camera: options.folder / f"{camera}.json" for camera in options.cameras}
    if options.table:
        files = {camera: path for camera, path in files.items() if path.exists()}
    records = {camera: Record(path, None if options.table else asdict(recipe)) for camera, path in files.items()}
    for camera, record in () if options.table else records.items():
        work(Bench(options.folder, camera), recipe, record, options)
    print(table(records))


def work(bench: Bench, recipe: Recipe, record: Record, options: argparse.Namespace) -> None:
    """Do what a camera's record lacks."""
    for seed, row in product(range(options.seeds), options.rows):
        if row in TRAINED and not record.has(row, seed):
            record.add(row, seed, *train(bench, row, seed, recipe, options.device))
        elif row in UNTRAINED and not record.has(row, 0):
            denoiser = None if row == "input" else BaselineDenoiser(row, (bench.profile,))
            record.add(row, 0, *score(bench, denoiser, row))


def slug(row: str) -> str:
    """Return a row's name for files."""
    return row.replace("*", "s").replace("+", "").replace(" ", "-")


# --- what is recorded -------------------------------------------------------------------------------------------------


class Record:
    """A camera's scores: images of each row and seed in one order."""

    def __init__(self, path: Path, recipe: dict[str, Any] | None) -> None:
        self.path = path
        known: dict[str, Any] = {"recipe": recipe}
        if path.exists():
            known = dict(TextFile(path, EldataError).json().data)
        if recipe not in (None, known["recipe"]):
            raise EldataError(f"{path}: is of {known['recipe']}, not of {recipe}; take another folder")
        self.data = known
        self.scores: dict[str, dict[str, list[float]]] = known.setdefault("psnr_db", {})

    def has(self, row: str, seed: int) -> bool:
        """Return whether a row's seed is finished."""
        return str(seed) in self.scores.get(row, {})

    def add(self, row: str, seed: int, images: list[tuple[str, float]], scores: list[float]) -> None:
        """Take up the scores of a row's seed; its images are those of all the others."""
        if self.data.setdefault("images", [list(one) for one in images]) != [list(one) for one in images]:
            raise EldataError(f"{self.path}: {row} was scored on other images than what is recorded")
        self.scores.setdefault(row, {})[str(seed)] = scores
        write_json(self.path, self.data)

    def of(self, row: str, ratio: float, less: str | None = None) -> tuple[np.ndarray, list[str]]:
        """Return a row's scores (seeds, images) at a factor, and the images' scenes.

        With ``less``, how far they lie above another row's: of networks with the same seed, which had the same first
        weights. What is not trained has one score an image, which is held against those of every seed.
        """
        wanted = [n for n, (_, factor) in enumerate(self.data["images"]) if factor == ratio]
        own, other = self.scores[row], self.scores[less or row]
        seeds = sorted(other if row in UNTRAINED else own.keys() & other)
        values = np.array([own["0" if row in UNTRAINED else seed] for seed in seeds])
        if less is not None:
            values = values - np.array([other[seed] for seed in seeds])
        return values[:, wanted], [self.data["images"][n][0] for n in wanted]


# --- the runs ---------------------------------------------------------------------------------------------------------


class Trained:
    """A network as what predicts a frame."""

    def __init__(self, network: UNet, device: str) -> None:
        self.network, self.device = network.to(device).eval(), device

    def settings(self, cameras: Any, channels: Any) -> dict[str, str]:  # noqa: ARG002 # of all alike
        """Return what decides its predictions; their folder is removed once it is scored."""
        return {"denoiser": "UNet"}

    def __call__(self, frame: NoisyFrame) -> np.ndarray:
        """Return the network's estimate of a whole frame."""
        with torch.inference_mode():
            made = self.network(torch.from_numpy(frame.image)[None].to(self.device))[0]
        clean: np.ndarray = made.contiguous().cpu().numpy()
        return clean


def score(bench: Bench, denoiser: Any, name: str) -> tuple[list[tuple[str, float]], list[float]]:
    """Predict and score the test scenes; return (scene, factor) of each image, and its PSNR to a thousandth of a dB."""
    where: dict[str, Any] = {"manifest": bench.manifest, "root": bench.root, "cameras": [bench.camera]}
    if name.startswith("shading"):
        where["dark_shading"] = bench.shading
    if denoiser is None:
        result = evaluate(None, baseline="input", **where)
    else:
        folder = bench.folder / "runs" / f"{bench.camera}.{name}.predictions"  # predictions that are there are kept
        write_predictions(denoiser, "eld-benchmark", folder, clip=CLIP, **where)
        result = evaluate(folder, **where)
        shutil.rmtree(folder)
    print(f"{bench.camera}.{name}: {result.table[-1].psnr_db:.2f} dB", flush=True)
    images = sorted(result.scores, key=lambda one: one.path)
    return [(one.scene, float(one.ratio or 0)) for one in images], [round(one.psnr_db, 3) for one in images]


def train(
    bench: Bench, row: str, seed: int, recipe: Recipe, device: str
) -> tuple[list[tuple[str, float]], list[float]]:
    """Train a network on one row's data, or go on with it, and score it."""
    name = f"{slug(row)}.{seed}"
    runs = bench.folder / "runs"
    runs.mkdir(exist_ok=True)
    checkpoint = runs / f"{bench.camera}.{name}.pt"
    loader = training_loader(training_data(bench, row, seed), recipe.batch, seed=seed, num_workers=0)
    settings = {"camera": bench.camera, "row": row, "seed": seed, **asdict(recipe)}
    network = recipe.network(seed)
    training = Training(
        network, loader, steps=recipe.steps, learning_rate=recipe.rate, device=device, settings=settings
    )
    for report in training.epochs(checkpoint):
        print(f"{bench.camera}.{name}: {report}", flush=True)
    scored = score(bench, Trained(network, device), name)
    checkpoint.unlink()
    return scored


# --- the table --------------------------------------------------------------------------------------------------------


def with_interval(values: np.ndarray, scenes: list[str]) -> tuple[float, float]:
    """Return the mean of scores, or of differences, (seeds, images), and the half width of its 95 % interval.

    Student's of the scenes, and Student's of the seeds' means, put together as independent. With one seed its share is
    not known, and not in it.
    """
    from scipy.stats import t

    interval = interval_of_mean(values.mean(axis=0), scenes)
    half, count = (interval.high - interval.low) / 2, len(values)
    if count > 1:
        half = math.hypot(half, t.ppf(0.975, count - 1) * values.mean(axis=1).std(ddof=1) / math.sqrt(count))
    return float(values.mean()), half


def table(records: Mapping[str, Record]) -> str:
    """Return the table: the PSNR of networks trained on real pairs, and how far others lie above it on the same images.

    Without such a network, each row's own PSNR.
    """
    lines = []
    done = [row for row in (*UNTRAINED, *TRAINED) if all(row in record.scores for record in records.values())]
    if not done:
        raise EldataError("no row is finished for every camera")
    less = "paired" if "paired" in done else None
    for row in done:
        own = less is None or row == less
        form = "{:.2f}±{:.2f}" if own else "{:+.2f}±{:.2f}"
        line = [TITLES.get(row, row)]
        for record, ratio in product(records.values(), RATIOS):
            line.append(form.format(*with_interval(*record.of(row, ratio, None if own else less))))
        lines.append(line)
    header = ["trained on", *(f"{camera} x{ratio:g}" for camera, ratio in product(records, RATIOS))]
    return markdown_table(header, lines)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
