"""`eldata evaluate`: a folder of predictions in, the paper's table out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.console import (
    OK,
    PROBLEMS,
    add_cameras,
    add_debug,
    add_json,
    add_root,
    add_workers,
    chosen_workers,
)
from eldata.errors import ArgumentError
from eldata.reports.evaluation.tables import FORMATS

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from eldata.base.workers import Workers
    from eldata.evaluation.combined import CombinedResult
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.video_results import VideoResult


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    from eldata.protocols.named import FAMILIES, PROTOCOLS
    from eldata.protocols.video import VIDEO_PROTOCOLS

    parser = commands.add_parser(
        "evaluate",
        help="score a folder of predictions under a named protocol",
        description=(
            "Score predictions under a named protocol and print the paper's table. The prediction of "
            "CAMERA/scene-1/IMG_0004.ARW is PREDS/CAMERA/scene-1/IMG_0004.EXT with EXT one of npy, npz, h5, tif, "
            "png (16 bit), dng: packed (C, h, w) or mosaic (H, W), float in [0, 1] or uint16 with 65535 = 1.0 (dng: "
            "raw DN). Under a protocol of sRGB it is a rendering: an RGB PNG of 8 or 16 bits. Of clips (drv) it is "
            "PREDS/CLIP/FRAME.EXT for five frames of each."
        ),
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("predictions", metavar="PREDS", nargs="?", help="folder of predictions")
    source.add_argument(
        "--baseline",
        choices=("input",),
        help="in place of PREDS: score the noisy input itself, as the protocol has it",
    )
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--dataset", metavar="N", help="name of a dataset that eldata knows, such as eld")
    which.add_argument("--manifest", metavar="FILE", help="manifest of a set of your own, in a known layout")
    parser.add_argument(
        "--protocol",
        metavar="P",
        help=(
            f"how to score: {', '.join((*PROTOCOLS, *FAMILIES, *VIDEO_PROTOCOLS))}; a TOML file of your own; or all, "
            "those for the dataset in one pass (default: the dataset's own, such as eld or sid). eldata protocols "
            "shows what each fixes"
        ),
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
    add_workers(parser)
    parser.add_argument("--csv", metavar="FILE", help="write the score of each image to FILE")
    parser.add_argument("--format", choices=FORMATS, default="text", help="how to print the table (default: text)")
    parser.add_argument("--html", metavar="FILE", help="write a page with plots, pictures and intervals to FILE")
    add_json(parser)
    parser.add_argument(
        "--compare", action="store_true", help="show the result among the published numbers that compare with it"
    )
    add_debug(parser)
    parser.set_defaults(run=run, command="evaluate")


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    of_clips = _is_of_clips(arguments)
    if of_clips and (arguments.html or arguments.format != "text"):
        raise ArgumentError("--html and --format are for datasets of images")
    with chosen_workers(arguments) as workers:
        result = _of_clips(arguments, workers) if of_clips else _of_images(arguments, workers)
    try:
        _write(result, arguments)
    finally:  # after hours of work the table is shown even if a file cannot be written
        _show(result, arguments)
    return OK if result.scored and not result.problems else PROBLEMS


def _write(result: EvaluationResult | CombinedResult | VideoResult, arguments: argparse.Namespace) -> None:
    from eldata.evaluation.video_results import VideoResult

    if arguments.json:
        result.write_json(arguments.json)
    if arguments.csv:
        result.write_csv(arguments.csv)
    if arguments.html and not isinstance(result, VideoResult):
        _write_page(_each(result), arguments)


def _show(result: EvaluationResult | CombinedResult | VideoResult, arguments: argparse.Namespace) -> None:
    from eldata.evaluation.video_results import VideoResult

    if isinstance(result, VideoResult) or arguments.format == "text" or not result.scored:
        print(result.format_text())
    else:
        from eldata.reports.evaluation.tables import format_evaluations

        for problem in result.problems:
            print(f"eldata evaluate: {problem}", file=sys.stderr)
        print(format_evaluations(_each(result), arguments.format))
    if arguments.compare and result.scored:
        from eldata.evaluation.published_comparison import comparison_table

        for one in (result,) if isinstance(result, VideoResult) else _each(result):
            print(f"\n{comparison_table(one)}")


def _each(result: EvaluationResult | CombinedResult) -> tuple[EvaluationResult, ...]:
    from eldata.evaluation.combined import CombinedResult

    return result.results if isinstance(result, CombinedResult) else (result,)


def _write_page(results: Sequence[EvaluationResult], arguments: argparse.Namespace) -> None:
    from eldata.manifest.catalogue import load_manifest, shipped_manifest
    from eldata.reports.evaluation.page import write_evaluation_page

    manifest = load_manifest(arguments.manifest) if arguments.manifest else shipped_manifest(arguments.dataset)
    predictions = Path(arguments.predictions) if arguments.predictions else None
    folder = manifest.folder(arguments.root)
    write_evaluation_page(results, arguments.html, dataset_folder=folder, predictions=predictions)


def _is_of_clips(arguments: argparse.Namespace) -> bool:
    from eldata.manifest.catalogue import load_manifest
    from eldata.protocols.video import default_video_protocol

    name = arguments.dataset if arguments.manifest is None else load_manifest(arguments.manifest).name
    return default_video_protocol(name) is not None


def _of_images(arguments: argparse.Namespace, workers: Workers) -> EvaluationResult | CombinedResult:
    from eldata.evaluation.evaluate import ALL, evaluate, evaluate_all

    if arguments.clips:
        raise ArgumentError("--clip is for datasets of clips, such as drv")
    if arguments.protocol == ALL:
        if arguments.subset is not None:
            raise ArgumentError("--protocol all scores each protocol's own pairs; leave --subset out")
        return evaluate_all(
            arguments.predictions,
            arguments.dataset or "",
            root=arguments.root,
            manifest=arguments.manifest,
            cameras=arguments.cameras,
            exclude_flags=arguments.exclude_flags,
            allow_missing=arguments.allow_missing,
            baseline=arguments.baseline,
            workers=workers,
        )
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
        baseline=arguments.baseline,
        workers=workers,
    )


def _of_clips(arguments: argparse.Namespace, workers: Workers) -> VideoResult:
    from eldata.evaluation.video import evaluate_video

    if arguments.cameras or arguments.exclude_flags:
        raise ArgumentError("--camera and --exclude are for datasets of images; choose clips with --subset or --clip")
    if arguments.baseline:
        raise ArgumentError("--baseline is for datasets of images")
    return evaluate_video(
        arguments.predictions,
        arguments.dataset or "",
        protocol=arguments.protocol,
        root=arguments.root,
        manifest=arguments.manifest,
        subset=arguments.subset,
        ids=arguments.clips,
        allow_missing=arguments.allow_missing,
        workers=workers,
    )
