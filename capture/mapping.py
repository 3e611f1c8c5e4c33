"""The mapping of files to shots as a JSON file, to be looked at, edited and passed back; metered times and apertures.

Exposure ratios are computed from ISO and time alone, so one aperture must hold for a scene. The plan may state it, EXIF
states it for each file; a lens without contacts states none, which is not a mistake.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capture.capture_errors import MappingError
from capture.matching import Match, MatchRemark, can_be, match, no_file
from capture.observed import f_text, same_aperture
from eldata.base.fields import TextFile
from eldata.base.numbers import counted
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction

    from capture.matching import Slot
    from capture.observed import Observed, ObservedFrame
    from capture.plan import Plan

SCHEMA: Final = 1


def mapping_as_dict(plan: Plan, observed: Observed, match: Match) -> dict[str, Any]:
    """Return the mapping as plain JSON types: one line per shot, the files without one, and the remarks."""
    files = {slot: str(frame.path.absolute()) for slot, frame in match.frames.items()}
    used = {frame.path for frame in match.frames.values()}
    return {
        "schema": SCHEMA,
        "shots": [
            {
                "scene": scene,
                "number": shot.number,
                "shot": f"{shot.role}, {shot.settings}",
                "file": files.get((scene, shot.number)),
            }
            for scene, shot in plan.shots
        ],
        "unused": [
            {"file": str(frame.path.absolute()), "settings": frame.settings}
            for frame in observed.frames
            if frame.path not in used
        ],
        "remarks": [f"{remark.kind}: {remark.text}" for remark in match.remarks],
    }


def load_mapping(path: Path | str, plan: Plan, observed: Observed) -> Match:
    """Read a mapping that was written before and, perhaps, edited.

    Only ``scene``, ``number`` and ``file`` of its ``shots`` are read. A shot without a file, or without a line, is
    missing.

    Raises
    ------
    MappingError
        If the file is malformed, names a shot that the plan does not have, or a file that was not given, is used twice
        or has settings different from its shot's; the message says which.
    """
    top = TextFile(path, MappingError).json()
    top.only(("schema", "shots", "unused", "remarks"))
    top.schema(SCHEMA, "capture")
    known = {(scene, shot.number) for scene, shot in plan.shots}
    given: dict[Path, ObservedFrame] = {frame.path.resolve(): frame for frame in observed.frames}
    frames: dict[Slot, ObservedFrame] = {}
    used: dict[Path, Slot] = {}
    for fields in top.objects("shots"):
        fields.only(("scene", "number", "shot", "file"))
        slot = (fields.text("scene"), fields.whole("number", at_least=1))
        if slot not in known:
            raise fields.wrong("number", f"a shot of the plan ({slot[0]} has none of this number)", slot[1])
        if fields.value("file") is None:
            continue
        if slot in frames:
            raise fields.wrong("number", f"each shot once ({slot[0]} frame {slot[1]} has a file already)", slot[1])
        file = Path(fields.text("file")).resolve()
        if file not in given:
            raise fields.wrong("file", "one of the files given, with the camera's ISO and exposure time", str(file))
        if file in used:
            raise fields.wrong("file", f"each file once ({used[file][0]} frame {used[file][1]} has it)", str(file))
        frames[slot], used[file] = given[file], slot
    remarks = [
        MatchRemark("extra", f"{frame.path.name}: {frame.settings}: left out by the mapping", path=frame.path)
        for path, frame in given.items()
        if path not in used
    ]
    for scene, shot in plan.shots:
        frame = frames.get((scene, shot.number))
        if frame is None:
            remarks.append(MatchRemark("missing", no_file(scene, shot), scene, shot.number))
        elif not can_be(shot, frame):
            raise MappingError(
                f"mapping, {scene} frame {shot.number}: asks for {shot.settings}, and {frame.path} was taken at "
                f"{frame.settings}: its ratio would be wrong. Choose another file, or null to leave the frame out"
            )
    return Match(frames, tuple(remarks))


def explain_metering(plan: Plan, observed: Observed, found: Match) -> Match:
    """Return a match that says of scenes which lack most of their frames at which other metered time these are there.

    Of the frames that this explains, nothing else is said. Only times of frames at the base ISO are tried: references
    are taken at the metered time.
    """
    used = {frame.path for frame in found.frames.values()}
    left = tuple(frame for frame in observed.frames if frame.path not in used)
    dials = {
        setting.nominal_s: setting.dial
        for frame in left
        if frame.iso == plan.protocol.base_iso and frame.exposure_s
        if (setting := plan.camera.nearest(frame.exposure_s)) is not None
    }
    remarks: list[MatchRemark] = []
    explained: set[Path] = set()
    for scene in plan.scenes:
        count = len(scene.shots)
        if 2 * sum(remark.scene == scene.name for remark in found.missing) <= count:
            continue
        rest = replace(observed, frames=left, unusable=())
        tried = [
            (_frames_at(time_s, plan.only([scene.name]), rest), time_s)
            for time_s in sorted(dials.keys() - {scene.metered_s})
        ]
        frames, time_s = max(tried, key=lambda one: len(one[0]), default=(frozenset[Path](), scene.metered_s))
        if 2 * len(frames) > count:
            text = (
                f"{scene.name}: planned for a metered time of {scene.metered_s} s; {len(frames)} of its {count} frames "
                f"are there if it was metered at {dials[time_s]} s. If so: capture plan PLAN --remeter "
                f"{scene.name}={dials[time_s]}, and this again"
            )
            remarks.append(MatchRemark("metered", text, scene.name))
            explained |= frames
    remarks += [one for one in found.remarks if one.path not in explained or one.kind not in ("extra", "wrong-setting")]
    return replace(found, remarks=tuple(remarks))


def _frames_at(time_s: Fraction, scene: Plan, observed: Observed) -> frozenset[Path]:
    """Return the files that are frames of a plan's scene if it was metered at this time."""
    try:
        again = scene.remeter(scene.scenes[0].name, time_s)
    except EldataError:  # some of its shots are beyond the camera
        return frozenset()
    return frozenset(frame.path for frame in match(again, observed).frames.values())


def aperture_remarks(plan: Plan, frames: Mapping[Slot, ObservedFrame]) -> tuple[MatchRemark, ...]:
    """Return where files have another aperture than their scene in the plan, or state none."""
    remarks = []
    for scene in plan.scenes:
        if scene.aperture is None:
            continue
        unknown = []
        for shot in scene.shots:
            frame = frames.get((scene.name, shot.number))
            if frame is None:
                continue
            if frame.f_number is None:
                unknown.append(frame.path.name)
            elif not same_aperture(frame.f_number, scene.aperture):
                text = (
                    f"{frame.path.name} ({scene.name} frame {shot.number}): taken at {f_text(frame.f_number)}, where "
                    f"the plan has {f_text(scene.aperture)}: take the scene again; or, if all of it was taken so, "
                    f"correct the plan with capture plan --aperture {scene.name}={float(frame.f_number):.4g}"
                )
                remarks.append(MatchRemark("aperture", text, scene.name, shot.number, frame.path))
        if unknown:
            text = (
                f"{scene.name}: {counted(len(unknown), 'file')} without an aperture, such as {unknown[0]}, so that "
                f"{f_text(scene.aperture)} cannot be checked; a lens without contacts states none"
            )
            remarks.append(MatchRemark("note", text, scene.name))
    return tuple(remarks)
