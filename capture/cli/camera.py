"""`capture camera`: check a camera description, or write an example to start from.

Check a camera description and show its exposure times, as the camera names them and as it gives them; or write an
example (the Sony A7S II) to change for your own camera.

    capture camera --example cam.json
    capture camera cam.json
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.console import OK, add_output, add_shared, show_and_write
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import argparse

    from capture.camera import CameraDescription


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `capture camera`."""
    parser.add_argument("camera", metavar="CAMERA", nargs="?", help="a camera description (JSON)")
    add_output(parser, "--example", help="write an example description to FILE")
    add_shared(parser, run, json=True)


def run(arguments: argparse.Namespace) -> int:
    """Show a camera description, or write an example (`capture camera`)."""
    from capture.camera import EXAMPLE, CameraDescription, camera_as_dict

    if (arguments.camera is None) == (arguments.example is None):
        raise ArgumentError("give either a camera description to check, or --example FILE to write one")
    if arguments.example is not None:
        if Path(arguments.example).exists():  # somebody's camera, most likely
            raise ArgumentError(f"--example {arguments.example}: is there already; give another name")
        EXAMPLE.save(arguments.example)
        camera = EXAMPLE
        text = f"{arguments.example}: the {EXAMPLE.name}'s; change it to your camera's, then: capture camera FILE"
    else:
        camera = CameraDescription.load(arguments.camera)
        text = _format_camera(camera)
    times = [
        {"dial": time.dial, "nominal_s": str(time.nominal_s), "true_s": time.true_s} for time in camera.shutter.times
    ]
    show_and_write(arguments, lambda: text, lambda: camera_as_dict(camera) | {"times": times})
    return OK


def _format_camera(camera: CameraDescription) -> str:
    """Write a camera's name, ISOs, measured speeds, and table of shutter times."""
    from eldata.base.tables import text_table

    rows = [(f"{time.dial} s", f"{time.true_s:.6g} s") for time in camera.shutter.times]
    speeds = ", ".join(f"{iso} is {float(speed):g}" for iso, speed in camera.true_isos)
    return "\n".join(
        (
            f"{camera.name} ({', '.join(camera.models)}): {camera.raw_extension}, {camera.cfa}",
            f"ISO {', '.join(map(str, camera.isos))}; base {camera.base_iso}",
            *([f"measured: ISO {speeds}"] if speeds else []),
            text_table(("marked", "gives"), rows, left=()),
        )
    )
