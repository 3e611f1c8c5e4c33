"""`eldata export`: a set's files under the names, and in the lists, that published code reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import OK, add_shared, chosen_workers

if TYPE_CHECKING:
    import argparse


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = commands.add_parser(
        "export",
        help="links and lists of a set, as the code of LED, PMN, ELD or SID reads them",
        description=(
            "Write what the published code of a repository reads of a set, your own included: links to its files under "
            "the names from which that code takes scene and ratio, and its lists of pairs; for PMN, infos. Links are "
            "no copies, and nothing that is there is overwritten."
        ),
    )
    parser.add_argument("code", metavar="CODE", choices=("led", "pmn", "eld", "sid"), help="led, pmn, eld or sid")
    parser.add_argument("folder", metavar="FOLDER", help="where to write")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--dataset", metavar="N", help="name of a dataset that eldata knows, such as eld")
    which.add_argument("--manifest", metavar="FILE", help="manifest of a set of your own")
    parser.add_argument(
        "--link",
        choices=("symbolic", "hard", "copy"),
        default="symbolic",
        help="how files get their names (default: %(default)s)",
    )
    parser.add_argument("--split", action="append", dest="splits", metavar="S", help="only this split; may be repeated")
    parser.add_argument("--subset", metavar="NAME", help="only this subset of the dataset card")
    parser.add_argument(
        "--exclude", action="append", default=[], metavar="FLAG", help="leave out pairs with this flag; may be repeated"
    )
    kept = "the links that were made are kept, the lists come last, and the same command goes on"
    add_shared(
        parser,
        run,
        "root",
        "cameras",
        "workers",
        "isolation",
        interrupted=kept,
        example=(
            "eldata export led datasets/ELD --dataset eld --root data --camera SonyA7S2",
            "eldata export eld for-eld --manifest my-set.csv --root data",
        ),
    )


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from eldata.integrations.exports import export

    with chosen_workers(arguments) as workers:
        report = export(
            arguments.code,
            arguments.folder,
            arguments.dataset or "",
            manifest=arguments.manifest,
            root=arguments.root,
            link=arguments.link,
            workers=workers,
            cameras=arguments.cameras,
            split=arguments.splits,
            subset=arguments.subset,
            exclude_flags=arguments.exclude,
        )
    print(report.format_text())
    return OK
