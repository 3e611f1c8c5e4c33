"""`capture plan`: plan the shots of scenes with the settings of your camera; change a plan.

Plan the shots of each scene: the setting to dial, what the camera then really gives, and by how much the exposure ratio
misses its low-light factor. With PLAN, show that plan or change it.

    capture plan --camera cam.json --scenes 10 --metered 4 -o plan.json
    capture plan plan.json --remeter scene-2=2

The first makes a plan; the second is for the scene, when the meter says something else.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from capture.camera import CameraDescription, parse_seconds
from capture.checklist import make_rows
from capture.observed import format_f_number
from capture.protocol import PROTOCOLS, CaptureProtocol
from capture.shots import BIAS_FRAMES, CalibrationPlan, Shot, choose_isos, describe_duration, plan_calibration
from eldata.base.console import OK, add_output, add_shared, show_and_write, whole_number
from eldata.base.tables import text_table
from eldata.base.visible import shown
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from capture.plan import Plan

_CREATING = ("camera", "scenes", "metered", "protocol", "isos", "factors", "repeats", "references")
_MOST_SCENES = 1000
_SCENES_END = 1_000_000  # scene-999999 is the last that a plan may have


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `capture plan`."""
    whole = whole_number(1)
    parser.add_argument("plan", metavar="PLAN", nargs="?", help="a plan to show or to change in place")
    add = parser.add_argument_group("a new plan").add_argument
    add("--camera", metavar="FILE", help="camera description; capture camera --example writes one")
    add("--scenes", type=read_scene_numbers, metavar="N", help="number of scenes, or the first and the last, as 11-15")
    times = "time that exposes every scene well at the base ISO, as 4, 5/2 or 2.5; that of one scene, as scene-3=2"
    add("--metered", type=read_scene_time, nargs="+", action="extend", metavar="SECONDS", help=times)
    frames = "frames of a scene: the released set's (default), or the paper's, without the factors 1 and 10"
    add("--protocol", choices=tuple(PROTOCOLS), help=frames)
    add("--isos", type=whole, nargs="+", metavar="ISO", help="other ISOs of the noisy frames")
    add("--factors", type=whole, nargs="+", metavar="FACTOR", help="other low-light factors than the protocol's")
    add("--repeats", type=whole, metavar="N", help="noisy frames of each ISO and factor (default: 1; LRID has 10)")
    references = "references before and after each ISO (default: 1); a noisy frame is compared with the nearest one"
    add("--references", type=whole, metavar="N", help=references)
    change = partial(parser.add_argument_group("changes; may be repeated").add_argument, action="append", default=[])
    remeter = "compute a scene's shots from another metered time, as scene-2=2"
    change("--remeter", type=read_one_scene_time, metavar="SCENE=SECONDS", help=remeter)
    change("--add-scene", type=read_one_scene_time, metavar="SCENE=SECONDS", help="one more scene, as scene-11=4")
    change("--note", metavar="SCENE=TEXT", help="a note on a scene, as scene-2=bookshelf")
    f_number = "f-number of every scene, as 8, or of one, as scene-3=5.6; the files' is compared with it"
    change("--aperture", type=read_aperture, metavar="F", help=f_number)
    add = parser.add_argument_group("calibration frames, in a new plan or an older one").add_argument
    add("--calibration", action="store_true", help="plan bias frames and flats too; needs --flat-clips-at")
    clips_at = "time at the base ISO from which the evenly lit surface is overexposed in raw"
    add("--flat-clips-at", type=read_seconds, metavar="SECONDS", help=clips_at)
    isos = "ISOs to calibrate (default: full stops from the base ISO to the highest noisy one)"
    add("--calibration-isos", type=whole, nargs="+", metavar="ISO", help=isos)
    add("--bias-frames", type=whole, metavar="N", help="bias frames per ISO (default: 10)")
    add_output(parser, "-o", "--output", help="the new plan's file; with PLAN: write the changes there")
    add_shared(parser, run, json=True)


def read_seconds(text: str) -> Fraction:
    """Read seconds above 0, exactly."""
    try:
        return parse_seconds(text)
    except ArgumentError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def read_scene_time(text: str) -> tuple[str | None, Fraction]:
    """Read seconds for every scene (``None``) or, as ``scene-3=1/4``, for one."""
    return (None, read_seconds(text)) if "=" not in text else read_one_scene_time(text)


def read_one_scene_time(text: str) -> tuple[str, Fraction]:
    """Read the seconds of one scene, as ``scene-3=1/4``."""
    name, _, time = text.rpartition("=")
    if not name:
        raise argparse.ArgumentTypeError(f"expected a scene and its metered time, such as scene-2=1/4; found {text!r}")
    return name, read_seconds(time)


def read_aperture(text: str) -> tuple[str | None, Fraction]:
    """Read the f-number for every scene (``None``) or, as ``scene-3=5.6``, for one."""
    name, equals, number = text.rpartition("=")
    try:
        f_number = parse_seconds(number.lower().removeprefix("f/"))
    except ArgumentError:
        f_number = None
    if f_number is None or not 0.5 <= f_number <= 128 or (equals and not name):
        expected = "expected an f-number from 0.5 to 128, such as 5.6, or scene-3=5.6"
        raise argparse.ArgumentTypeError(f"{expected}; found {shown(text)}")
    return name or None, f_number


def read_scene_numbers(text: str) -> range:
    """Read the scenes that a text such as ``10``, the first ten, or ``11-15`` names."""
    first, dash, last = text.rpartition("-")
    whole = whole_number(0)
    numbers = range(whole(first) if dash and first else 1, whole(last) + 1)
    if not 1 <= len(numbers) <= _MOST_SCENES or not 1 <= numbers[0] <= numbers[-1] < _SCENES_END:
        raise argparse.ArgumentTypeError(
            f"expected a number of scenes from 1 to {_MOST_SCENES}, or the first and the last, as 11-15; found {text!r}"
        )
    return numbers


def run(arguments: argparse.Namespace) -> int:
    """Make a plan, or change one, and print it (`capture plan`)."""
    from capture.plan import Plan

    if arguments.plan is None:
        plan = before = _make_plan(arguments)
    else:
        new_only = [name for name in _CREATING if getattr(arguments, name) is not None]
        if new_only:
            raise ArgumentError(f"--{new_only[0]} is for a new plan; {arguments.plan} has its own: leave one out")
        before = plan = Plan.load(arguments.plan)
    plan = _change_plan(plan, arguments)
    target: str = arguments.output or (arguments.plan if plan != before else "")

    def write_plan() -> None:
        plan.save(target)
        print(f"\nplan: {target}")

    show_and_write(arguments, lambda: format_plan(plan), plan.as_dict, write_plan if target else None)
    return OK


def _make_plan(arguments: argparse.Namespace) -> Plan:
    """Make a new plan from the camera's file and the command's options."""
    from capture.plan import make_plan

    if arguments.camera is None:
        raise ArgumentError("a new plan needs --camera FILE; capture camera --example cam.json writes one to change")
    camera = CameraDescription.load(arguments.camera)
    chosen = PROTOCOLS[arguments.protocol or "released"]
    protocol = CaptureProtocol(
        camera.base_iso,
        tuple(arguments.isos or chosen.noisy_isos),
        tuple(arguments.factors or chosen.low_light_factors),
        arguments.repeats or 1,
        arguments.references or 1,
    )
    return make_plan(camera, protocol, _read_metered_times(arguments), _plan_calibration(camera, protocol, arguments))


def _read_metered_times(arguments: argparse.Namespace) -> dict[str, Fraction]:
    """Read the metered time of each scene, in seconds by its name."""
    if arguments.scenes is None and arguments.calibration and not arguments.metered:
        return {}  # calibration frames alone
    if arguments.scenes is None:
        raise ArgumentError("a new plan needs --scenes, a number of scenes, or the first and the last, as 11-15")
    names = [f"scene-{number}" for number in arguments.scenes]
    metered = dict(arguments.metered or ())
    times = {name: metered.pop(name, metered.get(None)) for name in names}
    metered.pop(None, None)
    for name in metered:
        raise ArgumentError(f"--metered {name}: the scenes are {names[0]} to {names[-1]}")
    lacking = [name for name in names if times[name] is None]
    if lacking:
        raise ArgumentError(
            f"--metered: {', '.join(lacking)} need a metered time; --metered 4 gives one to every scene"
        )
    return {name: time for name, time in times.items() if time is not None}


def _plan_calibration(
    camera: CameraDescription, protocol: CaptureProtocol, arguments: argparse.Namespace
) -> CalibrationPlan | None:
    """Plan the calibration frames that are asked for."""
    if not arguments.calibration:
        for name in ("flat_clips_at", "calibration_isos", "bias_frames"):
            if getattr(arguments, name):
                raise ArgumentError(f"--{name.replace('_', '-')} goes with --calibration")
        return None
    if arguments.flat_clips_at is None:
        raise ArgumentError(
            "--calibration needs --flat-clips-at SECONDS: point the camera at the evenly lit surface, at the base ISO, "
            "and lengthen the exposure until the raw histogram touches its right end"
        )
    return plan_calibration(
        camera,
        protocol.base_iso,
        tuple(sorted(arguments.calibration_isos or choose_isos(camera, protocol))),
        arguments.flat_clips_at,
        bias_frames=arguments.bias_frames or BIAS_FRAMES,
    )


def _change_plan(plan: Plan, arguments: argparse.Namespace) -> Plan:
    """Add scenes, times, apertures, notes and calibration frames to a plan, as the options say."""
    for name, time in arguments.add_scene:
        plan = plan.add_scene(name, time)
    for name, time in arguments.remeter:
        plan = plan.remeter(name, time)
    # First the aperture of every scene, whatever the order in which they are given.
    for name, f_number in sorted(arguments.aperture, key=lambda pair: pair[0] is not None):
        for scene in plan.scenes if name is None else (plan.scene(name),):
            plan = plan.set_aperture(scene.name, f_number)
    for text in arguments.note:
        name, _, note = text.partition("=")
        if not note.strip():
            raise ArgumentError(f"--note: expected a scene and a text, such as scene-2=bookshelf; found {text!r}")
        plan = plan.add_note(name, note.strip())
    if arguments.plan is not None:
        calibration = _plan_calibration(plan.camera, plan.protocol, arguments)
        plan = plan if calibration is None else replace(plan, calibration=calibration)
    return plan


# --- text ---------------------------------------------------------------------------------------------------------


def format_plan(plan: Plan) -> str:
    """Format a plan: a table for the scenes of each metered time, and one for the calibration frames."""
    protocol = plan.protocol
    parts = [f"{plan.camera.name}: {len(plan.shots)} shots; {protocol}"]
    for time, f_number in dict.fromkeys((scene.metered_s, scene.aperture) for scene in plan.scenes):
        scenes = [scene for scene in plan.scenes if (scene.metered_s, scene.aperture) == (time, f_number)]
        at = "" if f_number is None else f", {format_f_number(f_number)}"
        names = [scene.name for scene in scenes]
        title = f"{', '.join(names)}: metered at {time} s{at}"
        notes = [f"{scene.name}: {note}" for scene in scenes for note in scene.notes]
        shots, each = scenes[0].shots, "each scene" if len(names) > 1 else names[0]
        duration = f"{each}: {describe_duration(shots)}"
        parts.append("\n".join([title, *notes, _format_shots(shots), duration, *scenes[0].remarks]))
    if plan.calibration is not None:
        shots, clips_at_s = plan.calibration.shots, plan.calibration.flat_clips_at_s
        title = f"calibration: the surface clips at {clips_at_s} s, ISO {protocol.base_iso}"
        duration = f"calibration: {describe_duration(shots)}"
        parts.append("\n".join([title, _format_shots(shots), duration, *plan.calibration.remarks]))
    whole = describe_duration([shot for _, shot in plan.shots])
    parts.append(f"the whole plan: {whole}; composing, focusing and metering come on top")
    return "\n\n".join(parts)


def _format_shots(shots: Sequence[Shot]) -> str:
    """Format the table of shots, a line for each row of the checklist, without the columns that none of them has."""

    def format_cell(value: object, form: str = "{}") -> str:
        return "-" if value is None else form.format(value)

    rows = []
    for row in make_rows(shots):
        shot, error = row.shot, row.shot.ratio_error
        cells = {
            "frame": row.numbers,
            "role": shot.role,
            "ISO": format_cell(shot.iso),
            "true ISO": format_cell(shot.true_iso and float(shot.true_iso), "{:g}"),
            "level": format_cell(shot.level and float(100 * shot.level), "{:.0f} %"),
            "factor": format_cell(shot.factor, "x{}"),
            "asked": f"{shot.target_s} s",
            "set": f"{shot.setting.dial} s",
            "gives": f"{shot.setting.true_s:.4g} s",
            "ratio": format_cell(shot.true_ratio, "{:.2f}"),
            "EXIF": format_cell(shot.named_ratio and float(shot.named_ratio), "{:.2f}"),
            "error": format_cell(error and 100 * (error - 1), "{:+.1f} %"),
            "stops": format_cell(error and math.log2(error), "{:+.3f}"),
            "reference": format_cell(shot.reference),
        }
        rows.append(cells)
    names = [name for name in rows[0] if any(cells[name] != "-" for cells in rows)]
    return text_table(names, [[cells[name] for name in names] for cells in rows], left=(1,))
