"""`eldata calibrate`: a camera's noise profile from its bias and flat-field frames."""

from __future__ import annotations

from argparse import ArgumentTypeError
from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_output, add_shared, chosen_workers, each_of, whole_number
from eldata.base.fields import number_of, whole_of
from eldata.base.files import write_json
from eldata.base.visible import in_line
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from eldata.manifest.verify import Problem


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = commands.add_parser(
        "calibrate",
        help="measure a camera's noise from bias and flat-field frames",
        description=(
            "Measure system gain, colour bias, row noise and read noise at each ISO from bias frames (lens capped, "
            "shortest exposure) and pairs of flat-field frames, fit their joint distribution, and write the camera's "
            "profile for the noise model. Frames that cannot be used are listed, and their ISO is left out; figures "
            "that the frames cannot bear are withheld, and the text says why. Flats alone give K; with bias frames "
            "alone, state K with --gain. Exit code 1 if an ISO is left out, a figure is withheld, or the profile that "
            "-o asks for cannot be made."
        ),
        epilog="What to shoot, how failures show and what to do about each: docs/calibration.md.",
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
    parser.add_argument(
        "--gain",
        action="append",
        dest="gains",
        default=[],
        type=_stated_gain,
        metavar="ISO=K",
        help=(
            "K in DN per photoelectron at an ISO that has no flats, or a profile that knows it, by name or path; may "
            "be repeated. A measured K counts before a stated one"
        ),
    )
    modes = parser.add_mutually_exclusive_group()
    modes.add_argument(
        "--mode",
        action="append",
        dest="modes",
        type=whole_number(1),
        metavar="ISO",
        help=(
            "the camera switches its conversion gain, and from this ISO on the noise has lines of its own over K; may "
            "be repeated (default: told by a step in the lines)"
        ),
    )
    modes.add_argument(
        "--one-mode", action="store_const", const=[], dest="modes", help="the camera does not switch: one line each"
    )
    add_shared(parser, run, "root", "workers", "isolation", "json")


def _stated_gain(text: str) -> tuple[int, float] | str:
    """Return ISO and K, or what names a profile."""
    iso, equals, gain = text.partition("=")
    if not (equals and iso.isdecimal()):
        return text
    try:
        return whole_of(iso, at_least=1), number_of(gain, above=0)
    except ArgumentError as error:
        raise ArgumentTypeError(f"{error}, in {text!r}") from None


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from dataclasses import asdict

    from eldata.base.files import write_text
    from eldata.calibration.camera import calibrate, stated_gains
    from eldata.calibration.frame_checks import FramesError
    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.manifest.catalogue import load_manifest
    from eldata.noise.profile import CameraProfile

    if arguments.frames.endswith(".csv"):
        folder = load_manifest(arguments.frames).folder(arguments.root)
        frames = CalibrationFrames(folder, arguments.camera, manifest=arguments.frames, isos=arguments.isos)
    else:
        if arguments.root:
            raise ArgumentError("--root says where a manifest's files lie; with a folder of frames, leave it out")
        frames = CalibrationFrames(arguments.frames, arguments.camera, isos=arguments.isos)
    gains: dict[float, float] = {}
    for profile in (name for name in arguments.gains if isinstance(name, str)):
        gains |= stated_gains(frames, CameraProfile.load(profile))
    gains |= dict(stated for stated in arguments.gains if not isinstance(stated, str))
    try:
        with chosen_workers(arguments) as workers:
            found = calibrate(frames, gains=gains, modes=arguments.modes, workers=workers)
    except FramesError as error:
        problems = error.problems
        data = {"camera": frames.camera, "problems": [asdict(one) for one in problems]}
        each_of(
            lambda: _show_problems(frames.camera, problems, "nothing was written"),
            arguments.json and (lambda: write_json(arguments.json, data)),
        )
        return PROBLEMS

    def show() -> None:
        print(f"{found.camera}: {found.source}\n\n{found.format_text()}")
        if frames.skipped:
            left = in_line(frames.skipped[0])
            print(f"\n{len(frames.skipped)} file(s) that are not raw files were left alone, such as {left}")

        if found.problems:
            print()
            _show_problems(found.camera, found.problems, f"left out: ISO {_listed(one.iso for one in found.failed)}")

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
    return PROBLEMS if lacking or found.problems or any(one.withheld for one in found.all_isos) else OK


def _listed(isos: Iterable[float]) -> str:
    return ", ".join(f"{iso:g}" for iso in isos)


def _show_problems(camera: str, problems: Sequence[Problem], outcome: str) -> None:
    for problem in problems:
        print(problem.format_text())
    count = len(problems)
    print(f"{camera}: {count} problem{'s' if count > 1 else ''}; {outcome}")
