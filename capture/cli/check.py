"""`capture check`: check the pixels of each scene: keep, look or shoot again.

Check the pixels of each scene: do the references agree (light, position, focus), is each noisy frame exposed as its
name says; light leaks in bias frames, saturated or uneven flats. Gives one verdict per scene: keep, look or shoot
again, with the reasons. Nothing is changed.

    capture check manifests/mine.csv --root data --sheet sheet.html
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_cameras, add_output, add_shared, show_and_write
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import argparse


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `capture check`."""
    parser.add_argument("manifest", metavar="MANIFEST", help="the manifest's CSV file, its card beside it")
    scene = "only this scene, by name or number, and no calibration frames; may be repeated"
    parser.add_argument("--scene", action="append", dest="scenes", default=[], metavar="N", help=scene)
    add_cameras(parser)
    add_output(parser, "--sheet", help="write a contact sheet, an HTML page that needs no network")
    add_shared(parser, run, "root", "jobs", json=True)


def run(arguments: argparse.Namespace) -> int:
    """Check the pixels of a set, and print the verdicts (`capture check`)."""
    from capture.check.checking import check
    from capture.check.result import write_sheet

    if arguments.sheet and not arguments.sheet.endswith(".html"):
        raise ArgumentError(f"--sheet {arguments.sheet}: expected a name that ends in .html")
    report = check(
        arguments.manifest,
        arguments.root,
        scenes=arguments.scenes,
        cameras=arguments.cameras or (),
        workers=arguments.jobs,
    )

    def write_pictures() -> None:
        write_sheet(arguments.sheet, report)
        print(f"contact sheet: {arguments.sheet}")

    show_and_write(arguments, report.format_text, report.as_dict, arguments.sheet and write_pictures)
    return OK if report.ok else PROBLEMS
