"""Train the network that is told the noise, on photographs, drawn pictures and the noise of virtual cameras.

    python examples/train_noise_aware.py run --steps 2000                 # on a CPU: a beginning
    python examples/train_noise_aware.py run --device cuda --workers 14

Clean frames are made once (`run/clean.npy`); `run/checkpoint.pt` is written after each 500 steps, a line of
`run/curve.csv` after each epoch, `run/noise_aware.safetensors` at the end, in half precision. The same command goes on
after a Ctrl-C or a kill. How the network that ships was trained is on its card, in docs/baselines.md.

Clean frames are photographs (photographs.py fetches them), averaged so far that they are sharp in each pixel and taken
back to raw: linear light, in half of them without a camera's contrast curve, through a sensor's filters and white
balance. Besides, there are scikit-image's pictures that the virtual benchmark does not test on, still lifes of the
demo's kind, discs that lie upon each other like dead leaves, and charts. Noise is that of virtual cameras, K from 0.05
to 20 DN/e- and factors from 1 to 300, and in half of the crops each what no line tells of: columns and rows with an
offset, pixels that jump, a colour cast of the black; in a quarter, a response that differs from pixel to pixel.
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
from photographs import STOP, TRAIN, fetch_photographs, photograph_radiance, picture_path
from PIL import Image
from safetensors.torch import load_file
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torch.utils.data import ConcatDataset
from virtual_benchmark import TRAINING_PICTURES, picture_radiance, pictures_of

from eldata import SyntheticPairs
from eldata.base.files import atomic_write
from eldata.base.workers import Workers
from eldata.baselines import Training
from eldata.baselines.unet import NoiseAwareUNet, save_weights
from eldata.datasets import Arrays, training_loader
from eldata.demo.camera import CAMERAS, METERED_SHARE, mosaic_light
from eldata.demo.scenes import scene_radiance
from eldata.noise import LED_RANGES, NoiseModel, VirtualCameras
from eldata.raw import pack

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

RANGE_DN = 15871.0
GAINS_DN_PER_E = (0.05, 20.0)
# Factors, and how often each is drawn: frames that have hardly any noise are the hardest to leave as they are.
FACTORS = {(1.0, 3.0): 3, (3.0, 8.0): 2, (8.0, 40.0): 2, (40.0, 120.0): 2, (120.0, 300.0): 2}
MODEL = "P*+G*+R+U"
SIDE = 256  # of a clean frame, packed pixels
FRAMES = {"photograph": 1040, "picture": 220, "still life": 720, "leaves": 120, "chart": 240}
HELD = {"photograph": 16, "still life": 4}  # of photographs kept out, and by cameras that are not trained on
PHASES = (((0, 1), (3, 2)), ((1, 0), (2, 3)), ((3, 2), (0, 1)), ((2, 3), (1, 0)))  # of the CFA, in turn
FIRST_STILL_LIFE = 1001  # none that the demo, the benchmark or a test shows
EPOCH = 500  # steps
SHARE = 1 / 500  # of the present weights in their running mean
HELD_SIDE, HELD_FACTORS = 128, (1.0, 10.0, 100.0, 250.0)
TOLD = 0.05  # standard deviation of the logarithm of what the network is told, over what is true
# What is left of noise of variance v goes about as v to this power: the network that ships gains 4 dB where the input
# has 47, and 12 where it has 11.
USUAL, FLOOR = 0.75, 1e-4
LAMBDA = (-0.24, 0.3)  # the Tukey lambda distribution has no variance from -0.5 on, and profiles stay above -0.25
# What no line tells of, in standard deviations of the read noise, each in half of the crops: offsets of columns, of
# rows that remember the row above, and of colours; and a share of pixels that jump by so much.
COLUMNS, ROWS, COLOURS, JUMPING, JUMPS = 0.3, 0.5, 0.1, 0.03, 4.0
RESPONSE = 0.012  # standard deviation of the pixels' response to light, at most; in a quarter of the crops
MEMORY = 12  # rows, at most


def main(argv: Sequence[str] | None = None) -> None:
    """Train to the end, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of this training; the same command goes on with it")
    parser.add_argument(
        "--photographs", type=Path, metavar="FOLDER", default="photographs", help="(default: %(default)s)"
    )
    parser.add_argument("--begin", type=Path, metavar="FILE", help="weights to begin with, of an earlier run")
    parser.add_argument("--steps", type=int, default=20_000, help="(default: %(default)s)")
    parser.add_argument("--rate", type=float, default=5e-4, help="learning rate at first (default: %(default)s)")
    parser.add_argument("--batch", type=int, default=64, help="(default: %(default)s)")
    parser.add_argument("--crop", type=int, default=96, help="in packed pixels (default: %(default)s)")
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="bfloat16")
    parser.add_argument("--device", default="cpu", help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="processes that make the noise (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    options = parser.parse_args(argv)
    options.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    torch.backends.cudnn.benchmark = True  # all crops have one size
    seed, workers = options.seed, Workers(max(options.workers, 1))
    begun = NoiseAwareUNet(seed=seed)
    if options.begin is not None:
        begun.load_state_dict(load_file(options.begin))
    fetch_photographs(options.photographs)
    learnt, kept = (tuple(picture_path(options.photographs, name) for name in names) for names in (TRAIN, STOP))
    clean = clean_frames(options.run / "clean.npy", FRAMES, learnt, seed, workers)
    held = validation(clean_frames(options.run / "validation.npy", HELD, kept, seed + 1, workers), seed + 1)
    network = Averaged(begun)
    pairs = noisy_pairs(clean, options.batch, options.crop, seed)
    training = Training(
        network.to(memory_format=torch.channels_last),  # type: ignore[call-overload] # torch's stub
        training_loader(pairs, options.batch, seed=seed, num_workers=options.workers, device=options.device),
        steps=options.steps,
        learning_rate=options.rate,
        loss=root_error,
        device=options.device,
        precision=options.precision,
        settings={"seed": seed, "crop": options.crop, "frames": len(clean)},
    )
    torch.manual_seed(seed)
    started, curve = time.monotonic(), options.run / "curve.csv"
    for report in training.epochs(options.run / "checkpoint.pt", save_every=EPOCH):
        found = gains_db(network, held, options.device)
        line = {"step": report.step, "s": round(time.monotonic() - started), "loss": f"{report.loss:.4f}", **found}
        with curve.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, line)
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(line)
        print(report, *(f"{factors} {gain}" for factors, gain in found.items()), sep=", ", flush=True)
    save_weights(network.average, options.run / "noise_aware.safetensors")


class Averaged(nn.Module):
    """A network in training, and a running mean of its weights, which is what it is in use."""

    def __init__(self, network: NoiseAwareUNet) -> None:
        super().__init__()
        self.network = network
        self.average = copy.deepcopy(network).requires_grad_(False)
        self.update = get_ema_multi_avg_fn(1 - SHARE)  # type: ignore[no-untyped-call] # torch's stub

    def forward(self, *given: torch.Tensor) -> torch.Tensor:
        """Return what the network makes, or in use the mean."""
        if not self.training:
            made: torch.Tensor = self.average(*given)
            return made
        self.update(list(self.average.parameters()), [one.detach() for one in self.network.parameters()], 0)
        trained: torch.Tensor = self.network(*given)
        return trained


# --- the loss ---------------------------------------------------------------------------------------------------------


def line_of(batch: Mapping[str, Any]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return slope and offset of the true noise of each item, (N,) (eldata/baselines/classical.py has them)."""
    scale = batch["ratio"] / RANGE_DN
    read = tukey_lambda_variances(batch["tukey_lambda"]) * batch["sigma_tl_dn"] ** 2 + batch["sigma_row_dn"] ** 2
    return (batch["gain_dn_per_e"] * scale).float(), ((read + 1 / 12) * scale**2).float()


def tukey_lambda_variances(shape: torch.Tensor) -> torch.Tensor:
    """Return the variances for scale 1: 2 / lambda^2 (1 / (1 + 2 lambda) - Gamma(lambda + 1)^2 / Gamma(2 lambda + 2)).

    On the device of the batch. Nearer to 0 than 1e-4 that of 1e-4, which is the limit's to 1 part in 2,000.
    """
    shape = torch.where(shape.abs() < 1e-4, 1e-4, shape.double())
    beta = torch.exp(2 * torch.lgamma(shape + 1) - torch.lgamma(2 * shape + 2))
    return 2 / shape**2 * (1 / (1 + 2 * shape) - beta)


def root_error(network: nn.Module, batch: Mapping[str, Any]) -> torch.Tensor:
    """Return the mean root of each crop's error over what is usual at its noise.

    Between the mean error itself, which crops full of texture rule, and the mean of its logarithm, which is PSNR's and
    which smooth crops rule.
    """
    slope, offset = line_of(batch)
    told = torch.exp(TOLD * torch.randn(2, len(slope), device=slope.device))
    clean = batch["target"]
    # It counts as noise: by what is told alone, bright crops would outweigh all others, and texture would be taken off.
    response = RESPONSE * (torch.rand(len(slope), device=slope.device) * 4 - 3).clamp(min=0)
    noisy = batch["input"] + draw_noise_in_the_dark(batch["input"], offset.sqrt())
    noisy = noisy + response[:, None, None, None] * clean * torch.randn_like(clean)
    made = network(noisy, slope * told[0], offset * told[1] ** 2)
    noise = offset + slope * clean.mean(dim=(1, 2, 3)) + response**2 * (clean**2).mean(dim=(1, 2, 3))
    error = ((made - clean) ** 2).mean(dim=(1, 2, 3)) / noise**USUAL
    loss: torch.Tensor = (error + FLOOR).sqrt().mean()
    return loss


def draw_noise_in_the_dark(noisy: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
    """Draw what slope and offset do not describe: columns, rows, jumping pixels, colours, for read noise ``sigma``.

    Parameters
    ----------
    noisy
        Images to draw it for, (N, 4, h, w).
    sigma
        Standard deviation of each one's read noise, (N,).
    """
    count, _, height, width = noisy.shape
    each = sigma[:, None, None, None] * (torch.rand(4, count, 1, 1, 1, device=noisy.device) * 2 - 1).clamp(min=0)
    # In any phase R and G2 lie in the same columns of the mosaic, B and G1 in those between; R and G1 share rows.
    columns = torch.randn(count, 2, 1, width, device=noisy.device)[:, [0, 1, 1, 0]]
    memory = torch.rand((), device=noisy.device) ** torch.arange(MEMORY, device=noisy.device)
    memory = memory.flip(0) / memory.norm()
    drawn = torch.randn(count, 1, 2 * height + MEMORY - 1, device=noisy.device)
    rows = nn.functional.conv1d(drawn, memory[None, None]).reshape(count, height, 2)
    rows = rows.transpose(1, 2)[:, [0, 0, 1, 1], :, None]
    colours = torch.randn(count, 4, 1, 1, device=noisy.device)
    places = torch.rand(noisy.shape, device=noisy.device)
    jumps = (places < JUMPING).float() - (places > 1 - JUMPING).float()
    return COLUMNS * each[0] * columns + JUMPS * each[1] * jumps + ROWS * each[2] * rows + COLOURS * each[3] * colours


# --- clean frames -----------------------------------------------------------------------------------------------------


def clean_frames(
    path: Path, counts: Mapping[str, int], photographs: tuple[Path, ...], seed: int, workers: Workers
) -> Kept:
    """Return clean frames, made once: frame i depends on (seed, i) and the photographs."""
    if not path.exists():
        kinds = [kind for kind, count in counts.items() for _ in range(count)]
        wanted = [(kind, place, seed, photographs) for place, kind in enumerate(kinds)]
        with atomic_write(path) as file:
            np.save(file, np.stack(list(workers.run(clean_frame, wanted, unit="frame"))))
    return Kept(path)


def clean_frame(wanted: tuple[str, int, int, tuple[Path, ...]]) -> NDArray[np.float16]:
    """Return what one of the demo's sensors would see of a picture without noise, packed, white at 1."""
    kind, place, seed, photographs = wanted
    generator = np.random.default_rng([seed, place])
    side, colours = 2 * SIDE, np.arange(3)
    exposure = METERED_SHARE * 2 ** generator.uniform(-2.2, 0.6)
    if kind == "photograph":
        radiance = photograph(photographs[place % len(photographs)], side, generator)
        if generator.random() < 0.4:
            exposure = float(np.exp(generator.uniform(np.log(0.02), 0)))
    elif kind == "still life":
        size = int(side * generator.uniform(1, 2.2))
        radiance = window(scene_radiance(FIRST_STILL_LIFE + int(generator.integers(400)), size, size), side, generator)
    elif kind == "picture" and (names := pictures_of(TRAINING_PICTURES)):
        size = int(side * generator.uniform(1, 1.6))
        name = str(generator.choice(names))
        radiance = window(picture_radiance(name, size, size * 3 // 2), side, generator)
        colours = generator.permutation(3) if generator.random() < 0.5 else colours
        radiance = radiance * (generator.uniform(0.6, 1, (3, 1, 1)) ** generator.uniform(0, 1)).astype(np.float32)
    elif kind == "chart":
        radiance = chart(side, generator)
    else:
        radiance = leaves(side, generator)
    known = CAMERAS[generator.integers(len(CAMERAS))].sensor
    balance = (float(generator.uniform(1.2, 2.6)), 1.0, float(generator.uniform(1.2, 2.6)), 1.0)
    cfa = PHASES[place % len(PHASES)]
    sensor = replace(known, cfa=cfa, height=side, width=side, white_balance=balance)
    mosaic = mosaic_light(radiance[colours].astype(np.float32), sensor)
    return np.clip(pack((mosaic * exposure).astype(np.float32), cfa), 0, 1).astype(np.float16)


def photograph(path: Path, side: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return a part of a photograph, turned by quarters, averaged over 2 x 2 or, where it is large, 3 x 3 pixels."""
    times = int(generator.choice([2, 3]))
    light = photograph_radiance(path, times, bool(generator.random() < 0.5))
    if min(light.shape[1:]) < side:
        light = photograph_radiance(path, 2)
        missing = [max(side - length, 0) for length in light.shape[1:]]
        light = np.pad(light, [(0, 0), *((0, lacks) for lacks in missing)], mode="symmetric")
    return np.rot90(window(light, side, generator), int(generator.integers(4)), axes=(1, 2))


def chart(side: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return a board of patterns that repeat: bars, checks, rings and rays of many periods in two colours each."""
    light = np.empty((3, side, side), np.float32)
    cells = int(generator.integers(2, 6))
    edges = np.linspace(0, side, cells + 1).astype(int)
    for row, column in np.ndindex(cells, cells):
        here = np.s_[:, edges[row] : edges[row + 1], edges[column] : edges[column + 1]]
        y, x = np.mgrid[: light[here].shape[1], : light[here].shape[2]] - 0.5 * side / cells
        turn, period = (
            generator.choice([0, np.pi / 2, generator.uniform(0, np.pi)]),
            np.exp(generator.uniform(1.1, 3.5)),
        )
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        phases = (along, np.hypot(x, y), np.arctan2(y, x) * generator.integers(2, 12) * period / 2)
        wave = np.sin(phases[generator.choice(3, p=(0.6, 0.2, 0.2))] * (2 * np.pi / period))
        if generator.random() < 0.2:
            wave = wave * np.sin(across * (2 * np.pi / period))
        if generator.random() < 0.8:  # sharp, of an edge about a pixel wide
            wave = np.clip(wave * period / 6, -1, 1)
        dark, bright = generator.uniform(0, 1, (2, 3, 1, 1)) ** 2
        if generator.random() < 0.6:
            dark, bright = dark.mean() * 0.2, bright.mean() * 0.5 + 0.5
        light[here] = dark + (bright - dark) * (0.5 + 0.5 * wave)
    return light


def window(radiance: NDArray[np.floating], side: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return a part of a picture."""
    top, left = (int(generator.integers(length - side + 1)) for length in radiance.shape[1:])
    return radiance[:, top : top + side, left : left + side].astype(np.float32)


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


def noisy_pairs(source: Kept, batch: int, crop: int, seed: int) -> ConcatDataset[Any]:
    """Return crops of all frames with the noise of virtual cameras, factors as often as they are wanted."""
    virtual = VirtualCameras(200, replace(LED_RANGES, gain_dn_per_e=GAINS_DN_PER_E, tukey_lambda=LAMBDA), seed=seed)
    per = max(1, round(EPOCH * batch / len(source) / sum(FACTORS.values())))
    options: dict[str, Any] = {"model": NoiseModel(MODEL), "clip": "none", "crop": crop, "augment": True}
    return ConcatDataset(
        [
            SyntheticPairs(source, virtual, ratio=factors, crops_per_frame=per * often, seed=seed + place, **options)
            for place, (factors, often) in enumerate(FACTORS.items())
        ]
    )


class Kept:
    """The clean frames of a file as a source, each with the CFA that it was seen through.

    Worker processes are sent the file's name, and share its pages.
    """

    reads_parts = True

    def __init__(self, path: Path) -> None:
        self.path, clean = path, np.load(path, mmap_mode="r")
        by_phase = [Arrays(clean, range_dn=RANGE_DN, cfa=cfa) for cfa in PHASES]
        self.frames = [by_phase[place % len(PHASES)].frame(place) for place in range(len(clean))]

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int) -> Any:
        """Return a frame."""
        return self.frames[index]

    def __reduce__(self) -> tuple[Any, ...]:
        return Kept, (self.path,)

    def __repr__(self) -> str:
        return f"Kept({len(self)} frames)"


# --- validation -------------------------------------------------------------------------------------------------------


def validation(clean: Kept, seed: int) -> dict[str, list[Mapping[str, Any]]]:
    """Return noisy items by other cameras, by factor."""
    virtual = VirtualCameras(50, replace(LED_RANGES, gain_dn_per_e=GAINS_DN_PER_E), seed=seed)
    held = {}
    for factor in HELD_FACTORS:
        pairs = SyntheticPairs(
            clean, virtual, ratio=factor, model=NoiseModel(MODEL), clip="none", crop=HELD_SIDE, seed=seed
        )
        held[f"x{factor:g}"] = [torch.utils.data.default_collate([pairs[place]]) for place in range(len(clean))]
    return held


def gains_db(network: Averaged, held: Mapping[str, Sequence[Mapping[str, Any]]], device: str) -> dict[str, float]:
    """Return the mean gain in PSNR over the input, by factor."""
    network.eval()

    def db(image: torch.Tensor, clean: torch.Tensor) -> float:
        return float(-10 * torch.log10(((image.clamp(0, 1) - clean) ** 2).mean()))

    gains = {}
    with torch.inference_mode():
        for factor, items in held.items():
            found = []
            for item in items:
                made = network(*(one.to(device) for one in (item["input"], *line_of(item)))).cpu()
                found.append(db(made, item["target"]) - db(item["input"], item["target"]))
            gains[factor] = round(sum(found) / len(found), 3)
    return gains


if __name__ == "__main__":
    main()
