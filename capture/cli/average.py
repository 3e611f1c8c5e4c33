"""`capture average`: compare noisy frames with the mean of several references.

Write the mean of references that follow each other (capture plan --references 10) into a DNG beside them, and let the
manifest compare their noisy frames with it. The single frames stay. Frames among which light or camera changed are not
averaged. What was measured against a single one is removed from the manifest: run capture check --write afterwards.

    capture average manifests/mine.csv --root data
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_shared, show_and_write
from eldata.base.numbers import counted
from eldata.base.visible import in_line

if TYPE_CHECKING:
    import argparse


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("manifest", metavar="MANIFEST", help="the manifest's CSV file, its card beside it")
    add_shared(parser, run, "root", "jobs", json=True)


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from dataclasses import asdict

    from capture.check.averaging import average_references

    found = average_references(arguments.manifest, arguments.root, workers=arguments.jobs)
    lines = []
    for one in found:
        what = f"{one.name}: {counted(len(one.files), 'reference')}, {one.files[0]} to {one.files[-1]}"
        if one.mean is None:
            lines += [f"{in_line(what)}: not averaged", *(f"    {reason}" for reason in one.reasons)]
        else:
            lines.append(f"{in_line(what)}: mean in {in_line(one.mean)}, for {counted(one.noisy, 'noisy frame')}")
    show_and_write(arguments, lambda: "\n".join(lines), lambda: {"blocks": [asdict(one) for one in found]})
    return OK if all(one.mean for one in found) else PROBLEMS
