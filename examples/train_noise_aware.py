"""Train the network that is told the noise, on clean pictures that every installation has and virtual cameras' noise.

    python examples/train_noise_aware.py run                              # until it is ended; again: it goes on
    python examples/train_noise_aware.py run --cooldown 20000 --export noise-aware.safetensors

The first makes the clean frames once (`run/clean.npy`), trains at a constant rate, and writes `run/checkpoint.pt` and a
line of `run/curve.csv` every 1,000 steps. Ctrl-C or a kill costs what came after the last of them. The second begins
with the running mean of the weights so far, lets the rate fall to nothing over so many steps of its own, and writes the
weights in half precision; the first may go on afterwards as if nothing had been.

Clean frames are still lifes of the demo's kind, scikit-image's pictures that the virtual benchmark does not test on,
and discs that lie upon each other like dead leaves, in sizes, colours and exposures of all kinds. Noise is that of
virtual cameras, K from 0.05 to 20 DN/e- and factors from 1 to 300; the colour bias, which a profile knows and
`denoise` takes off, is left out.
"""

from __future__ import annotations

import argparse
import copy
import csv
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from PIL import Image
from torch import nn
from torch.utils.data import ConcatDataset

from eldata import SyntheticPairs
from eldata.base.files import atomic_write
from eldata.baselines import Training
from eldata.baselines.noise_aware import NoiseAwareUNet
from eldata.baselines.unet import save_weights
from eldata.datasets import Arrays, training_loader
from eldata.demo.benchmark_frames import TRAINING_PICTURES, picture_radiance, pictures_of
from eldata.demo.camera import CAMERAS, METERED_SHARE, mosaic_light
from eldata.demo.scenes import scene_radiance
from eldata.noise import LED_RANGES, NoiseModel, VirtualCameras
from eldata.noise.parameters import tukey_lambda_variance
from eldata.raw import pack

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

RANGE_DN = 15871.0
GAINS_DN_PER_E = (0.05, 20.0)
# Factors, and how often each is drawn: high ones are what such a network is for.
FACTORS = {(1.0, 8.0): 1, (8.0, 40.0): 1, (40.0, 120.0): 2, (120.0, 300.0): 2}
MODEL = "P*+G*+R+U"
SIDE = 256  # of a clean frame, packed pixels
FRAMES = {"still life": 200, "picture": 360, "leaves": 140}
PHASES = (((0, 1), (3, 2)), ((1, 0), (2, 3)), ((3, 2), (0, 1)), ((2, 3), (1, 0)))  # of the CFA, in turn
FIRST_STILL_LIFE = 1001  # none that the demo, the benchmark or a test shows
BATCH, CROP, EPOCH = 16, 64, 1000
RATE, OPEN_END = 5e-4, 4_000_000  # half of these steps have this rate, which is days of them
VALIDATION = 128, 16  # side of a crop, and frames for each factor
TOLD = 0.05  # standard deviation of the logarithm of what the network is told, over what is true
FLOOR = 0.01  # share of the noise's variance below which an error hardly counts


def main(argv: Sequence[str] | None = None) -> None:
    """Train on, or cool down and export."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of this training; the same command goes on with it")
    parser.add_argument("--steps", type=int, default=OPEN_END, help="(default: %(default)s)")
    parser.add_argument("--width", type=int, default=46, help="of the network's first level (default: %(default)s)")
    parser.add_argument("--cooldown", type=int, metavar="STEPS", help="end the training on a copy, with a falling rate")
    parser.add_argument("--export", type=Path, metavar="FILE", help="write the weights of a cooldown")
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="bfloat16")
    parser.add_argument("--device", default="cpu", help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    options = parser.parse_args(argv)
    options.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    clean = clean_frames(options.run / "clean.npy", options.seed)
    network = Averaged(NoiseAwareUNet(width=options.width, seed=options.seed))
    name, steps = "checkpoint", options.steps
    if options.cooldown is not None:
        name, steps = f"cooldown-{options.cooldown}", options.cooldown
        begun = torch.load(options.run / "checkpoint.pt", map_location="cpu", weights_only=True)
        network.load_state_dict(begun["network"])
        network.network.load_state_dict(network.average.state_dict())
        network.share = 1.0  # a falling rate is a mean already
    train(network, clean, steps, options, name)
    if options.export is not None:
        save_weights(network.average, options.export)


def train(network: Averaged, clean: NDArray[np.float16], steps: int, options: Any, name: str) -> None:
    """Train to an end, with a checkpoint and a line of the curve each epoch."""
    torch.manual_seed(options.seed)
    is_end = options.cooldown is not None
    loader = training_loader(noisy_pairs(clean, options.seed + is_end), BATCH, seed=options.seed, workers=0)
    training = Training(
        network.to(memory_format=torch.channels_last),  # type: ignore[call-overload] # torch's stub
        loader,
        steps=steps,
        learning_rate=RATE,
        loss=decibels,
        device=options.device,
        precision=options.precision,
        settings={"width": options.width, "seed": options.seed, "crop": CROP, "frames": len(clean)},
    )
    held = validation(options.seed)
    begun, curve = time.monotonic(), options.run / ("curve.csv" if not is_end else f"{name}.csv")
    for report in training.epochs(options.run / f"{name}.pt", save_every=250):
        found = gains_db(network, held)
        line = {"step": report.step, "s": round(time.monotonic() - begun), "loss": f"{report.loss:.4f}", **found}
        with curve.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, line)
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(line)
        print(report, *(f"{factors} {gain}" for factors, gain in found.items()), sep=", ", flush=True)


class Averaged(nn.Module):
    """A network in training, and a running mean of its weights, which is what it is in use.

    Attributes
    ----------
    share
        Of the present weights in the mean, at each step.
    """

    def __init__(self, network: NoiseAwareUNet, share: float = 1 / 2000) -> None:
        super().__init__()
        self.network, self.share = network, share
        self.average = copy.deepcopy(network).requires_grad_(False)

    def forward(self, *given: torch.Tensor) -> torch.Tensor:
        """Return what the network makes, or in use the mean."""
        if not self.training:
            made: torch.Tensor = self.average(*given)
            return made
        with torch.no_grad():
            for mean, weights in zip(self.average.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(weights, self.share)
        trained: torch.Tensor = self.network(*given)
        return trained


# --- the loss ---------------------------------------------------------------------------------------------------------


def line_of(batch: Mapping[str, Any]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return slope and offset of the true noise of each item, (N,) (eldata/baselines/classical.py has them)."""
    scale = batch["ratio"] / RANGE_DN
    shapes = [tukey_lambda_variance(float(shape)) for shape in batch["tukey_lambda"]]
    read = torch.tensor(shapes) * batch["sigma_tl_dn"] ** 2 + batch["sigma_row_dn"] ** 2 + 1 / 12
    return batch["gain_dn_per_e"] * scale, read * scale**2


def decibels(network: nn.Module, batch: Mapping[str, Any]) -> torch.Tensor:
    """Return the mean logarithm of each crop's error over its noise: what PSNR means, whatever the noise."""
    slope, offset = line_of(batch)
    told = torch.exp(TOLD * torch.randn(2, len(slope)))
    made = network(batch["input"], slope * told[0], offset * told[1] ** 2)
    noise = offset + slope * batch["target"].mean(dim=(1, 2, 3))
    error = ((made - batch["target"]) ** 2).mean(dim=(1, 2, 3)) / noise
    loss: torch.Tensor = torch.log(error + FLOOR).mean()
    return loss


# --- clean frames -----------------------------------------------------------------------------------------------------


def clean_frames(path: Path, seed: int) -> NDArray[np.float16]:
    """Return clean frames (N, 4, h, w), made once: frame i depends on (seed, i) alone."""
    if not path.exists():
        kinds = [kind for kind, count in FRAMES.items() for _ in range(count)]
        made = [clean_frame(kind, place, np.random.default_rng([seed, place])) for place, kind in enumerate(kinds)]
        with atomic_write(path) as file:
            np.save(file, np.stack(made).astype(np.float16))
    frames: NDArray[np.float16] = np.load(path, mmap_mode="r")
    return frames


def clean_frame(kind: str, place: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return what one of the demo's sensors would see of a picture without noise, packed, white at 1."""
    side, colours = 2 * SIDE, np.arange(3)
    if kind == "still life":
        size = int(side * generator.uniform(1, 2.2))
        radiance = window(scene_radiance(FIRST_STILL_LIFE + int(generator.integers(400)), size, size), side, generator)
    elif kind == "picture" and (names := pictures_of(TRAINING_PICTURES)):
        size = int(side * generator.uniform(1, 1.6))
        name = str(generator.choice(names))
        radiance = window(picture_radiance(name, size, size * 3 // 2), side, generator)
        colours = generator.permutation(3) if generator.random() < 0.5 else colours
        radiance = radiance * (generator.uniform(0.6, 1, (3, 1, 1)) ** generator.uniform(0, 1)).astype(np.float32)
    else:
        radiance = leaves(side, generator)
    known = CAMERAS[generator.integers(len(CAMERAS))].sensor
    balance = (float(generator.uniform(1.2, 2.6)), 1.0, float(generator.uniform(1.2, 2.6)), 1.0)
    cfa = PHASES[place % len(PHASES)]
    sensor = replace(known, cfa=cfa, height=side, width=side, white_balance=balance)
    mosaic = mosaic_light(radiance[colours].astype(np.float32), sensor)
    exposure = METERED_SHARE * 2 ** generator.uniform(-2.2, 0.6)
    return np.clip(pack((mosaic * exposure).astype(np.float32), cfa), 0, 1)


def window(radiance: NDArray[np.float32], side: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return a part of a picture."""
    top, left = (int(generator.integers(length - side + 1)) for length in radiance.shape[1:])
    return radiance[:, top : top + side, left : left + side]


def leaves(side: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return ellipses and boxes of all sizes upon each other, shaded and grained, (3, side, side), linear light.

    Dead leaves have edges and scales as photographs do (A. Lee, D. Mumford and J. Huang, IJCV 2001), and networks that
    are trained on them denoise photographs (R. Achddou, Y. Gousseau and S. Ladjal, SSVM 2021).
    """
    large = 2 * side
    rows, columns = np.mgrid[:large, :large].astype(np.float32)
    grains = np.stack([grain(large, generator) for _ in range(3)])
    smallest, hue = generator.uniform(8, 40), generator.uniform(0, 1, 3)
    picture = (hue[:, None, None] ** 2 * np.clip(0.6 + 0.3 * grains[0], 0, 2)).astype(np.float32)
    for _ in range(int(generator.integers(100, 400))):
        radius = min(smallest / (1 - generator.random()) ** 0.5, large / 2)
        y, x = generator.uniform(-radius, large + radius, 2)
        top, left = (max(int(place - 1.5 * radius), 0) for place in (y, x))
        here = np.s_[top : int(y + 1.5 * radius) + 1, left : int(x + 1.5 * radius) + 1]
        if y + 1.5 * radius < 0 or x + 1.5 * radius < 0 or not rows[here].size:
            continue
        turn, long = generator.uniform(0, np.pi), generator.uniform(0.3, 1)
        along = ((rows[here] - y) * np.cos(turn) + (columns[here] - x) * np.sin(turn)) / radius
        across = ((columns[here] - x) * np.cos(turn) - (rows[here] - y) * np.sin(turn)) / radius / long
        is_inside = np.maximum(abs(along), abs(across)) < 0.8 if generator.random() < 0.4 else along**2 + across**2 < 1
        colour = (0.5 * hue + 0.5 * generator.uniform(0, 1, 3)) ** generator.uniform(1, 3)
        shade = (
            1
            + generator.uniform(0, 0.5) * along
            + generator.choice([0, 0.15, 0.4]) * grains[generator.integers(3)][here]
        )
        if generator.random() < 0.1:
            shade = shade * (1 + 0.6 * np.sign(np.sin(along * radius * 2 * np.pi / generator.uniform(6, 40))))
        picture[:, *here][:, is_inside] = (colour[:, None, None] * np.clip(shade, 0, 2)).astype(np.float32)[
            :, is_inside
        ]
    halves = [Image.fromarray(one).resize((side, side), Image.Resampling.BOX) for one in picture]
    return np.clip(np.stack([np.asarray(half, np.float32) for half in halves]), 0, 1)


def grain(side: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return noise of zero mean and unit deviation whose power falls with frequency."""
    far = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    shape = np.maximum(far, 2 / side) ** -generator.uniform(0.6, 1.8) * np.exp(-((far / 0.25) ** 2))
    shape[0, 0] = 0
    made = np.fft.irfft2(np.fft.rfft2(generator.standard_normal((side, side))) * shape, (side, side))
    return np.asarray(made / made.std(), np.float32)


def noisy_pairs(clean: NDArray[np.float16], seed: int) -> ConcatDataset[Any]:
    """Return crops of all frames with the noise of virtual cameras, factors as often as they are wanted."""
    virtual = VirtualCameras(200, replace(LED_RANGES, gain_dn_per_e=GAINS_DN_PER_E), seed=seed)
    per = EPOCH * BATCH / len(clean) / sum(FACTORS.values())
    source = Kept(clean)
    options: dict[str, Any] = {"model": NoiseModel(MODEL), "clip": "none", "crop": CROP, "augment": True}
    return ConcatDataset(
        [
            SyntheticPairs(
                source, virtual, ratio=factors, crops_per_frame=round(per * often), seed=seed + place, **options
            )
            for place, (factors, often) in enumerate(FACTORS.items())
        ]
    )


class Kept:
    """The clean frames as a source, each with the CFA that it was seen through."""

    reads_parts = True

    def __init__(self, clean: NDArray[np.floating[Any]]) -> None:
        by_phase = [Arrays(clean, range_dn=RANGE_DN, cfa=cfa) for cfa in PHASES]
        self.frames = [by_phase[place % len(PHASES)].frame(place) for place in range(len(clean))]

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int) -> Any:
        """Return a frame."""
        return self.frames[index]

    def __repr__(self) -> str:
        return f"Kept({len(self)} frames)"


# --- validation -------------------------------------------------------------------------------------------------------


def validation(seed: int) -> dict[str, list[Mapping[str, Any]]]:
    """Return noisy items of pictures and cameras that are not trained on, by factor."""
    side, count = VALIDATION
    kinds = [("still life", "leaves", "picture")[place % 3] for place in range(count)]
    clean = np.stack(
        [clean_frame(kind, place, np.random.default_rng([seed, 9, place])) for place, kind in enumerate(kinds)]
    )
    virtual = VirtualCameras(50, replace(LED_RANGES, gain_dn_per_e=GAINS_DN_PER_E), seed=seed + 999)
    held = {}
    for factor in (3.0, 30.0, 100.0, 250.0):
        pairs = SyntheticPairs(Kept(clean), virtual, ratio=factor, model=NoiseModel(MODEL), clip="none", crop=side)
        held[f"x{factor:g}"] = [torch.utils.data.default_collate([pairs[place]]) for place in range(count)]
    return held


def gains_db(network: Averaged, held: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, float]:
    """Return the mean gain in PSNR over the input, by factor."""
    network.eval()

    def db(image: torch.Tensor, clean: torch.Tensor) -> float:
        return float(-10 * torch.log10(((image.clamp(0, 1) - clean) ** 2).mean()))

    with torch.inference_mode():
        return {
            factors: round(
                sum(
                    db(network(one["input"], *line_of(one)), one["target"]) - db(one["input"], one["target"])
                    for one in items
                )
                / len(items),
                3,
            )
            for factors, items in held.items()
        }


if __name__ == "__main__":
    main()
