"""`capture run`: shoot a plan with the camera on the cable, through the program gphoto2."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.console import OK, PROBLEMS, add_shared
from eldata.base.files import write_json
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from capture.plan import Plan
    from capture.tether import Outcome


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add this command."""
    parser = commands.add_parser(
        "run",
        help="shoot a plan with the camera on the cable (needs the program gphoto2)",
        description=(
            "Shoot a plan with the camera on the USB cable. Before each scene it says what to prepare; for each shot "
            "it sets ISO and time, reads them back, releases, downloads, and compares the frame's EXIF with the plan. "
            "A scene is checked by its pixels as soon as it is taken, while the tripod still stands. Whatever cuts it "
            "off (a pulled cable, a crash, Ctrl-C), the same command resumes, without repeating or losing a frame: "
            "DIR/journal.jsonl records each one."
        ),
        epilog="Then: capture manifest PLAN DIR/* -o manifests/mine.csv --copy-to data/mine",
    )
    parser.add_argument("plan", metavar="PLAN", help="the plan (JSON)")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="folder for the frames and their journal")
    parser.add_argument(
        "--scene",
        action="append",
        dest="scenes",
        metavar="N",
        help="only this scene, by name or number, or calibration; may be repeated",
    )
    parser.add_argument("--port", metavar="P", default="", help="the camera's port, as gphoto2 --auto-detect lists it")
    parser.add_argument(
        "--gphoto2", metavar="PATH", default="gphoto2", help="the program (default: the gphoto2 on the PATH)"
    )
    parser.add_argument(
        "--timeout",
        type=_patience,
        default=60.0,
        metavar="S",
        help="seconds that gphoto2 may take beyond twice the exposure (default: 60)",
    )
    parser.add_argument(
        "--no-check", action="store_true", help="do not check each scene by its pixels when its last frame is here"
    )
    parser.add_argument(
        "--flats-as-planned",
        action="store_true",
        help="take flats as they are planned; else the first one is taken until its level is right, and the others are "
        "planned again by it (PLAN is changed)",
    )
    parser.add_argument("--yes", action="store_true", help="go on from scene to scene without waiting for Enter")
    parser.add_argument("--dry-run", action="store_true", help="only list the commands that are left to run")
    add_shared(
        parser,
        run,
        "isolation",
        json="frames planned taken_now verdicts",
        makes="output",
        example="capture run plan.json -o shots",
    )


def _patience(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 86400:
        raise argparse.ArgumentTypeError(f"expected a number of seconds above 0, up to a day; found {text!r}")
    return value


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from dataclasses import replace

    from capture.plan import Plan
    from capture.tether import Gphoto, run_session

    whole = Plan.load(arguments.plan)
    part = whole.only([_scene_name(text) for text in arguments.scenes]) if arguments.scenes else whole
    folder = Path(arguments.output)
    if folder.exists() and not folder.is_dir():
        raise ArgumentError(f"--output {folder}: is a file; give a folder")
    if arguments.dry_run:
        _show_commands(part, folder, arguments)
        return OK
    if not arguments.yes and not sys.stdin.isatty():
        raise ArgumentError("there is no terminal to ask on before each scene; use --yes to go on without asking")
    gphoto = replace(Gphoto.find(arguments.gphoto2, timeout_s=arguments.timeout), port=arguments.port)
    ask = _say if arguments.yes else _ask
    outcome = run_session(
        part,
        folder,
        gphoto,
        whole=whole,
        path=arguments.plan,
        ask=ask,
        say=_say,
        check=not arguments.no_check,
        save=None if arguments.flats_as_planned else lambda plan: plan.save(arguments.plan),
    )
    print(f"{len(outcome.files)} of {len(part.shots)} frames are in {folder}, {outcome.taken} of them taken now")
    if len(part.shots) == len(whole.shots):
        shots = f"{shlex.quote(str(folder))}/*"
        print(f"next: capture manifest {shlex.quote(arguments.plan)} {shots} -o manifests/mine.csv --copy-to data/mine")
    if arguments.json:
        write_json(arguments.json, _as_dict(part, outcome))
    return OK if all(verdict == "keep" for verdict in outcome.verdicts.values()) else PROBLEMS


def _scene_name(text: str) -> str:
    return f"scene-{text}" if text.isdecimal() else text


def _say(text: str) -> None:
    print(text, flush=True)


def _ask(text: str) -> None:
    _say(text)
    try:
        input("    Enter when ready, Ctrl-C to stop: ")
    except EOFError:
        raise ArgumentError("the terminal was closed before the scene was ready; run this again to go on") from None


def _show_commands(plan: Plan, folder: Path, arguments: argparse.Namespace) -> None:
    from capture.tether import Gphoto, Journal, commands
    from capture.tether.journal import NAME

    journal = Journal(folder / NAME, writable=False)
    done = {slot for slot, entry in journal.done().items() if (folder / str(entry.details.get("file"))).is_file()}
    before = ""
    for title, command in commands(plan, Gphoto(arguments.gphoto2, arguments.port), frozenset(done)):
        if title != before:
            print(f"# {title}")
            before = title
        print(shlex.join(command))
    print("# times and ISOs as the plan names them; a session takes the camera's own spelling")


def _as_dict(plan: Plan, outcome: Outcome) -> dict[str, object]:
    return {
        "frames": [
            {"scene": scene, "number": number, "file": str(path)} for (scene, number), path in outcome.files.items()
        ],
        "planned": len(plan.shots),
        "taken_now": outcome.taken,
        "seconds": round(outcome.seconds, 1),
        "verdicts": outcome.verdicts,
    }
