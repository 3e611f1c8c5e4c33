"""`eldata manifest`: list raws of your own: a manifest and a card from EXIF.

Make the manifest (CSV) and the card (JSON) of a folder of your own raws, by their EXIF. A scene is a
folder; its reference is what was exposed most at the lowest ISO, the others are noisy frames of it. What cannot be told
is asked, and nothing is written. Frames in folders called bias and flat are calibration frames.

    eldata manifest data/MINE -o mine.csv
    eldata manifest data/MINE -o mine.csv --reference 'long/*' --scene '*/{scene}_*'
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.console import add_output
from eldata.base.numbers import counted
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from eldata.manifest.own import OwnSet


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata manifest`."""
    parser.add_argument("folder", metavar="FOLDER", help="the set's own folder, in the folder that holds the datasets")
    text = "the new manifest, such as mine.csv; its card becomes mine.json"
    add_output(parser, "-o", "--output", beside=[".json"], required=True, metavar="CSV", help=text)
    parser.add_argument(
        "--reference",
        metavar="PATTERN",
        help="the references' paths below FOLDER, such as '*/clean.dng' or 'long/*', instead of what EXIF says",
    )
    parser.add_argument(
        "--scene",
        metavar="PATTERN",
        help="where a scene's name stands in all paths, such as '*/{scene}_*' (default: a scene is a folder)",
    )
    console.add_shared(parser, run, "workers", json=True)


def run(arguments: console.Arguments) -> int:
    """Write a manifest and a card of a user's raws (`eldata manifest`)."""
    from eldata.manifest.catalogue import refuse_others, save_manifest
    from eldata.manifest.own import sort_own_set

    output, folder = Path(arguments.output), Path(arguments.folder).absolute()
    if output.suffix != ".csv":
        raise ArgumentError(f"-o takes a name that ends in .csv, found {arguments.output}")
    with console.chosen_workers(arguments) as workers:
        own = sort_own_set(folder, output.stem, reference=arguments.reference, scene=arguments.scene, workers=workers)
    if not own.problems:
        refuse_others(output, own.card, own.records, "remove it")
        save_manifest(output, own.card, own.records)
    data = {
        "card": asdict(own.card),
        "frames": len(own.records),
        "problems": [asdict(problem) for problem in own.problems],
        "left_out": dict(own.left_out),
    }
    console.show_and_write(arguments, lambda: _format_own_set(own, output, folder), lambda: data)
    return console.PROBLEMS if own.problems else console.OK


def _format_own_set(own: OwnSet, output: Path, folder: Path) -> str:
    """List the problems of a user's set or, without any, its files and the next commands."""
    if own.problems:
        lines = [problem.format_text() for problem in own.problems]
        return "\n".join([*lines, f"{counted(len(lines), 'problem')}: nothing was written"])
    place = f"{output} --root {folder.parent}"
    lines = [
        own.format_text(),
        f"manifest: {output}, {counted(len(own.records), 'frame')}",
        f"card: {output.with_suffix('.json')}; fill in its licence and homepage before you give the set to others",
        f"to check: eldata verify {place} --level metadata",
        f"to score: eldata evaluate PREDS --manifest {place}",
    ]
    return "\n".join(lines)
