"""`eldata verify`: check the files on disk against manifests, or a store.

Check the files on disk against manifests and list every problem. Levels: quick (present, size, no unlisted raw files),
metadata (also: opens, camera, ISO, exposure, ratio; remarks), full (also: hashes). Nothing is written. For a training
store (.h5) every level checks its structure, full also its pixels.

    eldata verify
    eldata verify eld --root data --level metadata
    eldata verify store.h5 --level full
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from eldata.base import console
from eldata.errors import ArgumentError
from eldata.manifest.verify import verify
from eldata.manifest.verify_report import LEVELS, VerifyReport

if TYPE_CHECKING:
    from eldata.base.workers import Workers


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata verify`."""
    text = (
        "datasets by name, such as eld; manifests (CSV files), or folders of them; or a store "
        "(default: every known dataset that is there)"
    )
    parser.add_argument("manifests", metavar="MANIFESTS", nargs="*", help=text)
    console.add_cameras(parser)
    parser.add_argument("--level", choices=LEVELS, default="quick", help="how deep to look (default: %(default)s)")
    console.add_shared(parser, run, "root", "workers", json=True)


def run(arguments: console.Arguments) -> int:
    """Verify files against manifests, or a store (`eldata verify`)."""
    store = next((path for path in arguments.manifests if path.lower().endswith((".h5", ".hdf5"))), None)
    if store is not None and len(arguments.manifests) > 1:
        raise ArgumentError(f"{store} is checked alone: give it in a command of its own")
    with console.chosen_workers(arguments) as workers:
        report = _verify_files(arguments, workers) if store is None else _verify_store(arguments, store, workers)
    console.show_and_write(
        arguments, report.format_text if arguments.manifests else partial(_format_all_known, report), report.as_dict
    )
    return console.OK if report.ok else console.PROBLEMS


def _verify_store(arguments: console.Arguments, path: str, workers: Workers) -> VerifyReport:
    """Verify a packed store, without options that are for manifests."""
    from eldata.sources.store.write import verify_store

    if arguments.root is not None or arguments.cameras:
        raise ArgumentError("--root and --camera are for manifests; a store is checked whole")
    return verify_store(path, level=arguments.level, workers=workers)


def _verify_files(arguments: console.Arguments, workers: Workers) -> VerifyReport:
    """Verify datasets' files: of the named manifests, else of all known ones."""
    from eldata.manifest.catalogue import find_manifests, known_manifests

    if arguments.manifests:
        manifests = find_manifests(arguments.manifests, arguments.root)
    else:
        manifests, problems = known_manifests(arguments.root)
        for problem in problems:
            print(f"eldata verify: {problem}", file=sys.stderr)
    return verify(manifests, arguments.root, cameras=arguments.cameras, level=arguments.level, workers=workers)


def _format_all_known(report: VerifyReport) -> str:
    """Format the report on every known dataset: those that are there, and the names of the others."""
    there = tuple(dataset for dataset in report.datasets if not dataset.absent)
    absent = ", ".join(dataset.dataset for dataset in report.datasets if dataset.absent)
    lines = [f"not there: {absent}; eldata info NAME says where to get one"] if absent else []
    return "\n".join([replace(report, datasets=there).format_text(), *lines])
