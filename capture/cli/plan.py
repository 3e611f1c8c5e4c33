"""`capture plan`: plan the shots of scenes with the settings of your camera; change a plan.

Plan the shots of each scene: the setting to dial, what the camera then really gives, and by how much the exposure ratio
misses its low-light factor. With PLAN, show that plan or change it.

    capture plan --camera cam.json --scenes 10 --metered 4 -o plan.json
    capture plan plan.json --remeter scene-2=2

The first makes a plan; the second is for the scene, when the meter says something else.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from capture.checklist_content import rows as rows_of
from capture.cli.values import (
    add_alike,
    add_numbers,
    aperture,
    given_counts,
    metered,
    or_dash,
    scene_numbers,
    scene_time,
    seconds,
)
from capture.protocol import COUNTS, PROTOCOLS, CaptureProtocol
from eldata.base.console import OK, add_output, add_shared, show_and_write, whole_number
from eldata.base.tables import text_table
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence
    from fractions import Fraction

    from capture.calibration import CalibrationPlan
    from capture.camera import CameraDescription
    from capture.plan import Plan
    from capture.shots import Shot
    from capture.shutter import ExactNumber

_CREATING = ("camera", "scenes", "metered", "protocol", "isos", "factors", *COUNTS)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("plan", metavar="PLAN", nargs="?", help="a plan to show or to change in place")
    new = parser.add_argument_group("a new plan")
    new.add_argument("--camera", metavar="FILE", help="camera description; capture camera --example writes one")
    new.add_argument(
        "--scenes",
        type=scene_numbers,
        metavar="N",
        help="number of scenes: scene-1 to scene-N; another night's, as 11-15: scene-11 to scene-15",
    )
    new.add_argument(
        "--metered",
        type=metered,
        action="append",
        metavar="SECONDS",
        help="time that exposes the scenes well at the base ISO, as 4, 5/2 or 2.5; for one scene: scene-3=2",
    )
    new.add_argument(
        "--protocol",
        choices=tuple(PROTOCOLS),
        help="frames of a scene: those of the released set (default), or the paper's, without the factors 1 and 10",
    )
    add_numbers(new, "--isos", "ISO", "other ISOs of the noisy frames")
    add_numbers(new, "--factors", "FACTOR", "other low-light factors than the protocol's")
    add_alike(new)
    change = parser.add_argument_group("changes")
    repeated = partial(change.add_argument, action="append", default=[])
    repeated(
        "--remeter",
        type=scene_time,
        metavar="SCENE=SECONDS",
        help="compute a scene's shots from another metered time, as scene-2=2; may be repeated",
    )
    more = "one more scene, as scene-11=4; may be repeated"
    repeated("--add-scene", type=scene_time, metavar="SCENE=SECONDS", help=more)
    repeated("--note", metavar="SCENE=TEXT", help="a note on a scene, as scene-2=bookshelf; may be repeated")
    repeated(
        "--aperture",
        type=aperture,
        metavar="F",
        help="the f-number of every scene, as 8, or of one: scene-3=5.6; in a new plan or an older one. That of the "
        "files is compared with it",
    )
    calibration = parser.add_argument_group("calibration frames, in a new plan or an older one")
    calibration.add_argument(
        "--calibration", action="store_true", help="plan bias frames and flats too; needs --flat-clips-at"
    )
    calibration.add_argument(
        "--flat-clips-at",
        type=seconds,
        metavar="SECONDS",
        help="time at the base ISO from which the evenly lit surface is overexposed in raw",
    )
    isos = "ISOs to calibrate (default: full stops from the base ISO to the highest noisy one)"
    add_numbers(calibration, "--calibration-isos", "ISO", isos)
    calibration.add_argument(
        "--bias-frames", type=whole_number(1), metavar="N", help="bias frames per ISO (default: 10)"
    )
    calibration.add_argument(
        "--warm",
        action="store_true",
        default=None,
        help="bias frames a second time, with the sensor warm from the shooting; the first come before it",
    )
    add_output(parser, "-o", "--output", help="the new plan's file; with PLAN: write the changes there")
    add_shared(parser, run, json=True)


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from capture.plan import Plan

    if arguments.plan is None:
        plan = before = _new(arguments)
    else:
        given = [name for name in _CREATING if getattr(arguments, name) is not None]
        if given:
            raise ArgumentError(f"--{given[0]} is for a new plan; {arguments.plan} has its own: leave one of them out")
        before = plan = Plan.load(arguments.plan)
    plan = _changed(plan, arguments)
    target: str = arguments.output or (arguments.plan if plan != before else "")

    def write_plan() -> None:
        plan.save(target)
        print(f"\nplan: {target}")

    show_and_write(arguments, lambda: format_plan(plan), plan.as_dict, write_plan if target else None)
    return OK


def _new(arguments: argparse.Namespace) -> Plan:
    from capture.camera import CameraDescription
    from capture.plan import make_plan

    if arguments.camera is None:
        raise ArgumentError("a new plan needs --camera FILE; capture camera --example cam.json writes one to change")
    camera = CameraDescription.load(arguments.camera)
    chosen = PROTOCOLS[arguments.protocol or "released"]
    protocol = CaptureProtocol(
        camera.base_iso,
        tuple(arguments.isos or chosen.noisy_isos),
        tuple(arguments.factors or chosen.low_light_factors),
        **given_counts(arguments),
    )
    return make_plan(camera, protocol, _metered(arguments), _calibration(camera, protocol, arguments))


def _metered(arguments: argparse.Namespace) -> dict[str, Fraction]:
    if arguments.scenes is None and arguments.calibration and not arguments.metered:
        return {}  # calibration frames alone
    if arguments.scenes is None:
        raise ArgumentError("a new plan needs --scenes, a number of scenes, or the first and the last, as 11-15")
    names = [f"scene-{number}" for number in arguments.scenes]
    times: dict[str, Fraction] = {}
    # First the time of every scene, whatever the order in which they are given.
    for name, time in sorted(arguments.metered or (), key=lambda given: given[0] is not None):
        if name is None:
            times = dict.fromkeys(names, time)
        elif name in names:
            times[name] = time
        else:
            raise ArgumentError(f"--metered {name}: the scenes are {names[0]} to {names[-1]}")
    lacking = [name for name in names if name not in times]
    if lacking:
        raise ArgumentError(
            f"--metered: {', '.join(lacking)} need a metered time; --metered 4 gives one to every scene"
        )
    return {name: times[name] for name in names}


def _calibration(
    camera: CameraDescription, protocol: CaptureProtocol, arguments: argparse.Namespace
) -> CalibrationPlan | None:
    """Return the calibration frames that are asked for."""
    from capture.calibration import default_isos, plan_calibration

    if not arguments.calibration:
        for name in ("flat_clips_at", "calibration_isos", "bias_frames", "warm"):
            if getattr(arguments, name) is not None:
                raise ArgumentError(f"--{name.replace('_', '-')} goes with --calibration")
        return None
    if arguments.flat_clips_at is None:
        raise ArgumentError(
            "--calibration needs --flat-clips-at SECONDS: point the camera at the evenly lit surface, at the base ISO, "
            "and lengthen the exposure until the raw histogram touches its right end"
        )
    isos = tuple(sorted(arguments.calibration_isos)) if arguments.calibration_isos else default_isos(camera, protocol)
    given = {name: getattr(arguments, name) for name in ("bias_frames", "warm")}
    given = {name: value for name, value in given.items() if value is not None}
    return plan_calibration(camera, protocol.base_iso, isos, arguments.flat_clips_at, **given)


def _changed(plan: Plan, arguments: argparse.Namespace) -> Plan:
    for name, time in arguments.add_scene:
        plan = plan.add_scene(name, time)
    for name, time in arguments.remeter:
        plan = plan.remeter(name, time)
    # First the aperture of every scene, whatever the order in which they are given.
    for name, f_number in sorted(arguments.aperture, key=lambda given: given[0] is not None):
        for scene in plan.scenes if name is None else (plan.scene(name),):
            plan = plan.set_aperture(scene.name, f_number)
    for text in arguments.note:
        name, equals, note = text.partition("=")
        if not equals or not note.strip():
            raise ArgumentError(f"--note: expected a scene and a text, such as scene-2=bookshelf; found {text!r}")
        plan = plan.add_note(name, note.strip())
    if arguments.plan is not None:
        calibration = _calibration(plan.camera, plan.protocol, arguments)
        plan = plan if calibration is None else replace(plan, calibration=calibration)
    return plan


# --- text ---------------------------------------------------------------------------------------------------------


def format_plan(plan: Plan) -> str:
    """Return a plan as text: a table for the scenes of each metered time, and one for the calibration frames."""
    from capture.observed import f_text
    from capture.shots import duration_of

    protocol = plan.protocol
    parts = [f"{plan.camera.name}: {len(plan.shots)} shots; {protocol}"]
    for time, f_number in dict.fromkeys((scene.metered_s, scene.aperture) for scene in plan.scenes):
        scenes = [scene for scene in plan.scenes if (scene.metered_s, scene.aperture) == (time, f_number)]
        at = "" if f_number is None else f", {f_text(f_number)}"
        names = [scene.name for scene in scenes]
        title = f"{', '.join(names)}: metered at {time} s{at}"
        notes = [f"{scene.name}: {note}" for scene in scenes for note in scene.notes]
        each = "each scene" if len(names) > 1 else names[0]
        time_needed = f"{each}: {duration_of(scenes[0].shots)}"
        parts.append("\n".join([title, *notes, _table(scenes[0].shots), time_needed, *scenes[0].remarks]))
    if plan.calibration is not None:
        shots, clips_at_s = plan.calibration.shots, plan.calibration.flat_clips_at_s
        title = f"calibration: the surface clips at {clips_at_s} s, ISO {protocol.base_iso}"
        after = [f"calibration: {duration_of(shots)}", *plan.calibration.remarks]
        parts.append("\n".join([title, _calibration_table(shots), *after]))
    parts.append(f"the whole plan: {plan.duration}; composing, focusing and metering come on top")
    return "\n\n".join(parts)


def _table(shots: Sequence[Shot]) -> str:
    measured = any(shot.true_iso is not None for shot in shots)
    return _as_table(
        {
            "frame": row.numbers,
            "role": shot.role,
            "ISO": str(shot.iso),
            **({"true ISO": _number(shot.true_iso, "{:g}")} if measured else {}),
            "factor": or_dash(shot.factor, "x{}"),
            "asked": f"{shot.target_s} s",
            "set": f"{shot.setting.dial} s",
            "gives": f"{shot.setting.true_s:.4g} s",
            "ratio": _number(shot.true_ratio, "{:.2f}"),
            "EXIF": _number(shot.named_ratio, "{:.2f}"),
            "error": or_dash(shot.error_percent, "{:+.1f} %"),
            "stops": or_dash(shot.error_stops, "{:+.3f}"),
            "reference": or_dash(shot.reference),
        }
        for row in rows_of(shots)
        for shot in (row.shot,)
    )


def _calibration_table(shots: Sequence[Shot]) -> str:
    return _as_table(
        {
            "frames": row.numbers,
            "role": f"{row.shot.series} {row.shot.role}".lstrip(),
            "ISO": str(row.shot.iso),
            "level": _number(row.shot.level and 100 * row.shot.level, "{:.0f} %"),
            "set": f"{row.dial} s",
            "count": str(row.count),
        }
        for row in rows_of(shots)
    )


def _as_table(found: Iterable[dict[str, str]]) -> str:
    rows = list(found)
    return text_table(tuple(rows[0]), [tuple(row.values()) for row in rows], left=(1,))


def _number(value: ExactNumber | Fraction | None, form: str) -> str:
    return or_dash(None if value is None else float(value), form)
