"""What a session goes through: stages with one preparation each, and the commands that they run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture.apertures import f_text
from capture.checklist_content import before_moment, part_of
from capture.plan import CALIBRATION
from capture.tether.gphoto import CAPTURE, get_arguments, set_arguments

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capture.matching import Slot
    from capture.plan import Plan
    from capture.shots import Shot
    from capture.tether.gphoto import Gphoto


@dataclass(frozen=True, slots=True)
class Stage:
    """Shots that are taken in one go, after one preparation."""

    title: str
    prepare: tuple[str, ...]
    shots: tuple[tuple[Slot, Shot], ...]


def stages_of(plan: Plan) -> tuple[Stage, ...]:
    """Return a plan's stages: each scene, then the bias frames, then the flats."""
    stages = []
    for scene in plan.scenes:
        first = scene.shots[0].setting.dial
        moment = tuple(filter(None, (before_moment(plan, scene),)))
        prepare = (
            f"metered at {scene.metered_s} s, ISO {plan.protocol.base_iso}; the first frame at {first} s",
            *(() if scene.aperture is None else (f"aperture {f_text(scene.aperture)}",)),
            *scene.notes,
            *scene.remarks,
            *moment,
            "tripod and focus fixed, lamps steady, nobody walks; the mode dial on M, image format raw",
        )
        if scene.moment > 1:
            prepare = (*moment, *scene.notes)  # all else is as it was
        stages.append(Stage(scene.name, prepare, tuple(((scene.name, shot.number), shot) for shot in scene.shots)))
    frames = () if plan.calibration is None else plan.calibration.shots
    capped = "lens capped, viewfinder covered, room dark"
    clips_at = "" if plan.calibration is None else f"{plan.calibration.flat_clips_at_s} s, ISO {plan.protocol.base_iso}"
    surface = f"cap off; an evenly lit surface fills the frame, lens at infinity; it clips at {clips_at}"
    how = {
        "bias": ("bias frames", capped),
        "flats": ("flat frames", surface),
        "dark": ("dark frames", f"{capped}; the camera as warm as at the scenes"),
        "warm": ("warm frames", f"{capped}, right after the last scene"),
    }
    for kind, (title, text) in how.items():
        shots = tuple(((CALIBRATION, shot.number), shot) for shot in frames if part_of(shot) == kind)
        if shots:
            stages.append(Stage(title, (text, f"{len(shots)} frames"), shots))
    return tuple(stages)


def commands(plan: Plan, gphoto: Gphoto, done: frozenset[Slot]) -> Iterator[tuple[str, list[str]]]:
    """Yield what a session would run, each with its stage; with the plan's spelling of times, not yet the camera's."""
    yield "before the first shot", [gphoto.program, "--auto-detect"]
    yield "before the first shot", gphoto.command("--list-config")
    yield "before the first shot", gphoto.command(*get_arguments(("iso", "shutterspeed", "imageformat")))
    for stage in stages_of(plan):
        before: dict[str, str] = {}
        for slot, shot in stage.shots:
            if slot in done:
                continue
            title = f"{stage.title} frame {slot[1]}"
            values = {"iso": str(shot.iso), "shutterspeed": shot.setting.dial}
            if values != before:
                yield title, gphoto.command(*set_arguments(values))
                yield title, gphoto.command(*get_arguments(tuple(values)))
                before = values
            yield title, gphoto.command(*CAPTURE)
