"""`eldata lock`: record sizes and hashes of a trusted copy in a manifest.

Record the size and SHA-256 of every file of a copy that you trust in its manifest. The copy must pass eldata verify
--level metadata first, and files without a recorded hash must decode and show no damage; with any problem the manifest
stays as it is. Of a dataset by name, the filled-in manifest is written to manifests/NAME.csv in the folder that holds
the datasets, and eldata verify NAME finds it there.

    eldata lock eld --root data
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_command, add_shared, chosen_workers, each_of
from eldata.base.files import write_json
from eldata.base.numbers import counted
from eldata.manifest.lock import lock

if TYPE_CHECKING:
    import argparse

    from eldata.manifest.lock import LockReport


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = add_command(commands, "lock", __doc__)
    parser.add_argument(
        "manifest", metavar="MANIFEST", help="a dataset's name, or a manifest's CSV file, which is changed"
    )
    add_shared(parser, run, "root", "cameras", "workers", json="files_locked problems")


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from dataclasses import asdict

    with chosen_workers(arguments) as workers:
        report = lock(arguments.manifest, arguments.root, cameras=arguments.cameras, workers=workers)
    found = {"files_locked": report.files_locked, "problems": [asdict(problem) for problem in report.problems]}
    each_of(
        lambda: _show(report),
        arguments.json and (lambda: write_json(arguments.json, found)),
    )
    return OK if report.files_locked else PROBLEMS


def _show(report: LockReport) -> None:
    if not report.checks.ok:
        print(report.checks.format_text())
    for problem in report.problems if report.checks.ok else ():
        print(problem)
    if not report.files_locked:
        count = len(report.problems)
        print(f"{report.path} was left as it is" + (f": {counted(count, 'problem')}" if count else ""))
    else:
        print(f"{report.path}: size and hash of {report.files_locked} files recorded")
