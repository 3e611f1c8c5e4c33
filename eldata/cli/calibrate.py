"""`eldata calibrate`: measure a camera's noise from bias and flat-field frames.

Measure system gain, colour bias, row noise and read noise at each ISO from bias frames (lens capped, shortest exposure)
and pairs of flat-field frames, fit their joint distribution, and write the camera's profile for the noise model. Frames
that cannot be used are listed, and their ISO is left out; figures that the frames cannot bear are withheld, and the
text says why. Flats alone give K; with bias frames alone, state K with --gain. Exit code 1 if an ISO is left out, a
figure is withheld, or the profile that -o asks for, or the dark shading, cannot be made.

    eldata calibrate data/calibration --camera MyCamera -o mycamera.json --html report.html

What to shoot, how failures show and what to do about each: docs/calibration.md.
"""

from __future__ import annotations

import shlex
from argparse import ArgumentTypeError
from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.numbers import counted, number_of, whole_of
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.manifest.verify_report import Problem


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata calibrate`."""
    text = "folder with CAMERA/{bias,flat}/ISO100/..., a camera's own folder, a manifest (.csv) or a set's name"
    parser.add_argument("frames", metavar="FRAMES", help=text)
    console.add_output(parser, "-o", "--output", help="write the camera profile to FILE (JSON)")
    console.add_output(parser, "--html", help="write a report with plots to FILE")
    text = "write the dark shading (a line over ISO in each pixel, black level errors) to FILE (.npz)"
    console.add_output(parser, "--dark-shading", help=text)
    text = "K in DN per photoelectron at an ISO without flats, or a profile of the camera; may be repeated"
    parser.add_argument(
        "--gain", action="append", dest="gains", default=[], type=_read_gain, metavar="ISO=K", help=text
    )
    text = (
        "ISO from which the camera switches its conversion gain; may be repeated; none: it does not switch (default: "
        "one line for all, and a step over the ISOs is remarked)"
    )
    parser.add_argument("--mode", action="append", dest="modes", type=_read_mode, metavar="ISO", help=text)
    text = "keep a figure that this check withholds, with a larger error, and say so in the profile; may be repeated"
    parser.add_argument("--accept", action="append", default=[], metavar="CHECK", help=text)
    text = "rows and columns to use, as numpy slices them: 8:-8,16: (default: all but a border without picture)"
    parser.add_argument("--crop", type=_read_crop, metavar="ROWS,COLUMNS", help=text)
    parser.add_argument("--camera", metavar="NAME", help="the camera's name (default: the only camera there)")
    whole, text = console.whole_number(1), "only this ISO; may be repeated"
    parser.add_argument("--iso", action="append", dest="isos", type=whole, metavar="ISO", help=text)
    console.add_shared(parser, run, "root", "workers", json=True)


def _read_gain(text: str) -> tuple[int, float] | str:
    """Read ISO and K, or the name of a profile."""
    iso, equals, gain = text.partition("=")
    if not (equals and iso.isdecimal()):
        return text
    try:
        return whole_of(iso, at_least=1), number_of(gain, above=0)
    except ArgumentError as error:
        raise ArgumentTypeError(f"{error}, in {text!r}") from None


def _read_crop(text: str) -> tuple[slice, slice]:
    """Read rows and columns such as ``8:-8,16:``."""
    try:
        parts = (part.split(":") for part in text.replace("−", "-").split(","))  # as pages print a minus
        rows, columns = (slice(*(int(end) if end.strip() else None for end in (start, stop))) for start, stop in parts)
    except ValueError:
        raise ArgumentTypeError(f"expected rows and columns such as 8:-8,16:, found {text!r}") from None
    return rows, columns


def _read_mode(text: str) -> int | None:
    """Read an ISO, or ``none``."""
    return None if text == "none" else console.whole_number(1)(text)


def run(arguments: console.Arguments) -> int:
    """Calibrate a camera, print its figures and write the files asked for (`eldata calibrate`)."""
    from dataclasses import asdict

    from eldata.base.files import write_text
    from eldata.calibration.camera import calibrate, stated_gains
    from eldata.calibration.frames import FramesError
    from eldata.calibration.shading_fit import dark_shading
    from eldata.noise.profile import CameraProfile

    frames = _find_frames(arguments)
    modes = _check_modes(arguments.modes)
    gains: dict[float, float] = {}
    for profile in (name for name in arguments.gains if isinstance(name, str)):
        gains |= stated_gains(frames, CameraProfile.load(profile))
    gains |= dict(stated for stated in arguments.gains if not isinstance(stated, str))
    try:
        with console.chosen_workers(arguments) as workers:
            calibration = calibrate(
                frames, gains=gains, modes=modes, accept=arguments.accept, crop=arguments.crop, workers=workers
            )
            shading, no_shading = None, ""
            try:
                if arguments.dark_shading:
                    shading = dark_shading(frames, calibration, modes=modes, workers=workers)
            except DatasetError as error:  # the calibration is not lost for it
                no_shading = str(error)
    except FramesError as error:
        problems = error.problems
        data = {"camera": frames.camera, "problems": [asdict(problem) for problem in problems]}
        console.show_and_write(
            arguments, lambda: _format_problems(frames.camera, problems, "nothing was written"), lambda: data
        )
        return console.PROBLEMS

    def format_all() -> str:
        parts = [f"{calibration.camera}: {calibration.source}", calibration.format_text()]
        if frames.skipped:
            left = in_line(frames.skipped[0])
            parts.append(f"left alone, not raw: {counted(len(frames.skipped), 'file')}, such as {left}")
        if calibration.problems:
            out = f"left out: ISO {_format_isos(iso.iso for iso in calibration.failed)}"
            parts.append(_format_problems(calibration.camera, calibration.problems, out))
        return "\n\n".join(parts)

    def write_profile() -> None:
        if calibration.made_profile is None:
            print(f"\n{arguments.output} was not written: {calibration.no_profile}")
            return
        calibration.made_profile.save(arguments.output)
        print(f"\nprofile: {arguments.output}; look at it with eldata profile show {shlex.quote(arguments.output)}")

    def write_shading() -> None:
        if shading is None:
            print(f"\n{arguments.dark_shading} was not written: {no_shading}")
            return
        shading.save(arguments.dark_shading)
        isos, hot = _format_isos(iso.iso for iso in shading.isos), int(shading.hot.sum())
        print(f"\ndark shading: {arguments.dark_shading}; ISO {isos}; {counted(hot, 'hot pixel')} left as measured")
        print(f"    {shading.digest}")
        if arguments.crop:
            print("    of whole frames, as it is subtracted: --crop chooses the area of the figures alone")
        for note in shading.notes:
            print(f"    {note}")

    def write_page() -> None:
        from eldata.reports.calibration import calibration_page

        write_text(arguments.html, calibration_page(calibration))
        print(f"\nreport: {arguments.html}")

    def collect_json() -> dict[str, object]:
        """Collect calibration and dark shading for JSON."""
        of_shading = {"dark_shading": None if shading is None else shading.summary()}
        return calibration.as_dict() | (of_shading if arguments.dark_shading else {})

    more = arguments.output and write_profile, arguments.dark_shading and write_shading, arguments.html and write_page
    console.show_and_write(arguments, format_all, collect_json, *more)
    lacking = arguments.output and calibration.made_profile is None
    lacking = lacking or (arguments.dark_shading and shading is None) or calibration.problems
    return console.PROBLEMS if lacking or any(iso.withheld for iso in calibration.all_isos) else console.OK


def _find_frames(arguments: console.Arguments) -> CalibrationFrames:
    """Find the frames of a manifest, or of a folder."""
    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.manifest.catalogue import find_manifests, is_manifest

    if is_manifest(arguments.frames):
        (manifest,) = find_manifests(arguments.frames, arguments.root)
        folder = manifest.folder(arguments.root)
        return CalibrationFrames(folder, arguments.camera, manifest=manifest.path, isos=arguments.isos)
    if arguments.root:
        raise ArgumentError("--root says where a manifest's files lie; with a folder of frames, leave it out")
    return CalibrationFrames(arguments.frames, arguments.camera, isos=arguments.isos)


def _check_modes(stated: Sequence[int | None] | None) -> list[int] | None:
    """List the ISOs from which modes begin, none of a camera that does not switch; ``None``: to be found."""
    if stated is None:
        return None
    if None in stated and len(stated) > 1:
        raise ArgumentError("--mode none says that the camera does not switch: give it alone, or leave it out")
    return [iso for iso in stated if iso is not None]


def _format_isos(isos: Iterable[float]) -> str:
    """Write ISOs with commas."""
    return ", ".join(f"{iso:g}" for iso in isos)


def _format_problems(camera: str, problems: Sequence[Problem], outcome: str) -> str:
    """List the problems of a camera's frames, their number and their outcome."""
    lines = [problem.format_text() for problem in problems]
    return "\n".join([*lines, f"{camera}: {counted(len(lines), 'problem')}; {outcome}"])
