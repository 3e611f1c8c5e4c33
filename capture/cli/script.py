"""`capture script`: turn a plan into a shell script for a camera on the cable (gphoto2).

Turn a plan into a shell script that shoots it with a camera on the USB cable, through the program gphoto2. Read it
before you run it: it is a line a shot. Before each scene it waits for Enter, it puts each frame into a folder beside
itself, and it skips frames that are there. Not tried with a real camera.

    capture script plan.json -o shots/shoot.sh

Then: capture manifest PLAN DIR -o manifests/mine.csv --copy-to data/mine
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from capture.checklist import TEMPLATES, ChecklistRow, calibration_parts
from capture.cli.values import add_plan, load_plan
from capture.observed import format_f_number
from capture.plan import CALIBRATION, Plan
from capture.shots import ScenePlan, Shot, format_minutes, sum_duration_s
from eldata.base.console import OK, add_output, add_shared
from eldata.base.files import write_text
from eldata.base.tables import one_line

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator, Sequence

    from capture.camera import ShutterTime

_NEXT_LINE = "\n    "


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `capture script`."""
    add_plan(parser)
    add_output(parser, "-o", "--output", required=True, help="the script; frames go into folders beside it")
    add_shared(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Write the shell script that takes a plan's shots (`capture script`)."""
    plan, path = load_plan(arguments), Path(arguments.output)
    write_text(path, gphoto_script(plan, Path(arguments.plan).name))
    mode = path.stat().st_mode
    path.chmod(mode | (mode & 0o444) >> 2)  # whoever may read it may run it
    print(f"{path}: {len(plan.shots)} frames, about {format_script_duration(plan)}; read it before you run it")
    return OK


def gphoto_script(plan: Plan, title: str) -> str:
    """Return a POSIX shell script that takes a plan's shots; whatever the plan says is quoted or on one line.

    Parameters
    ----------
    plan
        What to take.
    title
        What to call the plan in the script's first comment, such as its file's name.
    """
    shots = [shot for _, shot in plan.shots]
    times = sorted({shot.setting for shot in shots}, key=lambda time: time.true_s)
    head = (
        f"{title}: {plan.extent}, {len(shots)} frames with {plan.camera.name} ({', '.join(plan.camera.models)}), "
        f"about {format_script_duration(plan)} of exposures and downloads."
    )
    lines = [
        "#!/bin/sh",
        f"# {one_line(head)}",
        "# Written by capture script, and never tried with a real camera: read it before you run it.",
        (TEMPLATES / "gphoto2.sh").read_text(encoding="utf-8"),
        shlex.join(["offers", "iso", *map(str, sorted({shot.iso for shot in shots}))]),
        shlex.join(["offers", "shutterspeed", *dict.fromkeys(_split_time(time)[0] for time in times)]),
    ]
    for scene in plan.scenes:
        lines += _write_part(scene.name, scene.name, _list_scene_words(plan, scene), scene.shots)
    for part in calibration_parts(plan):
        lines += _write_part(CALIBRATION, part.title, (item["text"] for item in part.items), part.shots)
    return "\n".join(lines) + "\n"


def format_script_duration(plan: Plan) -> str:
    """Write how long the exposures and downloads take."""
    return format_minutes(sum_duration_s([shot for _, shot in plan.shots], dial_s=0))


def _split_time(time: ShutterTime) -> list[str]:
    """Return the words that gphoto2 sets: the time's name, or ``Bulb`` and its seconds."""
    return time.dial.replace("bulb", "Bulb").split()


def _list_scene_words(plan: Plan, scene: ScenePlan) -> Iterator[str]:
    """List a scene's metered time, aperture, remarks and notes."""
    yield f"Metered at {scene.metered_s} s, ISO {plan.protocol.base_iso}"
    if scene.aperture is not None:
        yield f"Aperture {format_f_number(scene.aperture)}"
    yield from scene.remarks
    yield from scene.notes


def _write_part(folder: str, title: str, words: Iterable[str], shots: Sequence[Shot]) -> Iterator[str]:
    """Yield the lines of shots that are taken after one preparation."""
    yield f"\n# {title}: {len(shots)} frames"
    yield f"prepare {shlex.quote(_NEXT_LINE.join([title, *(one_line(text) for text in words if text)]))}"
    for shot in shots:
        command = ["shot", f"{folder}/IMG_{shot.number:04d}", str(shot.iso), *_split_time(shot.setting)]
        yield f"{shlex.join(command)}  # {ChecklistRow(shot, 1).what}"
