"""`eldata noise`: whether a noise model makes frames like the camera's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_output, add_shared, each_of, whole_number
from eldata.base.files import write_json

if TYPE_CHECKING:
    import argparse


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = commands.add_parser(
        "noise",
        help="hold a noise model against frames of the camera",
        description="Noise models: hold the frames that one makes against frames of the camera.",
    )
    subcommands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    check = subcommands.add_parser(
        "check",
        help="the acceptance test of a noise model",
        description=(
            "Hold the frames that a profile's noise model makes against bias frames and flats of the same camera that "
            "its calibration did not see: level, distribution and tails, rows and columns, neighbours, fixed pattern, "
            "pixels of unlike noise, variance over mean. Each statistic gets a verdict; its standard error is that of "
            "the scatter from pair to pair of frames. Exit code 1 if one is off by more than 4 standard errors."
        ),
        epilog=(
            "Any other model (a network, recorded dark frames) is judged by eldata.calibration.check_noise: "
            "docs/noise.md, examples/check_noise_model.py."
        ),
    )
    check.add_argument("profile", metavar="PROFILE", help="name of a shipped profile, or path of a JSON file")
    check.add_argument(
        "--frames",
        metavar="BIAS",
        required=True,
        help=(
            "held-out frames: folder with CAMERA/{bias,flat}/ISO100/... in it, or the camera's own folder; two bias "
            "frames of an ISO at least, ten make the verdicts sharp; flats are optional"
        ),
    )
    check.add_argument("--camera", metavar="NAME", help="the camera's name (default: the only camera there)")
    check.add_argument(
        "--iso",
        action="append",
        dest="isos",
        type=whole_number(1),
        metavar="ISO",
        help="only this ISO; may be repeated",
    )
    check.add_argument(
        "--model", default="P*+G*+B+R+U", metavar="SPEC", help="components of the noise (default: %(default)s)"
    )
    check.add_argument(
        "--pairs",
        type=whole_number(16),
        default=32,
        metavar="N",
        help="pairs of frames that the model makes for each comparison, 16 or more (default: %(default)s)",
    )
    check.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="S", help="seed of the model (default: %(default)s)"
    )
    add_output(check, "--html", help="write a page with plots to FILE")
    add_shared(check, run_check, "isolation", "json")


def run_check(arguments: argparse.Namespace) -> int:
    """Judge one model."""
    from eldata.base.files import write_text
    from eldata.base.tables import one_line
    from eldata.calibration.acceptance import check_noise
    from eldata.calibration.frame_checks import FramesError
    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.noise.model import NoiseModel
    from eldata.noise.profile import CameraProfile

    model, profile = NoiseModel(arguments.model), CameraProfile.load(arguments.profile)
    frames = CalibrationFrames(arguments.frames, arguments.camera, isos=arguments.isos)
    try:
        found = check_noise(model, frames, profile, seed=arguments.seed, pairs=arguments.pairs)
    except FramesError as error:
        for problem in error.problems:
            print(problem.format_text())
        print(f"{frames.camera}: {len(error.problems)} problem(s) with the held-out frames; nothing was judged")
        return PROBLEMS

    def show() -> None:
        print(f"{one_line(profile.camera)}: {found.model} against {one_line(found.camera)}\n\n{found.format_text()}")

    def write_page() -> None:
        from eldata.reports.acceptance.page import acceptance_page

        write_text(arguments.html, acceptance_page(found))
        print(f"\nreport: {arguments.html}")

    each_of(
        show,
        arguments.json and (lambda: write_json(arguments.json, found.as_dict())),
        arguments.html and write_page,
    )
    return PROBLEMS if found.off else OK
