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

from dataclasses import replace

from eldata.base import console
from eldata.base.workers import Workers
from eldata.errors import ArgumentError

# Fields of eldata.demo.body.FixedFeatures.
_FEATURES = {
    "shading": ("bias_shading_dn", "vignetting"),
    "hot-pixels": ("hot_share",),
    "fixed-pattern": ("prnu", "dsnu_dn", "column_pattern_dn"),
}


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
    text = f"with --calibration: a camera without this ({', '.join(_FEATURES)}); may be repeated"
    features = tuple(_FEATURES)
    parser.add_argument("--without", action="append", choices=features, default=[], metavar="FEATURE", help=text)
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
        from eldata.demo.calibration_frames import DEMO_FEATURES

        off = {field: 0.0 for feature in arguments.without for field in _FEATURES[feature]}
        run_calibration_demo(folder, seed=seed, features=replace(DEMO_FEATURES, **off), workers=workers)
        return console.OK
    if arguments.without:
        raise ArgumentError("--without is about calibration frames: give --calibration too")
    from eldata.demo.evaluation import run_demo

    scenes = 4 if arguments.scenes is None else arguments.scenes
    results = run_demo(folder, scenes=scenes, seed=seed, beside=arguments.beside or "dct")
    if arguments.train:
        from eldata.examples.train_on_demo import train_on_demo

        train_on_demo(folder, results, scenes=scenes, seed=seed)
    return console.OK
