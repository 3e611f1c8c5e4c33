"""`eldata evaluate`: a folder of predictions in, the paper's table out."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, cast

from eldata.base.console import (
    OK,
    PROBLEMS,
    add_cameras,
    add_json,
    add_output,
    add_root,
    add_shared,
    add_workers,
    chosen_workers,
    each_of,
)
from eldata.base.tables import FORMATS

if TYPE_CHECKING:
    import argparse

    from eldata.base.tables import Format
    from eldata.evaluation.combined import CombinedResult
    from eldata.evaluation.results import EvaluationResult


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    from eldata.protocols.named import FAMILIES, PROTOCOLS

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
            f"how to score: {', '.join((*PROTOCOLS, *FAMILIES))}; a TOML file of your own; or all, "
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
        dest="ids",
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
    parser.add_argument(
        "--lpips",
        metavar="FOLDER",
        help=(
            "add LPIPS, under a protocol of sRGB such as sid2018, with the weights in FOLDER; nothing is downloaded: "
            "docs/metrics.md says where they are"
        ),
    )
    add_root(parser)
    add_cameras(parser)
    parser.add_argument(
        "--allow-missing",
        action="store_true",
        help="score the rest if predictions are missing; the table says so",
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        help="refuse predictions that show a mistake, such as channels in another order, a shift, or a wrong level; "
        "without it, a line says so",
    )
    add_workers(parser)
    add_output(parser, "--csv", help="write the score of each image to FILE")
    parser.add_argument("--format", choices=FORMATS, default="text", help="how to print the table (default: text)")
    add_output(parser, "--html", help="write a page with plots, pictures and intervals to FILE")
    add_json(parser)
    parser.add_argument(
        "--compare", action="store_true", help="show the result among the published numbers that compare with it"
    )
    add_shared(parser, run, "isolation")


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from eldata.evaluation.evaluate import perform
    from eldata.evaluation.request import EvaluationOptions, make_request

    with chosen_workers(arguments) as workers:
        options = {name: getattr(arguments, name) for name in EvaluationOptions.__annotations__ if name != "workers"}
        options["workers"] = workers
        request = make_request(
            arguments.predictions, arguments.dataset or "", arguments.protocol, cast("EvaluationOptions", options)
        )
        combined = perform(request)
    result = combined if request.every else combined.results[0]

    def write_page() -> None:
        from eldata.reports.evaluation.page import write_evaluation_page

        write_evaluation_page(
            combined.results, arguments.html, dataset_folder=request.folder, predictions=request.predictions
        )

    each_of(
        arguments.json and (lambda: result.write_json(arguments.json)),
        arguments.csv and (lambda: result.write_csv(arguments.csv)),
        lambda: _show(result, combined, arguments),
        arguments.html and write_page,  # last, because it takes longest
    )
    return OK if result.scored and not result.problems else PROBLEMS


def _show(result: EvaluationResult | CombinedResult, combined: CombinedResult, arguments: argparse.Namespace) -> None:
    from eldata.evaluation.results import problem_lines

    form: Format = arguments.format if result.scored else "text"
    if form != "text":
        for line in problem_lines(result.problems):
            print(f"eldata evaluate: {line}", file=sys.stderr)
    print(result.format(form))
    if arguments.compare and result.scored:
        from eldata.evaluation.published_comparison import comparison_table

        for one, *others in combined.groups:
            print(f"\n{comparison_table(one)}")
            if others:
                print(f"\nThe same holds for {', '.join(other.protocol.name for other in others)}: the same scores.")
