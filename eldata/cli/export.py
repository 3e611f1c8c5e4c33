"""`eldata export`: a set as the code of LED, PMN, ELD or SID reads it, or with its card for the Hugging Face Hub.

Write what the published code of a repository reads of a set, your own included: links to its files under the names from
which that code takes scene and ratio, and its lists of pairs; for PMN, infos. Or, as hub, a folder that the package
datasets reads and that can be uploaded as it is: dataset card, manifest and Croissant with the pixels as shards, or,
where no licence lets these be passed on, references alone. Links are no copies, and nothing that is there is
overwritten.

    eldata export led datasets/ELD --dataset eld --root data --camera SonyA7S2
    eldata export eld for-eld --manifest my-set.csv --root data
    eldata export hub for-the-hub --manifest my-set.csv --shards shards/train --shards shards/test
"""

from __future__ import annotations

from eldata.base import console
from eldata.cli.baseline import add_excluded, add_part
from eldata.errors import ArgumentError

_CHOICE = ("manifest", "link", "cameras", "split", "subset", "exclude_flags")


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    codes = ("led", "pmn", "eld", "sid", "hub")
    parser.add_argument("code", metavar="CODE", choices=codes, help="led, pmn, eld, sid or hub")
    parser.add_argument("folder", metavar="FOLDER", help="where to write")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--dataset", metavar="N", help="name of a dataset that eldata knows, such as eld")
    which.add_argument("--manifest", metavar="FILE", help="manifest of a set of your own")
    parser.add_argument(
        "--shards",
        action="append",
        default=[],
        metavar="DIR",
        help="for hub: shards of one split of the set, from eldata shard --split; may be repeated",
    )
    parser.add_argument(
        "--link",
        choices=("symbolic", "hard", "copy"),
        default="symbolic",
        help="how files get their names (default: %(default)s)",
    )
    add_part(parser)
    add_excluded(parser, "; may be repeated")
    kept = "the links that were made are kept, the lists come last, and the same command goes on"
    console.add_shared(parser, run, "root", "cameras", "workers", interrupted=kept)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.integrations.exports import export, export_hub

    if arguments.code == "hub":
        report = export_hub(
            arguments.folder,
            arguments.dataset or "",
            **console.chosen(arguments, (*_CHOICE, "shards")),
        )
        print(report.format_text())
        return console.OK
    if arguments.shards:
        raise ArgumentError(f"--shards is for hub: the code of {arguments.code} reads the set's own files")
    with console.chosen_workers(arguments) as workers:
        report = export(
            arguments.code,
            arguments.folder,
            arguments.dataset or "",
            workers=workers,
            **console.chosen(arguments, (*_CHOICE, "root")),
        )
    print(report.format_text())
    return console.OK
