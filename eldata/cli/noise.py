"""`eldata noise`: hold a noise model against frames of the camera.

Noise models: hold the frames that one makes against frames of the camera.

    eldata noise check mycamera.json --frames data/held-out
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.numbers import counted
from eldata.base.outputs import add_output
from eldata.cli.baseline import add_another_camera

if TYPE_CHECKING:
    import argparse

    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.datasets.synthetic.dark_frames import DarkFrames
    from eldata.noise.structure import Components


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    subcommands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    check = console.add_command(subcommands, "check", run_check.__doc__)
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
    add_components(
        check,
        dark_frames="other bias frames of the camera than those of --frames",
        dark_shading="the dark shading, from other frames",
    )
    check.add_argument(
        "--pairs",
        type=console.whole_number(16),
        default=32,
        metavar="N",
        help="pairs of frames that the model makes for each comparison, 16 or more (default: %(default)s)",
    )
    check.add_argument(
        "--seed", type=console.whole_number(0), default=0, metavar="S", help="seed of the model (default: %(default)s)"
    )
    add_another_camera(check, "frames of another camera")
    add_output(check, "--html", help="write a page with plots to FILE")
    console.add_shared(check, run_check, "isos", "workers", json=True)


def add_components(parser: argparse.ArgumentParser, *, dark_frames: str, dark_shading: str) -> None:
    """Add which components noise has, and the files of those that have one; the texts say of what."""
    parser.add_argument(
        "--model", default="P*+G*+B+R+U", metavar="SPEC", help="components of the noise (default: %(default)s)"
    )
    parser.add_argument(
        "--dark-frames",
        metavar="FOLDER|STORE",
        help=f"of component D, as in 'P*+D': {dark_frames}; or eldata pack's store, or a manifest (.csv)",
    )
    parser.add_argument(
        "--dark-shading",
        metavar="FILE",
        help=f"of component S, as in 'P*+G*+R+U+S': {dark_shading}, which eldata calibrate --dark-shading writes",
    )


def check_components(spec: str, dark_frames: str | None, dark_shading: str | None) -> Components:
    """Return what noise has, once it is known that each component has its file, and each file its component.

    Raises
    ------
    ArgumentError
        If not, or the spec is malformed.
    """
    from eldata.errors import ArgumentError
    from eldata.noise.structure import parse_components

    parts = parse_components(spec)
    for name, has, given, option, what, example in (
        ("D", parts.dark, dark_frames, "--dark-frames", "real dark frames; give --dark-frames FOLDER|STORE", "P*+D"),
        ("S", parts.shading, dark_shading, "--dark-shading", "a dark shading; give --dark-shading FILE", "P*+G*+R+U+S"),
    ):
        if has and given is None:
            raise ArgumentError(f"--model {spec!r}: component {name} takes {what}")
        if given is not None and not has:
            raise ArgumentError(f"{option} is for component {name}; name it in --model, as in {example!r}")
    return parts


def _check_apart(dark: DarkFrames, frames: CalibrationFrames) -> None:
    """Refuse held-out frames that are the model's own: it would be right by heart."""
    from pathlib import Path

    from eldata.errors import ArgumentError

    own = {Path(name).resolve() for iso in dark.isos for name in dark.names(iso)}
    for path in (frames.path(record) for record in frames.records):
        if path.resolve() in own:
            raise ArgumentError(
                f"{path}: is in --frames and in --dark-frames; a model is judged by frames that it does not have"
            )


def run_check(arguments: console.Arguments) -> int:
    """`eldata noise check`: the acceptance test of a noise model.

    Hold the frames that a profile's noise model makes against bias frames and flats of the same camera that its
    calibration did not see: level, distribution and tails, rows and columns, neighbours, fixed pattern, pixels of
    unlike noise, variance over mean. Each statistic gets a verdict; its standard error is that of the scatter from pair
    to pair of frames. Exit code 1 if one is off by more than 4 standard errors.

        eldata noise check mycamera.json --frames data/held-out --camera MyCamera --html check.html

    Any other model (a network, recorded dark frames) is judged by eldata.calibration.check_noise: docs/noise.md,
    eldata.examples.check_noise_model.
    """
    from eldata.base.files import write_text
    from eldata.base.tables import one_line
    from eldata.calibration.acceptance.comparison import check_noise
    from eldata.calibration.frames import FramesError
    from eldata.datasets.calibration_frames import CalibrationFrames
    from eldata.datasets.synthetic.dark_frames import DarkFrames
    from eldata.noise.dark_shading import DarkShading
    from eldata.noise.model import NoiseModel
    from eldata.noise.profile import CameraProfile

    parts = check_components(arguments.model, arguments.dark_frames, arguments.dark_shading)
    shading = None if arguments.dark_shading is None else DarkShading.load(arguments.dark_shading)
    profile = CameraProfile.load(arguments.profile)
    frames = CalibrationFrames(arguments.frames, arguments.camera, isos=arguments.isos)
    dark = None
    if arguments.dark_frames is not None:  # whole DN like the held-out ones: a dither would add its 1/12 DN^2
        dark = DarkFrames(arguments.dark_frames, isos=[float(iso) for iso in frames.isos], dither=False)
        _check_apart(dark, frames)
    model = NoiseModel(arguments.model, dark_frames=dark, dark_shading=shading)
    of_sensor = parts.shading or parts.dark
    try:
        with console.chosen_workers(arguments) as workers:
            options = {"seed": arguments.seed, "pairs": arguments.pairs, "whole_frames": of_sensor}
            options["profile_of_another_camera"] = arguments.profile_of_another_camera
            found = check_noise(model, frames, profile, workers=workers, **options)
    except FramesError as error:
        for problem in error.problems:
            print(problem.format_text())
        print(
            f"{frames.camera}: {counted(len(error.problems), 'problem')} with the held-out frames; nothing was judged"
        )
        return console.PROBLEMS

    def told() -> str:
        return f"{one_line(profile.camera)}: {found.model} against {one_line(found.camera)}\n\n{found.format_text()}"

    def write_page() -> None:
        from eldata.reports.noise_models import acceptance_page

        write_text(arguments.html, acceptance_page(found))
        print(f"\nreport: {arguments.html}")

    console.show_and_write(arguments, told, found.as_dict, arguments.html and write_page)
    return console.PROBLEMS if found.off else console.OK
