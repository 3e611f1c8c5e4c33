"""`eldata evaluate`: score predictions under a named protocol.

Save one prediction per noisy frame: for CAMERA/scene-1/IMG_0004.ARW, PREDS/CAMERA/scene-1/IMG_0004.npy (or npz, h5,
tif, 16-bit png, dng), packed (C, h, w) or mosaic (H, W), float in [0, 1] or uint16. docs/evaluation.md has sRGB, clips,
and several methods in one pass.

    eldata evaluate preds --dataset eld --root data --html page.html
    eldata evaluate preds/bm3d preds/ours --manifest mine.csv -o results
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.base import console
from eldata.base.files import refuse_among
from eldata.base.tables import FORMATS, Format
from eldata.cli.baseline import add_pairs, add_set
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Collection

    from eldata.base.workers import Workers
    from eldata.evaluation.comparison import Comparison
    from eldata.evaluation.request import Request
    from eldata.evaluation.results import EvaluationResult


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata evaluate`."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("predictions", metavar="PREDS", nargs="*", default=[], help="folder of a method's predictions")
    source.add_argument("--baseline", choices=("input",), help="instead of PREDS: score the noisy input itself")
    add_set(parser)
    text = "name in eldata protocols, or a TOML file (default: the set's own; raw for your own set)"
    parser.add_argument("--protocol", metavar="P", help=text)
    console.add_cameras(parser)
    console.add_output(parser, "--csv", help="write each image's score; -: to standard output")
    console.add_output(parser, "--html", help="write a page with plots and pictures to FILE")
    rare = parser.add_argument_group("less common options")
    add_pairs(rare)
    text = "leave out pairs with this flag; may be repeated"
    rare.add_argument("--exclude", action="append", default=[], dest="exclude_flags", metavar="FLAG", help=text)
    text = "score by this function of (prediction, reference), too"
    rare.add_argument("--task", metavar="MODULE:NAME", help=text)
    rare.add_argument("--dark-shading", metavar="FILE", help="dark shading subtracted from the inputs")
    rare.add_argument("--allow-missing", action="store_true", help="score the rest if files are missing")
    rare.add_argument("--strict", action="store_true", help="refuse predictions that show a mistake")
    text = "exit with 0 although predictions show a mistake"
    rare.add_argument("--allow-suspect", action="store_true", help=text)
    rare.add_argument("--format", choices=FORMATS, default="text", help="how to print the table (default: text)")
    text = "write JSON, CSV and the methods' comparison here"
    rare.add_argument("-o", "--output", metavar="FOLDER", help=text)
    text = "a method's name; once per folder, in their order"
    rare.add_argument("--name", action="append", default=[], dest="names", metavar="NAME", help=text)
    rare.add_argument("--compare", action="store_true", help="show published numbers beside the result")
    console.add_shared(parser, run, "root", "workers", json=True)


def run(arguments: console.Arguments) -> int:
    """Score predictions, and print or write the results (`eldata evaluate`)."""
    from eldata.evaluation.evaluate import perform_each
    from eldata.evaluation.request import make_request

    if len(arguments.predictions) > 1 or arguments.output or arguments.names:
        return _run_several(arguments)
    predictions = next(iter(arguments.predictions), None)
    with console.chosen_workers(arguments) as workers:
        request = make_request(predictions, **_take_options(arguments, workers))
        outputs = filter(None, (getattr(arguments, name) for name in arguments.outputs))
        _check_places(request, *(Path(output).parent for output in outputs))
        result = perform_each([request])[0]

        def write_page() -> None:
            from eldata.reports.evaluation import write_evaluation_page

            write_evaluation_page(
                result,
                arguments.html,
                dataset_folder=request.files,
                predictions=request.predictions,
                dark_shading=request.dark_shading,
            )

        console.each_of(
            arguments.json and (lambda: result.write_json(arguments.json)),
            arguments.csv and (lambda: result.write_csv(arguments.csv)),
            lambda: _show_result(result, arguments),
            arguments.html and write_page,  # last, because it takes longest
        )
    return _find_code([result], arguments)


def _find_code(results: Collection[EvaluationResult], arguments: console.Arguments) -> int:
    """Find the exit code: 1 for what has no scores, has problems, or is suspect."""
    if any(not result.scored or result.problems for result in results):
        return console.PROBLEMS
    if arguments.allow_suspect or not any(result.suspicions for result in results):
        return console.OK
    print("eldata evaluate: SUSPECT predictions; if they are right, --allow-suspect makes this exit 0", file=sys.stderr)
    return console.PROBLEMS


def _check_places(request: Request, *folders: Path) -> None:
    """Refuse to write among the set's own files."""
    for folder in folders:
        refuse_among(folder, request.folder, (record.path for record in request.manifest.records))


def _take_options(arguments: console.Arguments, workers: Workers) -> dict[str, Any]:
    """Take the options of scoring as keyword arguments."""
    names = (
        "protocol", "root", "manifest", "cameras", "subset", "ids", "exclude_flags",
        "allow_missing", "baseline", "strict", "task", "dark_shading",
    )  # fmt: skip
    return console.chosen(arguments, names) | {"dataset": arguments.dataset or "", "workers": workers}


def _run_several(arguments: console.Arguments) -> int:
    """Score several folders, or one whose results go to a folder."""
    from eldata.evaluation.comparison import format_comparison
    from eldata.evaluation.evaluate import (
        COMPARISON,
        compare_methods,
        make_results_folder,
        name_folders,
        perform_each,
        write_results,
    )
    from eldata.evaluation.predictions import check_folder
    from eldata.evaluation.request import make_request

    if arguments.baseline is not None:
        raise ArgumentError("-o and --name are for folders of predictions; of --baseline give --json FILE, --csv FILE")
    unfit = next((name for name in ("json", "csv", "html") if getattr(arguments, name)), None)
    if unfit is not None:
        raise ArgumentError(
            f"--{unfit} writes the result of one method; of several, and with -o or --name, give -o FOLDER alone: it "
            "gets NAME.json and NAME.csv of each, and their comparison"
        )
    folders = name_folders([Path(name) for name in arguments.predictions], arguments.names)
    out = None if arguments.output is None else Path(arguments.output)
    with console.chosen_workers(arguments) as workers:
        options = _take_options(arguments, workers)
        requests = [make_request(folder, **options) for folder in folders.values()]
        for folder in folders.values():
            check_folder(folder)
        if out is not None:
            _check_places(requests[0], out)
            make_results_folder(out, folders)
        results = dict(zip(folders, perform_each(requests), strict=True))
    comparison, why_not = compare_methods(results)

    def show() -> None:
        """Print every result, and the comparison or why there is none."""
        heading = {"text": "{}:\n", "markdown": "## {}\n", "latex": "% {}"}[arguments.format]
        for name, result in results.items():
            print(heading.format(name))
            _show_result(result, arguments)
            print()
        if comparison is not None:
            for warning in comparison.warnings:
                print(f"eldata evaluate: warning: {' '.join(warning.split())}", file=sys.stderr)
            print(format_comparison(comparison, arguments.format))
        elif why_not:
            print(f"eldata evaluate: {why_not}", file=sys.stderr)

    def write_page() -> None:
        from eldata.reports.comparison import write_comparison_page

        if comparison is not None and out is not None:
            write_comparison_page(comparison, out / f"{COMPARISON}.html")

    def print_next_command() -> None:
        if comparison is not None and out is not None and arguments.format == "text":
            command = _make_pictures_command(comparison, arguments)
            print(f"\nwritten: {out}\nto see every image beside each other: {command}")

    console.each_of(
        None if out is None else lambda: write_results(out, results, comparison), show, write_page, print_next_command
    )
    return _find_code(results.values(), arguments)


def _make_pictures_command(comparison: Comparison, arguments: console.Arguments) -> str:
    """Make the command that draws a comparison's images."""
    out = Path(arguments.output)
    options = {name: getattr(arguments, name) for name in ("manifest", "root", "dark_shading")}
    return " ".join(
        [
            "eldata compare",
            *(shlex.quote(str(out / f"{name}.json")) for name in comparison.names),
            *(f"--{name.replace('_', '-')} {shlex.quote(value)}" for name, value in options.items() if value),
            f"--html {shlex.quote(str(out / 'pictures.html'))} --pictures",
        ]
    )


def _show_result(result: EvaluationResult, arguments: console.Arguments) -> None:
    """Print a result, its problems and, with ``--compare``, published scores."""
    from eldata.evaluation.scores import problem_lines

    form: Format = arguments.format if result.scored else "text"
    if form != "text":
        for line in problem_lines(result.problems):
            print(f"eldata evaluate: {line}", file=sys.stderr)
    print(result.format(form))
    if arguments.compare and result.scored:
        from eldata.evaluation.published import comparison_table

        print(f"\n{comparison_table(result)}")
