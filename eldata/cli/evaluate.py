"""`eldata evaluate`: a folder of predictions in, the paper's table out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.console import OK, PROBLEMS, add_cameras, add_debug, add_jobs, add_json, add_root
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import argparse

    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.video_results import VideoResult


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    from eldata.protocols import PROTOCOLS
    from eldata.video_protocols import VIDEO_PROTOCOLS

    parser = commands.add_parser(
        "evaluate",
        help="score a folder of predictions under a named protocol",
        description=(
            "Score predictions under a named protocol and print the paper's table. The prediction of "
            "CAMERA/scene-1/IMG_0004.ARW is PREDS/CAMERA/scene-1/IMG_0004.EXT with EXT one of npy, npz, h5, tif, "
            "png (16 bit), dng: packed (C, h, w) or mosaic (H, W), float in [0, 1] or uint16 with 65535 = 1.0 (dng: "
            "raw DN). Of clips (drv) it is PREDS/CLIP/FRAME.EXT for five frames of each."
        ),
    )
    parser.add_argument("predictions", metavar="PREDS", help="folder of predictions")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--dataset", metavar="N", help="name of a dataset that eldata knows, such as eld")
    which.add_argument("--manifest", metavar="FILE", help="manifest of a set of your own, in a known layout")
    parser.add_argument(
        "--protocol",
        choices=(*PROTOCOLS, *VIDEO_PROTOCOLS),
        help="how to score (default: the dataset's own, such as eld or sid)",
    )
    parser.add_argument(
        "--subset",
        metavar="NAME",
        help="which of the dataset's named choices of pairs or clips (default: the first on its card)",
    )
    parser.add_argument(
        "--clip",
        action="append",
        dest="clips",
        metavar="ID",
        help="only this clip, in place of a subset; may be repeated",
    )
    parser.add_argument(
        "--exclude",
        action="append",
        default=[],
        dest="exclude_flags",
        metavar="FLAG",
        help="leave out pairs with this flag, such as misaligned; may be repeated; the table says so",
    )
    add_root(parser)
    add_cameras(parser)
    parser.add_argument(
        "--allow-missing",
        action="store_true",
        help="score the rest if predictions are missing; the table says so",
    )
    add_jobs(parser)
    parser.add_argument("--csv", metavar="FILE", help="write the score of each image to FILE")
    add_json(parser)
    add_debug(parser)
    parser.set_defaults(run=run, command="evaluate")


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    result = _of_clips(arguments) if _is_of_clips(arguments) else _of_images(arguments)
    print(result.format_text())
    if arguments.json:
        result.write_json(arguments.json)
    if arguments.csv:
        result.write_csv(arguments.csv)
    return OK if result.scored and not result.problems else PROBLEMS


def _is_of_clips(arguments: argparse.Namespace) -> bool:
    from eldata.manifest.catalogue import load_manifest
    from eldata.video_protocols import default_video_protocol

    name = arguments.dataset if arguments.manifest is None else load_manifest(arguments.manifest).name
    return default_video_protocol(name) is not None


def _of_images(arguments: argparse.Namespace) -> EvaluationResult:
    from eldata.evaluation.evaluate import evaluate

    if arguments.clips:
        raise ArgumentError("--clip is for datasets of clips, such as drv")
    return evaluate(
        arguments.predictions,
        arguments.dataset or "",
        protocol=arguments.protocol,
        root=arguments.root,
        manifest=arguments.manifest,
        cameras=arguments.cameras,
        subset=arguments.subset,
        exclude_flags=arguments.exclude_flags,
        allow_missing=arguments.allow_missing,
        jobs=arguments.jobs,
    )


def _of_clips(arguments: argparse.Namespace) -> VideoResult:
    from eldata.evaluation.video import evaluate_video

    if arguments.cameras or arguments.exclude_flags:
        raise ArgumentError("--camera and --exclude are for datasets of images; choose clips with --subset or --clip")
    return evaluate_video(
        arguments.predictions,
        arguments.dataset or "",
        protocol=arguments.protocol,
        root=arguments.root,
        manifest=arguments.manifest,
        subset=arguments.subset,
        ids=arguments.clips,
        allow_missing=arguments.allow_missing,
        jobs=arguments.jobs,
    )
