"""What `eldata demo --train` adds: a training of ``eldata.examples.train_denoiser`` on scenes that are not scored."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from eldata.baselines import load_network, write_predictions
from eldata.demo.evaluation import INPUT, score_method
from eldata.demo.tree import make_clean
from eldata.errors import EldataError
from eldata.examples.train_denoiser import parser, run

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from eldata.evaluation import EvaluationResult

TRAINED = "trained"
_SCENES = 16  # four variations of each of the demo's still lifes
# A network and steps for two minutes on two CPU cores; noise of the gains and factors that the demo scores.
_SMALL = (
    *("--iso", "800", "1600", "3200", "--ratio", "100", "200", "--crop", "64", "--crops-per-frame", "4"),
    *("--batch-size", "8", "--width", "12", "--depth", "2", "--learning-rate", "3e-3", "--workers", "0"),
)


def train_on_demo(
    folder: Path, results: Mapping[str, EvaluationResult], *, scenes: int, seed: int = 0, epochs: int = 20
) -> EvaluationResult:
    """Train a network on a demo's cameras and other scenes, score it like the others, and print what happens.

    Parameters
    ----------
    folder
        Of a demo that has just run.
    results
        What it returned.
    scenes
        How many it has scored: those that are trained on have the numbers after theirs.
    seed
        Of the noise of the clean frames, and of the training.
    epochs
        Of the training.

    Raises
    ------
    EldataError
        If the network cannot be run over the demo's files.
    """
    first, last = scenes + 1, scenes + _SCENES
    clean = make_clean(folder, range(first, last + 1), seed=seed)
    print(f"\nScored: scenes 1 to {scenes}. To train on: references of scenes {first} to {last}, which nothing scores:")
    print("the same kinds of still life, in another layout, light and colours.")
    manifest, root, made = folder / "manifests" / "eld-demo.csv", folder / "data", folder / TRAINED
    command = ["--clean", str(clean), "--camera", *map(str, sorted((folder / "profiles").glob("*.json"))), *_SMALL]
    command += ["--epochs", str(epochs), "--seed", str(seed), "--device", "cpu", "-o", str(made)]
    command += ["--validate", str(manifest), "--root", str(root), "--validate-every", str(epochs)]
    print("$", shlex.join(["python", "-m", "eldata.examples.train_denoiser", *command]))
    run(parser().parse_args(command))

    predictions = made / "predictions"  # as the training's last lines have it
    report = write_predictions(
        load_network(str(made / "model.pt2"), device="cpu"), "", predictions, manifest=manifest, root=root
    )
    print(report.format_text())
    if report.problems:
        raise EldataError("the trained network could not be run over the demo's files")
    what, told = f"the network that scenes {first} to {last} have trained", results[INPUT].notes
    trained = score_method(folder, TRAINED, what, predictions, told)
    for name, result in (*results.items(), (TRAINED, trained)):
        print(f"{name:<10} {result.psnr_db:6.2f} dB  SSIM {result.ssim:.3f}")
    gain_db = trained.psnr_db - results[INPUT].psnr_db
    side = "above" if gain_db > 0 else "below"
    print(f"{TRAINED}: {abs(gain_db):.2f} dB {side} the {INPUT} input. Two minutes are too short for a good network.")
    return trained
