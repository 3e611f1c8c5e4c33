"""`eldata lock`: record sizes and hashes of a trusted copy in a manifest.

Record the size and SHA-256 of every file of a copy that you trust in its manifest. The copy must pass eldata verify
--level metadata first, and files without a recorded hash must decode and show no damage; with any problem the manifest
stays as it is. Of a dataset by name, the filled-in manifest is written to manifests/NAME.csv in the folder that holds
the datasets, and eldata verify NAME finds it there.

    eldata lock eld --root data
"""

from __future__ import annotations

from eldata.base import console
from eldata.base.numbers import counted
from eldata.manifest.lock import LockReport, lock


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata lock`."""
    text = "a dataset's name, or a manifest of your own (CSV file or name), which is changed"
    parser.add_argument("manifest", metavar="MANIFEST", help=text)
    console.add_cameras(parser)
    console.add_shared(parser, run, "root", "workers", json=True)


def run(arguments: console.Arguments) -> int:
    """Record sizes and hashes in a manifest (`eldata lock`)."""
    from dataclasses import asdict

    with console.chosen_workers(arguments) as workers:
        report = lock(arguments.manifest, arguments.root, cameras=arguments.cameras, workers=workers)
    data = {"files_locked": report.files_locked, "problems": [asdict(problem) for problem in report.problems]}
    console.show_and_write(arguments, lambda: _format_report(report), lambda: data)
    return console.OK if report.files_locked else console.PROBLEMS


def _format_report(report: LockReport) -> str:
    """List the problems, and how many files the manifest has recorded."""
    if report.files_locked:
        done = f"{report.path}: size and hash of {report.files_locked} files recorded"
    else:
        count = len(report.problems)
        done = f"{report.path} was left as it is" + (f": {counted(count, 'problem')}" if count else "")
    problems = map(str, report.problems) if report.checks.ok else [report.checks.format_text()]
    return "\n".join([*problems, done])
