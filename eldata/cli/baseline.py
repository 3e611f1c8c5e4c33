"""`eldata baseline`: denoise a dataset without a network of yours, for the other rows of a table.

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
    """Add its options."""
    parser.add_argument("name", metavar="NAME", choices=NAMES, help=", ".join(NAMES))
    add_choice(parser)
    parser.add_argument(
        "--profile",
        action="append",
        default=[],
        dest="profiles",
        metavar="P",
        help="the camera's noise: a shipped profile (SonyA7S2) or a JSON file; once for each camera. Without it the "
        "noise is estimated from each frame",
    )
    parser.add_argument(
        "--noise",
        choices=("chen2015",),
        help="with bm3d and no profile: one noise level for each frame, by the estimator that the paper names",
    )
    add_another_camera(parser, "frames of cameras that have none of their own")
    kept = "{output} keeps the finished predictions, and the same command goes on"
    console.add_shared(parser, run, "root", "workers", interrupted=kept)


def add_another_camera(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``--profile-of-another-camera``, without which a profile is for frames of its own camera alone."""
    parser.add_argument(
        "--profile-of-another-camera",
        action="store_true",
        help=f"take the profile for {what}, whose noise is another; what is written says so",
    )


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add which set, by name or manifest."""
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--dataset", metavar="N", help="name of a dataset that eldata knows, such as eld")
    which.add_argument("--manifest", metavar="FILE", help="manifest of a set of your own, in a known layout")


def add_pairs(parser: argparse.ArgumentParser) -> None:
    """Add which of a set's pairs or clips."""
    parser.add_argument(
        "--subset",
        metavar="NAME",
        help="which of the dataset's named choices of pairs or clips (default: the first on its card)",
    )
    parser.add_argument(
        "--clip",
        action="append",
        dest="ids",
        metavar="ID",
        help="only this clip, in place of a subset; may be repeated",
    )


def add_part(parser: argparse.ArgumentParser) -> None:
    """Add which of a set's rows: by split and subset."""
    parser.add_argument("--split", action="append", metavar="S", help="only this split; may be repeated")
    parser.add_argument("--subset", metavar="NAME", help="only this subset of the dataset card")


def add_excluded(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Add which pairs are left out; ``more`` goes on after what it does."""
    parser.add_argument(
        "--exclude",
        action="append",
        default=[],
        dest="exclude_flags",
        metavar="FLAG",
        help=f"leave out pairs with this flag{more}",
    )


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add what predictions are made of, where they go, and in which form."""
    add_set(parser)
    parser.add_argument("-o", "--output", metavar="PREDS", required=True, help="a new folder for the predictions")
    parser.add_argument(
        "--protocol",
        metavar="P",
        help="whose pairs, levels and amplification to take (default: the dataset's own, such as eld or sid)",
    )
    add_pairs(parser)
    parser.add_argument(
        "--dark-shading",
        metavar="FILE",
        help="take this dark shading (eldata calibrate --dark-shading) off the inputs; give it to eldata evaluate, too",
    )
    console.add_cameras(parser)
    parser.add_argument(
        "--dtype",
        choices=("float32", "float16", "uint16"),
        default="float32",
        help="of the files; uint16 (65535 = 1.0) takes half of the space (default: %(default)s)",
    )


def chosen_options(arguments: console.Arguments) -> dict[str, Any]:
    """Return what :func:`add_choice` has added, as keyword arguments."""
    names = ("manifest", "root", "cameras", "subset", "ids", "protocol", "dtype", "dark_shading")
    return console.chosen(arguments, names)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.baselines.predicting import BaselineDenoiser, write_predictions
    from eldata.noise.profile import CameraProfile

    profiles = tuple(CameraProfile.load(name) for name in arguments.profiles)
    denoiser = BaselineDenoiser(arguments.name, profiles, arguments.profile_of_another_camera, arguments.noise)
    with console.chosen_workers(arguments) as workers:
        report = write_predictions(
            denoiser, arguments.dataset or "", arguments.output, workers=workers, **chosen_options(arguments)
        )
    return show_report(report, arguments)


def show_report(report: PredictionReport, arguments: console.Arguments) -> int:
    """Show what was predicted, and the command that scores it if there is anything; return the exit code."""
    print(report.format_text())
    if report.written or report.kept:
        print(_scoring_line(arguments))
    return console.PROBLEMS if report.problems else console.OK


def _scoring_line(arguments: console.Arguments) -> str:
    """Return the command that scores what was written."""
    given = ("dataset", "manifest", "protocol", "subset", "root", "dark_shading")
    options = [
        f"--{name.replace('_', '-')} {shlex.quote(value)}" for name in given if (value := getattr(arguments, name))
    ]
    cameras = [f"--camera {shlex.quote(camera)}" for camera in arguments.cameras or ()]
    clips = [f"--clip {shlex.quote(clip)}" for clip in arguments.ids or ()]
    return " ".join(["to score: eldata evaluate", shlex.quote(arguments.output), *options, *cameras, *clips])
