"""`eldata demo`: try everything on simulated raw files, without a download.

Photograph procedural scenes with two simulated cameras into real DNG files, verify them, denoise them, score the
results and draw a contact sheet. With --train, train a network on other scenes of these cameras, and score it too: two
minutes on two CPU cores, too short for a good one. With --calibration, take bias and flat-field frames with a camera
whose noise is known, calibrate it from them, and compare with the truth. DIR must be new, empty, or an earlier demo.

    eldata demo
    eldata demo --train
    eldata demo eldata-calibration --calibration
"""

from __future__ import annotations

from eldata.base import console
from eldata.base.workers import Workers
from eldata.errors import ArgumentError


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata demo`."""
    parser.add_argument("folder", metavar="DIR", nargs="?", default="eldata-demo", help="default: %(default)s")
    parser.add_argument("--scenes", type=int, metavar="N", help="scenes per camera (default: 4)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the noise (default: %(default)s)")
    text = "baseline to compare with; bm3d takes minutes (default: dct)"
    parser.add_argument("--beside", choices=("dct", "bm3d", "anscombe-bm3d"), metavar="NAME", help=text)
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--train", action="store_true", help="train a network on other scenes, and score it too")
    instead.add_argument("--calibration", action="store_true", help="calibrate a camera, instead of scenes")
    console.add_shared(parser, run, "jobs")


def run(arguments: console.Arguments) -> int:
    """Run the demo of scoring, or of calibration, in a folder (`eldata demo`)."""
    from pathlib import Path

    folder, seed, workers = Path(arguments.folder), arguments.seed, Workers(arguments.jobs)
    for option in ("beside", "scenes"):
        if arguments.calibration and getattr(arguments, option) is not None:
            raise ArgumentError(f"--{option} is about the demo that scores: leave it out with --calibration")
    if arguments.calibration:
        from eldata.demo.calibration import run_calibration_demo

        run_calibration_demo(folder, seed=seed, workers=workers)
        return console.OK
    from eldata.demo.evaluation import run_demo

    scenes = 4 if arguments.scenes is None else arguments.scenes
    results = run_demo(folder, scenes=scenes, seed=seed, beside=arguments.beside or "dct")
    if arguments.train:
        from eldata.examples.train_on_demo import train_on_demo

        train_on_demo(folder, results, scenes=scenes, seed=seed)
    return console.OK
