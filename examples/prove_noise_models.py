"""Train one small U-Net on each noise model in turn, and score all on a camera whose noise is none of them.

    eldata demo proof/benchmark --benchmark
    python examples/prove_noise_models.py proof                       # all rows, both cameras, three seeds
    python examples/prove_noise_models.py proof --check               # the acceptance test of each model, too
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
import time
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
from eldata.baselines import BaselineDenoiser, Training, UNet, absolute_error, write_predictions
from eldata.calibration import check_noise
from eldata.datasets import CleanFrames, DarkFrames, Noise2Noise, training_loader
from eldata.datasets.loading import set_epoch
from eldata.errors import EldataError
from eldata.evaluation import evaluate
from eldata.evaluation.statistics import interval_of_mean
from eldata.manifest import load_manifest
from eldata.noise import LED_RANGES, CameraProfile, NoiseModel, VirtualCameras
from eldata.sources.store.build import build_store
from eldata.sources.store.sources import source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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
        return arranged(UNet(4, width=self.width, depth=self.depth, seed=seed))


def arranged(network: UNet) -> UNet:
    """Return a network in the layout in which a CPU takes two thirds of the time for a step."""
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

    @property
    def held_out(self) -> Path:
        """Frames that neither calibration nor training has seen."""
        return self.root / "held-out" / self.camera

    def clean_files(self) -> list[Path]:
        """Return the long exposures to train on."""
        manifest = load_manifest(self.manifest)
        wanted = ("reference", "train", self.camera)
        rows = [row for row in manifest.records if (row.role, row.split, row.camera) == wanted]
        return [manifest.folder(self.root) / row.path for row in rows]

    def clean(self) -> CleanFrames:
        """Return them as a source, decoded once."""
        files = self.clean_files()
        return CleanFrames(files, keep=len(files))

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
UNTRAINED = {
    "input": "amplified input",
    "dct": "VST + DCT",
    "bm3d": "BM3D",
    "anscombe-bm3d": "A-BM3D",
}
SPECS = ("G", "P+G", "P*+G", "P*+G*", "P*+G*+B", "P*+G*+B+R", FULL, "P*+D")
TRAINED = (*SPECS, "shading", "any ISO", "virtual", "noise2noise", "paired")
TITLES = UNTRAINED | {
    "P*+D": "dark frames, P*+D",
    "shading": f"{LESS}, dark shading taken off the input",
    "any ISO": f"{FULL}, K from the whole range",
    "virtual": f"virtual cameras, {FULL}",
    "noise2noise": "Noise2Noise, real",
    "paired": "paired, real",
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
    parser.add_argument("--check", action="store_true", help="run the acceptance test of each noise model")
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
    print("\n\n".join(table(camera, record) for camera, record in records.items()))


def work(bench: Bench, recipe: Recipe, record: Record, options: argparse.Namespace) -> None:
    """Do what a camera's record lacks."""
    if options.check:
        for spec in (row for row in SPECS if row in options.rows and row not in record.checks):
            record.add_check(spec, check(bench, spec))
    for seed, row in product(range(options.seeds), options.rows):
        if row in TRAINED and not record.has(row, seed):
            record.add(row, seed, *train(bench, row, seed, recipe, options.device))
        elif row in UNTRAINED and not record.has(row, 0):
            record.add(row, 0, *score(bench, untrained(bench, row), row))


def untrained(bench: Bench, row: str) -> Any:
    """Return what denoises without a training of ours; for the noisy input nothing does."""
    return None if row == "input" else BaselineDenoiser(row, (bench.profile,))


def slug(row: str) -> str:
    """Return a row's name for files."""
    return row.replace("*", "s").replace("+", "").replace(" ", "-")


# --- what is recorded -------------------------------------------------------------------------------------------------


class Record:
    """A camera's scores, images of each row and seed in one order, and what the acceptance test said of each model."""

    def __init__(self, path: Path, recipe: dict[str, Any] | None) -> None:
        self.path = path
        known: dict[str, Any] = {"recipe": recipe}
        if path.exists():
            known = dict(TextFile(path, EldataError).json().data)
        if recipe not in (None, known["recipe"]):
            raise EldataError(f"{path}: is of {known['recipe']}, not of {recipe}; take another folder")
        self.data = known
        self.checks: dict[str, dict[str, float]] = known.setdefault("checks", {})
        self.scores: dict[str, dict[str, list[float]]] = known.setdefault("psnr_db", {})

    def has(self, row: str, seed: int) -> bool:
        """Return whether a row's seed is finished."""
        return str(seed) in self.scores.get(row, {})

    def add(self, row: str, seed: int, images: list[tuple[str, float]], scores: list[float], facts: Any = None) -> None:
        """Take up the scores of a row's seed; its images are those of all the others."""
        if self.data.setdefault("images", [list(one) for one in images]) != [list(one) for one in images]:
            raise EldataError(f"{self.path}: {row} was scored on other images than what is recorded")
        self.scores.setdefault(row, {})[str(seed)] = scores
        if facts:
            self.data.setdefault("training", {}).setdefault(row, {})[str(seed)] = facts
        write_json(self.path, self.data)

    def add_check(self, spec: str, statistics: dict[str, float]) -> None:
        """Take up what the acceptance test said of a model."""
        self.checks[spec] = statistics
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
    images = sorted(result.images, key=lambda one: one.path)
    return [(one.scene, float(one.ratio or 0)) for one in images], [round(one.psnr_db, 3) for one in images]


def train(
    bench: Bench, row: str, seed: int, recipe: Recipe, device: str
) -> tuple[list[tuple[str, float]], list[float], dict[str, float]]:
    """Train a network on one row's data, or go on with it, and score it; return scores and what it took."""
    name = f"{slug(row)}.{seed}"
    runs = bench.folder / "runs"
    runs.mkdir(exist_ok=True)
    checkpoint = runs / f"{bench.camera}.{name}.pt"
    loader = training_loader(training_data(bench, row, seed), recipe.batch, seed=seed, workers=0)
    settings = {"camera": bench.camera, "row": row, "seed": seed, **asdict(recipe)}
    network = recipe.network(seed)
    training = Training(
        network, loader, steps=recipe.steps, learning_rate=recipe.rate, device=device, settings=settings
    )
    speed = speeds(loader, recipe.network(seed), device)
    begun = time.process_time()
    for report in training.epochs(checkpoint):
        print(f"{bench.camera}.{name}: {report}", flush=True)
    facts = {"cpu_s": round(time.process_time() - begun, 1), **speed}
    images, scores = score(bench, Trained(network, device), name)
    checkpoint.unlink()
    return images, scores, facts


def speeds(loader: Any, network: UNet, device: str) -> dict[str, float]:
    """Return images a second that the data give, and those that the network takes, each by itself.

    On a CPU by CPU time, since something else may run beside it.
    """
    clock = time.process_time if device == "cpu" else time.perf_counter

    def per_second(step: Any) -> float:
        step()
        begun = clock()
        for _ in range(20):
            step()
        if device != "cpu":
            torch.cuda.synchronize()
        return round(20 * BATCH / (clock() - begun), 1)

    set_epoch(loader, 0)
    batches: Iterator[Any] = iter(loader)
    batch = {name: next(batches)[name].to(device) for name in ("input", "target")}
    network.to(device)
    optimiser = torch.optim.Adam(network.parameters())

    def step() -> None:
        optimiser.zero_grad()
        absolute_error(network, batch).backward()  # type: ignore[no-untyped-call]
        optimiser.step()

    return {"data_per_s": per_second(lambda: next(batches)), "network_per_s": per_second(step)}


def check(bench: Bench, row: str) -> dict[str, float]:
    """Hold a model against the held-out frames; return the mean deviation of each statistic, on a logarithmic scale."""
    # Dark frames are a whole sensor's; what is compared is the middle, which with these frames is all of it.
    found = check_noise(noise_model(bench, row), bench.held_out, bench.profile, whole_frames=row.endswith("D"))
    print(f"{bench.camera}.{row}: {found.summary}", flush=True)
    statistics = [one for iso in found.as_dict()["isos"] for one in iso["statistics"]]
    groups: dict[str, list[float]] = {}
    for one in statistics:
        if one.get("deviation") is not None:
            name = "flats" if one["check"].startswith("flats") else one["check"]
            groups.setdefault(name, []).append(math.log1p(abs(one["deviation"])))
    means = {name: round(float(np.mean(values)), 4) for name, values in groups.items()}
    return {"number of statistics that are off": sum(one["verdict"] == "off" for one in statistics), **means}


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


def table(camera: str, record: Record) -> str:
    """Return the table of one camera: PSNR, and the distance from real pairs on the same images."""
    cells = []
    for row in (one for one in (*UNTRAINED, *TRAINED) if one in record.scores):
        line = [TITLES.get(row, row), "" if row in UNTRAINED else str(len(record.scores[row]))]
        for ratio in RATIOS:
            line.append("{:.2f} ± {:.2f}".format(*with_interval(*record.of(row, ratio))))
            if "paired" in record.scores and row != "paired":
                line.append("{:+.2f} ± {:.2f}".format(*with_interval(*record.of(row, ratio, "paired"))))
            else:
                line.append("")
        cells.append(line)
    header = ["trained on", "seeds", "x100 [dB]", "less paired", "x200 [dB]", "less paired"]
    if not cells:
        raise EldataError(f"{record.path}: holds no scores of {camera}")
    return f"{camera}\n\n{markdown_table(header, cells)}{predictors(record)}"


def predictors(record: Record) -> str:
    """Return which statistics of the acceptance test order the models as their networks' scores do."""
    from scipy.stats import spearmanr

    specs = [spec for spec in SPECS if spec in record.checks and spec in record.scores]
    if len(specs) < 4:
        return ""
    scores = [float(record.of(spec, 200.0)[0].mean()) for spec in specs]
    ranks = {}
    for name in set.intersection(*(set(record.checks[spec]) for spec in specs)):
        values = [record.checks[spec][name] for spec in specs]
        if len(set(values)) > 1:
            ranks[name] = float(spearmanr(values, scores).statistic)
    lines = [[name, f"{rank:+.2f}"] for name, rank in sorted(ranks.items(), key=lambda item: (item[1], item[0]))]
    return f"\n\n{markdown_table([f'deviation, {len(specs)} models', 'rank correlation with x200'], lines)}"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
