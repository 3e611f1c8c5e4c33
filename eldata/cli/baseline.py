"""`eldata baseline`: denoise a dataset by DCT, BM3D or the network that ships.

Denoise each noisy frame that a protocol scores by a method without training, or by the network that ships, and write
the predictions that eldata evaluate reads. input is the amplified frame itself; dct, sliding-window thresholding; bm3d
takes one noise level for a frame, anscombe-bm3d stabilises the variance first. Both need the bm3d package, which its
authors allow for non-commercial use only. network was trained for all cameras and is told the noise. Predictions that
are there are kept, so that interrupted work goes on.

    eldata baseline anscombe-bm3d --dataset eld --root data -o preds/bm3d
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from eldata.base import console

if TYPE_CHECKING:
    import argparse

    from eldata.baselines.predicting import PredictionReport

NAMES = ("input", "dct", "bm3d", "anscombe-bm3d", "network")


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata baseline`."""
    parser.add_argument("name", metavar="NAME", choices=NAMES, help=", ".join(NAMES))
    add_choice(parser)
    text = "profile of the camera's noise, by name or file; once per camera (default: estimated from each frame)"
    parser.add_argument("--profile", action="append", default=[], dest="profiles", metavar="P", help=text)
    text = "take the profile for frames of cameras that have none of their own; what is written says so"
    parser.add_argument("--profile-of-another-camera", action="store_true", help=text)
    kept = "{output} keeps the finished predictions, and the same command goes on"
    console.add_shared(parser, run, "root", "workers", interrupted=kept)


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a set, by name or manifest."""
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--dataset", metavar="N", help="name in eldata info, such as eld, or a manifest")
    which.add_argument("--manifest", metavar="FILE", help="manifest of a set of your own")


def add_pairs(parser: argparse._ActionsContainer) -> None:
    """Add the options that choose pairs or clips of a set."""
    parser.add_argument("--subset", metavar="NAME", help="subset on the set's card (default: the first)")
    parser.add_argument("--clip", action="append", dest="ids", metavar="ID", help="only this clip; may be repeated")


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options for the input, place and form of predictions."""
    add_set(parser)
    parser.add_argument("-o", "--output", metavar="PREDS", required=True, help="a new folder for the predictions")
    text = "pairs, levels and amplification as this protocol has them (default: the set's own)"
    parser.add_argument("--protocol", metavar="P", help=text)
    add_pairs(parser)
    text = "dark shading to subtract from the inputs; give it to eldata evaluate, too"
    parser.add_argument("--dark-shading", metavar="FILE", help=text)
    console.add_cameras(parser)
    text = "of the files; uint16 (65535 = 1.0) takes half of the space (default: %(default)s)"
    parser.add_argument("--dtype", choices=("float32", "float16", "uint16"), default="float32", help=text)


def chosen_options(arguments: console.Arguments) -> dict[str, Any]:
    """Take what :func:`add_choice` has added as keyword arguments."""
    names = ("manifest", "root", "cameras", "subset", "ids", "protocol", "dtype", "dark_shading")
    return console.chosen(arguments, names)


def run(arguments: console.Arguments) -> int:
    """Predict a set with a baseline (`eldata baseline`)."""
    from eldata.baselines.predicting import BaselineDenoiser, write_predictions
    from eldata.noise.profile import CameraProfile

    profiles = tuple(CameraProfile.load(name) for name in arguments.profiles)
    denoiser = BaselineDenoiser(arguments.name, profiles, arguments.profile_of_another_camera)
    with console.chosen_workers(arguments) as workers:
        report = write_predictions(
            denoiser, arguments.dataset or "", arguments.output, workers=workers, **chosen_options(arguments)
        )
    return show_report(report, arguments)


def show_report(report: PredictionReport, arguments: console.Arguments) -> int:
    """Show the predictions made, and the command that scores them, if any; return the exit code."""
    print(report.format_text())
    if report.written or report.kept:
        print(_make_scoring_line(arguments))
    return console.PROBLEMS if report.problems else console.OK


def _make_scoring_line(arguments: console.Arguments) -> str:
    """Make the command that scores the written predictions."""
    names = ("dataset", "manifest", "protocol", "subset", "root", "dark_shading")
    options = [
        f"--{name.replace('_', '-')} {shlex.quote(value)}" for name in names if (value := getattr(arguments, name))
    ]
    cameras = [f"--camera {shlex.quote(camera)}" for camera in arguments.cameras or ()]
    clips = [f"--clip {shlex.quote(clip)}" for clip in arguments.ids or ()]
    return " ".join(["to score: eldata evaluate", shlex.quote(arguments.output), *options, *cameras, *clips])
