"""`eldata calibrate`: a camera's noise profile from its bias and flat-field frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_output, add_shared, chosen_workers, each_of, whole_number
from eldata.base.files import write_json
from eldata.base.visible import in_line

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from eldata.manifest.verify import Problem


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = commands.add_parser(
        "calibrate",
        help="measure a camera's noise from bias and flat-field frames",
        description=(
            "Measure system gain, colour bias, row noise and read noise at each ISO from bias frames (lens capped, "
            "shortest exposure) and pairs of flat-field frames, fit their joint distribution, and write the camera's "
            "profile for the noise model. If frames cannot be used, each is listed and nothing is written."
        ),
        epilog="What to shoot, and how failures show: docs/calibration.md.",
    )
    parser.add_argument(
        "frames",
        metavar="FRAMES",
        help="folder with CAMERA/{bias,flat}/ISO100/... in it, the camera's own folder, or a manifest (.csv)",
    )
    parser.add_argument("--camera", metavar="NAME", help="the camera's name (default: the only camera there)")
    add_output(parser, "-o", "--output", help="write the camera profile to FILE (JSON)")
    add_output(parser, "--html", help="write a report with plots to FILE")
    parser.add_argument(
        "--iso",
        action="append",
        dest="isos",
        type=whole_number(1),
        metavar="ISO",
        help="only this ISO; may be repeated",
    )
    add_shared(parser, run, "root", "workers", "isolation", "json")


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from dataclasses import asdict

    from eldata.base.files import write_text
    from eldata.calibration.camera import calibrate
    from eldata.calibration.frame_checks import FramesError
    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.errors import ArgumentError
    from eldata.manifest.catalogue import load_manifest

    if arguments.frames.endswith(".csv"):
        folder = load_manifest(arguments.frames).folder(arguments.root)
        frames = CalibrationFrames(folder, arguments.camera, manifest=arguments.frames, isos=arguments.isos)
    else:
        if arguments.root:
            raise ArgumentError("--root says where a manifest's files lie; with a folder of frames, leave it out")
        frames = CalibrationFrames(arguments.frames, arguments.camera, isos=arguments.isos)
    try:
        with chosen_workers(arguments) as workers:
            found = calibrate(frames, workers=workers)
    except FramesError as error:
        problems = error.problems
        data = {"camera": frames.camera, "problems": [asdict(one) for one in problems]}
        each_of(
            lambda: _show_problems(frames.camera, problems),
            arguments.json and (lambda: write_json(arguments.json, data)),
        )
        return PROBLEMS

    def show() -> None:
        print(f"{found.camera}: {found.source}\n\n{found.format_text()}")
        if frames.skipped:
            left = in_line(frames.skipped[0])
            print(f"\n{len(frames.skipped)} file(s) that are not raw files were left alone, such as {left}")

    def write_profile() -> None:
        if found.made_profile is None:
            print(f"\n{arguments.output} was not written")  # the text says why
            return
        found.made_profile.save(arguments.output)
        print(f"\nprofile: {arguments.output}; look at it with eldata profile show {arguments.output}")

    def write_page() -> None:
        from eldata.reports.calibration.page import calibration_page

        write_text(arguments.html, calibration_page(found))
        print(f"\nreport: {arguments.html}")

    each_of(
        show,
        arguments.output and write_profile,
        arguments.json and (lambda: write_json(arguments.json, found.as_dict())),
        arguments.html and write_page,
    )
    lacking = arguments.output and found.made_profile is None
    return PROBLEMS if lacking or any(one.withheld for one in found.isos) else OK


def _show_problems(camera: str, problems: Sequence[Problem]) -> None:
    for problem in problems:
        print(problem.format_text())
    count = len(problems)
    print(f"{camera}: {count} problem{'s' if count > 1 else ''}; nothing was written")
