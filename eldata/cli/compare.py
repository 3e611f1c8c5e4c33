"""`eldata compare`: compare results of several methods on their common images.

Compare results that eldata evaluate --json wrote, all with the first: means by camera and factor over the images that
all have scored, and differences with intervals over scenes. Warnings name differing protocols, subsets and manifests.

    eldata compare first.json second.json --name first --name second --html compare.html
    eldata compare first.json second.json --html compare.html --pictures --root data
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.tables import FORMATS
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from eldata.evaluation.comparison import Comparison
    from eldata.evaluation.looking import ScoredImage


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata compare`."""
    text = "JSON of eldata evaluate; the first is the baseline"
    parser.add_argument("results", nargs="+", metavar="RESULT", help=text)
    text = "name of a method; once per file, in their order (default: the file's name)"
    parser.add_argument("--name", action="append", default=[], dest="names", metavar="NAME", help=text)
    parser.add_argument("--format", choices=FORMATS, default="text", help="how to print the tables (default: text)")
    console.add_output(parser, "--html", help="write a page with plots and the biggest differences to FILE")
    text = (
        "with --html: draw every common image into the folder FILE-pictures: the part in which the "
        "methods differ most, or all of it; needs the raw files and the predictions"
    )
    parser.add_argument("--pictures", choices=("parts", "whole"), nargs="?", const="parts", help=text)
    text = "with --pictures: manifest of a set of your own that the results are of"
    parser.add_argument("--manifest", metavar="M", help=text)
    text = "with --pictures: a method's predictions, once per file, in their order (default: as each result says)"
    parser.add_argument("--predictions", action="append", default=[], metavar="FOLDER", help=text)
    text = "with --pictures: the dark shading that the results state, if any"
    parser.add_argument("--dark-shading", metavar="FILE", help=text)
    console.add_shared(parser, run, "root", "jobs", json=True)


def run(arguments: console.Arguments) -> int:
    """Compare results of several methods, and write the page if asked for (`eldata compare`)."""
    from eldata.evaluation.comparison import compare, format_comparison
    from eldata.evaluation.results import load_result

    if arguments.pictures and not arguments.html:
        raise ArgumentError("--pictures are of a page: say where to write it with --html FILE")
    paths = [Path(name) for name in arguments.results]
    names = arguments.names or [path.stem for path in paths]
    if len(names) != len(paths):
        raise ArgumentError(f"expected one --name per file, or none; found {len(names)} for {len(paths)} files")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ArgumentError(f"two results are called {twice!r}; name each with --name, in the order of the files")
    comparison = compare({name: load_result(path) for name, path in zip(names, paths, strict=True)})

    def format_text() -> str:
        for warning in comparison.warnings:
            print(f"eldata compare: warning: {' '.join(warning.split())}", file=sys.stderr)
        return format_comparison(comparison, arguments.format)

    images = _list_images(comparison, arguments) if arguments.pictures else ()

    def write_page() -> None:
        from eldata.base.workers import Workers
        from eldata.reports.comparison import write_comparison_page

        write_comparison_page(
            comparison,
            arguments.html,
            images=images,
            whole=arguments.pictures == "whole",
            workers=Workers(arguments.jobs),
        )
        print(f"written: {arguments.html}")

    console.show_and_write(arguments, format_text, comparison.as_dict, arguments.html and write_page)
    return console.OK


def _list_images(comparison: Comparison, arguments: console.Arguments) -> tuple[ScoredImage, ...]:
    """List the images to decode for the pictures, from what the results state of their data."""
    from eldata.evaluation.looking import images_of, stated_predictions, units_again

    named: list[Path | None] = [Path(name) for name in arguments.predictions]
    folders = named or [stated_predictions(result) for result in comparison.results.values()]
    folder, units = units_again(
        comparison.first,
        manifest=arguments.manifest and Path(arguments.manifest),
        root=arguments.root and Path(arguments.root),
    )
    return images_of(
        list(comparison.results.values()),
        comparison.images,
        dataset_folder=folder,
        predictions=folders,
        dark_shading=arguments.dark_shading and Path(arguments.dark_shading).absolute(),
        units=units,
    )
