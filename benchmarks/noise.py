"""The full noise model on one training patch, over the gain range of a camera."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import torch

from benchmarks import plain_noise
from benchmarks.data import SIZE
from benchmarks.harness import Row, in_turn
from eldata.datasets import DarkFrames
from eldata.demo.scenes import scene_radiance
from eldata.noise import CameraProfile, NoiseModel
from eldata.raw import bayer_cfa, write_dng
from eldata.records import Exposure, Sensor
from eldata.sources.store import build_store, source_of_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from benchmarks.data import Files
    from eldata.noise import NoiseParameters

_DRAWS = 8  # parameter draws a timed call: K is log-uniform, and the time of plain Poisson depends on it
_PATCH = (4, 512, 512)
_BATCH = 32
_DARK_ISO, _DARK_FRAMES = 1600, 3


def _dark_store(folder: Path) -> Path:
    """Make a store of bias frames of 12 megapixels."""
    place, generator = folder / "bias" / f"ISO{_DARK_ISO}", np.random.default_rng(3)
    place.mkdir(parents=True)
    sensor = Sensor("Acme", "Nocturne", bayer_cfa(), (512.0,) * 4, 512 + plain_noise.RANGE_DN, *SIZE)
    for number in range(_DARK_FRAMES):
        mosaic = np.rint(generator.normal(512, 4, SIZE)).astype(np.uint16)
        write_dng(place / f"{number}.dng", mosaic, sensor, Exposure(Fraction(_DARK_ISO), Fraction(1, 4000)))
    build_store(source_of_folder(folder), folder / "bias.h5")
    return folder / "bias.h5"


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    profile = CameraProfile.load("SonyA7S2")
    generator = np.random.default_rng(0)
    drawn = [profile.sample(generator) for _ in range(_DRAWS)]
    ratios = [float(value) for value in generator.uniform(100, 300, _DRAWS)]
    radiance = scene_radiance(1, _PATCH[1], _PATCH[2])
    clean = np.ascontiguousarray(radiance[[0, 1, 2, 1]], dtype=np.float32)
    tensor, torch_generator = torch.from_numpy(clean), torch.Generator().manual_seed(0)
    model = NoiseModel("P*+G*+B+R+U")
    store = _dark_store(files.data.parent / f"dark-{cores}")
    with_frames = NoiseModel("P*+D", dark_frames=DarkFrames(store))
    with_kept = NoiseModel("P*+D", dark_frames=DarkFrames(store, keep=_DARK_FRAMES))
    out = np.empty_like(clean)

    def every(work: Callable[..., object], image: object, source: object) -> Callable[[], None]:
        def call() -> None:
            for p, ratio in zip(drawn, ratios, strict=True):
                work(image, p, ratio, source)

        return call

    def eldata(image: object, p: object, ratio: float, source: object, threads: int | None = None) -> None:
        model(image, parameters=p, ratio=ratio, range_dn=plain_noise.RANGE_DN, generator=source, threads=threads)  # type: ignore[type-var,arg-type] # arrays and tensors alike

    def dark(its: NoiseModel, image: object, p: NoiseParameters, ratio: float, source: object) -> None:
        of_iso = replace(p, iso=_DARK_ISO)
        its(image, parameters=of_iso, ratio=ratio, range_dn=plain_noise.RANGE_DN, generator=source, threads=1)  # type: ignore[type-var,arg-type] # arrays and tensors alike

    ways = {
        "scipy's tukeylambda.rvs": every(plain_noise.with_scipy, clean, generator),
        "plain numpy": every(plain_noise.with_numpy, clean, generator),
        "plain torch": every(plain_noise.with_torch, tensor, torch_generator),
        "eldata": every(eldata, clean, generator),
        "eldata, one thread": every(partial(eldata, threads=1), clean, generator),
        "eldata, P*+D from a store, one thread": every(partial(dark, with_frames), clean, generator),
        "eldata, P*+D, frames of the store kept, one thread": every(partial(dark, with_kept), clean, generator),
        "numpy uniforms, float32": lambda: [generator.random(out=out, dtype=np.float32) for _ in range(_DRAWS)],
        "copy of the patch": lambda: [out.__setitem__(slice(None), clean) for _ in range(_DRAWS)],
    }
    timings = in_turn(rounds, ways, dict.fromkeys(ways, _DRAWS))
    case = "P*+G*+B+R+U, 4x512x512"
    rows: Sequence[Row] = [
        timings.faster(case, "eldata, one thread", "plain numpy", at_least=8 if cores == 1 else None),
        timings.faster(case, "eldata, one thread", "scipy's tukeylambda.rvs", at_least=12 if cores == 1 else None),
        timings.faster(case, "eldata", "plain torch"),
        timings.faster(
            "P*+D from a store", "eldata, P*+D from a store, one thread", "eldata, one thread", at_least=1.0
        ),
        timings.faster(
            "P*+D, kept", "eldata, P*+D, frames of the store kept, one thread", "eldata, one thread", at_least=1.0
        ),
        timings.cost(case, "eldata, one thread", "numpy uniforms, float32"),
        timings.cost(case, "eldata, one thread", "copy of the patch"),
    ]
    if cores > 1:
        # Apart from torch, whose threads go on spinning for a while after their work and take the cores.
        alone = ("eldata", "eldata, one thread")
        patch = in_turn(4 * rounds, {way: ways[way] for way in alone}, dict.fromkeys(alone, _DRAWS))
        many = np.repeat(clean[None], _BATCH, axis=0)
        batch = in_turn(
            rounds,
            {
                way: partial(eldata, many, drawn[0], ratios[0], generator, count)
                for way, count in zip(alone, (None, 1), strict=True)
            },
            dict.fromkeys(alone, _BATCH),
        )
        least = 0.8 * cores
        rows = [
            *rows,
            patch.faster("all threads, one patch a call", *alone, at_least=least),
            batch.faster(f"all threads, {_BATCH} patches a call", *alone, at_least=least),
        ]
    return list(rows)
