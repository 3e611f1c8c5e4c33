"""The virtual benchmark: its files, the calibration of its cameras, and what a network's training and test need."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from eldata.base.numbers import counted
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration.camera import calibrate
from eldata.calibration.shading_fit import dark_shading
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.demo.benchmark_frames import (
    CALIBRATION,
    DEFAULT_PLAN,
    FOLDER,
    HELD_OUT,
    BenchmarkPlan,
    benchmark_scenes,
    make_benchmark,
)
from eldata.demo.sensor import BENCHMARK_SENSORS
from eldata.demo.tree import prepare_folder, verify_own
from eldata.evaluation.evaluate import evaluate
from eldata.sources.store.build import build_store
from eldata.sources.store.sources import source_of_folder

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.calibration.results import Calibration
    from eldata.demo.sensor import SensorDesign
    from eldata.manifest.catalogue import Manifest


def run_benchmark(folder: Path, plan: BenchmarkPlan = DEFAULT_PLAN, *, workers: Workers = IN_THIS_PROCESS) -> Manifest:
    """Make the benchmark in a folder, calibrate its cameras from their frames, and score the input, printing all.

    Beside what :func:`~eldata.demo.benchmark_frames.make_benchmark` writes, ``folder/profiles`` gets each camera's
    profile (``<camera>.json``), dark shading (``<camera>-shading.npz``) and store of bias frames
    (``<camera>-bias.h5``).

    Parameters
    ----------
    folder
        New, empty, or an earlier demo's.
    plan, workers
        As of :func:`~eldata.demo.benchmark_frames.make_benchmark`.

    Raises
    ------
    EldataError
        If the folder holds something that no demo made.
    """
    start = time.perf_counter()
    prepare_folder(folder)
    manifest = make_benchmark(folder, plan, workers=workers)
    data, profiles = folder / "data", folder / "profiles"
    profiles.mkdir()
    pictures = sum(bool(scene.picture) for scene in benchmark_scenes(plan.scenes, plan.training_scenes))
    names = " and ".join(manifest.card.cameras)
    print(
        f"{counted(plan.scenes, 'scene')} to test on and {plan.training_scenes} to train on, photographed by {names}: "
        f"{data / FOLDER}"
    )
    if pictures:
        print(f"{pictures} of them are pictures that scikit-image ships, the others still lifes")
    else:
        print("all are still lifes; with scikit-image, pip install 'eldata[baselines]', up to half are its pictures")

    verify_own(manifest, data)
    for design in BENCHMARK_SENSORS:
        calibrate_camera(design, data / CALIBRATION, profiles, workers)

    print(f"\n$ eldata evaluate --baseline input --manifest {manifest.path} --root {data}")
    print(evaluate(None, manifest=manifest.path, root=data, baseline="input", workers=workers).format_text())
    print(
        f"\nTo train: the split train of {manifest.path}; clean frames are its long exposures, noise is that of "
        f"{profiles}/*.json and *-bias.h5; docs/proof.md has an example.\n"
        f"To judge a noise model: eldata noise check, with --frames {data / HELD_OUT}.\n"
        f"The truth: {folder / 'truth.json'}. Took {time.perf_counter() - start:.0f} s."
    )
    return manifest


def calibrate_camera(design: SensorDesign, frames: Path, folder: Path, workers: Workers) -> Calibration:
    """Calibrate a camera from its frames as ``eldata calibrate`` does, and write profile, dark shading and store.

    Where its conversion gain switches is told, as a camera's handbook tells it.
    """
    name = design.name
    modes = [next(iso for iso in design.isos if iso >= design.high_gain_iso)]
    profile, shading, store = folder / f"{name}.json", folder / f"{name}-shading.npz", folder / f"{name}-bias.h5"
    print(f"\n$ eldata calibrate {frames} --camera {name} --mode {modes[0]} -o {profile} --dark-shading {shading}")
    source = CalibrationFrames(frames, name)
    found = calibrate(source, modes=modes, workers=workers)
    print(found.format_text())
    found.profile.save(profile)
    dark_shading(source, found, modes=modes, workers=workers).save(shading)
    print(f"\n$ eldata pack calibration --root {frames.parent} --camera {name} -o {store}")
    build_store(source_of_folder(frames / name), store, workers=workers)
    return found
